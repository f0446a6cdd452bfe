"""Cut a tissue to its room, for the whole gap or for as much of it as leaves the tissue whole."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vhp_cli.errors import VhpError
from vhp_cli.measures import Action
from vhp_cli.mesh import Mesh
from vhp_cli.processes import CallFailed
from vhp_cli.stages.clearance.attempt import ROUNDING_MM, Attempt, finish_mm, held_mm
from vhp_cli.stages.clearance.carving import carved
from vhp_cli.stages.clearance.cell import Bound, Cell
from vhp_cli.stages.clearance.finishing import finished
from vhp_cli.stages.clearance.options import ClearanceOptions
from vhp_cli.stages.clearance.sampling import excess_of
from vhp_cli.stages.clearance.stiffness import thickness_of
from vhp_cli.stages.clearance.zero_surface import TooFineError
from vhp_cli.stages.heal.candidate import Candidate, judge

# The step of an action that says that there is no room for the gap.
SQUEEZED = "squeezed"
# If the room at the full gap takes the tissue apart, or makes it thinner (4 V / A, twice the thickness of a plate) than
# so many gaps, smaller gaps are tried. That does not depend on how thick it was before: what was squeezed once is not
# squeezed more by another run.
_SCALES = (0.5, 0.3, 0.15)
_LEAST_THICKNESS = 1.5
# So many neighbours squeeze a tissue.
_SQUEEZING = 2
# Points at which a cut is looked at afterwards, in gaps and in mm, and how much more than what it lacks it gets.
_CHECK_SPACING, _LEAST_SPACING_MM, _MORE = 0.3, 0.2, 1.25
# Cells of a cutter at most; beyond, so many times larger ones are tried, so often.
_MOST_CELLS, _COARSER, _COARSENINGS = 1_000_000, 1.6, 3


class NoCutError(VhpError):
    """A tissue can't be cut to its room."""


@dataclass(frozen=True, slots=True, eq=False)
class Cut:
    """A tissue that was cut.

    Parameters
    ----------
    candidate
        What is left.
    scale
        The part of the gaps that it has.
    tight
        To how many neighbours; 0: to all.
    grid_mm
        The cells.
    crumbs_mm3
        Volume of small pieces that were dropped.
    parts
        How many more parts it has than before.
    keeps_shape
        Whether it is what it was, but for what was cut off.
    rank
        The higher, the better.
    """

    candidate: Candidate
    scale: float
    tight: int
    grid_mm: float
    crumbs_mm3: float
    parts: int
    keeps_shape: bool
    rank: tuple[bool, bool, int]

    @property
    def good(self) -> bool:
        """Whether nothing speaks against it."""
        return self.rank[0] and self.keeps_shape

    @property
    def actions(self) -> list[Action]:
        """What was done."""
        found: list[Action] = []

        def note(step: str, message: str, count: int = 1) -> Action:
            found.append({"step": step, "message": message, "count": count, "places": []})
            return found[-1]

        note("cut", f"cut to its room on a grid of {self.grid_mm:.2g} mm", len(self.candidate.mesh.faces))
        if self.scale < 1:
            towards = f" to {self.tight} of them" if self.tight else ""
            note(SQUEEZED, f"squeezed between its neighbours: only {self.scale:.0%} of the gap{towards} leave it whole")
        if self.parts > 0:
            note("parts", "parts more than before: neighbours run through it", self.parts)
        if self.crumbs_mm3:
            note("crumbs", "pieces left over by cuts dropped")["volume_mm3"] = -self.crumbs_mm3
        return found


class Cutter:
    """Cuts one tissue.

    Parameters
    ----------
    mesh
        The given surface, closed and outward.
    cell
        Its room.
    options
        Limits and wishes.
    attempt
        How finely.
    may_shrink
        Whether it is meant to lose much of its volume, to another tissue that has it too.
    """

    def __init__(
        self, mesh: Mesh, cell: Cell, options: ClearanceOptions, attempt: Attempt, *, may_shrink: bool
    ) -> None:
        self._mesh, self._cell, self._options, self._attempt = mesh, cell, options, attempt
        self._may_shrink = may_shrink
        self._given = judge(mesh)
        measures = self._given.measures
        self._thickness_mm = thickness_of(measures["volume_mm3"], measures["area_mm2"])
        self._is_thin = self._thickness_mm < 2 * options.thin_mm
        self._failure = ""

    def cut(self, current: Mesh) -> Cut:
        """Return the tissue cut to its room, from a surface made of the given one.

        Raises
        ------
        NoCutError
            If nothing sound is left of it, or it has a part of the gap already and there is no room for more.
        """
        whole = self._tried(current, 1.0)
        if whole is not None and whole.good:
            return whole
        held = next((scale for scale in _SCALES if self._has(scale)), 0.0)
        scales = [scale for scale in _SCALES if scale > held]
        least = self._tried(current, scales[-1]) if scales else None
        # What the smallest gap does not leave whole, no wider one does: then none of them is tried.
        if least is not None and (whole is None or least.rank > whole.rank):
            wider = (self._tried(current, scale) for scale in scales[:-1])
            best = next((one for one in wider if one is not None and one.rank >= least.rank), least)
            if best.good:
                return self._loosened(current, best)
            if not held:
                return best
        if held:
            raise NoCutError(f"{SQUEEZED} between its neighbours: the whole gap would take it apart")
        if whole is None:
            raise NoCutError(f"it can't be cut to its room: {self._failure or 'nothing would be left'}")
        return whole

    def _loosened(self, current: Mesh, found: Cut) -> Cut:
        """Return a squeezed tissue with the whole gap to all but the two neighbours that are deepest in it, if it goes.

        It takes two to squeeze; others may just be near.
        """
        active = self._cell.without_idle()
        if len(active.bounds) <= _SQUEEZING:
            return found
        spacing = max(_CHECK_SPACING * self._cell.gap_mm, _LEAST_SPACING_MM)
        depth = [excess_of(self._mesh, Cell(active.own, [bound]), spacing_mm=spacing) for bound in active.bounds]
        deepest = sorted(range(len(depth)), key=lambda index: (-depth[index], index))[:_SQUEEZING]
        loosened = self._tried(current, found.scale, [active.bounds[index] for index in deepest])
        return loosened if loosened is not None and loosened.good else found

    def _tried(self, current: Mesh, scale: float, only: Sequence[Bound] | None = None) -> Cut | None:
        try:
            candidate, grid, crumbs = self._cut_for(current, self._cell.scaled(scale, only))
        except (CallFailed, TooFineError) as error:
            self._failure = self._failure or error.message
            return None
        if not candidate.sound and self._given.sound:
            self._failure = self._failure or ", ".join(candidate.flaws)
            return None
        keeps_shape = self._may_shrink or self._keeps_shape(candidate)
        # Edges that are too short would have the whole result thrown away.
        long_enough = candidate.min_edge >= min(self._given.min_edge, 0.5 * self._options.min_edge_mm)
        rank = (long_enough, keeps_shape, 0 if keeps_shape else -self._harm(candidate))
        parts = candidate.measures["components"] - self._given.measures["components"]
        return Cut(candidate, scale, len(only or ()), grid, crumbs, parts, keeps_shape, rank)

    def _cut_for(self, current: Mesh, cell: Cell) -> tuple[Candidate, float, float]:
        """Return the tissue in a room, the cells it took, and the volume of crumbs.

        Raises
        ------
        CallFailed, TooFineError
            As of `carved`.
        """
        # What is thin has no room for the margins of large cells, too, where it is squeezed.
        gap = min(bound.gap_mm for bound in cell.without_idle().bounds) if self._is_thin else self._cell.gap_mm
        grid = self._attempt.grid_mm(self._options, gap, self._thickness_mm)
        for _ in range(_COARSENINGS):
            try:
                return self._cut_on(current, cell, grid)
            except TooFineError:
                grid *= _COARSER
        return self._cut_on(current, cell, grid)

    def _cut_on(self, current: Mesh, cell: Cell, grid: float) -> tuple[Candidate, float, float]:
        """Cut on a grid, with a margin; again with a wider one if the room is still exceeded."""
        options, gap = self._options, self._cell.gap_mm
        finish, margin = finish_mm(gap, grid), self._attempt.cut_margin_mm(gap, grid)
        grows = any(bound.kind == "core" for bound in cell.bounds)
        outside = np.inf if grows else 2 * options.max_move_mm + finish + grid
        for last in (False, True):
            made, crumbs = carved(
                current,
                cell.without_idle(),
                grid_mm=grid,
                margin_mm=margin,
                most_cells=_MOST_CELLS,
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
            excess = excess_of(found.mesh, cell, spacing_mm=spacing, enough_mm=0.5 * grid, outside_mm=outside)
            if excess <= 0:
                break
            margin += min(_MORE * excess, 0.5 * grid) + ROUNDING_MM
        return found, grid, crumbs

    def _has(self, scale: float) -> bool:
        """Tell whether the given tissue has this part of the gap already, but for what cuts are off."""
        most = held_mm(scale * self._cell.gap_mm)
        room = self._cell.without_idle().scaled(scale)
        return excess_of(self._mesh, room, spacing_mm=_LEAST_SPACING_MM, least_mm=most, enough_mm=most) <= most

    def _keeps_shape(self, found: Candidate) -> bool:
        """Tell whether there are no more parts than before, and of a thin tissue no more handles and some thickness."""
        before, after = self._given.measures, found.measures
        if after["components"] > before["components"]:
            return False
        if not self._is_thin:
            return True
        left = thickness_of(after["volume_mm3"], after["area_mm2"])
        return self._harm(found) == 0 and left >= _LEAST_THICKNESS * self._cell.gap_mm

    def _harm(self, found: Candidate) -> int:
        """Return how many parts and handles a tissue has that it had not."""
        before, after = self._given.measures, found.measures
        # The Euler number of so many spheres, less two for each handle.
        handles = [one["components"] - one["euler"] // 2 for one in (before, after)]
        return max(after["components"] - before["components"], 0) + max(handles[1] - handles[0], 0)
