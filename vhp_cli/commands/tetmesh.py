"""``vhp tetmesh``: one conforming, labelled tetrahedral mesh of the whole model, or one for each tissue."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
from vhp_cli.commands.options import comma_list, judging_options, model_options, report_html_option, run_options
from vhp_cli.commands.staging import Shared
from vhp_cli.errors import UsageError

if TYPE_CHECKING:
    from vhp_cli.config import Settings
    from vhp_cli.stages.tetmesh.options import TetmeshOptions

_LENGTH = click.FloatRange(min=0, min_open=True)


@click.command()
@model_options
@click.option(
    "-o",
    "--output",
    required=True,
    metavar="OUT",
    type=click.Path(path_type=Path, file_okay=False),
    help="Directory for model.vtu, or a mesh under the name of each tissue, and report.json.",
)
@click.option("--overwrite", is_flag=True, help="Write into a directory that is not empty.")
@click.option("--dry-run", is_flag=True, help="List what would be written.")
@click.option(
    "--format",
    "forms",
    callback=comma_list,
    metavar="FORMATS",
    help="Formats of the meshes: vtu, msh (Gmsh 4.1), msh22, bdf (Nastran), comsol, inp (Abaqus), med, xdmf, mat "
    "(MATLAB); several with commas. [default: vtu]",
)
@click.option("--per-tissue", is_flag=True, help="One mesh for each tissue, which do not fit to each other.")
@click.option("--surfaces", is_flag=True, help="Write the boundary of each tissue as OUT/surfaces/NAME.stl, too.")
@click.option(
    "--surface-gap",
    type=_LENGTH,
    metavar="MM",
    help="Heal these boundaries and set them apart by a gap, as `vhp heal --clearance` does.",
)
@click.option(
    "--edge-length",
    metavar="MM|%",
    help="Wanted edge length, in mm or as a part of the model's diagonal, such as 2% [default: 5%]",
)
@click.option(
    "--epsilon",
    type=_LENGTH,
    metavar="MM",
    help="How far the mesh may lie from the surfaces. [default: from the smallest gap and the thinnest walls]",
)
@click.option(
    "--keep-surface",
    is_flag=False,
    flag_value="any",
    type=click.Choice(["any", "tetgen", "gmsh"]),
    metavar="ENGINE",
    help="Keep every triangle as it is, by tetgen (AGPL) or gmsh (GPL), if it is installed; for clean models.",
)
@click.option("--max-tets", type=click.IntRange(min=1), metavar="N", help="Most tetrahedra, air left out.")
@click.option(
    "--with-air",
    metavar="MM|BOX",
    help="Keep the air around the model: within a margin, or a box x0,y0,z0,x1,y1,z1. [default: none]",
)
@click.option(
    "--stop-energy",
    type=click.FloatRange(min=3, min_open=True),
    metavar="E",
    help="When fTetWild is content; below 7 it may not end. [default: 10]",
)
@click.option("--coarsen", is_flag=True, help="Let fTetWild take out what it can at the same quality.")
@click.option("--fit/--no-fit", default=None, help="Move the interfaces onto the surfaces at the end. [default: on]")
@click.option(
    "--attempts",
    type=click.IntRange(1, 10),
    metavar="N",
    help="Calls of fTetWild for a cluster at most, crashes apart, until limits and targets hold. [default: 2]",
)
@click.option("--time-limit", type=_LENGTH, metavar="S", help="Seconds for one call of fTetWild. [default: 3600]")
@click.option("--memory", type=_LENGTH, metavar="GB", help="Memory for one call of fTetWild. [default: 8]")
@judging_options
@click.option(
    "--report",
    "reports",
    multiple=True,
    metavar="FILE|-",
    help="Write the report to a file, in the form that its suffix names (.json .jsonl .csv .md .xml=JUnit .sarif "
    ".txt .html); '-': JSON on stdout instead of the table. May be given several times.",
)
@report_html_option
@run_options
@click.pass_context
def tetmesh(
    ctx: click.Context,
    /,
    forms: list[str],
    per_tissue: bool,
    surfaces: bool,
    surface_gap: float | None,
    edge_length: str | None,
    epsilon: float | None,
    keep_surface: str | None,
    max_tets: int | None,
    with_air: str | None,
    stop_energy: float | None,
    coarsen: bool,
    fit: bool | None,
    attempts: int | None,
    time_limit: float | None,
    memory: float | None,
    **shared: Any,
) -> None:
    """Fill a model with tetrahedra: one conforming mesh in which each tetrahedron carries its tissue.

    Neighbouring and nested tissues share faces; of tissues within each other the inner one counts. Tissues that stand
    apart are meshed by themselves, several at a time. Surfaces with defects are meshed as well as they can be, and the
    report says where that was a guess. The mesh comes from fTetWild, which gives a slightly different one each time.

    Exit code: 0 the mesh passed, 1 errors, 2 wrong usage or nothing readable, 3 a tissue could not be processed.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    request = Shared(**shared, form=None, timeout=0.0, memory=0.0)
    flags = {
        "edge-length": edge_length,
        "epsilon": epsilon,
        "keep-surface": keep_surface,
        "max-tets": max_tets,
        "with-air": with_air,
        "stop-energy": stop_energy,
        "coarsen": coarsen or None,
        "fit": fit,
        "attempts": attempts,
        "time-limit": time_limit,
        "memory": memory,
    }
    settings = request.settings()
    options, options_of = _options(settings, {key: value for key, value in flags.items() if value is not None})

    from vhp_cli.formats.volume import check_form
    from vhp_cli.model import find_model
    from vhp_cli.pipeline.tetmesh import Job, planned_files, prepare_output
    from vhp_cli.pipeline.tetmesh_surfaces import Apart

    for form in forms:
        check_form(form)
    apart = None
    if surface_gap is not None:
        if per_tissue:
            raise UsageError("--surface-gap is for one mesh of all tissues, not for one mesh each")
        apart = Apart(replace(request, gap=surface_gap).settings())
    job = Job(
        options,
        options_of,
        tuple(dict.fromkeys(forms)) or ("vtu",),
        per_tissue,
        surfaces or surface_gap is not None,
        apart,
    )
    targets = [report_target(report, None) for report in request.reports]
    model, output = request.model, request.output
    found = find_model(model, recursive=settings.recursive)
    for tissue in found.tissues:
        # A mistake is told before the first tissue is done.
        options_of(tissue.name)
    talk = ctx.obj or {}
    if request.dry_run:
        prepare_output(found, output, paths=model, overwrite=request.overwrite)
        for name, files in planned_files(found, job).items():
            for file in files:
                click.echo(f"{name or 'all tissues'}\t{output / file}")
        return
    if not talk.get("quiet"):
        for pattern in settings.idle_patterns(tissue.name for tissue in found.tissues):
            click.echo(f"note: no tissue matches {pattern!r} of the settings", err=True)

    from vhp_cli.pipeline.cache import default_directory
    from vhp_cli.pipeline.output import REPORT
    from vhp_cli.pipeline.tetmesh import SURFACES, run_tetmesh

    with ProgressBar(quiet=talk.get("quiet", False)) as progress:
        done = run_tetmesh(
            found,
            output,
            job,
            settings,
            paths=model,
            jobs=request.jobs,
            overwrite=request.overwrite,
            cache_directory=default_directory() if request.cache else None,
            progress=progress,
        )
    report = done.report
    apart_passed = done.surfaces is None or done.surfaces.passed
    if done.surfaces is not None:
        write_reports(done.surfaces.report, [(output / SURFACES / REPORT, "json")], report_base((output / SURFACES,)))
    write_reports(report, [*targets, (output / REPORT, "json")], report_base(model))
    to_stdout = next((target_form for path, target_form in targets if path is None), "table")
    show_report(report, to_stdout, report_base(model), **talk)
    if done.failed:
        ctx.exit(FAILED)
    ctx.exit(PASSED if report["summary"]["passed"] and apart_passed else ERRORS)


def _options(settings: Settings, flags: Mapping[str, object]) -> tuple[TetmeshOptions, Callable[[str], TetmeshOptions]]:
    """Return the options of the run, and what they are for a tissue: patterns of the settings come last."""
    from vhp_cli.stages.tetmesh.options import OF_A_TISSUE, TetmeshOptions

    options = TetmeshOptions().changed(settings.stages.get("tetmesh", {}), "tetmesh").changed(flags, "command line")
    for override in settings.tissues:
        # What is wrong in a section is said, whether a tissue matches or not.
        where, values = f"[[tissue]] {override.match!r}: tetmesh", override.stages.get("tetmesh", {})
        options.changed(values, where)
        for key in values:
            if key not in OF_A_TISSUE:
                raise UsageError(f"{where}: {key} belongs to the whole run", hint=f"keys: {', '.join(OF_A_TISSUE)}")

    def options_of(name: str) -> TetmeshOptions:
        mine = options
        for where, values in settings.stage_tables("tetmesh", name):
            mine = mine.changed(values, where)
        return mine

    return options, options_of
