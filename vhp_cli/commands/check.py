"""``vhp check``: the gate."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from vhp_cli.commands.options import (
    REPORT_SUFFIXES,
    judging_options,
    model_options,
    report_options,
    run_options,
)
from vhp_cli.errors import UsageError

if TYPE_CHECKING:
    from vhp_cli.measures import Report
    from vhp_cli.pipeline.check import Progress

PASSED, ERRORS, FAILED = 0, 1, 3


@click.command()
@model_options
@click.option("-o", "--output", type=click.Path(path_type=Path, file_okay=False), help="Write report.json in here.")
@judging_options
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
    targets = [_target(report, form) for report in reports]
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

    with _progress(quiet=talk.get("quiet", False)) as progress:
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
    _write(report, targets, _base(model))
    to_stdout = next((target_form for path, target_form in targets if path is None), form)
    _show(report, to_stdout or "table", _base(model), nesting=nesting, **talk)
    if checked.failed:
        ctx.exit(FAILED)
    ctx.exit(PASSED if report["summary"]["passed"] else ERRORS)


def _target(report: str, form: str | None) -> tuple[Path | None, str]:
    """Return where a report goes (None: stdout) and its form."""
    if report == "-":
        return None, form or "json"
    path = Path(report)
    known = REPORT_SUFFIXES.get(path.suffix.lower())
    if known is None:
        raise UsageError(
            f"--report {report}: no report format has the suffix {path.suffix!r}",
            hint=f"suffixes: {' '.join(REPORT_SUFFIXES)}",
        )
    return path, known


def _base(model: tuple[Path, ...]) -> str:
    """Return the directory to which the report's file names are relative, as CI tools want to see it."""
    return f"{model[0].as_posix().rstrip('/')}/" if len(model) == 1 and model[0].is_dir() else ""


def _write(report: Report, targets: list[tuple[Path | None, str]], base: str) -> None:
    from vhp_cli.formats.atomic import write_atomically
    from vhp_cli.report import render

    for path, form in targets:
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            write_atomically(path, render(report, form, base=base).encode())


def _show(report: Report, form: str, base: str, *, nesting: bool, quiet: bool = False, verbose: bool = False) -> None:
    if form != "table":
        from vhp_cli.report import render

        click.echo(render(report, form, base=base), nl=False)
    elif not quiet:
        from rich.console import Console

        from vhp_cli.report import print_table

        print_table(report, Console(), verbose=verbose, nesting=nesting)


class _progress:
    """A progress bar on stderr, shown only to a person who has waited for a moment."""

    def __init__(self, *, quiet: bool) -> None:
        self._wanted = not quiet and sys.stderr.isatty()
        self._bar: Any = None

    def __enter__(self) -> Progress | None:
        if not self._wanted:
            return None
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        self._bar = Progress(*columns, console=Console(stderr=True), transient=True)
        self._bar.start()
        steps: dict[str, Any] = {}

        def report(step: str, done: int, total: int) -> None:
            if step not in steps:
                steps[step] = self._bar.add_task(step, total=total)
            self._bar.update(steps[step], completed=done)

        return report

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()
