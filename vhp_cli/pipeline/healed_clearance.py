"""Heal a model, then take its tissues apart: two stages, one result."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path

from vhp_cli import formats
from vhp_cli.config import Settings
from vhp_cli.errors import UsageError
from vhp_cli.inspection.deviation import deviation
from vhp_cli.measures import Deviation, Report, TissueRecord
from vhp_cli.model import Model
from vhp_cli.pipeline.check import Progress
from vhp_cli.pipeline.clearance import separate_model
from vhp_cli.pipeline.journal import read_journal
from vhp_cli.pipeline.measuring import parse_in_mm
from vhp_cli.pipeline.output import output_files, refuse_overlap
from vhp_cli.pipeline.stage import Limits, Plan, Stage, plan_stage
from vhp_cli.pipeline.staged import Staged, run_and_check
from vhp_cli.stages.clearance.options import ClearanceOptions
from vhp_cli.stages.clearance.relations import gap_of


def plan_healing(
    model: Model,
    out: Path,
    stage: Stage,
    options: ClearanceOptions,
    settings: Settings,
    *,
    paths: Sequence[Path],
    overwrite: bool = False,
) -> Plan:
    """Return what `heal_and_separate` would do; nothing is written.

    Raises
    ------
    UsageError
        If the output directory can't be used.
    """
    _refuse_foreign(out, model, paths, overwrite=overwrite)
    between = _between(out)
    healed = plan_stage(model, between, stage, settings, paths=paths, overwrite=overwrite)
    if not between.exists():
        # All was finished, or nothing begun.
        recorded = None if overwrite else read_journal(out)
        done = recorded.entries if recorded and recorded.entries.keys() == set(healed.files) else {}
        return Plan(healed.files, done, done, {})
    return healed


def heal_and_separate(
    model: Model,
    out: Path,
    stage: Stage,
    options: ClearanceOptions,
    settings: Settings,
    *,
    paths: Sequence[Path],
    jobs: int | None = None,
    limits: Limits | None = None,
    overwrite: bool = False,
    cache_directory: Path | None = None,
    progress: Progress | None = None,
) -> Staged:
    """Heal a model, take the healed tissues apart, and report on both together.

    The healed tissues lie in a hidden directory beside the output until all is done, so that a run that was stopped
    is taken up where it was.

    Parameters
    ----------
    stage
        How it is healed.
    options
        How it is taken apart.
    model, out, settings, paths, jobs, limits, overwrite, cache_directory, progress
        As of `vhp_cli.pipeline.staged.run_and_check`.

    Raises
    ------
    UsageError
        If the output directory can't be used, or not one file could be read.
    """
    _refuse_foreign(out, model, paths, overwrite=overwrite)
    between = _between(out)
    files = output_files(model, paths)
    healed = run_and_check(
        model,
        between,
        stage,
        settings,
        paths=paths,
        jobs=jobs,
        limits=limits,
        overwrite=overwrite,
        cache_directory=cache_directory,
        progress=progress,
    )
    halfway = Model(
        tuple(
            type(tissue)(tissue.name, between / file, file, tissue.clashes)
            for tissue, file in zip(model.tissues, files, strict=True)
        ),
        model.unread,
    )
    apart = separate_model(
        halfway,
        out,
        options,
        settings,
        paths=[between],
        jobs=jobs,
        limits=limits,
        overwrite=overwrite,
        cache_directory=cache_directory,
        progress=progress,
    )
    report = _together(healed.report, apart.report, model, out, settings, stage.described)
    failed = healed.failed or apart.failed
    if not failed:
        shutil.rmtree(between, ignore_errors=True)
    return Staged(report, failed, healed.reused)


def _refuse_foreign(out: Path, model: Model, paths: Sequence[Path], *, overwrite: bool) -> None:
    refuse_overlap(out, model, paths)
    if not overwrite and out.is_dir() and any(out.iterdir()) and read_journal(out) is None:
        raise UsageError(f"{out} is not empty", hint="give another directory, or --overwrite")


def _between(out: Path) -> Path:
    return out.with_name(f".{out.name}.healed")


def _together(
    healed: Report, apart: Report, model: Model, out: Path, settings: Settings, described: Mapping[str, object]
) -> Report:
    tissues = [
        _record(first, second, source.path, out / second["file"], settings)
        for first, second, source in zip(healed["tissues"], apart["tissues"], model.tissues, strict=True)
    ]
    statuses = [record["status"] for record in tissues]
    seconds = {
        **{f"heal: {step}": value for step, value in _seconds(healed).items() if step != "total"},
        **{step: value for step, value in _seconds(apart).items() if step != "total"},
    }
    return {
        **apart,
        "command": "heal",
        "settings": {**apart["settings"], "heal": dict(described)},
        "model": healed["model"],
        "summary": {
            **apart["summary"],
            "status": {status: statuses.count(status) for status in ("changed", "unchanged", "refused", "failed")},
        },
        "tissues": tissues,
        "run": {**apart["run"], "seconds": {**seconds, "total": round(sum(seconds.values()), 4)}},
    }


def _seconds(report: Report) -> dict[str, float]:
    found = report["run"]["seconds"]
    assert isinstance(found, dict)
    return found


def _record(first: TissueRecord, second: TissueRecord, given: Path, made: Path, settings: Settings) -> TissueRecord:
    """Return the record of a tissue that went through both stages."""
    statuses = (first["status"], second["status"])
    status = next(one for one in ("failed", "changed", "refused", "unchanged") if one in statuses)
    changes = [record for record in (first, second) if record["status"] == "changed"]
    old, new = first["before"], second
    known = bool(old["closed"] and new["closed"] and old["volume_mm3"])
    return {
        **second,
        "status": status,
        "reason": "; ".join(record["reason"] for record in (first, second) if record["reason"]),
        "actions": [*first["actions"], *second["actions"]],
        "introduced": [*first["introduced"], *second["introduced"]],
        "before": old,
        "deviation_mm": _apart(given, made, settings)
        if len(changes) == 2
        else (changes or [second])[0]["deviation_mm"],
        "volume_change": abs(new["volume_mm3"]) / abs(old["volume_mm3"]) - 1.0 if known else None,
    }


def _apart(given: Path, made: Path, settings: Settings) -> Deviation:
    first, second = (parse_in_mm(path, formats.read_bytes(path), settings).mesh for path in (given, made))
    return deviation(first, second, lost_limit_mm=gap_of(given.stem, given.stem, settings))
