"""The room that each tissue may fill, such that all tissues that stay within theirs keep their gaps.

Between two tissues A and B, of which A gives way by the share y and B by 1 - y, lies the field
f = (1 - y) phi_A - y phi_B of the signed distances to the given surfaces. It changes by at most the way between two
points. A stays where f <= -y g, B where f >= (1 - y) g: so they are at least g apart, for all pairs at once and
whatever the order. A rigid tissue (y = 0) may stay as it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from vhp_cli.stages.clearance.distance import Located, SignedDistance

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Bound:
    """What a neighbour leaves to a tissue.

    Parameters
    ----------
    kind
        ``"apart"``: the neighbour lies beside it; ``"parent"``: around it; ``"core"``: in it, and does not give way;
        ``"beyond"``: in a tissue beside it, which grows around it.
    distance
        Of the neighbour: of its given surface, of its final one for a parent.
    gap_mm
        The gap to keep.
    share
        By which the tissue gives way to one beside it, 0 to 1.
    """

    kind: Literal["apart", "parent", "core", "beyond"]
    distance: SignedDistance
    gap_mm: float
    share: float = 1.0

    def combined(self, own: Floats, other: Floats) -> Floats:
        """Return the excess at points, positive outside of the room, by the two signed distances (P,)."""
        if self.kind == "apart":
            return (1 - self.share) * own + self.share * (self.gap_mm - other)
        return other + self.gap_mm if self.kind == "parent" else self.gap_mm - other

    def farthest(self, own: float, band_mm: float) -> float:
        """Return the distance of the neighbour beyond which the excess is below minus a band, at most that far out."""
        if self.kind == "apart":
            return self.gap_mm + (max((1 - self.share) * own, 0.0) + band_mm) / self.share if self.share else np.inf
        return np.inf if self.kind == "parent" else self.gap_mm + band_mm

    def gradient(self, own: Floats, other: Floats) -> Floats:
        """Return the gradient (P, 3) of the excess by those of the two distances."""
        if self.kind == "apart":
            return (1 - self.share) * own - self.share * other
        return other if self.kind == "parent" else -other


class Cell:
    """The room of one tissue.

    Parameters
    ----------
    own
        Of the given surface of the tissue.
    bounds
        By its neighbours.
    """

    def __init__(self, own: SignedDistance, bounds: Sequence[Bound]) -> None:
        self.own = own
        self.bounds = tuple(bounds)

    def scaled(self, scale: float) -> Cell:
        """Return the room with all gaps multiplied."""
        if scale == 1:
            return self
        return Cell(self.own, [replace(bound, gap_mm=scale * bound.gap_mm) for bound in self.bounds])

    def excess(self, points: Floats, band_mm: float, *, cores: bool = True, own: Floats | None = None) -> Floats:
        """Return by how much points (P, 3) exceed the room in mm; negative inside.

        Parameters
        ----------
        points
            Where.
        band_mm
            Values below minus this are upper bounds only.
        cores
            Whether points have to be outside of cores, as those of a surface.
        own
            Signed distances of the points to the given surface, if they are known.
        """
        if own is None:
            own = self.own(points)
        found = np.full(len(points), -np.inf)
        for bound in self.bounds:
            if bound.kind == "core" and not cores:
                continue
            value = self._bound(bound, own, points)
            at = np.flatnonzero(value > np.maximum(found, -band_mm))
            if len(at):
                limit = bound.farthest(float(own[at].max()), band_mm)
                value[at] = bound.combined(own[at], bound.distance(points[at], limit))
            np.maximum(found, value, out=found)
        return found

    def located(self, points: Floats, band_mm: float) -> Located:
        """Return the excess at points (P, 3), and the gradients of that by the neighbour which leaves least.

        Values below minus the band are upper bounds only, and have no gradient.
        """
        own = self.own.located(points)
        values, gradients = np.full(len(points), -np.inf), np.zeros_like(points)
        for bound in self.bounds:
            value = self._bound(bound, own.values, points)
            at = np.flatnonzero(value > np.maximum(values, -band_mm))
            if len(at):
                limit = bound.farthest(float(own.values[at].max()), band_mm)
                value[at] = bound.combined(own.values[at], bound.distance(points[at], limit))
            more = value > values
            values[more] = value[more]
            near = at[more[at] & (value[at] > -band_mm)]
            other = bound.distance.located(points[near])
            gradients[near] = bound.gradient(own.gradients[near], other.gradients)
        return Located(values, gradients)

    @staticmethod
    def _bound(bound: Bound, own: Floats, points: Floats) -> Floats:
        """Return what the excess can be at most, by the box around the neighbour."""
        if bound.kind == "parent" or not bound.share:
            return np.full(len(points), np.inf)
        return bound.combined(own, bound.distance.least(points))
