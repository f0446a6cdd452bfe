"""What the commands that make new surfaces share: settings, the run itself, and its report."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from vhp_cli.commands.common import (
    ERRORS,
    FAILED,
    PASSED,
    ProgressBar,
    report_base,
    report_target,
    show_report,
    write_reports,
)
from vhp_cli.commands.declaring import Declared, hand_on_settings

if TYPE_CHECKING:
    from vhp_cli.config import Settings
    from vhp_cli.pipeline.stage import Plan, Stage
    from vhp_cli.pipeline.staged import Staged


@dataclass(frozen=True, slots=True)
class Shared:
    """The values of `model_options`, `stage_options`, `judging_options`, `report_options` and `worker_options`."""

    model: tuple[Path, ...]
    recursive: bool
    units: str | None
    weld_tolerance: float | None
    output: Path
    overwrite: bool
    dry_run: bool
    config: Path | None
    profile: str | None
    select: list[str]
    ignore: list[str]
    min_q: float | None
    min_edge: float | None
    gap: float | None
    gap_search: float | None
    reports: tuple[str, ...]
    form: str | None
    jobs: int | None
    timeout: float
    memory: float
    cache: bool

    def settings(self) -> Settings:
        """Put the settings together."""
        from vhp_cli.config import load_settings

        limits = (("Q001", self.min_q), ("Q002", self.min_edge), ("P005", self.gap))
        return load_settings(
            config=self.config,
            model=self.model,
            profile=self.profile,
            select=self.select,
            ignore=self.ignore,
            limits={code: value for code, value in limits if value is not None},
            units=self.units,
            weld_tolerance_mm=self.weld_tolerance,
            gap_search_mm=self.gap_search,
            recursive=self.recursive,
        )


def run_staged(
    ctx: click.Context,
    stage: Stage,
    settings: Settings,
    request: Shared,
    *,
    run: Callable[..., Staged] | None = None,
    plan: Callable[..., Plan] | None = None,
    declared: Declared | None = None,
) -> None:
    """Run a stage over a model, report on the result, and end with its exit code.

    `run` takes the place of `vhp_cli.pipeline.staged.run_and_check`, `plan` that of
    `vhp_cli.pipeline.stage.plan_stage`. `declared` are pairs that the settings know already.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

    from vhp_cli.model import find_model
    from vhp_cli.pipeline.stage import Limits, plan_stage

    model, output = request.model, request.output
    targets = [report_target(report, request.form) for report in request.reports]
    found = find_model(model, recursive=settings.recursive)
    for tissue in found.tissues:
        # A mistake is told before the first tissue is done.
        stage.options(tissue.name)
    talk = ctx.obj or {}
    if request.dry_run:
        planned = (plan or plan_stage)(found, output, stage, settings, paths=model, overwrite=request.overwrite)
        for tissue, file in zip(found.tissues, planned.files, strict=True):
            todo = "keep" if file in planned.done else stage.command
            click.echo(f"{tissue.name}\t{todo}\t{tissue.path}\t{output / file}")
        return
    if not talk.get("quiet"):
        for pattern in settings.idle_patterns(tissue.name for tissue in found.tissues):
            click.echo(f"note: no tissue matches {pattern!r} of the settings", err=True)

    from vhp_cli.pipeline.cache import default_directory
    from vhp_cli.pipeline.output import REPORT, foreign_meshes
    from vhp_cli.pipeline.staged import run_and_check

    with ProgressBar(quiet=talk.get("quiet", False)) as progress:
        done = (run or run_and_check)(
            found,
            output,
            stage,
            settings,
            paths=model,
            jobs=request.jobs,
            limits=Limits(request.timeout, request.memory),
            overwrite=request.overwrite,
            cache_directory=default_directory() if request.cache else None,
            progress=progress,
        )
    untold = hand_on_settings(request.config, model, output, declared or Declared())
    report = done.report
    write_reports(report, [*targets, (output / REPORT, "json")], report_base((output,)))
    to_stdout = next((target_form for path, target_form in targets if path is None), request.form)
    show_report(report, to_stdout or "table", report_base((output,)), **talk)
    if not talk.get("quiet"):
        if untold:
            click.echo(f"note: {untold}", err=True)
        if done.reused:
            click.echo(f"note: {done.reused} of {len(report['tissues'])} were taken from the run before", err=True)
        if others := foreign_meshes(output, [tissue["file"] for tissue in report["tissues"]]):
            click.echo(f"note: {output} holds other meshes, which this run left alone: {', '.join(others)}", err=True)
    if done.failed:
        ctx.exit(FAILED)
    ctx.exit(PASSED if report["summary"]["passed"] else ERRORS)
