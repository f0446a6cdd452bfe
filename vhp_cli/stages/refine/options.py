"""What `decimate --refine` may be told: values, defaults and checks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import ClassVar

from vhp_cli.stages.options import Flag, Keys, Name, Number, StageOptions, Text
from vhp_cli.stages.refine.splitting import Mask, Sides, all_sides, shared_sides

BY_ERROR, BY_SIZE = "error", "size"
ALL_EDGES, SHARED_EDGES = "all-edges", "shared-edges"
SCENARIOS: Mapping[str, Callable[[Sides, Mask], Mask]] = MappingProxyType(
    {ALL_EDGES: all_sides, SHARED_EDGES: shared_sides}
)
# Attempts at a tissue that smooth more gently each; the one after them does not smooth, so that nothing moves.
_SMOOTHED_ATTEMPTS = 2
# More would make a million triangles of one.
_MOST_LEVELS = 10

# Keys in the section [decimate] of vhp.toml, also long options of the command line.
KEYS: Keys = MappingProxyType(
    {
        "refine": ("percent", Number(0, 100)),
        "by": ("by", Name((BY_ERROR, BY_SIZE))),
        "errors": ("errors", Text()),
        "error-property": ("error_property", Text()),
        "scenario": ("scenario", Name(tuple(SCENARIOS))),
        "levels": ("levels", Number(1, _MOST_LEVELS, may_be_least=True, whole=True)),
        "smooth": ("smooth", Flag()),
        "max-deviation": ("max_deviation_mm", Number()),
    }
)


@dataclass(frozen=True, slots=True)
class RefineOptions(StageOptions):
    """How a tissue is refined; lengths in mm.

    Parameters
    ----------
    percent
        How many of the triangles are picked; None: not told.
    by
        ``"error"``: those with the largest errors; ``"size"``: the largest.
    errors
        A file with the error of each triangle, or a directory with one for each tissue; None: they are in the mesh.
    error_property
        The property of the faces of a PLY file that holds them; None: ``error``.
    scenario
        Which edges are cut: ``"all-edges"`` of the picked triangles, or ``"shared-edges"``, those between two of them
        and at the boundary.
    levels
        How often the picked triangles are split.
    smooth
        Whether the surface is smoothed afterwards.
    max_deviation_mm
        How far smoothing may move the surface; None: 0.1 % of the diagonal of the tissue's box, at most 0.1 mm.
    min_edge_mm
        Edges of less than twice this length are not cut.
    fold_deg
        Edges at which the faces enclose less than this angle are not cut.

    Raises
    ------
    UsageError
        If a value is not known or out of range.
    """

    known: ClassVar[Keys] = KEYS

    percent: float | None = None
    by: str = BY_ERROR
    errors: str | None = None
    error_property: str | None = None
    scenario: str = ALL_EDGES
    levels: int = 1
    smooth: bool = True
    max_deviation_mm: float | None = None
    min_edge_mm: float = 0.01
    fold_deg: float = 0.1

    def gentler(self, level: int, diagonal_mm: float) -> RefineOptions:
        """Return the options for a further attempt at a tissue of this size: each may move it a quarter as far."""
        if level > _SMOOTHED_ATTEMPTS:
            return replace(self, smooth=False)
        limit = self.max_deviation_mm or min(1e-3 * diagonal_mm, 0.1)
        return replace(self, max_deviation_mm=limit / 4**level)
