"""``vhp decimate --refine``: the other way round, told apart from decimation."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from vhp_cli.errors import UsageError

if TYPE_CHECKING:
    from vhp_cli.commands.staging import Shared
    from vhp_cli.config import Settings
    from vhp_cli.pipeline.stage import Stage
    from vhp_cli.stages.refine.options import RefineOptions

TARGET = "vhp_cli.stages.refine:refine"
# Each time a tissue meets a neighbour, smoothing may move it a quarter as far, then not at all; the last time it is
# left as it is.
_MOST_GENTLE = 4
# Keys of [decimate], also flags, that belong to one of the two only.
DECIMATING = ("ratio", "triangles", "edge-length", "method", "target-q")
REFINING = ("refine", "by", "errors", "error-property", "scenario", "levels", "smooth")
_WHOLE_RUN = ("errors", "error-property")


def is_refinement(table: Mapping[str, object], flags: Mapping[str, object]) -> bool:
    """Tell whether triangles are to be refined: as the flags say, else as the section [decimate] says.

    Raises
    ------
    UsageError
        If either of them says both.
    """
    from vhp_cli.stages.decimate.options import TARGETS

    decimating, refining = ([key for key in keys if key in flags] for keys in (DECIMATING, REFINING))
    if decimating and refining:
        raise UsageError(
            f"--{refining[0]} and --{decimating[0]} exclude each other: one refines triangles, the other decimates",
            hint="run the command twice, the second time on the result of the first",
        )
    if "refine" in table and (targets := table.keys() & TARGETS.keys()):
        raise UsageError(f"decimate: refine and {min(targets)} exclude each other")
    if refining and "refine" not in flags and "refine" not in table:
        raise UsageError(f"--{refining[0]} needs --refine PERCENT")
    return bool(refining) or ("refine" in table and not decimating)


def own_values(
    values: Mapping[str, object], others: Collection[str], where: str, refused: Collection[str] = ()
) -> dict[str, object]:
    """Return the values of a table without those for the other kind of run.

    Raises
    ------
    UsageError
        If there is one that is refused.
    """
    if found := [key for key in refused if key in values]:
        raise UsageError(f"{where}: {found[0]}: a run either refines or decimates", hint="run the command on each part")
    return {key: value for key, value in values.items() if key not in others}


def refine_stage(settings: Settings, flags: Mapping[str, object], request: Shared) -> Stage:
    """Put the stage together.

    Raises
    ------
    UsageError
        If a value is wrong, or it is known beforehand that there are no errors to pick triangles by.
    """
    from vhp_cli.model import find_model
    from vhp_cli.pipeline.face_errors import FaceErrors, fingerprint
    from vhp_cli.pipeline.stage import Stage
    from vhp_cli.stages.refine.options import BY_ERROR

    options, options_of = _options(settings, flags)
    path = None
    if options.errors is not None:
        path = Path(options.errors) if "errors" in flags else _beside_settings(request) / options.errors
        path = path.absolute()
    where = FaceErrors(path, options.error_property or "error")
    model = find_model(request.model, recursive=settings.recursive)
    wanting = [tissue for tissue in model.tissues if options_of(tissue.name).by == BY_ERROR]
    if path is not None and not path.exists():
        raise UsageError(f"errors: {path}: no such file or directory")
    if path is not None and not path.is_dir() and len(model.tissues) > 1:
        raise UsageError(
            f"errors: {path} is one file, and the model has {len(model.tissues)} tissues",
            hint="give a directory with NAME.npy for each tissue",
        )
    if path is None and wanting and all(tissue.path.suffix.lower() != ".ply" for tissue in wanting):
        raise UsageError(
            "where are the errors of the triangles?",
            hint="give --errors with a file or directory, or --by size to refine the largest triangles",
        )
    described = options.as_dict()
    if path is not None:
        # What the files hold decides what comes out, too.
        described |= {"errors": str(path), "errors-sha256": fingerprint(where, model)}
    return Stage(
        "decimate",
        TARGET,
        options_of,
        described,
        most_gentle=_MOST_GENTLE,
        gives_up=True,
        face_errors=lambda name: where if options_of(name).by == BY_ERROR else None,
    )


def _options(settings: Settings, flags: Mapping[str, object]) -> tuple[RefineOptions, Callable[[str], RefineOptions]]:
    """Return the options of the run, and what they are for a tissue: patterns of the settings come last."""
    from vhp_cli.stages.decimate.options import TARGETS
    from vhp_cli.stages.refine.options import BY_SIZE, RefineOptions

    table = own_values(settings.stages.get("decimate", {}), DECIMATING, "decimate")
    options = RefineOptions().changed(table, "decimate").changed(flags, "command line")
    if options.errors is not None and options.error_property is not None:
        raise UsageError("errors come from files (errors) or from the mesh files (error-property), not both")
    if options.by == BY_SIZE and (options.errors is not None or options.error_property is not None):
        raise UsageError("by size, no errors are needed", hint="leave out --errors and --error-property, or --by size")
    # A table that goes with a flag is not that of this run alone.
    refused = () if "refine" in flags else tuple(TARGETS)

    def changed(mine: RefineOptions, values: Mapping[str, object], where: str) -> RefineOptions:
        if found := [key for key in _WHOLE_RUN if key in values]:
            raise UsageError(f"{where}: {found[0]} belongs to the whole run")
        return mine.changed(own_values(values, DECIMATING, where, refused), where)

    for override in settings.tissues:
        # What is wrong in a section is said, whether a tissue matches or not.
        changed(options, override.stages.get("decimate", {}), f"[[tissue]] {override.match!r}: decimate")

    def options_of(name: str) -> RefineOptions:
        mine = options
        for where, values in settings.stage_tables("decimate", name):
            mine = changed(mine, values, where)
        edge, fold = (settings.rule(code, name).limit or 0.0 for code in ("Q002", "X005"))
        return replace(mine, min_edge_mm=edge, fold_deg=fold)

    return options, options_of


def _beside_settings(request: Shared) -> Path:
    """Return the directory that paths in the settings file are relative to."""
    if request.config is not None:
        return request.config.parent
    return next((path for path in request.model if path.is_dir()), Path())
