"""``vhp decimate``: fewer triangles, or more where it matters, and surfaces that are as valid as they were."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import click

from vhp_cli.commands.common import ProgressBar
from vhp_cli.commands.options import judging_options, model_options, report_options, stage_options, worker_options
from vhp_cli.commands.refining import DECIMATING, REFINING, is_refinement, own_values, refine_stage
from vhp_cli.commands.staging import Shared, run_staged
from vhp_cli.errors import UsageError

if TYPE_CHECKING:
    from vhp_cli.config import Settings
    from vhp_cli.stages.decimate.options import DecimateOptions

TARGET = "vhp_cli.stages.decimate:decimate"
# Each time a tissue meets a neighbour, it may move a quarter as far; the last time not at all.
_MOST_GENTLE = 4
_LENGTH = click.FloatRange(min=0, min_open=True)


@click.command()
@model_options
@stage_options
@click.option(
    "--ratio",
    type=click.FloatRange(0, 1, min_open=True),
    metavar="R",
    help="Part of the triangles of each tissue that is left.",
)
@click.option(
    "--triangles",
    type=click.IntRange(min=4),
    metavar="N",
    help="Triangles of the model that are left, shared out over the tissues by where error is least.",
)
@click.option("--edge-length", type=_LENGTH, metavar="MM", help="Mean length of the edges that are left.")
@click.option(
    "--max-deviation",
    type=_LENGTH,
    metavar="MM",
    help="How far a surface may move; alone: as few triangles as this allows. "
    "[default: 0.5 % of the tissue's diagonal, more where triangles are few, less where it is thin]",
)
@click.option(
    "--method",
    type=click.Choice(["quadric", "midpoint", "removal"]),
    help="Collapse edges of least quadric error, or the shortest edge to its midpoint, or remove vertices. "
    "[default: quadric]",
)
@click.option(
    "--target-q",
    type=click.FloatRange(0, 0.9),
    metavar="Q",
    help="Bring all triangles to this q = 2 r_in / r_out. [default: 0.3]",
)
@click.option(
    "--refine",
    type=click.FloatRange(0, 100, min_open=True),
    metavar="PERCENT",
    help="Do not decimate: split the worst triangles of each tissue at the midpoints of their edges, then smooth.",
)
@click.option(
    "--by",
    type=click.Choice(["error", "size"]),
    help="Refine the triangles with the largest errors, or the largest ones. [default: error]",
)
@click.option(
    "--errors",
    type=click.Path(),
    metavar="PATH",
    help="Errors to refine by: FILE.npy with a number for each triangle of the only tissue, or a directory with "
    "NAME.npy for each. [default: in PLY files, see --error-property]",
)
@click.option(
    "--error-property", metavar="NAME", help="Property of the faces of PLY files that is the error. [default: error]"
)
@click.option(
    "--scenario",
    type=click.Choice(["all-edges", "shared-edges"]),
    help="Refine all edges of the picked triangles, and fit those around them; or only edges that two picked triangles "
    "share, and boundary edges. [default: all-edges]",
)
@click.option("--levels", type=click.IntRange(1, 10), metavar="N", help="Refine N times over. [default: 1]")
@click.option("--smooth/--no-smooth", default=None, help="Smooth what was refined. [default: smooth]")
@judging_options
@report_options
@worker_options
@click.pass_context
def decimate(
    ctx: click.Context,
    /,
    ratio: float | None,
    triangles: int | None,
    edge_length: float | None,
    max_deviation: float | None,
    method: str | None,
    target_q: float | None,
    refine: float | None,
    by: str | None,
    errors: str | None,
    error_property: str | None,
    scenario: str | None,
    levels: int | None,
    smooth: bool | None,
    **shared: Any,
) -> None:
    """Decimate a model, or refine it: fewer or more triangles, no new hole, crossing or contact.

    Every tissue of MODEL is written to OUT under its own name, with the number of triangles asked for, or as few as
    the limits allow; the report says why. With --refine, its worst triangles are split instead. A result that breaks
    a rule which the input kept is never written. The gate of `vhp check` then judges OUT.

    Exit code: 0 the result passed, 1 errors remain, 2 wrong usage or nothing readable, 3 a tissue could not be
    processed.
    """
    request = Shared(**shared)
    given = {
        "ratio": ratio,
        "triangles": triangles,
        "edge-length": edge_length,
        "max-deviation": max_deviation,
        "method": method,
        "target-q": target_q,
        "refine": refine,
        "by": by,
        "errors": errors,
        "error-property": error_property,
        "scenario": scenario,
        "levels": levels,
        "smooth": smooth,
    }
    flags = {key: value for key, value in given.items() if value is not None}
    settings = request.settings()
    if is_refinement(settings.stages.get("decimate", {}), flags):
        run_staged(ctx, refine_stage(settings, flags, request), settings, request)
        return
    options, options_of = _options(settings, flags)

    from vhp_cli.pipeline.stage import Stage

    described = options.as_dict()
    if options.triangles is not None:
        sharing, shares = _shares(ctx, options.triangles, settings, request)
        described["shares"] = shares
        options_of = _shared(options_of, sharing, shares)
    stage = Stage("decimate", TARGET, options_of, described, most_gentle=_MOST_GENTLE, gives_up=True)
    run_staged(ctx, stage, settings, request)


def _options(
    settings: Settings, flags: Mapping[str, object]
) -> tuple[DecimateOptions, Callable[[str], DecimateOptions]]:
    """Return the options of the run, and what they are for a tissue: patterns of the settings come last.

    Triangles are brought to the quality that the gate wants, at least.
    """
    from vhp_cli.stages.decimate.options import DecimateOptions

    table = own_values(settings.stages.get("decimate", {}), REFINING, "decimate")
    options = DecimateOptions().changed(table, "decimate").changed(flags, "command line")
    if not options.targets and options.max_deviation_mm is None:
        raise UsageError(
            "how far is the model to be decimated?",
            hint="give --ratio, --triangles, --edge-length, or --max-deviation alone; or --refine for more triangles",
        )
    refused = () if flags.keys() & DECIMATING else ("refine",)
    for override in settings.tissues:
        # What is wrong in a section is said, whether a tissue matches or not.
        where = f"[[tissue]] {override.match!r}: decimate"
        options.changed(own_values(override.stages.get("decimate", {}), REFINING, where, refused), where)

    def options_of(name: str) -> DecimateOptions:
        mine = options
        for where, values in settings.stage_tables("decimate", name):
            mine = mine.changed(own_values(values, REFINING, where), where)
        quality = settings.rule("Q001", name)
        if quality.level and quality.limit is not None:
            mine = replace(mine, target_quality=max(mine.target_quality, min(quality.limit, 0.9)))
        return mine

    return options, options_of


def _shares(
    ctx: click.Context, total: int, settings: Settings, request: Shared
) -> tuple[Collection[str], Mapping[str, int]]:
    """Return the names of the tissues that share a number of triangles, and what each of them gets.

    Those with a target of their own take no part. What can't be estimated is not among the second.
    """
    from vhp_cli.model import find_model
    from vhp_cli.pipeline.output import refuse_overlap
    from vhp_cli.pipeline.sharing import share_triangles
    from vhp_cli.pipeline.stage import Limits
    from vhp_cli.stages.decimate.options import TARGETS

    def has_own(name: str) -> bool:
        return any(key in values for _, values in settings.stage_tables("decimate", name) for key in TARGETS)

    model = find_model(request.model, recursive=settings.recursive)
    refuse_overlap(request.output, model, request.model)
    tissues = [tissue for tissue in model.tissues if not has_own(tissue.name)]
    with ProgressBar(quiet=(ctx.obj or {}).get("quiet", False)) as progress:
        shares = share_triangles(
            tissues,
            total,
            settings,
            jobs=request.jobs,
            limits=Limits(request.timeout, request.memory),
            progress=progress,
        )
    return {tissue.name for tissue in tissues}, shares


def _shared(
    options_of: Callable[[str], DecimateOptions], sharing: Collection[str], shares: Mapping[str, int]
) -> Callable[[str], DecimateOptions]:
    """Return options in which the tissues that share have their part; one that could not be estimated keeps all."""

    def shared(name: str) -> DecimateOptions:
        options = options_of(name)
        if name in shares:
            return replace(options, triangles=shares[name])
        return replace(options, triangles=None, ratio=1.0) if name in sharing else options

    return shared
