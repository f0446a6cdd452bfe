"""``vhp smooth``: the same surfaces with better triangles."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import click

from vhp_cli.commands.options import judging_options, model_options, report_options, stage_options, worker_options
from vhp_cli.commands.staging import Shared, run_staged

if TYPE_CHECKING:
    from vhp_cli.config import Settings
    from vhp_cli.stages.smooth.options import SmoothOptions

TARGET = "vhp_cli.stages.smooth:smooth"
_METHODS = ("guarded", "standard", "lumped", "cvt", "wcc", "cvt-equal", "wcc-equal")
_ANGLE = click.FloatRange(0, 180, min_open=True)


@click.command()
@model_options
@stage_options
@click.option(
    "--method",
    type=click.Choice(_METHODS),
    help="guarded: relax vertices along the surface and flip edges, as long as that helps; or a Laplacian method of "
    "the thesis. [default: guarded]",
)
@click.option(
    "--update",
    type=click.Choice(["simultaneous", "sequential"]),
    help="When a Laplacian method moves a vertex. [default: simultaneous]",
)
@click.option(
    "--correction",
    type=click.Choice(["none", "hc", "taubin", "volume"]),
    help="What a Laplacian method does against shrinkage. [default: none]",
)
@click.option("--tangential", is_flag=True, help="Let a Laplacian method move vertices along the surface only.")
@click.option("--flips/--no-flips", default=None, help="Flip edges. [default: with the method guarded only]")
@click.option("--iterations", type=click.IntRange(min=0), metavar="N", help="At most. [default: 50 guarded, else 10]")
@click.option("--until-q", type=click.FloatRange(0, 1), metavar="Q", help="Stop when all triangles have this q.")
@click.option(
    "--max-deviation",
    type=click.FloatRange(min=0, min_open=True),
    metavar="MM",
    help="How far a surface may move. [default: 0.1 % of the tissue's diagonal, at most 0.1 mm]",
)
@click.option(
    "--volume-tolerance",
    type=click.FloatRange(0, 1, min_open=True),
    metavar="SHARE",
    help="How much the volume may change. [default: 0.001]",
)
@click.option("--max-dihedral", type=_ANGLE, metavar="DEG", help="Round off edges where the surface turns by more.")
@click.option("--feature-angle", type=_ANGLE, metavar="DEG", help="Keep edges where the surface turns by more.")
@click.option("--unguarded", is_flag=True, help="Take what a Laplacian method makes, broken or not.")
@judging_options
@report_options
@worker_options
@click.pass_context
def smooth(
    ctx: click.Context,
    /,
    method: str | None,
    update: str | None,
    correction: str | None,
    tangential: bool,
    flips: bool | None,
    iterations: int | None,
    until_q: float | None,
    max_deviation: float | None,
    volume_tolerance: float | None,
    max_dihedral: float | None,
    feature_angle: float | None,
    unguarded: bool,
    **shared: Any,
) -> None:
    """Smooth a model: better triangles at the same shape, volume and topology.

    Every tissue of MODEL is written to OUT under its own name. No step adds a hole, a crossing or a contact,
    with the tissue itself or with its neighbours, and defects that are there stay as they are. A tissue that
    can't get better is copied. The gate of `vhp check` then judges OUT.

    Exit code: 0 the result passed, 1 errors remain, 2 wrong usage or nothing readable, 3 a tissue could not be
    processed.
    """
    request = Shared(**shared)
    flags = {
        "method": method,
        "update": update,
        "correction": correction,
        "tangential": tangential or None,
        "flips": flips,
        "iterations": iterations,
        "until-q": until_q,
        "max-deviation": max_deviation,
        "volume-tolerance": volume_tolerance,
        "max-dihedral": max_dihedral,
        "feature-angle": feature_angle,
        "unguarded": unguarded or None,
    }
    settings = request.settings()
    options, options_of = _options(settings, {key: value for key, value in flags.items() if value is not None})

    from vhp_cli.pipeline.stage import Stage

    # Unguarded, nothing is held back: not for the tissue's own sake, and not for a neighbour's.
    guarded = not options.unguarded
    stage = Stage(
        "smooth",
        TARGET,
        options_of,
        options.as_dict(),
        most_gentle=3 if guarded else 0,
        gives_up=guarded,
        never_worse=guarded,
    )
    run_staged(ctx, stage, settings, request)


def _options(settings: Settings, flags: Mapping[str, object]) -> tuple[SmoothOptions, Callable[[str], SmoothOptions]]:
    """Return the options of the run, and what they are for a tissue: patterns of the settings come last."""
    from vhp_cli.errors import UsageError
    from vhp_cli.stages.smooth.options import SmoothOptions

    table = settings.stages.get("smooth", {})
    options = SmoothOptions().changed(table, "smooth").changed(flags, "command line")
    options.require_sense("smooth")
    for override in settings.tissues:
        # What is wrong in a section is said, whether a tissue matches or not.
        where, values = f"[[tissue]] {override.match!r}: smooth", override.stages.get("smooth", {})
        if "unguarded" in values:
            raise UsageError(f"{where}: unguarded belongs to the whole run")
        options.changed(values, where).require_sense(where)

    def options_of(name: str) -> SmoothOptions:
        mine = options
        for where, values in settings.stage_tables("smooth", name):
            mine = mine.changed(values, where)
        mine.require_sense(f"options for {name}")
        edge = settings.rule("Q002", name)
        return replace(mine, min_edge_mm=edge.limit) if edge.level and edge.limit is not None else mine

    return options, options_of
