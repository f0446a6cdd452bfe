"""``vhp diff``: what two models, or two reports, differ in."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from vhp_cli.commands.common import ERRORS, FAILED, PASSED, ProgressBar
from vhp_cli.commands.options import judging_options, run_options
from vhp_cli.errors import UsageError

if TYPE_CHECKING:
    from vhp_cli.config import Settings
    from vhp_cli.measures import Report
    from vhp_cli.report.compare import FailOn

_FORMS = {".json": "json", ".md": "markdown", ".txt": "text"}
_REPORT = "report.json"


@click.command("diff", options_metavar="[OPTIONS]")
@click.argument("before", metavar="A", type=click.Path(path_type=Path))
@click.argument("after", metavar="B", type=click.Path(path_type=Path))
@click.option(
    "--fail-on",
    type=click.Choice(["worse", "errors", "changes", "never"]),
    default="worse",
    show_default=True,
    help="What ends with exit code 1. worse: a verdict that was lost, new or worse errors and warnings, a tissue that "
    "is gone; errors: the verdict and errors alone; changes: any difference.",
)
@click.option(
    "--max-volume-change",
    type=click.FloatRange(min=0),
    metavar="SHARE",
    help="A tissue whose volume changed by more counts as worse.",
)
@click.option("--recursive", is_flag=True, help="Search directories to any depth.")
@click.option(
    "--units",
    type=click.Choice(["um", "mm", "cm", "in", "m"]),
    help="Unit of the files in directories. [default: mm]",
)
@judging_options
@click.option(
    "--report",
    "reports",
    multiple=True,
    metavar="FILE|-",
    help="Write the difference to a file, in the form that its suffix names (.json .md .txt); '-': JSON on stdout.",
)
@click.option("--format", "form", type=click.Choice(["text", "json", "markdown"]), help="Form of what goes to stdout.")
@run_options
@click.pass_context
def diff(
    ctx: click.Context,
    /,
    before: Path,
    after: Path,
    fail_on: FailOn,
    max_volume_change: float | None,
    reports: tuple[str, ...],
    form: str | None,
    **given: Any,
) -> None:
    """Compare A with B, each a report of vhp (JSON), a directory with one, or a model.

    A directory of meshes is checked first, both by the same settings; of one without any, report.json is read. Told
    are tissues that came, went or changed, findings that are new or fixed, and pairs that lie otherwise.

    Exit code: 0 nothing is worse, 1 something is (see --fail-on), 2 wrong usage or nothing readable, 3 a tissue could
    not be processed.
    """
    from vhp_cli.formats.atomic import make_directory, write_atomically
    from vhp_cli.report.compare import compare
    from vhp_cli.report.compare_text import render_difference

    targets = [_target(report) for report in reports]
    talk: dict[str, Any] = ctx.obj or {}
    settings = _settings(given, before, after)
    failed = False
    loaded: list[Report] = []
    for path in (before, after):
        report, incomplete = _load(path, settings, given, quiet=bool(talk.get("quiet")))
        loaded.append(report)
        failed = failed or incomplete
    names = (before.as_posix(), after.as_posix())
    found = compare(*loaded, names=names, max_volume_change=max_volume_change, fail_on=fail_on)
    verbose = bool(talk.get("verbose"))
    for target, its_form in targets:
        if target is not None:
            make_directory(target.parent)
            write_atomically(target, render_difference(found, its_form, verbose=True).encode())
    to_stdout = form or ("json" if any(target is None for target, _ in targets) else "text")
    if to_stdout != "text" or not talk.get("quiet"):
        click.echo(render_difference(found, to_stdout, verbose=verbose), nl=False)
    if failed:
        ctx.exit(FAILED)
    ctx.exit(ERRORS if found["worse"] else PASSED)


def _target(report: str) -> tuple[Path | None, str]:
    if report == "-":
        return None, "json"
    path = Path(report)
    if path.suffix.lower() not in _FORMS:
        raise UsageError(
            f"--report {report}: no form of a difference has the suffix {path.suffix!r}",
            hint=f"suffixes: {' '.join(_FORMS)}",
        )
    return path, _FORMS[path.suffix.lower()]


def _settings(given: Mapping[str, Any], before: Path, after: Path) -> Settings:
    """Return the settings by which both are judged: those of B, if it is a model, else of A."""
    from vhp_cli.config import load_settings

    limits = (("Q001", given["min_q"]), ("Q002", given["min_edge"]), ("P005", given["gap"]))
    return load_settings(
        config=given["config"],
        model=[path for path in (after, before) if path.is_dir()][:1],
        profile=given["profile"],
        select=given["select"],
        ignore=given["ignore"],
        limits={code: value for code, value in limits if value is not None},
        units=given["units"],
        gap_search_mm=given["gap_search"],
        recursive=given["recursive"],
    )


def _load(path: Path, settings: Settings, given: Mapping[str, Any], *, quiet: bool) -> tuple[Report, bool]:
    """Return the report on a path, and whether a tissue could not be processed."""
    import os

    from vhp_cli.model import SUFFIXES
    from vhp_cli.report.compare import parse_report

    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if path.is_dir():
        holds_meshes = settings.recursive or any(file.suffix.lower() in SUFFIXES for file in path.iterdir())
        if not holds_meshes and (path / _REPORT).is_file():
            path /= _REPORT
    if not path.exists():
        raise UsageError(f"{path}: no such file or directory")
    if path.suffix.lower() == ".json" and path.is_file():
        return parse_report(path.read_bytes(), path.as_posix()), False

    from vhp_cli.model import find_model
    from vhp_cli.pipeline.cache import default_directory
    from vhp_cli.pipeline.check import check_model

    with ProgressBar(quiet=quiet) as progress:
        checked = check_model(
            find_model([path], recursive=settings.recursive),
            settings,
            paths=[path],
            jobs=given["jobs"],
            cache_directory=default_directory() if given["cache"] else None,
            progress=progress,
        )
    return checked.report, checked.failed
