"""``vhp export``: a model that passes the gate, as another program wants it."""

from __future__ import annotations

import os
import tomllib
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
from vhp_cli.commands.options import judging_options, model_options, report_html_option, run_options
from vhp_cli.commands.staging import Shared
from vhp_cli.errors import UsageError

if TYPE_CHECKING:
    from vhp_cli.config import Settings
    from vhp_cli.stages.export.materials import UserMaterial


@click.command()
@model_options
@click.option(
    "-o",
    "--output",
    metavar="OUT",
    type=click.Path(path_type=Path, file_okay=False),
    help="Directory for the files, manifest.json and report.json. If an export of the same settings was interrupted "
    "there, it is taken up.",
)
@click.option(
    "--for",
    "target",
    type=click.Choice(["hfss", "cst", "matlab", "comsol", "print", "generic"]),
    help="Program: decides on the gate's profile, formats and scripts.",
)
@click.option(
    "--format",
    "forms",
    multiple=True,
    metavar="FORMATS",
    help="Formats instead of those of the program, several with commas; with a + before it, beside them: stl, ply, "
    "obj, 3mf, bdf, nas, mat, mat-all, vtp.",
)
@click.option("--out-units", type=click.Choice(["um", "mm", "cm", "in", "m"]), help="Unit of the files. [default: mm]")
@click.option(
    "--frequency", metavar="HZ", help="Of permittivity and conductivity, 10 Hz to 100 GHz: 300MHz. [default: none]"
)
@click.option(
    "--materials",
    type=click.Path(path_type=Path, dir_okay=False),
    help="A TOML file of materials by pattern on tissue names, over [materials] of vhp.toml.",
)
@click.option(
    "--list-materials", is_flag=True, help="Show material, density, mass and source of each tissue; no files."
)
@click.option("--force", is_flag=True, help="Export a model that fails the gate, too; the manifest says so.")
@click.option("--overwrite", is_flag=True, help="Write into a directory that is not empty.")
@click.option("--dry-run", is_flag=True, help="List what would be written.")
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
def export(
    ctx: click.Context,
    /,
    target: str | None,
    forms: tuple[str, ...],
    out_units: str | None,
    frequency: str | None,
    materials: Path | None,
    list_materials: bool,
    force: bool,
    output: Path | None,
    **shared: Any,
) -> None:
    """Write a model for another program: meshes, scripts that import them with materials, and a manifest.

    The gate of `vhp check` comes first, with the profile of the program; a model that fails is not exported. What was
    written is read again, as rounded to the format, and judged once more. Names of objects are made fit for every
    program, and no two are the same.

    Exit code: 0 exported, 1 the gate found errors (nothing is written but report.json, unless --force), 2 wrong usage
    or nothing readable, 3 a tissue could not be processed.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

    from vhp_cli.model import find_model
    from vhp_cli.pipeline.export import export_model
    from vhp_cli.pipeline.export_job import Job
    from vhp_cli.pipeline.export_plan import planned_files
    from vhp_cli.stages.export.options import ExportOptions
    from vhp_cli.stages.export.targets import TARGETS, chosen_forms

    request = Shared(**shared, output=output or Path(), form=None, timeout=0.0, memory=0.0)
    said = {"for": target, "format": ",".join(forms) or None, "out-units": out_units, "frequency": frequency}
    general = request.settings()
    options = ExportOptions().changed(general.stages.get("export", {}), "export")
    options = options.changed({key: value for key, value in said.items() if value is not None}, "command line")
    for override in general.tissues:
        if "export" in override.stages:
            raise UsageError(f"[[tissue]] {override.match!r}: export belongs to the whole run", hint="write [export]")
    if options.target is None:
        if not list_materials:
            raise click.UsageError(f"--for is needed: one of {', '.join(TARGETS)}.", ctx)
        options = options.changed({"for": "generic"}, "command line")
    if list_materials and request.reports:
        raise click.UsageError("--list-materials writes no report.", ctx)
    if output is None and not list_materials:
        raise click.UsageError("-o OUT is needed.", ctx)
    assert options.target is not None
    # The program's profile comes before that of the file, which knows of no program.
    settings = Shared(
        **{**shared, "profile": shared["profile"] or TARGETS[options.target].profile},
        output=request.output,
        form=None,
        timeout=0.0,
        memory=0.0,
    ).settings()
    job = Job(
        options.target,
        chosen_forms(TARGETS[options.target], _parts(options.forms)),
        options.unit,
        force,
        options.frequency_hz,
        _user_materials(settings, materials),
    )
    targets = [report_target(report, None) for report in request.reports]
    found = find_model(request.model, recursive=settings.recursive)
    talk = ctx.obj or {}
    if list_materials:
        _list_materials(found, settings, job, request)
        return
    if request.dry_run:
        for file, tissues in planned_files(found, job):
            click.echo(f"{request.output / file}\t{', '.join(tissues) if len(tissues) == 1 else 'all tissues'}")
        return
    if not talk.get("quiet"):
        names = [tissue.name for tissue in found.tissues]
        for pattern in [*settings.idle_patterns(names), *_idle(job.materials, names)]:
            click.echo(f"note: no tissue matches {pattern!r} of the settings", err=True)

    from vhp_cli.pipeline.cache import default_directory
    from vhp_cli.pipeline.output import REPORT
    from vhp_cli.report.export_table import closing_lines

    with ProgressBar(quiet=talk.get("quiet", False)) as progress:
        done = export_model(
            found,
            request.output,
            job,
            settings,
            paths=request.model,
            jobs=request.jobs,
            overwrite=request.overwrite,
            cache_directory=default_directory() if request.cache else None,
            progress=progress,
        )
    report = done.report
    base = report_base(request.model)
    write_reports(report, [*targets, (request.output / REPORT, "json")], base)
    to_stdout = next((form for path, form in targets if path is None), "table")
    show_report(report, to_stdout, base, **talk)
    if to_stdout == "table" and not talk.get("quiet"):
        for line in closing_lines(report["export"], str(request.output)):
            click.echo(line)
    if not talk.get("quiet"):
        if done.reused:
            click.echo(f"note: {done.reused} files were taken from the run before", err=True)
        for note in report["export"]["notes"]:
            click.echo(f"note: {note}", err=True)
    if done.failed:
        ctx.exit(FAILED)
    ctx.exit(PASSED if report["summary"]["passed"] else ERRORS)


def _parts(text: str | None) -> list[str]:
    parts = [part.strip() for part in (text or "").split(",")]
    if text and not all(parts):
        raise UsageError(f"--format {text}: expected formats separated by commas")
    return [part for part in parts if part]


def _user_materials(settings: Settings, file: Path | None) -> tuple[UserMaterial, ...]:
    """Return the rows of the settings, and those of the file after them: later rows come first."""
    from vhp_cli.stages.export.materials import user_materials

    rows = user_materials(settings.materials, "materials")
    if file is None:
        return rows
    try:
        table = tomllib.loads(file.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise UsageError(f"{file}: can't be read: {error.strerror}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UsageError(f"{file}: not valid TOML: {error}") from error
    if set(table) == {"materials"} and isinstance(table["materials"], dict):
        table = table["materials"]
    return (*rows, *user_materials(table, str(file)))


def _idle(rows: tuple[UserMaterial, ...], names: list[str]) -> list[str]:
    from vhp_cli.config import matches

    return [row.match for row in rows if not any(matches(name, row.match) for name in names)]


def _list_materials(found: Any, settings: Settings, job: Any, request: Shared) -> None:
    from vhp_cli.pipeline.cache import default_directory
    from vhp_cli.pipeline.check import check_model
    from vhp_cli.pipeline.export_job import tissue_rows
    from vhp_cli.report.export_table import print_materials
    from vhp_cli.stages.export.dielectric import frequency_text

    checked = check_model(
        found,
        settings,
        paths=request.model,
        jobs=request.jobs,
        cache_directory=default_directory() if request.cache else None,
    )
    from rich.console import Console

    frequency = "" if job.frequency_hz is None else frequency_text(job.frequency_hz)
    print_materials(tissue_rows(checked.report, settings, job), frequency, Console())
