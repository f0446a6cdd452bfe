"""Bring one tissue into its room: move its vertices, and cut what can't be moved."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from vhp_cli.inspection.deviation import deviation
from vhp_cli.kernels import surface
from vhp_cli.measures import Action
from vhp_cli.mesh import Mesh
from vhp_cli.processes import CallFailed
from vhp_cli.stages.clearance.carving import carved, known_vertices
from vhp_cli.stages.clearance.cell import Cell
from vhp_cli.stages.clearance.displacement import displaced
from vhp_cli.stages.clearance.finishing import finished, rescued
from vhp_cli.stages.clearance.options import ClearanceOptions
from vhp_cli.stages.clearance.sampling import excess_of
from vhp_cli.stages.clearance.stiffness import thickness_of
from vhp_cli.stages.clearance.zero_surface import TooFineError
from vhp_cli.stages.heal.candidate import Candidate, as_written, judge
from vhp_cli.stages.outcome import Outcome

# The step of an action that says that there is no room for the gap.
SQUEEZED = "squeezed"
# A margin on top of the room's border: shares of the gap, and a length for the rounding of coordinates.
_MOVE_MARGIN, _CUT_MARGIN, _FINISH_MARGIN, _ROUNDING_MM = 0.03, 0.13, 0.03, 2e-4
# Towards those to which it does not give way a tissue may move by so many margins.
_HELD = 1.05
# Deeper than so many times the way that vertices may go, moving is not tried; those of thin tissues may go so many
# times as far.
_TOO_DEEP, _THIN_FARTHER = 1.2, 2.0
# A thin tissue that could be moved only part of the way is cut from there if this share of the excess is left at most.
_HELPFUL = 0.6
_GRID_GAPS, _LEAST_GRID_MM, _FINER = 0.8, 0.05, 1.5
# Points of the surface stand for parts of this size, in gaps, or in mm if that is more, where it may exceed its room.
_SPACING_GAPS, _LEAST_SPACING_MM = 0.35, 0.2
# Points at which a cut is looked at afterwards, and how much more than what it lacks it gets.
_CHECK_SPACING, _MORE = 0.3, 1.25
# If the room at the full gap takes the tissue apart, or makes it thinner (4 V / A, twice the thickness of a plate) than
# so many gaps, smaller gaps are tried. That does not depend on how thick it was before: what was squeezed once is not
# squeezed more by another run.
_SCALES = (1.0, 0.5, 0.3, 0.15)
_LEAST_THICKNESS = 1.5


@dataclass(frozen=True, slots=True)
class Attempt:
    """How finely a tissue is done: each attempt has smaller cells and wider margins than the one before."""

    level: int = 0

    def grid_mm(self, options: ClearanceOptions, gap_mm: float) -> float:
        """Return the edge of the cells."""
        return float(max((options.grid_mm or _GRID_GAPS * gap_mm) / _FINER**self.level, _LEAST_GRID_MM))

    @property
    def factor(self) -> float:
        """By which the margin for moving is multiplied."""
        return float(2.5**self.level)


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
    gap = cell.gap_mm
    move_margin = attempt.factor * _MOVE_MARGIN * gap + _ROUNDING_MM
    cell = cell.held(_HELD * move_margin)
    if not (mesh.vertices.astype(np.float32) == mesh.vertices).all():
        mesh = as_written(mesh)
    if not gap:
        return Outcome(None, "unchanged")
    start = excess_of(mesh, cell.without_idle(), spacing_mm=max(_SPACING_GAPS * gap, _LEAST_SPACING_MM))
    if start <= 0:
        return Outcome(None, "unchanged")
    actions: list[Action] = []
    current = mesh
    farthest = (_THIN_FARTHER if _is_thin(cell, options) else 1.0) * options.max_move_mm
    # Moving by so much takes off so much at most.
    too_deep = start > (_TOO_DEEP if _is_thin(cell, options) else 1.0) * farthest
    if options.method == "move" or (options.method == "auto" and not may_shrink and not too_deep):
        thin = 0.0 if shrinks_only else options.thin_mm
        moved = displaced(mesh, cell, margin_mm=move_margin, max_move_mm=farthest, thin_mm=thin)
        done = moved.excess_mm <= 0 or options.method == "move"
        helps = moved.moved_mm > 0 and moved.excess_mm < (start if done else _HELPFUL * start)
        if helps and (done or _is_thin(cell, options)) and _is_no_worse(mesh, moved.mesh):
            current = _well_shaped(mesh, moved.mesh, cell, options)
            message = f"vertices moved by up to {moved.moved_mm:.2g} mm"
            count = int((~known_vertices(current, mesh)).sum())
            actions.append({"step": "move", "message": message, "count": count, "places": []})
            if moved.excess_mm <= 0 or options.method == "move":
                return _changed(mesh, current, cell, actions)
    if options.method == "move":
        return Outcome(None, "refused", "its vertices can't be moved as far as the gap needs")
    if not judge(mesh).measures["outward"]:
        reason = "it is no closed surface that faces outward, so that nothing can be cut from it; heal it first"
        return Outcome(None, "refused", reason)
    return _cut(mesh, current, cell, options, attempt, actions, may_shrink=may_shrink)


@dataclass(frozen=True, slots=True, eq=False)
class _Made:
    """A tissue that was cut: for which part of the gaps, on which grid, and the volume of crumbs that were dropped."""

    candidate: Candidate
    scale: float
    grid_mm: float
    crumbs_mm3: float


def _cut(
    mesh: Mesh,
    current: Mesh,
    cell: Cell,
    options: ClearanceOptions,
    attempt: Attempt,
    actions: list[Action],
    *,
    may_shrink: bool,
) -> Outcome:
    best: _Made | None = None
    best_rank = (False, False, -math.inf)
    failure = ""
    given, thin = judge(mesh), _is_thin(cell, options)
    for scale in _SCALES:
        if scale < 1 and _was_squeezed(mesh, cell, scale):
            return Outcome(None, "refused", f"{SQUEEZED} between its neighbours: the whole gap would take it apart")
        try:
            made = _cut_for(current, cell.scaled(scale), scale, options, attempt)
        except (CallFailed, TooFineError) as error:
            failure = failure or error.message
            continue
        if not made.candidate.sound and given.sound:
            failure = failure or ", ".join(made.candidate.flaws)
            continue
        keeps_shape = may_shrink or _keeps_shape(given, made.candidate, _LEAST_THICKNESS * cell.gap_mm, thin=thin)
        # Edges that are too short would have the whole result thrown away.
        long_enough = made.candidate.min_edge >= min(given.min_edge, 0.5 * options.min_edge_mm)
        # If no gap leaves it whole, the one that harms it least.
        rank = (long_enough, keeps_shape, 0.0 if keeps_shape else -_harm(given, made.candidate))
        if best is None or rank > best_rank:
            best, best_rank = made, rank
        if long_enough and keeps_shape:
            break
    if best is None:
        if actions:
            return _changed(mesh, current, cell, actions)
        return Outcome(None, "refused", f"it can't be cut to its room: {failure or 'nothing would be left'}")
    message = f"cut to its room on a grid of {best.grid_mm:.2g} mm"
    actions.append({"step": "cut", "message": message, "count": len(best.candidate.mesh.faces), "places": []})
    if best.scale < 1:
        message = f"squeezed between its neighbours: only {best.scale:.0%} of the gap leave it whole"
        actions.append({"step": SQUEEZED, "message": message, "count": 1, "places": []})
    if best.crumbs_mm3:
        crumbs: Action = {"step": "crumbs", "message": "pieces left over by cuts dropped", "count": 1, "places": []}
        actions.append({**crumbs, "volume_mm3": -best.crumbs_mm3})
    return _changed(mesh, best.candidate.mesh, cell, actions)


def _cut_for(current: Mesh, cell: Cell, scale: float, options: ClearanceOptions, attempt: Attempt) -> _Made:
    """Cut a tissue to its room, with a margin; again with a wider one if it still exceeds the room.

    Raises
    ------
    CallFailed, TooFineError
        As of `carved`.
    """
    gap = cell.gap_mm / scale
    grid, finish = attempt.grid_mm(options, gap), _FINISH_MARGIN * gap
    margin = _CUT_MARGIN * grid + (1 + attempt.level) * finish + _ROUNDING_MM
    grows = any(bound.kind == "core" for bound in cell.bounds)
    outside = np.inf if grows else _THIN_FARTHER * options.max_move_mm + finish + grid
    for last in (False, True):
        made, crumbs = carved(
            current,
            cell.without_idle(),
            grid_mm=grid,
            margin_mm=margin,
            timeout_s=options.engine_timeout_s,
            memory_gb=options.engine_memory_gb,
        )
        found = finished(
            made,
            current,
            grid_mm=grid,
            deviation_mm=finish,
            target_quality=options.target_quality,
            min_edge_mm=options.min_edge_mm,
        )
        if last or not len(found.mesh.faces):
            break
        spacing = max(_CHECK_SPACING * gap, _LEAST_SPACING_MM)
        excess = excess_of(found.mesh, cell, spacing_mm=spacing, outside_mm=outside)
        if excess <= 0:
            break
        margin += min(_MORE * excess, 0.5 * grid) + _ROUNDING_MM
    return _Made(found, scale, grid, crumbs)


def _changed(mesh: Mesh, made: Mesh, cell: Cell, actions: list[Action]) -> Outcome:
    gap = cell.gap_mm
    return Outcome(made, "changed", "", actions, deviation(mesh, made, lost_limit_mm=gap))


def _was_squeezed(mesh: Mesh, cell: Cell, scale: float) -> bool:
    """Tell whether a tissue has this part of the gap already, but for what cuts are off."""
    most = _CUT_MARGIN * scale * cell.gap_mm
    return excess_of(mesh, cell.without_idle().scaled(scale), spacing_mm=_LEAST_SPACING_MM, least_mm=most) <= most


def _keeps_shape(given: Candidate, found: Candidate, least_mm: float, *, thin: bool) -> bool:
    """Tell whether a tissue has no more parts than before, and a thin one no more handles and still some thickness."""
    before, after = given.measures, found.measures
    if after["components"] > before["components"]:
        return False
    if not thin:
        return True
    return _harm(given, found) == 0 and thickness_of(after["volume_mm3"], after["area_mm2"]) >= least_mm


def _harm(given: Candidate, found: Candidate) -> int:
    """Return how many parts and handles a tissue has that it had not."""
    before, after = given.measures, found.measures
    # The Euler number of so many spheres, less two for each handle.
    handles = [one["components"] - one["euler"] // 2 for one in (before, after)]
    return max(after["components"] - before["components"], 0) + max(handles[1] - handles[0], 0)


def _well_shaped(mesh: Mesh, moved: Mesh, cell: Cell, options: ClearanceOptions) -> Mesh:
    """Return a moved surface with its worst triangles reshaped, if that keeps it in its room."""
    gap = cell.gap_mm
    candidate = judge(moved)
    if candidate.min_quality >= min(options.target_quality, judge(mesh).min_quality):
        return moved
    found = rescued(
        candidate,
        deviation_mm=_FINISH_MARGIN * gap,
        target_quality=options.target_quality,
        min_edge_mm=options.min_edge_mm,
    )
    spacing = max(_SPACING_GAPS * gap, _LEAST_SPACING_MM)
    if found is candidate or excess_of(found.mesh, cell, spacing_mm=spacing) > 0:
        return moved
    return found.mesh


def _is_no_worse(mesh: Mesh, moved: Mesh) -> bool:
    """Tell whether a moved surface has no contact with itself that it had not; the guard promises that."""
    return judge(moved).measures["self_intersections"]["pairs"] <= judge(mesh).measures["self_intersections"]["pairs"]


def _is_thin(cell: Cell, options: ClearanceOptions) -> bool:
    """Tell whether a tissue is so thin that it keeps more of itself when it is moved before it is cut."""
    mesh = cell.own.mesh
    joined = surface.topology(mesh.vertices, mesh.faces)
    measured = surface.quality(mesh.vertices, mesh.faces, joined.component, joined.n_components)
    return thickness_of(measured.volume, measured.area) < 2 * options.thin_mm
