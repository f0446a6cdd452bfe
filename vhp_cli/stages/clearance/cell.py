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
        By which the tissue gives way to one beside it, 0 to 1. If it does not at all, it may go beyond its given
        surface only where the neighbour is far enough away from there.
    slack_mm
        How far beyond its surface it may go if it does not give way.
    """

    kind: Literal["apart", "parent", "core", "beyond"]
    distance: SignedDistance
    gap_mm: float
    share: float = 1.0
    slack_mm: float = 0.0

    @property
    def idle(self) -> bool:
        """Whether it is the neighbour that keeps away from the given surface, and this tissue may stay there."""
        return self.kind == "apart" and not self.share

    @property
    def needs_own(self) -> bool:
        """Whether the excess depends on the distance to the tissue's own surface."""
        return self.kind == "apart" and self.share < 1

    def combined(self, own: Floats | float, other: Floats) -> Floats:
        """Return the excess at points, positive outside of the room, by the two signed distances (P,)."""
        if self.idle:
            # The neighbour may have moved towards here by about a gap, too.
            return np.minimum(own, 2 * self.gap_mm - other) - self.slack_mm
        if self.needs_own:
            found: Floats = (1 - self.share) * own + self.share * (self.gap_mm - other)
            return found
        return other + self.gap_mm if self.kind == "parent" else self.gap_mm - other

    def farthest(self, own: float, band_mm: float) -> float:
        """Return the distance of the neighbour beyond which the excess is below minus a band, at most that far out."""
        if self.needs_own and self.share:
            return self.gap_mm + (max((1 - self.share) * own, 0.0) + band_mm) / self.share
        return np.inf if self.kind == "parent" else (2 if self.idle else 1) * self.gap_mm + band_mm

    def deepest(self, band_mm: float) -> float:
        """Return the depth in the neighbour beyond which the excess is below minus a band."""
        return self.gap_mm + band_mm if self.kind == "parent" else np.inf

    def gradient(self, own: Located, other: Located) -> Floats:
        """Return the gradient (P, 3) of the excess by the two distances and their gradients."""
        if self.idle:
            mine = own.values < 2 * self.gap_mm - other.values
            return np.where(mine[:, None], own.gradients, -other.gradients)
        if self.needs_own:
            return (1 - self.share) * own.gradients - self.share * other.gradients
        return other.gradients if self.kind == "parent" else -other.gradients


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

    def scaled(self, scale: float, only: Sequence[Bound] | None = None) -> Cell:
        """Return the room with all gaps multiplied, or only those of some of its bounds."""
        if scale == 1:
            return self
        tight = self.bounds if only is None else only
        return Cell(
            self.own,
            [replace(bound, gap_mm=scale * bound.gap_mm) if bound in tight else bound for bound in self.bounds],
        )

    @property
    def gap_mm(self) -> float:
        """The widest gap to a neighbour to which the tissue gives way; 0 if there is none."""
        return max((bound.gap_mm for bound in self.bounds if not bound.idle), default=0.0)

    def held(self, slack_mm: float) -> Cell:
        """Return the room with another way that the tissue may go towards those to which it does not give way."""
        return Cell(self.own, [replace(bound, slack_mm=slack_mm) if bound.idle else bound for bound in self.bounds])

    def without_idle(self) -> Cell:
        """Return the room by those neighbours alone to which the tissue gives way."""
        return Cell(self.own, [bound for bound in self.bounds if not bound.idle])

    def excess(
        self,
        points: Floats,
        band_mm: float,
        *,
        cores: bool = True,
        own: Floats | None = None,
        own_at_most: float = np.inf,
    ) -> Floats:
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
        own_at_most
            What these distances are at most, in mm, if they are not known: what is far from all neighbours is not
            looked at.
        """
        found = np.full(len(points), -np.inf)
        known = _Known(self.own, points, own)
        for bound in self.bounds:
            if bound.kind == "core" and not cores:
                continue
            value = self._bound(bound, own if own is not None else own_at_most, points)
            at = np.flatnonzero(value > np.maximum(found, -band_mm))
            if len(at) and bound.needs_own:
                mine = known(at)
                value[at] = self._bound(bound, mine, points[at])
                still = value[at] > np.maximum(found[at], -band_mm)
                at, mine = at[still], mine[still]
            else:
                mine = np.zeros(len(at))
            if len(at):
                limits = bound.farthest(float(mine.max()), band_mm), bound.deepest(band_mm)
                value[at] = bound.combined(mine, bound.distance(points[at], *limits))
            np.maximum(found, value, out=found)
        return found

    def located(self, points: Floats, band_mm: float) -> Located:
        """Return the excess at points (P, 3), and the gradients of that by the neighbour which leaves least.

        Values below minus the band are upper bounds only, and have no gradient.
        """
        own: Located | None = None
        values, gradients = np.full(len(points), -np.inf), np.zeros_like(points)
        for bound in self.bounds:
            if bound.needs_own and own is None:
                own = self.own.located(points)
            mine = own.values if own is not None else np.zeros(len(points))
            value = self._bound(bound, mine, points)
            at = np.flatnonzero(value > np.maximum(values, -band_mm))
            if len(at):
                limits = bound.farthest(float(mine[at].max()), band_mm), bound.deepest(band_mm)
                other = bound.distance.located(points[at], *limits)
                value[at] = bound.combined(mine[at], other.values)
                leads = np.flatnonzero((value[at] > values[at]) & (value[at] > -band_mm))
                near = at[leads]
                picked = Located(other.values[leads], other.gradients[leads])
                ahead = picked if own is None else Located(own.values[near], own.gradients[near])
                gradients[near] = bound.gradient(ahead, picked)
            np.maximum(values, value, out=values)
        return Located(values, gradients)

    @staticmethod
    def _bound(bound: Bound, own: Floats | float, points: Floats) -> Floats:
        """Return what the excess can be at most, by the box around the neighbour."""
        if bound.kind == "parent":
            return np.full(len(points), np.inf)
        least = bound.distance.least(points)
        return bound.combined(own if bound.needs_own else np.zeros(len(points)), least)


class _Known:
    """Signed distances of points to a surface, worked out where they are asked for."""

    def __init__(self, distance: SignedDistance, points: Floats, values: Floats | None) -> None:
        self._distance, self._points = distance, points
        self._values = np.full(len(points), np.nan) if values is None else values

    def __call__(self, at: NDArray[np.intp]) -> Floats:
        """Return those of some points, by their numbers."""
        asked = at[np.isnan(self._values[at])]
        if len(asked):
            self._values[asked] = self._distance(self._points[asked])
        found: Floats = self._values[at]
        return found
