"""Parameters of operations that grow evenly with the sweep variable."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from vhp_cli.stages.breathe.curves import Polynomial
from vhp_cli.stages.breathe.operations import NO_MOVE, LocalFrame, Move, Parameter, Triple, triple

GLOBAL = LocalFrame()


def even(end: float, steps: int, start: float = 0.0) -> Parameter:
    """Return the parameter that goes from `start` at t = 0 to `end` at t = N in a straight line."""
    if end == start:
        return Parameter(Polynomial((start,)))
    return Parameter(Polynomial((start, (end - start) / steps)))


def even_move(vector: ArrayLike, steps: int) -> Move:
    """Return the translation (mm) that reaches `vector` (3,) at t = N."""
    x, y, z = (even(value, steps) if value else NO_MOVE for value in np.asarray(vector, dtype=np.float64).tolist())
    return Move(GLOBAL, x, y, z)


def at(point: ArrayLike) -> LocalFrame:
    """Return the local coordinate system at a point, with the global axes."""
    origin: Triple = triple(point)
    return LocalFrame(origin)
