"""``vhp heal``: surfaces that a solver refuses in, surfaces that pass the gate out."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import replace
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
from vhp_cli.commands.options import judging_options, model_options, report_options, stage_options, worker_options

if TYPE_CHECKING:
    from vhp_cli.config import Settings
    from vhp_cli.stages.heal.options import HealOptions

TARGET = "vhp_cli.stages.heal:heal"
_LENGTH = click.FloatRange(min=0, min_open=True)


@click.command()
@model_options
@stage_options
@click.option(
    "--max-deviation",
    type=_LENGTH,
    metavar="MM",
    help="How far a surface may move. [default: 0.1 % of the tissue's diagonal, at most 0.1 mm]",
)
@click.option(
    "--target-q",
    type=click.FloatRange(0, 0.9),
    metavar="Q",
    help="Bring all triangles to this q = 2 r_in / r_out. [default: 0.3]",
)
@click.option("--edge-length", type=_LENGTH, metavar="MM", help="Remesh to this edge length. [default: as it is]")
@click.option("--max-triangles", type=click.IntRange(min=4), metavar="N", help="Most triangles of a tissue.")
@click.option(
    "--cap-openings/--keep-openings",
    default=None,
    help="Close wide openings, or leave open surfaces open and heal the rest. [default: close]",
)
@click.option("--min-component", type=_LENGTH, metavar="MM", help="Remove separate parts smaller than this.")
@click.option("--only-topology", is_flag=True, help="Close, orient and resolve; leave the shape of triangles alone.")
@click.option("--thicken", type=_LENGTH, metavar="MM", help="Make open sheets solids of this thickness.")
@judging_options
@report_options
@worker_options
@click.pass_context
def heal(
    ctx: click.Context,
    model: tuple[Path, ...],
    recursive: bool,
    units: str | None,
    weld_tolerance: float | None,
    output: Path,
    overwrite: bool,
    dry_run: bool,
    max_deviation: float | None,
    target_q: float | None,
    edge_length: float | None,
    max_triangles: int | None,
    cap_openings: bool | None,
    min_component: float | None,
    only_topology: bool,
    thicken: float | None,
    config: Path | None,
    profile: str | None,
    select: list[str],
    ignore: list[str],
    min_q: float | None,
    min_edge: float | None,
    gap: float | None,
    gap_search: float | None,
    reports: tuple[str, ...],
    form: str | None,
    jobs: int | None,
    timeout: float,
    memory: float,
    cache: bool,
) -> None:
    """Heal a model: close holes, resolve self-intersections, turn faces outward, improve triangles.

    Every tissue of MODEL is written to OUT under its own name. One that needs nothing, or that can't be healed
    within --max-deviation, is copied as it is, and the report says why. A result that breaks a rule which the
    input kept is never written. The gate of `vhp check` then judges OUT. --min-edge is the shortest edge that is
    left as well as the limit of Q002.

    Exit code: 0 the result passed, 1 errors remain, 2 wrong usage or nothing readable, 3 a tissue could not be
    processed.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

    from vhp_cli.config import load_settings
    from vhp_cli.model import find_model
    from vhp_cli.pipeline.stage import Limits, Stage, plan_stage

    limits = {code: value for code, value in (("Q001", min_q), ("Q002", min_edge), ("P005", gap)) if value is not None}
    settings = load_settings(
        config=config,
        model=model,
        profile=profile,
        select=select,
        ignore=ignore,
        limits=limits,
        units=units,
        weld_tolerance_mm=weld_tolerance,
        gap_search_mm=gap_search,
        recursive=recursive,
    )
    flags = {
        "max-deviation": max_deviation,
        "target-q": target_q,
        "min-edge": min_edge,
        "edge-length": edge_length,
        "max-triangles": max_triangles,
        "cap-openings": cap_openings,
        "min-component": min_component,
        "only-topology": only_topology or None,
        "thicken": thicken,
    }
    options, options_of = _options(settings, {key: value for key, value in flags.items() if value is not None})
    stage = Stage("heal", TARGET, options_of, options.as_dict(), most_gentle=2)
    targets = [report_target(report, form) for report in reports]
    found = find_model(model, recursive=settings.recursive)
    talk = ctx.obj or {}
    if dry_run:
        plan = plan_stage(found, output, stage, settings, paths=model, overwrite=overwrite)
        for tissue, file in zip(found.tissues, plan.files, strict=True):
            click.echo(f"{tissue.name}\t{'keep' if file in plan.done else 'heal'}\t{tissue.path}\t{output / file}")
        return
    if not talk.get("quiet"):
        for pattern in settings.idle_patterns(tissue.name for tissue in found.tissues):
            click.echo(f"note: no tissue matches {pattern!r} of the settings", err=True)

    from vhp_cli.pipeline.cache import default_directory
    from vhp_cli.pipeline.output import REPORT, foreign_meshes
    from vhp_cli.pipeline.staged import run_and_check

    with ProgressBar(quiet=talk.get("quiet", False)) as progress:
        done = run_and_check(
            found,
            output,
            stage,
            settings,
            paths=model,
            jobs=jobs,
            limits=Limits(timeout, memory),
            overwrite=overwrite,
            cache_directory=default_directory() if cache else None,
            progress=progress,
        )
    _hand_on_config(config, model, output)
    report = done.report
    write_reports(report, [*targets, (output / REPORT, "json")], report_base((output,)))
    to_stdout = next((target_form for path, target_form in targets if path is None), form)
    show_report(report, to_stdout or "table", report_base((output,)), **talk)
    if not talk.get("quiet"):
        if done.reused:
            click.echo(f"note: {done.reused} of {len(report['tissues'])} were taken from the run before", err=True)
        if others := foreign_meshes(output, [tissue["file"] for tissue in report["tissues"]]):
            click.echo(f"note: {output} holds other meshes, which this run left alone: {', '.join(others)}", err=True)
    if done.failed:
        ctx.exit(FAILED)
    ctx.exit(PASSED if report["summary"]["passed"] else ERRORS)


def _options(settings: Settings, flags: Mapping[str, object]) -> tuple[HealOptions, Callable[[str], HealOptions]]:
    """Return the options of the run, and what they are for a tissue: patterns of the settings come last.

    Triangles and edges are healed at least as far as the gate wants them.
    """
    from vhp_cli.stages.heal.options import HealOptions

    table = settings.stages.get("heal", {})
    options = HealOptions().changed(table, "heal").changed(flags, "command line")
    for override in settings.tissues:
        # What is wrong in a section is said, whether a tissue matches or not.
        options.changed(override.stages.get("heal", {}), f"[[tissue]] {override.match!r}: heal")

    def options_of(name: str) -> HealOptions:
        mine = options
        for where, values in settings.stage_tables("heal", name):
            mine = mine.changed(values, where)
        quality, edge, budget = (settings.rule(code, name) for code in ("Q001", "Q002", "Q005"))
        if quality.level and quality.limit is not None:
            mine = replace(mine, target_quality=max(mine.target_quality, min(quality.limit, 0.9)))
        if edge.level and edge.limit is not None:
            mine = replace(mine, min_edge_mm=max(mine.min_edge_mm, edge.limit))
        if budget.level == "error" and budget.limit is not None and mine.max_triangles is None:
            mine = replace(mine, max_triangles=max(int(budget.limit), 4))
        return mine

    return options, options_of


def _hand_on_config(config: Path | None, model: tuple[Path, ...], output: Path) -> None:
    """Copy the settings of the model, so that a check of the result judges by the same."""
    if config is not None or len(model) != 1 or not (model[0] / "vhp.toml").is_file():
        return
    from vhp_cli.formats.atomic import write_atomically

    write_atomically(output / "vhp.toml", (model[0] / "vhp.toml").read_bytes())
