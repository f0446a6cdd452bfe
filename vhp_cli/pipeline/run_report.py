"""The report of a pipeline: that of its final surfaces, with a section on every stage."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Literal

from vhp_cli import __version__
from vhp_cli.measures import Finding, PipelineSection, PipelineStage, Report
from vhp_cli.pipeline.check import SCHEMA, with_findings
from vhp_cli.pipeline.output import REPORT
from vhp_cli.pipeline.run import ERRORS, FAILED, FINAL, PASSED, USAGE, PipelineDone, StageDone
from vhp_cli.rules import RULES

_OUTCOMES: dict[int | None, Literal["passed", "errors", "failed", "refused", "not run"]] = {
    PASSED: "passed",
    ERRORS: "errors",
    USAGE: "refused",
    FAILED: "failed",
    None: "not run",
}
_NOT_PROCESSED = "F012"
# Families of rules on results that are no surfaces.
_OF_RESULTS = {"tetmesh": "M", "breathe": "B"}


def pipeline_report(done: PipelineDone, name: str, model: Sequence[Path], settings: dict[str, object]) -> Report:
    """Return the report of a pipeline.

    Parameters
    ----------
    done
        What came of it.
    name
        The file, or the preset.
    model
        The model as named by the user.
    settings
        Those of the final check, if no stage has a report.
    """
    base = _base(done.stages, settings)
    deciding = _deciding(done.stages)
    findings = list(base["findings"])
    for stage in done.stages:
        findings += _new_findings(stage, findings)
        findings += _not_processed(stage, {record["name"] for record in base["tissues"]})
    report = with_findings(base, findings)
    code = exit_code(done.stages)
    section: PipelineSection = {
        "name": name,
        "stages": [_section(stage, decides=stage in deciding) for stage in done.stages],
        "surfaces": FINAL if done.surfaces else None,
        "surfaces_of": done.surfaces or None,
        "exit_code": code,
    }
    seconds = {stage.step.directory: round(stage.seconds, 4) for stage in done.stages if stage.exit_code is not None}
    place = surfaces_place(done)
    for record in report["tissues"]:
        record["file"] = f"{place}/{record['file']}" if place else record["file"]
    report["command"] = "run"
    report["model"] = {**report["model"], "paths": [path.as_posix() for path in model]}
    report["summary"] = {**report["summary"], "passed": code == PASSED}
    report["pipeline"] = section
    report["run"] = {
        **report["run"],
        "seconds": {**seconds, "total": round(sum(seconds.values()), 4)},
        "reused": [stage.step.directory for stage in done.stages if stage.reused],
    }
    return report


def surfaces_place(done: PipelineDone) -> str:
    """Return where the surfaces lie that the report is about, below the output directory; empty: in the model."""
    stage = _last_on_surfaces(done.stages)
    if stage is None:
        return ""
    directory = stage.step.directory if stage.step.makes_surfaces else stage.given
    return FINAL if directory and directory == done.surfaces else directory


def exit_code(stages: Sequence[StageDone]) -> int:
    """Return the exit code of a pipeline: the highest of those that count.

    Errors that surfaces had on the way do not, as later stages may have cured them; the last check has the word. What
    could not be processed always does.
    """
    deciding = _deciding(stages)
    codes = [stage.exit_code for stage in stages if stage in deciding or stage.exit_code in (USAGE, FAILED)]
    return max((code for code in codes if code is not None), default=PASSED)


def _deciding(stages: Sequence[StageDone]) -> list[StageDone]:
    """Return the stages whose errors count: those that nothing after them can cure.

    That are those after the last surfaces, those that make something else of surfaces, and one that ended the pipeline.
    """
    last = max((index for index, stage in enumerate(stages) if stage.step.makes_surfaces), default=-1)
    ran = [stage for stage in stages if stage.exit_code is not None]
    ended = ran[-1:] if len(ran) < len(stages) else []
    return [
        stage
        for index, stage in enumerate(stages)
        if index > last or stage in ended or not (stage.step.makes_surfaces or stage.step.command == "check")
    ]


def _base(stages: Sequence[StageDone], settings: dict[str, object]) -> Report:
    """Return the last report on surfaces."""
    stage = _last_on_surfaces(stages)
    if stage is not None and stage.report is not None:
        return stage.report
    return {
        "schema": SCHEMA,
        "tool": {"name": "vhp", "version": __version__},
        "command": "run",
        "settings": settings,
        "model": {},
        "summary": {
            "passed": False,
            "tissues": 0,
            "triangles": 0,
            "pairs": 0,
            "errors": 0,
            "warnings": 0,
            "notes": 0,
            "counts": {},
        },
        "tissues": [],
        "pairs": [],
        "nesting": {},
        "findings": [],
        "run": {},
    }


def _last_on_surfaces(stages: Sequence[StageDone]) -> StageDone | None:
    found = (one for one in reversed(stages) if one.step.makes_surfaces or one.step.command == "check")
    return next((stage for stage in found if stage.report is not None), None)


def _new_findings(stage: StageDone, known: Sequence[Finding]) -> list[Finding]:
    """Return what a stage found on results that are no surfaces, so that every form of the report tells it."""
    if stage.report is None or stage.step.makes_surfaces or stage.step.command == "check":
        return []
    family = _OF_RESULTS.get(stage.step.command)
    seen = {(finding["rule"], tuple(finding["tissues"]), finding["message"]) for finding in known}
    return [
        finding
        for finding in stage.report["findings"]
        if (finding["rule"].startswith(family) if family else finding["level"] == "error")
        and (finding["rule"], tuple(finding["tissues"]), finding["message"]) not in seen
    ]


def _not_processed(stage: StageDone, names: Collection[str]) -> list[Finding]:
    """Return a finding for each tissue that a stage failed on, or for a stage that came to no result.

    It counts whatever the settings say of its rule, as the exit code does.
    """
    where = stage.step.directory
    failed = [
        (record["name"], record.get("reason", ""))
        for record in (stage.report["tissues"] if stage.report else [])
        if record.get("status") == "failed"
    ]
    if stage.exit_code in (USAGE, FAILED) and not failed:
        failed = [("", f"vhp {stage.step.command} ended with exit code {stage.exit_code}; see its messages")]
    return [
        {
            "rule": _NOT_PROCESSED,
            "level": "error",
            "tissues": [name] if name in names else [],
            "count": 1,
            "message": f"{where}: {reason}",
            "places": [],
            "hint": RULES[_NOT_PROCESSED].fix,
        }
        for name, reason in failed
    ]


def _section(stage: StageDone, *, decides: bool) -> PipelineStage:
    step, report = stage.step, stage.report
    left_alone = [
        {"name": record["name"], "status": str(record.get("status")), "reason": record.get("reason", "")}
        for record in (report["tissues"] if report else [])
        if record.get("status") in ("refused", "failed")
    ]
    return {
        "directory": step.directory,
        "command": step.command,
        "options": dict(step.options),
        "given": stage.given,
        "outcome": _OUTCOMES[stage.exit_code],
        "exit_code": stage.exit_code,
        "on_error": step.on_error,
        "decides": decides,
        "report": f"{step.directory}/{REPORT}" if report else None,
        "summary": report["summary"] if report else None,
        "left_alone": left_alone,
    }
