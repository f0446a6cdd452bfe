"""Prove that two bodies stay apart: their gaps at some times exceed the ways that their points go in between."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vhp_cli.kernels.spatial import gap
from vhp_cli.stages.breathe.bodies import Body

Pair = tuple[str, str]

# Intervals are halved at most so often before they count as unproven.
DEPTH = 12
# Gaps computed from coordinates are good to far less than this, in mm.
_ROUNDING_MM = 1e-6


@dataclass(frozen=True, slots=True)
class Unproven:
    """A pair that could meet between two moments, as far as the bounds tell."""

    a: str
    b: str
    start: float
    end: float
    reach_mm: float
    gaps_mm: tuple[float, float]


@dataclass(frozen=True, slots=True)
class PairProof:
    """What was proven of a pair.

    Parameters
    ----------
    intervals
        That were proven; 0 if the pair is further apart than both ever travel.
    least_mm
        A lower bound of their gap at every moment; None if they are far apart.
    unproven
        What was not.
    """

    intervals: int
    least_mm: float | None
    unproven: tuple[Unproven, ...]


def prove_apart(first: Body, second: Body, pair: Pair, depth: int = DEPTH) -> PairProof:
    """Prove that two bodies never meet, as far as that is so."""
    whole = first.whole_travel() + second.whole_travel()
    if _gap(first, second, 0.0, whole) > whole:
        return PairProof(0, None, ())
    times = first.grid.tolist()
    reaches = [first.travel(t, t + 1.0) + second.travel(t, t + 1.0) for t in times[:-1]]
    gaps = []
    for index, t in enumerate(times):
        # A gap of this or more proves the intervals on both sides whatever the next one is.
        enough = max(reaches[max(index - 1, 0)], reaches[min(index, len(reaches) - 1)])
        gaps.append(_gap(first, second, t, enough + _ROUNDING_MM))
    search = _Halving(first, second, pair, depth)
    proven, least, unproven = 0, np.inf, []
    for index in range(len(reaches)):
        count, bound, missing = search.interval(
            times[index], times[index + 1], gaps[index], gaps[index + 1], reaches[index], 0
        )
        proven, least = proven + count, min(least, bound)
        unproven += missing
    return PairProof(proven, float(least), tuple(unproven))


def _gap(first: Body, second: Body, t: float, limit: float) -> float:
    """Return the gap, or somewhat more than the limit where it is larger; 0 on contact."""
    found = gap(first.tree(t), second.tree(t), limit)
    return float(np.nextafter(limit, np.inf)) if found is None else found.distance


@dataclass(frozen=True, slots=True)
class _Halving:
    first: Body
    second: Body
    pair: Pair
    depth: int

    def interval(
        self, start: float, end: float, before: float, after: float, reach: float, level: int
    ) -> tuple[int, float, list[Unproven]]:
        """Return intervals proven, the least gap in them, and what is unproven."""
        slack = 0.5 * (before + after - reach) - _ROUNDING_MM
        if slack > 0.0:
            return 1, min(slack, before, after), []
        if level >= self.depth or min(before, after) <= 0.0:
            return 0, 0.0, [Unproven(*self.pair, start, end, reach, (before, after))]
        middle = 0.5 * (start + end)
        halves = [self.first.travel(s, e) + self.second.travel(s, e) for s, e in ((start, middle), (middle, end))]
        between = _gap(self.first, self.second, middle, max(halves) + _ROUNDING_MM)
        left = self.interval(start, middle, before, between, halves[0], level + 1)
        right = self.interval(middle, end, between, after, halves[1], level + 1)
        return left[0] + right[0], min(left[1], right[1]), left[2] + right[2]
