"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

REPORT_SUFFIXES = {
    ".json": "json",
    ".jsonl": "jsonl",
    ".csv": "csv",
    ".md": "markdown",
    ".xml": "junit",
    ".sarif": "sarif",
    ".txt": "table",
    ".html": "html",
}
FORMATS = ("table", "json", "jsonl", "csv", "markdown", "junit", "sarif", "github", "html")
# Where the context of a command keeps what `--report-html` names.
PAGES = "vhp.pages"

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]


def comma_list(ctx: click.Context, parameter: click.Parameter, value: str | None) -> list[str]:
    """Return the parts of a text between commas."""
    if value is None:
        return []
    parts = [part.strip() for part in value.split(",")]
    if not all(parts):
        raise click.BadParameter("expected rules separated by commas")
    return parts


def _keep_pages(ctx: click.Context, parameter: click.Parameter, value: tuple[Path, ...]) -> None:
    ctx.meta[PAGES] = value


def _combined(*decorators: Decorator) -> Decorator:
    def apply(function: Callable[..., Any]) -> Callable[..., Any]:
        for decorator in reversed(decorators):
            function = decorator(function)
        return function

    return apply


model_options = _combined(
    click.argument("model", nargs=-1, required=True, metavar="MODEL...", type=click.Path(path_type=Path)),
    click.option("--recursive", is_flag=True, help="Search the directory to any depth."),
    click.option(
        "--units",
        type=click.Choice(["um", "mm", "cm", "in", "m"]),
        help="Unit of the files; everything is measured and reported in mm. [default: mm]",
    ),
    click.option(
        "--weld-tolerance",
        type=click.FloatRange(min=0),
        metavar="MM",
        help="Join vertices closer than this; 0 joins equal coordinates only. [default: 0]",
    ),
)

judging_options = _combined(
    click.option(
        "--config",
        type=click.Path(path_type=Path, dir_okay=False),
        help="Settings file. [default: vhp.toml in MODEL, else [tool.vhp] of its pyproject.toml]",
    ),
    click.option("--profile", metavar="NAME", help="What the model must be fit for: strict, hfss, cst, print."),
    click.option(
        "--select",
        callback=comma_list,
        metavar="RULES",
        help="Only these rules, and errors in files: X,T001,...",
    ),
    click.option("--ignore", callback=comma_list, metavar="RULES", help="Leave these rules out."),
    click.option("--min-q", type=click.FloatRange(0, 1), metavar="Q", help="Limit of Q001, q = 2 r_in / r_out."),
    click.option("--min-edge", type=click.FloatRange(min=0), metavar="MM", help="Limit of Q002, shortest edge."),
    click.option("--gap", type=click.FloatRange(min=0), metavar="MM", help="Limit of P005, gap between tissues."),
    click.option(
        "--gap-search",
        type=click.FloatRange(min=0),
        metavar="MM",
        help="Measure and report gaps up to this; 'inf' measures all. [default: the gap limit]",
    ),
)

report_html_option = click.option(
    "--report-html",
    multiple=True,
    metavar="FILE",
    type=click.Path(path_type=Path, dir_okay=False),
    expose_value=False,
    callback=_keep_pages,
    help="Write the report as one page for a browser, with pictures and the model in three dimensions.",
)

report_options = _combined(
    click.option(
        "--report",
        "reports",
        multiple=True,
        metavar="FILE|-",
        help="Write the report to a file, in the form that its suffix names (.json .jsonl .csv .md .xml=JUnit "
        ".sarif .txt .html); '-': JSON on stdout instead of the table. May be given several times.",
    ),
    report_html_option,
    click.option(
        "--format",
        "form",
        type=click.Choice(FORMATS),
        help="Form of what goes to stdout. [default: table; json with '--report -']",
    ),
)

run_options = _combined(
    click.option("--jobs", "-j", type=click.IntRange(min=1), metavar="N", help="Threads. [default: all cores]"),
    click.option("--cache/--no-cache", default=True, help="Keep results between runs. [default: on]"),
)

stage_options = _combined(
    click.option(
        "-o",
        "--output",
        required=True,
        metavar="OUT",
        type=click.Path(path_type=Path, file_okay=False),
        help="Directory for the results, under the names of the inputs, and report.json. If a run of the same settings "
        "was interrupted there, it is taken up.",
    ),
    click.option("--overwrite", is_flag=True, help="Do everything anew, whatever OUT holds."),
    click.option("--dry-run", is_flag=True, help="List the tissues and what would be done."),
)

worker_options = _combined(
    click.option("--jobs", "-j", type=click.IntRange(min=1), metavar="N", help="Workers. [default: all cores]"),
    click.option(
        "--timeout",
        type=click.FloatRange(min=0, min_open=True),
        default=120.0,
        metavar="S",
        help="Seconds for one tissue. [default: 120; to take tissues apart 600, more for large ones]",
    ),
    click.option(
        "--memory",
        type=click.FloatRange(min=0, min_open=True),
        default=4.0,
        show_default=True,
        metavar="GB",
        help="Memory for one worker.",
    ),
    click.option("--cache/--no-cache", default=True, help="Keep measures between runs. [default: on]"),
)
