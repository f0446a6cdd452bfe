"""``vhp view``: a model and what is wrong with it, in a browser."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from vhp_cli.commands.common import FAILED, PASSED, ProgressBar, rendered, report_base
from vhp_cli.commands.options import judging_options, model_options, run_options

if TYPE_CHECKING:
    from vhp_cli.measures import Report


@click.command()
@model_options
@click.option(
    "-o",
    "--output",
    metavar="FILE",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Write the page here and keep it. [default: in the cache, where the next page of MODEL takes its place]",
)
@click.option("--open/--no-open", "opening", default=True, help="Open the page in a browser. [default: open]")
@judging_options
@run_options
@click.pass_context
def view(
    ctx: click.Context,
    /,
    model: tuple[Path, ...],
    recursive: bool,
    units: str | None,
    weld_tolerance: float | None,
    output: Path | None,
    opening: bool,
    config: Path | None,
    profile: str | None,
    select: list[str],
    ignore: list[str],
    min_q: float | None,
    min_edge: float | None,
    gap: float | None,
    gap_search: float | None,
    jobs: int | None,
    cache: bool,
) -> None:
    """Show a model in the browser, with the findings of `vhp check`.

    MODEL is what `vhp check` takes; or one JSON report of any command, such as OUT/report.json, whose surfaces are
    read from the directory in which it lies, or from where the model was. The path of the page goes to stdout.

    Exit code: 0 the page was made, whatever it says; 2 wrong usage or nothing readable, 3 a tissue could not be
    processed.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    failed = False
    if len(model) == 1 and model[0].suffix.lower() == ".json":
        report = read_report(model[0])
        base = f"{model[0].parent.as_posix()}/"
    else:
        from vhp_cli.config import load_settings
        from vhp_cli.model import find_model
        from vhp_cli.pipeline.cache import default_directory
        from vhp_cli.pipeline.check import check_model

        limits = (("Q001", min_q), ("Q002", min_edge), ("P005", gap))
        settings = load_settings(
            config=config,
            model=model,
            profile=profile,
            select=select,
            ignore=ignore,
            limits={code: value for code, value in limits if value is not None},
            units=units,
            weld_tolerance_mm=weld_tolerance,
            gap_search_mm=gap_search,
            recursive=recursive,
        )
        found = find_model(model, recursive=settings.recursive)
        quiet = (ctx.obj or {}).get("quiet", False)
        with ProgressBar(quiet=quiet) as progress:
            checked = check_model(
                found,
                settings,
                paths=model,
                jobs=jobs,
                cache_directory=default_directory() if cache else None,
                progress=progress,
            )
        report, base, failed = checked.report, report_base(model), checked.failed
    page = output or page_in_cache(model)
    from vhp_cli.formats.atomic import make_directory, write_atomically

    text = _page(report, base, model[0])
    make_directory(page.parent)
    write_atomically(page, text.encode())
    click.echo(str(page))
    if opening and click.launch(page.resolve().as_uri()) != 0:
        click.echo("note: no browser could be opened; open the page yourself", err=True)
    ctx.exit(FAILED if failed else PASSED)


def _page(report: Report, base: str, source: Path) -> str:
    """Return the page; what a report from a file lacks is told as a mistake in the file."""
    from vhp_cli.errors import UsageError

    try:
        return rendered(report, "html", base)
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        if source.suffix.lower() != ".json":
            raise
        raise UsageError(
            f"{source}: a damaged report: {type(error).__name__} {error}", hint="give the report.json of a command"
        ) from error


def page_in_cache(model: tuple[Path, ...]) -> Path:
    """Return where the page of a model lies if no other place is asked for."""
    import hashlib

    from vhp_cli.pipeline.cache import default_directory

    key = "\n".join(os.path.realpath(path) for path in model)
    digest = hashlib.sha256(key.encode("utf-8", "surrogateescape")).hexdigest()
    return default_directory() / "pages" / f"{digest[:16]}.html"


def read_report(path: Path) -> Report:
    """Return the report in a JSON file.

    Raises
    ------
    UsageError
        If the file can't be read, or holds no report of this form.
    """
    from vhp_cli.errors import UsageError
    from vhp_cli.formats import read_bytes

    try:
        found: Any = json.loads(read_bytes(path))
    except ValueError as error:
        raise UsageError(f"{path}: not JSON: {error}", hint="give a model, or the JSON report of a command") from error
    if not isinstance(found, dict) or found.get("schema") != "vhp-report/1":
        raise UsageError(f"{path}: no report of the form vhp-report/1", hint="give the report.json of a command")
    report: Report = found  # type: ignore[assignment]
    return report
