"""A displacement that depends on the height alone: what soft tissues between moving neighbours are carried by."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vhp_cli.stages.breathe.operations import Parameter, Triple

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Profile:
    """A displacement ``a(t) d(z)`` of points at rest: all that lies at one height moves together.

    d is linear between the given heights and constant beyond the first and the last. Tissues that share it keep their
    order, and two points keep at least ``1 - a steepness()`` times their distance.

    Parameters
    ----------
    name
        Of the field.
    amplitude
        a(t), a share: 0 at t = 0.
    heights
        Values of z at rest in mm, ascending, two or more.
    displacements
        d at these heights, in mm.

    Raises
    ------
    ValueError
        If the heights do not ascend, or a number is not finite.
    """

    name: str
    amplitude: Parameter
    heights: tuple[float, ...]
    displacements: tuple[Triple, ...]

    def __post_init__(self) -> None:
        if len(self.heights) < 2 or len(self.heights) != len(self.displacements):
            raise ValueError("a profile needs two heights or more, with a displacement each")
        if not np.isfinite(self.heights).all() or not np.isfinite(self.displacements).all():
            raise ValueError("a profile needs finite numbers")
        if min(np.diff(self.heights)) <= 0.0:
            raise ValueError("the heights of a profile must ascend")

    def full(self, points: ArrayLike) -> Array:
        """Return d at `points` (P, 3), (P, 3) mm."""
        z = np.asarray(points, dtype=np.float64).reshape(-1, 3)[:, 2]
        vectors = np.asarray(self.displacements)
        return np.stack([np.interp(z, self.heights, vectors[:, axis]) for axis in range(3)], axis=1)

    def weight(self, points: ArrayLike) -> Array:
        """Return the length of d at `points` (P, 3), (P,)."""
        length: Array = np.linalg.norm(self.full(points), axis=1)
        return length

    def displacement(self, points: ArrayLike, t: float) -> Array:
        """Return the displacement of `points` (P, 3) at `t`, (P, 3) mm."""
        moved: Array = float(self.amplitude.curve(t)) * self.full(points)
        return moved

    def speeds(self, points: Array, start: Array, end: Array) -> Array:
        """Return upper bounds of the speed of points (P, 3) in intervals of t from `start` to `end` (K,), (K, P)."""
        rates = self.amplitude.curve.slope_bounds(start, end).largest()
        bounds: Array = np.outer(rates, self.weight(points))
        return bounds

    def loss(self, t: float) -> float:
        """Return the share of its length by which the distance of two points may shrink at `t`."""
        return abs(float(self.amplitude.curve(t))) * self.steepness()

    def rests(self) -> bool:
        """Tell whether nothing is displaced at t = 0."""
        return float(self.amplitude.curve(0.0)) == 0.0

    def steepness(self) -> float:
        """Return the largest slope of d, per mm."""
        rises = np.linalg.norm(np.diff(np.asarray(self.displacements), axis=0), axis=1)
        return float((rises / np.diff(self.heights)).max()) if math.isfinite(rises.sum()) else math.inf
