"""How finely a tissue is done: cells, margins, and the points that are looked at."""

from __future__ import annotations

from dataclasses import dataclass

from vhp_cli.stages.clearance.options import ClearanceOptions

# A length for the rounding of coordinates.
ROUNDING_MM = 2e-4
# Margins on top of the room's border, for moving and for what reshaping moves, in gaps; this gap at least.
_MOVE_MARGIN, _FINISH_MARGIN, _LEAST_MARGIN_GAP_MM = 0.03, 0.03, 0.1
# The margin of cuts, in cells, as the border is known on their corners only.
_CUT_MARGIN = 0.13
# Margins grow by so many times, for cuts by so many of those for reshaping; cells shrink from the second level on.
_WIDER_MOVE, _WIDER_CUT, _FINER = 2.5, 2.0, 1.5
# Cells by the gap, but not smaller than this, nor, if that is less, than this part of the tissue's thickness: a gap
# of micrometres needs no cells of micrometres, as margins go with the cells.
_GRID_GAPS, _COARSE_GRID_MM, _THICKNESS_PART, _LEAST_GRID_MM = 0.8, 0.4, 1 / 12, 0.05
# Points of the surface stand for parts of this size, in gaps, or in mm if that is more, where it may exceed its room.
_SPACING_GAPS, _LEAST_SPACING_MM = 0.35, 0.2


@dataclass(frozen=True, slots=True)
class Attempt:
    """How finely a tissue is done: each attempt has wider margins than the one before, later ones smaller cells, too.

    What the exact check finds too close after a first attempt lacks some hundredths of the gap as a rule.
    """

    level: int = 0

    def grid_mm(self, options: ClearanceOptions, gap_mm: float, thickness_mm: float) -> float:
        """Return the edge of the cells."""
        coarse = max(_GRID_GAPS * gap_mm, min(_COARSE_GRID_MM, _THICKNESS_PART * thickness_mm))
        return float(max((options.grid_mm or coarse) / _FINER ** max(self.level - 1, 0), _LEAST_GRID_MM))

    def move_margin_mm(self, gap_mm: float) -> float:
        """Return how far inside of its room a surface is moved."""
        return float(_WIDER_MOVE**self.level * _MOVE_MARGIN * max(gap_mm, _LEAST_MARGIN_GAP_MM) + ROUNDING_MM)

    def cut_margin_mm(self, gap_mm: float, grid_mm: float) -> float:
        """Return how far inside of its room a surface is cut."""
        wider = (1 + _WIDER_CUT * self.level) * finish_mm(gap_mm, grid_mm)
        return _CUT_MARGIN * grid_mm + wider + ROUNDING_MM


def finish_mm(gap_mm: float, grid_mm: float = 0.0) -> float:
    """Return how far reshaping may move a surface that was cut on a grid, or moved."""
    return _FINISH_MARGIN * max(gap_mm, grid_mm / _GRID_GAPS, _LEAST_MARGIN_GAP_MM)


def held_mm(gap_mm: float) -> float:
    """Return by how much a cut for a gap may fall short of it."""
    return _CUT_MARGIN * gap_mm


def spacing_mm(gap_mm: float) -> float:
    """Return the size of the parts of a surface for which points stand."""
    return max(_SPACING_GAPS * gap_mm, _LEAST_SPACING_MM)
