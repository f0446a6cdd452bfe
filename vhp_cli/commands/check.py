"""``vhp check``: the gate."""

from __future__ import annotations

import os
from pathlib import Path

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
from vhp_cli.commands.declaring import declare_option, read_declared
from vhp_cli.commands.options import (
    judging_options,
    model_options,
    report_options,
    run_options,
)


@click.command()
@model_options
@click.option("-o", "--output", type=click.Path(path_type=Path, file_okay=False), help="Write report.json in here.")
@judging_options
@declare_option
@click.option(
    "--baseline",
    type=click.Path(path_type=Path, dir_okay=False),
    help="An earlier JSON report: only findings that it does not hold fail.",
)
@report_options
@click.option("--nesting", is_flag=True, help="Show which tissue lies inside which.")
@click.option("--dry-run", is_flag=True, help="List the tissues that would be checked.")
@run_options
@click.pass_context
def check(
    ctx: click.Context,
    model: tuple[Path, ...],
    recursive: bool,
    units: str | None,
    weld_tolerance: float | None,
    output: Path | None,
    config: Path | None,
    profile: str | None,
    select: list[str],
    ignore: list[str],
    min_q: float | None,
    min_edge: float | None,
    gap: float | None,
    gap_search: float | None,
    declare: Path | None,
    baseline: Path | None,
    reports: tuple[str, ...],
    form: str | None,
    nesting: bool,
    dry_run: bool,
    jobs: int | None,
    cache: bool,
) -> None:
    """Check whether a model is fit for a FEM or EM solver.

    MODEL is a directory of STL, PLY or OBJ files, one tissue each, or a list of files. Every tissue must be
    closed, 2-manifold, oriented outward and free of self-intersections, with well shaped triangles; no two
    tissues may cross or touch, and gaps must reach the limit. One tissue may enclose another. Verdicts are
    exact on the coordinates as stored.

    Exit code: 0 passed, 1 errors found, 2 wrong usage or nothing readable, 3 a tissue could not be processed.
    """
    # numpy's linear algebra is not used here; its pool of threads would only cost start-up.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

    from vhp_cli.config import load_settings
    from vhp_cli.model import find_model

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
    settings = read_declared(declare).added_to(settings)
    targets = [report_target(report, form) for report in reports]
    if output is not None:
        targets.append((output / "report.json", "json"))
    old_report = None
    if baseline is not None:
        from vhp_cli.report.baseline import parse_baseline

        old_report = parse_baseline(baseline.read_bytes())
    found = find_model(model, recursive=settings.recursive)
    if dry_run:
        for file in found.tissues:
            click.echo(f"{file.name}\t{settings.tissue_type(file.name)}\t{file.path}")
        return

    talk = ctx.obj or {}
    for pattern in settings.idle_patterns(tissue.name for tissue in found.tissues):
        if not talk.get("quiet"):
            click.echo(f"note: no tissue matches {pattern!r} of the settings", err=True)

    from vhp_cli.pipeline.cache import default_directory
    from vhp_cli.pipeline.check import check_model, with_findings

    with ProgressBar(quiet=talk.get("quiet", False)) as progress:
        checked = check_model(
            found,
            settings,
            paths=model,
            jobs=jobs,
            cache_directory=default_directory() if cache else None,
            progress=progress,
        )
    report = checked.report
    if old_report is not None:
        from vhp_cli.report.baseline import mark_known

        report = with_findings(report, mark_known(report["findings"], old_report))
    write_reports(report, targets, report_base(model))
    to_stdout = next((target_form for path, target_form in targets if path is None), form)
    show_report(report, to_stdout or "table", report_base(model), nesting=nesting, **talk)
    if checked.failed:
        ctx.exit(FAILED)
    ctx.exit(PASSED if report["summary"]["passed"] else ERRORS)
