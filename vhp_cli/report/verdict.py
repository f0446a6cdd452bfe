"""What the findings of a report mean for each tissue and for the whole model."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass

from vhp_cli.measures import Finding, Level, PipelineStage, Report, TissueRecord
from vhp_cli.report.text import number, plural, visible
from vhp_cli.rules import RULES

LEVELS: tuple[Level, ...] = ("error", "warning", "note")  # worst first


@dataclass(frozen=True, slots=True)
class Verdict:
    """The outcome for one tissue: numbers of findings by level, those of the baseline apart."""

    errors: int
    warnings: int
    notes: int
    known: int
    rules: tuple[str, ...]  # broken rules that explain the verdict: those of the errors, else of the warnings

    @property
    def passed(self) -> bool:
        """Whether no new error was found."""
        return self.errors == 0

    @property
    def words(self) -> str:
        """``pass``, ``2 errors T001 X001``, ``pass, 1 warning F010``, ``pass, 1 known T001``."""
        if self.errors:
            return " ".join((plural(self.errors, "error"), *self.rules))
        if self.warnings:
            return " ".join((f"pass, {plural(self.warnings, 'warning')}", *self.rules))
        if self.known:
            return " ".join((f"pass, {self.known} known", *self.rules))
        return "pass"


def _identity(finding: Finding) -> tuple[str, tuple[str, ...], str]:
    return finding["rule"], tuple(finding["tissues"]), finding["message"]


def all_findings(report: Report) -> list[Finding]:
    """Return the findings of the report, and any of its tissues that are missing there."""
    findings = list(report["findings"])
    seen = {_identity(finding) for finding in findings}
    for tissue in report["tissues"]:
        for finding in tissue["findings"]:
            if _identity(finding) not in seen:
                seen.add(_identity(finding))
                findings.append(finding)
    return findings


def judge(findings: Iterable[Finding]) -> Verdict:
    """Count findings by level; known ones don't count as errors, warnings or notes."""
    by_level: dict[str, list[str]] = {level: [] for level in LEVELS}
    known: list[str] = []
    for finding in findings:
        (known if finding.get("known") else by_level[finding["level"]]).append(finding["rule"])
    explained = by_level["error"] or by_level["warning"] or known
    return Verdict(
        errors=len(by_level["error"]),
        warnings=len(by_level["warning"]),
        notes=len(by_level["note"]),
        known=len(known),
        rules=tuple(sorted(set(explained))),
    )


def tissue_verdicts(report: Report) -> list[Verdict]:
    """Judge each tissue by all findings that name it, alone or with others, in the order of the report."""
    by_name: dict[str, list[Finding]] = defaultdict(list)
    for finding in all_findings(report):
        for name in dict.fromkeys(finding["tissues"]):
            by_name[name].append(finding)
    return [judge(by_name[tissue["name"]]) for tissue in report["tissues"]]


def by_rule(findings: Iterable[Finding]) -> list[tuple[str, list[Finding]]]:
    """Group findings by rule: errors before warnings before notes, new before known, many before few.

    A rule whose level differs between tissues stands where its worst finding stands.
    """
    groups: dict[str, list[Finding]] = defaultdict(list)
    for finding in findings:
        groups[finding["rule"]].append(finding)
    for group in groups.values():
        group.sort(key=lambda finding: (*_severity(finding), -finding["count"], finding["tissues"]))
    return sorted(groups.items(), key=lambda item: (*_severity(item[1][0]), item[0]))


def _severity(finding: Finding) -> tuple[bool, int]:
    return bool(finding.get("known")), LEVELS.index(finding["level"])


def is_staged(report: Report) -> bool:
    """Tell if the report is that of a stage such as heal, so that its tissues have a status."""
    return any("status" in tissue for tissue in report["tissues"])


def deviation(tissue: TissueRecord) -> str:
    """Return the greatest distance in mm between input and output of a stage; ``-`` where there is none."""
    found = tissue.get("deviation_mm")
    return number(found["max"] if found else None)


def stage_words(tissue: TissueRecord) -> str:
    """Return what a stage made of a tissue in one line: ``refused: ...``, ``changed, at most 0.02 mm off: ...``."""
    words = tissue.get("status", "")
    if words == "changed":
        words += f", at most {deviation(tissue)} mm off"
    said = [tissue.get("reason", ""), *(action["message"] for action in tissue.get("actions", []))]
    if detail := "; ".join(filter(None, said)):
        words += f": {visible(detail)}"
    return words


def stage_tissues(stage: PipelineStage) -> str:
    """Return how many tissues a stage of a pipeline worked on, by status if it has any: ``3 changed, 1 refused``."""
    summary = stage["summary"]
    if not summary:
        return "-"
    status = summary.get("status")
    return (
        ", ".join(f"{count:,} {name}" for name, count in status.items() if count) if status else str(summary["tissues"])
    )


def left_alone(report: Report) -> list[TissueRecord]:
    """Return the tissues that a stage failed on or refused, failed ones first."""
    found = [tissue for tissue in report["tissues"] if tissue.get("status") in ("failed", "refused")]
    return sorted(found, key=lambda tissue: tissue.get("status", ""))


def rule_name(code: str) -> str:
    """Return ``T001 open-edge``; the bare code if the rule is not in the table."""
    return f"{code} {RULES[code].name}" if code in RULES else code


def seconds(report: Report) -> float | None:
    """Total run time in s: the step ``total``, else the sum of the steps; None if nothing was timed."""
    steps = report["run"].get("seconds")
    if not isinstance(steps, dict) or not steps:
        return None
    times = {step: float(time) for step, time in steps.items() if isinstance(time, (int, float))}
    return times.get("total", sum(times.values())) if times else None


def closing_line(report: Report) -> str:
    """Return the verdict on the model in one line, with the numbers behind it."""
    summary = report["summary"]
    known = sum(bool(finding.get("known")) for finding in all_findings(report))
    words = (
        f"{'passed' if summary['passed'] else 'failed'}: "
        f"{plural(summary['tissues'], 'tissue')}, {plural(summary['triangles'], 'triangle')}; "
        f"{plural(summary['errors'], 'error')}, {plural(summary['warnings'], 'warning')}, "
        f"{plural(summary['notes'], 'note')}"
    )
    if known:
        words += f", {known:,} of them known"
    if status := summary.get("status"):
        words += f"; {', '.join(f'{count:,} {name}' for name, count in status.items() if count) or 'nothing done'}"
    time = seconds(report)
    return words if time is None else f"{words}; {time:.2f} s"
