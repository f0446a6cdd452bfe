"""Short ways that keep many demands, by projections on the one that is kept least."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_PROJECTIONS, _SETTLED = 60, 1e-3


def projected(ways: Floats, own: Ints, directions: Floats, demands: Floats) -> Floats:
    """Return ways (V, 3), changed a little, that lead far enough in all directions demanded of each.

    Agmon 1954, Motzkin & Schoenberg 1954: a projection on the plane that is farthest, again and again.

    Parameters
    ----------
    ways : (V, 3) float64
        Where to begin.
    own : (D,) int64
        Whose way is demanded of, in ascending order.
    directions : (D, 3) float64
        Unit vectors.
    demands : (D,) float64
        How far it shall lead that way, in mm.
    """
    ways = ways.copy()
    for _ in range(_PROJECTIONS):
        if not len(own):
            break
        starts = np.flatnonzero(np.r_[True, own[1:] != own[:-1]])
        counts = np.diff(np.r_[starts, len(own)])
        lacking = demands - (directions * ways[own]).sum(axis=1)
        most = np.maximum.reduceat(lacking, starts)
        first = np.where(lacking == np.repeat(most, counts), np.arange(len(own)), len(own))
        worst = np.minimum.reduceat(first, starts)
        ways[own[starts]] += np.maximum(most, 0.0)[:, None] * directions[worst]
        busy = np.repeat(most > _SETTLED * np.abs(demands[worst]), counts)
        own, directions, demands = own[busy], directions[busy], demands[busy]
    return ways
