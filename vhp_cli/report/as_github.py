"""The report as workflow commands, which GitHub shows as annotations of a run."""

from __future__ import annotations

from vhp_cli.measures import Finding, Report, TissueRecord
from vhp_cli.report import text
from vhp_cli.report.verdict import all_findings, by_rule, closing_line, left_alone, rule_name, stage_words

_COMMAND = {"error": "error", "warning": "warning", "note": "notice"}


def _data(words: str) -> str:
    return words.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _property(words: str) -> str:
    return _data(words).replace(":", "%3A").replace(",", "%2C")


def _line(finding: Finding, files: dict[str, str], base: str) -> str:
    known = bool(finding.get("known"))
    properties = [f"title={_property(rule_name(finding['rule']) + (' (known)' if known else ''))}"]
    file = next((files[name] for name in finding["tissues"] if name in files), "")
    if file:
        properties.insert(0, f"file={_property(text.visible(text.file_path(base, file)))}")
    lines = [text.headline(finding), *(text.place(place) for place in finding["places"][:3])]
    if finding["hint"]:
        lines.append(f"Fix: {text.visible(finding['hint'])}")
    command = "notice" if known else _COMMAND[finding["level"]]
    return f"::{command} {','.join(properties)}::{_data(chr(10).join(lines))}"


def _stage_line(tissue: TissueRecord, base: str) -> str:
    command = "error" if tissue.get("status") == "failed" else "warning"
    file = _property(text.visible(text.file_path(base, tissue["file"])))
    return f"::{command} file={file},title={tissue.get('status')}::{_data(text.visible(tissue['name']))}: " + _data(
        stage_words(tissue)
    )


def render_github(report: Report, *, base: str = "") -> str:
    """Return one workflow command per finding, worst first, and the verdict as a plain line.

    Parameters
    ----------
    report
        The report.
    base
        What to put before the file of a tissue so that it is relative to the repository, such as ``"model/"``.
    """
    files = {tissue["name"]: tissue["file"] for tissue in report["tissues"]}
    lines = [_line(finding, files, base) for _, group in by_rule(all_findings(report)) for finding in group]
    lines += [_stage_line(tissue, base) for tissue in left_alone(report)]
    return "\n".join((*lines, f"vhp {text.visible(report['command'])} {closing_line(report)}")) + "\n"
