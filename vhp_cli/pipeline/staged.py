"""A stage from end to end: check the model, run the stage, check what was written."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from vhp_cli.config import Settings
from vhp_cli.measures import Report
from vhp_cli.model import Model
from vhp_cli.pipeline.check import Progress, check_model
from vhp_cli.pipeline.journal import Entry, engine_versions
from vhp_cli.pipeline.stage import Limits, Stage, plan_stage, run_stage
from vhp_cli.pipeline.stage_report import stage_report


@dataclass(frozen=True, slots=True)
class Staged:
    """The report of a stage, whether a tissue could not be processed, and how many an earlier run had finished."""

    report: Report
    failed: bool
    reused: int


def run_and_check(
    model: Model,
    out: Path,
    stage: Stage,
    settings: Settings,
    *,
    paths: Sequence[Path],
    jobs: int | None = None,
    limits: Limits | None = None,
    overwrite: bool = False,
    cache_directory: Path | None = None,
    progress: Progress | None = None,
) -> Staged:
    """Run a stage over a model and report on it; parameters and errors as of `run_stage` and `check_model`."""

    def named(name: str) -> Progress | None:
        if progress is None:
            return None
        return lambda step, done, total: progress(f"{name}: {step}", done, total)

    # A mistake in the usage is found before anything is measured.
    plan_stage(model, out, stage, settings, paths=paths, overwrite=overwrite)
    before = check_model(
        model, settings, paths=paths, jobs=jobs, cache_directory=cache_directory, progress=named("input")
    )
    soften: list[str] = []
    seconds, reused = 0.0, None
    while True:
        started = time.perf_counter()
        run = run_stage(
            model,
            out,
            stage,
            settings,
            paths=paths,
            jobs=jobs,
            limits=limits,
            overwrite=overwrite,
            soften=soften,
            progress=progress,
        )
        seconds += time.perf_counter() - started
        reused = run.reused if reused is None else reused
        after = check_model(
            run.written, settings, paths=[out], jobs=jobs, cache_directory=cache_directory, progress=named("result")
        )
        report = stage_report(before.report, after.report, run.entries, command=stage.command, options=stage.described)
        soften = [
            entry.file
            for record, entry in zip(report["tissues"], run.entries, strict=True)
            if record.get("introduced") and entry.level < stage.most_gentle
        ]
        if not soften:
            break
        overwrite = False
    report["run"] = run_facts(
        before.report, after.report, run.entries, stage.command, seconds, reused, limits or Limits()
    )
    failed = after.failed or any(entry.status == "failed" for entry in run.entries)
    return Staged(report, failed, reused)


def run_facts(
    before: Report, after: Report, entries: Sequence[Entry], command: str, seconds: float, reused: int, limits: Limits
) -> dict[str, object]:
    """Return times and facts of the machine, those of both checks together."""
    steps: dict[str, float] = {}
    for prefix, report in (("input", before), ("result", after)):
        found = report["run"]["seconds"]
        assert isinstance(found, dict)
        steps |= {f"{prefix} {step}": value for step, value in found.items() if step != "total"}
    steps[command] = round(seconds, 4)
    return {
        **after["run"],
        "started": before["run"]["started"],
        "seconds": {**steps, "total": round(sum(steps.values()), 4)},
        "timeout_s": limits.timeout_s,
        "memory_gb": limits.memory_gb,
        "reused": reused,
        "tissue_seconds": {entry.file: entry.seconds for entry in entries},
        "engines": {name: version for name, version in engine_versions().items() if version},
    }
