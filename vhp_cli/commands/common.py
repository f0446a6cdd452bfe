"""What the commands on models share: reports to files and to stdout, and a progress bar."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from vhp_cli.commands.options import PAGES, REPORT_SUFFIXES
from vhp_cli.errors import UsageError

if TYPE_CHECKING:
    from vhp_cli.measures import Report
    from vhp_cli.pipeline.check import Progress

PASSED, ERRORS, FAILED = 0, 1, 3

# Where a report goes (None: stdout), and its form.
Target = tuple[Path | None, str]


def report_target(report: str, form: str | None) -> Target:
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


def report_base(model: tuple[Path, ...]) -> str:
    """Return the directory to which the report's file names are relative, as CI tools want to see it."""
    return f"{model[0].as_posix().rstrip('/')}/" if len(model) == 1 and model[0].is_dir() else ""


def write_reports(report: Report, targets: list[Target], base: str) -> None:
    """Write the report to every target that is a file, and to the pages of `--report-html`; pages come last."""
    from vhp_cli.formats.atomic import make_directory, write_atomically

    context = click.get_current_context(silent=True)
    pages = [(page, "html") for page in (context.meta.get(PAGES, ()) if context else ())]
    for path, form in sorted((*targets, *pages), key=lambda target: target[1] == "html"):
        if path is not None:
            make_directory(path.parent)
            write_atomically(path, rendered(report, form, base).encode())


def rendered(report: Report, form: str, base: str) -> str:
    """Return the report in a form; a page shows the surfaces in the directory `base`, or in the model."""
    from vhp_cli.report import render

    if form != "html":
        return render(report, form, base=base)
    from vhp_cli.pipeline.surfaces import surfaces_of

    return render(report, form, surfaces=surfaces_of(report, base))


def show_report(
    report: Report, form: str, base: str, *, nesting: bool = False, quiet: bool = False, verbose: bool = False
) -> None:
    """Show the report on stdout."""
    if form != "table":
        click.echo(rendered(report, form, base), nl=False)
    elif not quiet:
        from rich.console import Console

        from vhp_cli.report import print_table

        print_table(report, Console(), verbose=verbose, nesting=nesting)


class ProgressBar:
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
