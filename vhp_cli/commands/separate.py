"""``vhp separate``: tissues that neither cross nor touch, with the gap that a solver needs."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from vhp_cli.commands.declaring import declare_option, read_declared
from vhp_cli.commands.options import judging_options, model_options, report_options, stage_options, worker_options
from vhp_cli.commands.staging import Shared, run_staged
from vhp_cli.commands.time_limits import by_size

if TYPE_CHECKING:
    from vhp_cli.config import Settings
    from vhp_cli.stages.clearance.options import ClearanceOptions

_LENGTH = click.FloatRange(min=0, min_open=True)


@click.command()
@model_options
@stage_options
@click.option(
    "--method",
    type=click.Choice(["auto", "move", "cut"]),
    help="Move vertices and keep the triangles, or cut; auto: move, and cut what can't be moved. [default: auto]",
)
@click.option("--grid", type=_LENGTH, metavar="MM", help="Cells for cuts. [default: 0.8 of the gap]")
@click.option("--max-move", type=click.FloatRange(min=0), metavar="MM", help="How far vertices may move. [default: 2]")
@click.option(
    "--thin", type=click.FloatRange(min=0), metavar="MM", help="Walls thinner than this move as a whole. [default: 4.5]"
)
@click.option(
    "--rigid-pairs",
    type=click.Choice(["least", "share", "keep"]),
    help="Two rigid tissues: part those that cross or touch, the larger one gives way; let both give way wherever they "
    "are too close; or leave them. [default: least]",
)
@click.option("--rounds", type=click.IntRange(0, 6), metavar="N", help="Refinements of what is too close. [default: 3]")
@declare_option
@judging_options
@report_options
@worker_options
@click.pass_context
def separate(
    ctx: click.Context,
    /,
    method: str | None,
    grid: float | None,
    max_move: float | None,
    thin: float | None,
    rigid_pairs: str | None,
    rounds: int | None,
    declare: Path | None,
    **shared: Any,
) -> None:
    """Take the tissues of a model apart: no crossing, no contact, and a gap between any two (--gap).

    Every tissue of MODEL is written to OUT under its own name. Who gives way follows from the tissue type: bone
    stays as it is, cartilage gives way a little, soft tissue more; vhp.toml changes that. What lies inside another
    tissue stays inside, and what lies beside it stays beside it. If a gap can't be had, the best that can is kept,
    and the report says where. The gate of `vhp check` then judges OUT.

    Exit code: 0 the result passed, 1 errors remain, 2 wrong usage or nothing readable, 3 a tissue could not be
    processed.
    """
    request = Shared(**shared)
    flags = {
        "method": method,
        "grid": grid,
        "max-move": max_move,
        "thin": thin,
        "rigid-pairs": rigid_pairs,
        "rounds": rounds,
    }
    declared = read_declared(declare)
    settings = declared.added_to(request.settings())
    options = clearance_options(settings, {key: value for key, value in flags.items() if value is not None})

    from vhp_cli.pipeline.clearance import COMMAND, TARGET, plan_separation, separate_model
    from vhp_cli.pipeline.stage import Stage

    def run(model: Any, out: Any, stage: Stage, settings: Settings, **how: Any) -> Any:
        return separate_model(model, out, options, settings, **{**how, "limits": by_size(ctx, how["limits"])})

    def plan(model: Any, out: Any, stage: Stage, settings: Settings, **how: Any) -> Any:
        return plan_separation(model, out, options, settings, **how)

    stage = Stage(COMMAND, TARGET, partial(_checked, settings), options.as_dict())
    run_staged(ctx, stage, settings, request, run=run, plan=plan, declared=declared)


def clearance_options(settings: Settings, flags: Mapping[str, object]) -> ClearanceOptions:
    """Return the options of a run."""
    from vhp_cli.stages.clearance.options import ClearanceOptions
    from vhp_cli.stages.clearance.stiffness import stiffness_of

    for override in settings.tissues:
        # What is wrong in a section is said, whether a tissue matches or not.
        stiffness_of("tissue", [(f"[[tissue]] {override.match!r}: clearance", override.stages.get("clearance", {}))])
    return ClearanceOptions().changed(settings.stages.get("clearance", {}), "clearance").changed(flags, "command line")


def _checked(settings: Settings, name: str) -> object:
    from vhp_cli.stages.clearance.stiffness import stiffness_of

    return stiffness_of(settings.tissue_type(name), settings.stage_tables("clearance", name))
