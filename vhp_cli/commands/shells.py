"""``vhp shells``: skin, fat and average body from one body surface."""

from __future__ import annotations

from collections.abc import Iterator
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
from vhp_cli.commands.options import judging_options, report_options, worker_options
from vhp_cli.commands.time_limits import by_size

if TYPE_CHECKING:
    from vhp_cli.stages.shells.offsetting import Shell

_LENGTH = click.FloatRange(min=0, min_open=True)


@click.command()
@click.argument("skin", type=click.Path(path_type=Path, dir_okay=False, exists=True))
@click.option(
    "-o",
    "--output",
    required=True,
    metavar="OUT",
    type=click.Path(path_type=Path, file_okay=False),
    help="Directory for skin, fat, average_body and report.json.",
)
@click.option("--skin", "thickness", type=_LENGTH, default=1.0, show_default=True, metavar="MM", help="Skin thickness.")
@click.option(
    "--fat",
    required=True,
    metavar="MM|MAP",
    help="Thickness of the fat: a number; a .toml map of points on the skin, each with a thickness or a place of "
    "Table 5.1 of the thesis; or an .npy array with a number for each vertex or triangle.",
)
@click.option("--grid", type=_LENGTH, metavar="MM", help="Cells in which cuts are worked out. [default: by size]")
@click.option("--units", type=click.Choice(["um", "mm", "cm", "in", "m"]), help="Unit of the file. [default: mm]")
@click.option("--overwrite", is_flag=True, help="Write into a directory that is not empty.")
@judging_options
@report_options
@worker_options
@click.pass_context
def shells(
    ctx: click.Context,
    skin: Path,
    output: Path,
    thickness: float,
    fat: str,
    grid: float | None,
    units: str | None,
    overwrite: bool,
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
    """Make inner shells of the body surface SKIN: the fat shell within the skin, the average body within the fat.

    Every vertex goes inward until the faces are as deep as asked; where the body is too thin or too much bent for that
    (ears, lips, between fingers), what is too shallow is cut off, and the shell may end. The gate of `vhp check` then
    judges OUT.

    Exit code: 0 the result passed, 1 errors remain or a shell is nearer than asked, 2 wrong usage, a skin that can't be
    read or that is not sound, 3 a limit was broken.
    """
    from vhp_cli.config import load_settings
    from vhp_cli.pipeline.output import REPORT
    from vhp_cli.pipeline.shells import make_shells
    from vhp_cli.pipeline.stage import Limits
    from vhp_cli.processes import CallFailed

    targets = [report_target(report, form) for report in reports]
    limits = (("Q001", min_q), ("Q002", min_edge), ("P005", gap))
    settings = load_settings(
        config=config,
        model=(skin.parent,),
        profile=profile,
        select=select,
        ignore=ignore,
        limits={code: value for code, value in limits if value is not None},
        units=units,
        gap_search_mm=gap_search,
    )
    talk = ctx.obj or {}
    try:
        with ProgressBar(quiet=talk.get("quiet", False)) as progress:
            made = make_shells(
                skin,
                output,
                settings,
                skin_mm=thickness,
                fat=fat,
                grid_mm=grid,
                jobs=jobs,
                limits=by_size(ctx, Limits(timeout, memory)),
                overwrite=overwrite,
                progress=progress,
            )
    except CallFailed as error:
        if error.reason == "error":
            raise
        click.echo(f"error: {error.detail}", err=True)
        ctx.exit(FAILED)
    write_reports(made.report, [*targets, (output / REPORT, "json")], report_base((output,)))
    to_stdout = next((target_form for path, target_form in targets if path is None), form)
    show_report(made.report, to_stdout or "table", report_base((output,)), **talk)
    if not talk.get("quiet"):
        for shell in made.shells:
            for line in _notes(shell):
                click.echo(f"note: {shell.name} {line}", err=True)
    reached = all(shell.reached for shell in made.shells)
    ctx.exit(PASSED if made.report["summary"]["passed"] and reached else ERRORS)


def _notes(shell: Shell) -> Iterator[str]:
    """Return what is worth knowing of a shell, in one line each."""
    around = "skin" if shell.name == "fat" else "fat"
    yield (
        f"is {shell.gap_mm:.4g} mm or more within the {around}; half of it is not deeper than "
        f"{shell.depth[0]:.3g} times the thickness asked for, 99 % not than {shell.depth[1]:.3g} times"
    )
    if shell.gap_mm < shell.thickness_mm[0]:
        yield f"is nearer than {shell.thickness_mm[0]:.3g} mm at {_place(shell.gap_xyz_mm)}: smooth the skin there"
    elif not shell.reached:
        yield f"has places of {shell.shallowest:.3g} times the thickness asked for"
    if shell.ends:
        largest, area = shell.ends[0], sum(end.area_mm2 for end in shell.ends)
        yield (
            f"ends where the body is too thin, in {len(shell.ends)} places, under {area:.3g} mm2; "
            f"the largest is at {_place(largest.xyz_mm)}"
        )
    if shell.dropped:
        volume = sum(piece.volume_mm3 for piece in shell.dropped)
        yield (
            f"had {len(shell.dropped)} small separate pieces of {volume:.3g} mm3, which were left out; "
            f"the largest was at {_place(shell.dropped[0].xyz_mm)}"
        )


def _place(xyz_mm: tuple[float, float, float]) -> str:
    return ", ".join(f"{value:.1f}" for value in xyz_mm)
