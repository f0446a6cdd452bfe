"""Bring one tissue into its room: move its vertices, and cut what can't be moved."""

from __future__ import annotations

import numpy as np

from vhp_cli.inspection.deviation import deviation
from vhp_cli.kernels import surface
from vhp_cli.measures import Action
from vhp_cli.mesh import Mesh
from vhp_cli.stages.clearance.attempt import Attempt, finish_mm, spacing_mm
from vhp_cli.stages.clearance.carving import known_vertices
from vhp_cli.stages.clearance.cell import Cell
from vhp_cli.stages.clearance.cutting import SQUEEZED, Cut, Cutter, NoCutError
from vhp_cli.stages.clearance.displacement import displaced
from vhp_cli.stages.clearance.finishing import rescued
from vhp_cli.stages.clearance.options import ClearanceOptions
from vhp_cli.stages.clearance.sampling import excess_of
from vhp_cli.stages.clearance.stiffness import thickness_of
from vhp_cli.stages.heal.candidate import as_written, judge
from vhp_cli.stages.outcome import Outcome

# Towards those to which it does not give way a tissue may move by so many margins.
_HELD = 1.05
# Deeper than so many times the way that vertices may go, moving is not tried; those of thin tissues may go so many
# times as far.
_TOO_DEEP, _THIN_FARTHER = 1.2, 2.0
# A thin tissue that could be moved only part of the way is cut from there if this share of the excess is left at most.
_HELPFUL = 0.6
# If moving takes more than this share of the volume, it is cut as well, and what takes less is kept: where triangles
# are large, a wide surface follows the vertices that are moved.
_MUCH = 0.01


def separate(
    mesh: Mesh, cell: Cell, options: ClearanceOptions, attempt: Attempt, *, may_shrink: bool, shrinks_only: bool = False
) -> Outcome:
    """Bring a tissue into its room.

    Parameters
    ----------
    mesh
        The given surface, in mm.
    cell
        Its room.
    options
        Limits and wishes.
    attempt
        How finely.
    may_shrink
        Whether it is meant to lose much of its volume, to another tissue that has it too.
    shrinks_only
        Whether it gives way where it is too close alone: its other side does not follow.

    Returns
    -------
    Outcome
        ``unchanged`` if it is within its room; ``changed``; ``refused`` if it can't be brought there.
    """
    margin = attempt.move_margin_mm(cell.gap_mm)
    cell = cell.held(_HELD * margin)
    if not (mesh.vertices.astype(np.float32) == mesh.vertices).all():
        mesh = as_written(mesh)
    if not cell.gap_mm:
        return Outcome(None, "unchanged")
    too_deep = np.inf if options.method == "move" else _TOO_DEEP * _THIN_FARTHER * options.max_move_mm
    start = excess_of(mesh, cell.without_idle(), spacing_mm=spacing_mm(cell.gap_mm), enough_mm=too_deep)
    if start <= 0:
        return Outcome(None, "unchanged")
    moved: Mesh | None = None
    is_inside = False
    actions: list[Action] = []
    if options.method == "move" or (options.method == "auto" and not may_shrink):
        thin = 0.0 if shrinks_only else options.thin_mm
        moved, is_inside, actions = _moved(mesh, cell, options, start, margin_mm=margin, thin_mm=thin)
    if options.method == "move":
        if moved is not None:
            return _changed(mesh, moved, cell, actions)
        return Outcome(None, "refused", "its vertices can't be moved as far as the gap needs")
    if moved is not None and is_inside and _volume_change(mesh, moved) <= _MUCH:
        return _changed(mesh, moved, cell, actions)
    if not judge(mesh).measures["outward"]:
        if moved is not None and is_inside:
            return _changed(mesh, moved, cell, actions)
        reason = "it is no closed surface that faces outward, so that nothing can be cut from it; heal it first"
        return Outcome(None, "refused", reason)
    cutter = Cutter(mesh, cell, options, attempt, may_shrink=may_shrink)
    if moved is None:
        return _cut(mesh, mesh, cell, cutter, [])
    first = _changed(mesh, moved, cell, actions) if is_inside else _cut(mesh, moved, cell, cutter, actions)
    return _less_changed(mesh, first, cell, cutter)


def _moved(
    mesh: Mesh, cell: Cell, options: ClearanceOptions, start_mm: float, *, margin_mm: float, thin_mm: float
) -> tuple[Mesh | None, bool, list[Action]]:
    """Return the tissue with vertices moved, None if that is of no use; whether it is in its room; what was done."""
    is_thin = _is_thin(cell, options)
    farthest = (_THIN_FARTHER if is_thin else 1.0) * options.max_move_mm
    # Moving by so much takes off so much at most.
    if options.method == "auto" and start_mm > (_TOO_DEEP if is_thin else 1.0) * farthest:
        return None, False, []
    moved = displaced(mesh, cell, margin_mm=margin_mm, max_move_mm=farthest, thin_mm=thin_mm)
    is_inside = moved.excess_mm <= 0
    done = is_inside or options.method == "move"
    helps = moved.moved_mm > 0 and moved.excess_mm < (start_mm if done else _HELPFUL * start_mm)
    if not helps or not (done or is_thin) or not _is_no_worse(mesh, moved.mesh):
        return None, False, []
    shaped = _well_shaped(mesh, moved.mesh, cell, options)
    message = f"vertices moved by up to {moved.moved_mm:.2g} mm"
    count = int((~known_vertices(shaped, mesh)).sum())
    return shaped, is_inside, [{"step": "move", "message": message, "count": count, "places": []}]


def _cut(mesh: Mesh, current: Mesh, cell: Cell, cutter: Cutter, actions: list[Action]) -> Outcome:
    """Return the tissue cut from a surface made of the given one by these actions."""
    try:
        found = cutter.cut(current)
    except NoCutError as error:
        if actions and SQUEEZED not in error.message:
            return _changed(mesh, current, cell, actions)
        return Outcome(None, "refused", error.message)
    return _changed(mesh, found.candidate.mesh, cell, [*actions, *found.actions])


def _less_changed(mesh: Mesh, first: Outcome, cell: Cell, cutter: Cutter) -> Outcome:
    """Return what was made by moving, or what cutting alone makes of the tissue if that leaves more of it."""
    if first.mesh is None or _volume_change(mesh, first.mesh) <= _MUCH:
        return first
    try:
        other: Cut = cutter.cut(mesh)
    except NoCutError:
        return first
    is_squeezed = any(action["step"] == SQUEEZED for action in first.actions)
    is_less = _volume_change(mesh, other.candidate.mesh) < _volume_change(mesh, first.mesh)
    if other.good and other.scale == 1 and (is_less or is_squeezed):
        return _changed(mesh, other.candidate.mesh, cell, other.actions)
    return first


def _changed(mesh: Mesh, made: Mesh, cell: Cell, actions: list[Action]) -> Outcome:
    return Outcome(made, "changed", "", actions, deviation(mesh, made, lost_limit_mm=cell.gap_mm))


def _well_shaped(mesh: Mesh, moved: Mesh, cell: Cell, options: ClearanceOptions) -> Mesh:
    """Return a moved surface with its worst triangles reshaped, if that keeps it in its room."""
    candidate = judge(moved)
    if candidate.min_quality >= min(options.target_quality, judge(mesh).min_quality):
        return moved
    found = rescued(
        candidate,
        deviation_mm=finish_mm(cell.gap_mm),
        target_quality=options.target_quality,
        min_edge_mm=options.min_edge_mm,
    )
    if found is candidate or excess_of(found.mesh, cell, spacing_mm=spacing_mm(cell.gap_mm)) > 0:
        return moved
    return found.mesh


def _is_no_worse(mesh: Mesh, moved: Mesh) -> bool:
    """Tell whether a moved surface has no contact with itself that it had not; the guard promises that."""
    return judge(moved).measures["self_intersections"]["pairs"] <= judge(mesh).measures["self_intersections"]["pairs"]


def _volume_change(mesh: Mesh, made: Mesh) -> float:
    """Return which share of its volume a tissue gained or lost."""
    before, after = (judge(one).measures["volume_mm3"] for one in (mesh, made))
    return abs(after / before - 1) if before else 0.0


def _is_thin(cell: Cell, options: ClearanceOptions) -> bool:
    """Tell whether a tissue is so thin that it keeps more of itself when it is moved before it is cut."""
    mesh = cell.own.mesh
    joined = surface.topology(mesh.vertices, mesh.faces)
    measured = surface.quality(mesh.vertices, mesh.faces, joined.component, joined.n_components)
    return thickness_of(measured.volume, measured.area) < 2 * options.thin_mm
