"""``vhp heal``: surfaces that a solver refuses in, surfaces that pass the gate out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from vhp_cli.commands.declaring import declare_option, read_declared
from vhp_cli.commands.options import judging_options, model_options, report_options, stage_options, worker_options
from vhp_cli.commands.staging import Shared, run_staged
from vhp_cli.commands.time_limits import by_size
from vhp_cli.errors import UsageError

if TYPE_CHECKING:
    from vhp_cli.config import Settings
    from vhp_cli.stages.heal.options import HealOptions

TARGET = "vhp_cli.stages.heal:heal"
_LENGTH = click.FloatRange(min=0, min_open=True)


def _gap(ctx: click.Context, parameter: click.Parameter, value: str | None) -> float | None:
    """Return the gap asked for; 0 if no number was given, None without the option."""
    return None if value is None else 0.0 if not value else float(_LENGTH(value, parameter, ctx))


@click.command()
@model_options
@stage_options
@click.option(
    "--max-deviation",
    type=_LENGTH,
    metavar="MM",
    help="How far a surface may move. [default: 0.1 % of the tissue's diagonal, at most 0.1 mm]",
)
@click.option(
    "--target-q",
    type=click.FloatRange(0, 0.9),
    metavar="Q",
    help="Bring all triangles to this q = 2 r_in / r_out. [default: 0.3]",
)
@click.option("--edge-length", type=_LENGTH, metavar="MM", help="Remesh to this edge length. [default: as it is]")
@click.option("--max-triangles", type=click.IntRange(min=4), metavar="N", help="Most triangles of a tissue.")
@click.option(
    "--cap-openings/--keep-openings",
    default=None,
    help="Close wide openings, or leave open surfaces open and heal the rest. [default: close]",
)
@click.option("--min-component", type=_LENGTH, metavar="MM", help="Remove separate parts smaller than this.")
@click.option("--only-topology", is_flag=True, help="Close, orient and resolve; leave the shape of triangles alone.")
@click.option("--thicken", type=_LENGTH, metavar="MM", help="Make open sheets solids of this thickness.")
@click.option(
    "--clearance",
    is_flag=False,
    flag_value="",
    metavar="[GAP]",
    callback=_gap,
    help="Then take tissues apart as `vhp separate` does, to a gap of so many mm (--clearance=0.5). [default: --gap]",
)
@declare_option
@judging_options
@report_options
@worker_options
@click.pass_context
def heal(
    ctx: click.Context,
    /,
    max_deviation: float | None,
    target_q: float | None,
    edge_length: float | None,
    max_triangles: int | None,
    cap_openings: bool | None,
    min_component: float | None,
    only_topology: bool,
    thicken: float | None,
    clearance: float | None,
    declare: Path | None,
    **shared: Any,
) -> None:
    """Heal a model: close holes, resolve self-intersections, turn faces outward, improve triangles.

    Every tissue of MODEL is written to OUT under its own name. One that needs nothing, or that can't be healed
    within --max-deviation, is copied as it is, and the report says why. A result that breaks a rule which the
    input kept is never written. The gate of `vhp check` then judges OUT. --min-edge is the shortest edge that is
    left as well as the limit of Q002.

    Exit code: 0 the result passed, 1 errors remain, 2 wrong usage or nothing readable, 3 a tissue could not be
    processed.
    """
    if clearance:
        if shared["gap"] not in (None, clearance):
            raise UsageError(f"--clearance {clearance:g} and --gap {shared['gap']:g} contradict each other")
        shared["gap"] = clearance
    if declare and clearance is None:
        raise UsageError("--declare says how tissues are taken apart", hint="add --clearance")
    request = Shared(**shared)
    flags = {
        "max-deviation": max_deviation,
        "target-q": target_q,
        "min-edge": request.min_edge,
        "edge-length": edge_length,
        "max-triangles": max_triangles,
        "cap-openings": cap_openings,
        "min-component": min_component,
        "only-topology": only_topology or None,
        "thicken": thicken,
    }
    declared = read_declared(declare)
    settings = declared.added_to(request.settings())
    options, options_of = _options(settings, {key: value for key, value in flags.items() if value is not None})

    from vhp_cli.pipeline.stage import Stage

    stage = Stage("heal", TARGET, options_of, options.as_dict(), most_gentle=2)
    if clearance is None:
        run_staged(ctx, stage, settings, request)
        return

    from vhp_cli.commands.separate import clearance_options
    from vhp_cli.pipeline.healed_clearance import heal_and_separate, plan_healing

    apart = clearance_options(settings, {})

    def run(model: Any, out: Any, stage: Stage, settings: Settings, **how: Any) -> Any:
        limits = by_size(ctx, how["limits"])
        return heal_and_separate(model, out, stage, apart, settings, **{**how, "limits": limits})

    def plan(model: Any, out: Any, stage: Stage, settings: Settings, **how: Any) -> Any:
        return plan_healing(model, out, stage, apart, settings, **how)

    run_staged(ctx, stage, settings, request, run=run, plan=plan, declared=declared)


def _options(settings: Settings, flags: Mapping[str, object]) -> tuple[HealOptions, Callable[[str], HealOptions]]:
    """Return the options of the run, and what they are for a tissue: patterns of the settings come last.

    Triangles and edges are healed at least as far as the gate wants them.
    """
    from vhp_cli.stages.heal.options import HealOptions

    table = settings.stages.get("heal", {})
    options = HealOptions().changed(table, "heal").changed(flags, "command line")
    for override in settings.tissues:
        # What is wrong in a section is said, whether a tissue matches or not.
        options.changed(override.stages.get("heal", {}), f"[[tissue]] {override.match!r}: heal")

    def options_of(name: str) -> HealOptions:
        mine = options
        for where, values in settings.stage_tables("heal", name):
            mine = mine.changed(values, where)
        quality, edge, budget = (settings.rule(code, name) for code in ("Q001", "Q002", "Q005"))
        if quality.level and quality.limit is not None:
            mine = replace(mine, target_quality=max(mine.target_quality, min(quality.limit, 0.9)))
        if edge.level and edge.limit is not None:
            mine = replace(mine, min_edge_mm=max(mine.min_edge_mm, edge.limit))
        if budget.level == "error" and budget.limit is not None and mine.max_triangles is None:
            mine = replace(mine, max_triangles=max(int(budget.limit), 4))
        return mine

    return options, options_of
