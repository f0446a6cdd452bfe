"""A displacement between those of several bodies: what is joined to them bends so that no joint is torn."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vhp_cli.stages.breathe.operations import Operation, map_of, velocities

Array = NDArray[np.float64]
# Centre (x, y, z) and radius in mm.
Ball = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class Holder:
    """A body, and where others are joined to it.

    Parameters
    ----------
    name
        Of the body, for the reader; where a motion of the sequence has this name, its operations are meant.
    operations
        How it moves; none: it stays.
    balls
        What lies in one of them moves with the body.
    """

    name: str
    operations: tuple[Operation, ...]
    balls: tuple[Ball, ...]

    def distances(self, points: Array) -> Array:
        """Return how far `points` (P, 3) are outside of the balls, (P,) mm; 0 within."""
        nearest = np.full(len(points), np.inf)
        for x, y, z, radius in self.balls:
            nearest = np.minimum(nearest, np.sqrt(((points - (x, y, z)) ** 2).sum(axis=1)) - radius)
        outside: Array = np.maximum(nearest, 0.0)
        return outside


@dataclass(frozen=True, slots=True)
class Blend:
    """The displacement of points at rest by the motions of bodies, weighted by the nearness of their joints.

    With d_i the distance of a point from the balls of holder i, it is the mean of the displacements by all holders
    with the weights ``d_i^-2`` (Shepard 1968). In the balls of a holder its weight is 1, so that what is joined to it
    there keeps its place on it exactly.

    Parameters
    ----------
    name
        Of the field.
    holders
        One or more.

    Raises
    ------
    ValueError
        If there is no holder, one has no balls, or balls of two holders meet.
    """

    name: str
    holders: tuple[Holder, ...]

    def __post_init__(self) -> None:
        if not self.holders or not all(holder.balls for holder in self.holders):
            raise ValueError("a blend needs holders with a ball each")
        for holder in self.holders:
            if not np.isfinite(holder.balls).all() or min(ball[3] for ball in holder.balls) <= 0.0:
                raise ValueError("the balls of a holder need finite numbers and a radius above 0")
        for index, first in enumerate(self.holders):
            for second in self.holders[:index]:
                for ball in first.balls:
                    if second.distances(np.array([ball[:3]]))[0] <= ball[3]:
                        raise ValueError(f"the balls of {second.name!r} and {first.name!r} meet")

    def weights(self, points: ArrayLike) -> Array:
        """Return the weight of each holder at `points` (P, 3) at rest, (P, H); they add up to 1."""
        places = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        squares = np.stack([holder.distances(places) ** 2 for holder in self.holders], axis=1)
        # The product of the other distances, over its sum: the same as 1/d^2, and exact where one distance is 0.
        products = np.stack(
            [np.delete(squares, index, axis=1).prod(axis=1) for index in range(len(self.holders))], axis=1
        )
        shares: Array = products / products.sum(axis=1, keepdims=True)
        return shares

    def displacement(self, points: ArrayLike, t: float) -> Array:
        """Return the displacement of `points` (P, 3) at `t`, (P, 3) mm."""
        places = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        weights = self.weights(places)
        total = np.zeros_like(places)
        for index, holder in enumerate(self.holders):
            matrix = map_of(holder.operations, t)
            if np.array_equal(matrix, np.eye(4)):
                continue
            step = places @ (matrix[:3, :3] - np.eye(3)).T + matrix[:3, 3]
            total += weights[:, index, None] * step
        return total

    def speeds(self, points: Array, start: Array, end: Array) -> Array:
        """Return upper bounds of the speed of points (P, 3) in intervals of t from `start` to `end` (K,), (K, P)."""
        weights = self.weights(points)
        middle, radius = np.zeros((len(start), len(points), 3)), np.zeros((len(start), len(points), 3))
        for index, holder in enumerate(self.holders):
            own_middle, own_radius = velocities(holder.operations, points, start, end)
            middle += weights[:, index, None] * own_middle
            radius += weights[:, index, None] * own_radius
        bounds: Array = np.linalg.norm(np.abs(middle) + radius, axis=2)
        return bounds

    def held(self, points: ArrayLike) -> NDArray[np.int64]:
        """Return for each of `points` (P, 3) the holder that it moves with exactly, (P,); -1: none."""
        weights = self.weights(points)
        held: NDArray[np.int64] = np.where(weights.max(axis=1) == 1.0, weights.argmax(axis=1), -1)
        return held

    def loss(self, t: float) -> float:
        """Return the share of a gap that two tissues lose by following it: none, as nothing has to share a blend."""
        return 0.0

    def rests(self) -> bool:
        """Tell whether nothing is displaced at t = 0."""
        return all(np.array_equal(map_of(holder.operations, 0.0), np.eye(4)) for holder in self.holders)


def balls_around(points: ArrayLike, radius: float, margin: float) -> tuple[Ball, ...]:
    """Return balls of one radius that cover `points` (P, 3) and what is within `margin` of them, in mm.

    Each next ball is centred on the point farthest from those before (Gonzalez 1985), the first on the point
    nearest to the mean.
    """
    places = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    first = int(np.linalg.norm(places - places.mean(axis=0), axis=1).argmin())
    chosen = [first]
    distances = np.linalg.norm(places - places[first], axis=1)
    reach = radius - margin
    while distances.max() > reach:
        chosen.append(int(distances.argmax()))
        distances = np.minimum(distances, np.linalg.norm(places - places[chosen[-1]], axis=1))
    if not math.isfinite(reach) or reach <= 0.0:
        raise ValueError("the radius must exceed the margin")
    return tuple((float(x), float(y), float(z), radius) for x, y, z in places[chosen])
