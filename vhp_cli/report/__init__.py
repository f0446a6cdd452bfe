"""Writers of the report: for people (table, Markdown, HTML), scripts (JSON, CSV) and CI (JUnit, SARIF, GitHub)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from vhp_cli.errors import UsageError

if TYPE_CHECKING:
    from rich.console import Console

    from vhp_cli.measures import Report
    from vhp_cli.report.html import Surfaces

FORMATS: tuple[str, ...] = ("table", "json", "jsonl", "csv", "markdown", "junit", "sarif", "github")
# The form of a page, which is more than text: it shows surfaces.
PAGE = "html"


def render(
    report: Report,
    form: str,
    *,
    base: str = "",
    width: int = 100,
    verbose: bool = False,
    surfaces: Surfaces | None = None,
) -> str:
    """Return a report as text; nothing in it depends on the terminal.

    Parameters
    ----------
    report
        The report.
    form
        One of `FORMATS`, or `PAGE`.
    base
        Directory of the tissue files as seen from the root of the repository, ending in ``/``: makes the paths of
        ``sarif`` and ``github`` relative to it.
    width, verbose
        For ``table``: the number of columns, and whether everything is listed.
    surfaces
        For `PAGE`: the surfaces of the tissues.

    Returns
    -------
    str
        Encodable in UTF-8, ends with a newline. All forms but ``table``, ``csv``, ``markdown``, ``junit`` and
        ``github`` are pure ASCII.

    Raises
    ------
    UsageError
        If there is no such form.
    ValueError
        If a number in a JSON form is NaN or infinite.
    """
    if form == "table":
        return _table_text(report, width, verbose=verbose)
    if form == "json":
        from vhp_cli.report.as_json import render_json

        return render_json(report)
    if form == "jsonl":
        from vhp_cli.report.as_json import render_jsonl

        return render_jsonl(report)
    if form == "csv":
        from vhp_cli.report.as_csv import render_csv

        return render_csv(report)
    if form == "markdown":
        from vhp_cli.report.as_markdown import render_markdown

        return render_markdown(report)
    if form == "junit":
        from vhp_cli.report.as_junit import render_junit

        return render_junit(report)
    if form == "sarif":
        from vhp_cli.report.as_sarif import render_sarif

        return render_sarif(report, base=base)
    if form == "github":
        from vhp_cli.report.as_github import render_github

        return render_github(report, base=base)
    if form == PAGE:
        from vhp_cli.report.html import html_page

        return html_page(report, surfaces)
    raise UsageError(f"no such report format {form!r}", hint=f"use one of {', '.join((*FORMATS, PAGE))}")


def print_table(report: Report, console: Console, *, verbose: bool = False, nesting: bool = False) -> None:
    """Print a report for a person; see `vhp_cli.report.table.print_table`."""
    from vhp_cli.report import table

    table.print_table(report, console, verbose=verbose, nesting=nesting)


def schema() -> dict[str, Any]:
    """Return the JSON Schema (2020-12) of reports ``vhp-report/1``."""
    import json
    from importlib.resources import files

    text = files("vhp_cli.report").joinpath("report-1.schema.json").read_text(encoding="utf-8")
    loaded: dict[str, Any] = json.loads(text)
    return loaded


def _table_text(report: Report, width: int, *, verbose: bool) -> str:
    import io

    from rich.console import Console

    from vhp_cli.report.table import print_table as print_rich

    console = Console(file=io.StringIO(), width=width, color_system=None, force_terminal=False, legacy_windows=False)
    with console.capture() as capture:
        print_rich(report, console, verbose=verbose)
    # Trailing blanks of table cells are of no use in a file.
    return "".join(f"{line.rstrip()}\n" for line in capture.get().splitlines())
