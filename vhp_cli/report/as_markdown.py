"""The report as Markdown, such as for the step summary of a CI job."""

from __future__ import annotations

import re

from vhp_cli.measures import Finding, PipelineSection, Report
from vhp_cli.report import text
from vhp_cli.report.verdict import (
    Verdict,
    all_findings,
    by_rule,
    closing_line,
    deviation,
    is_staged,
    left_alone,
    rule_name,
    stage_tissues,
    stage_words,
    tissue_verdicts,
)
from vhp_cli.rules import RULES

_FINDINGS_PER_RULE = 20
_PLACES_PER_FINDING = 3
_SPECIAL = re.compile(r"[\\`*\[\]~!#@]|:(?=\S)|(?<![^\W_])_|_(?![^\W_])")
_ENTITIES = {"&": "&amp;", "<": "&lt;", ">": "&gt;", "|": "&#124;"}


def escape(words: str) -> str:
    """Return words that Markdown (CommonMark, GitHub tables) shows as they are, on one line."""
    words = _SPECIAL.sub(lambda match: f"\\{match.group()}", text.visible(words))
    return re.sub("[&<>|]", lambda match: _ENTITIES[match.group()], words)


def table_row(cells: list[str]) -> str:
    """Return one line of a table; the cells are Markdown already."""
    return f"| {' | '.join(cells)} |"


def _tissue_table(report: Report, verdicts: list[Verdict]) -> list[str]:
    staged = is_staged(report)
    more = (" Status | Deviation (mm) |", " :--- | ---: |") if staged else ("", "")
    lines = [
        f"| No | Tissue | Triangles | Mesh quality | Min. edge (mm) |{more[0]} Tissue type | Verdict |",
        f"| ---: | :--- | ---: | ---: | ---: |{more[1]} :--- | :--- |",
    ]
    for no, (tissue, verdict) in enumerate(zip(report["tissues"], verdicts, strict=True), start=1):
        quality, edge = tissue["quality"], tissue["edge_mm"]
        cells = [
            str(no),
            escape(tissue["name"]),
            f"{tissue['triangles']:,}",
            text.number(quality["min"] if quality else None),
            text.number(edge["min"] if edge else None),
            *((tissue.get("status", ""), deviation(tissue)) if staged else ()),
            escape(tissue["tissue_type"]),
            verdict.words if verdict.passed else f"**{verdict.words}**",
        ]
        lines.append(table_row(cells))
    return lines


def _finding_lines(finding: Finding) -> list[str]:
    mark = " (known)" if finding.get("known") else ""
    lines = [f"- {escape(text.headline(finding))}{mark}"]
    lines += [f"  - {escape(text.place(place))}" for place in finding["places"][:_PLACES_PER_FINDING]]
    if len(finding["places"]) > _PLACES_PER_FINDING or finding["count"] > len(finding["places"]) > 0:
        lines.append("  - ...")
    return lines


def _rule_section(code: str, findings: list[Finding]) -> list[str]:
    lines = [f"### {escape(rule_name(code))} ({findings[0]['level']})", ""]
    if code in RULES:
        lines += [escape(RULES[code].summary), ""]
    for finding in findings[:_FINDINGS_PER_RULE]:
        lines += _finding_lines(finding)
    if len(findings) > _FINDINGS_PER_RULE:
        lines.append(f"- ... and {len(findings) - _FINDINGS_PER_RULE:,} more")
    hint = next((finding["hint"] for finding in findings if finding["hint"]), "")
    return [*lines, "", f"Fix: {escape(hint)}", ""] if hint else [*lines, ""]


def pipeline_lines(section: PipelineSection) -> list[str]:
    """Return the table of the stages of a pipeline, and the tissues that they left alone."""
    lines = [
        table_row(["Stage", "Outcome", "Tissues", "Triangles", "Errors"]),
        "| :--- | :--- | :--- | ---: | ---: |",
    ]
    for stage in section["stages"]:
        summary = stage["summary"]
        outcome = stage["outcome"] if stage["outcome"] == "passed" else f"**{stage['outcome']}**"
        triangles, errors = (f"{summary[key]:,}" if summary else "-" for key in ("triangles", "errors"))
        lines.append(table_row([escape(stage["directory"]), outcome, stage_tissues(stage), triangles, errors]))
    left = [
        f"- {escape(stage['directory'])}: {escape(tissue['name'])} {tissue['status']}: {escape(tissue['reason'])}"
        for stage in section["stages"]
        for tissue in stage["left_alone"]
    ]
    return [*lines, "", *left] if left else lines


def render_markdown(report: Report) -> str:
    """Return the verdict, the table of tissues (thesis Table 4.3) and the findings by rule."""
    verdict = "passed" if report["summary"]["passed"] else "FAILED"
    lines = [f"## vhp {escape(report['command'])}: {verdict}", "", escape(closing_line(report)), ""]
    if "pipeline" in report:
        lines += [*pipeline_lines(report["pipeline"]), ""]
    if report["tissues"]:
        lines += [*_tissue_table(report, tissue_verdicts(report)), ""]
    if tissues := left_alone(report):
        lines += [f"- {escape(tissue['name'])}: {escape(stage_words(tissue))}" for tissue in tissues]
        lines.append("")
    for code, findings in by_rule(all_findings(report)):
        lines += _rule_section(code, findings)
    return "\n".join(lines).rstrip("\n") + "\n"
