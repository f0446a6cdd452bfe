"""The coordinates that a file can hold: float32 values in its own unit.

Stages work in mm. What they make must hold for the numbers that will be read again, and these are float32 values of
the unit of the file: a surface that is sound on the float32 values of mm may cross itself on those of metres.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import numpy as np
from numpy.typing import NDArray

_unit_mm: ContextVar[float] = ContextVar("unit_mm", default=1.0)


@contextmanager
def file_unit(mm: float) -> Iterator[None]:
    """Round to the float32 values of another unit than mm in the body of a `with`.

    Parameters
    ----------
    mm
        Length of the unit in mm.
    """
    token = _unit_mm.set(mm)
    try:
        yield
    finally:
        _unit_mm.reset(token)


def unit_mm() -> float:
    """Return the length of the unit of the file in mm."""
    return _unit_mm.get()


def rounded(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return coordinates as they will be read again.

    Parameters
    ----------
    points : (..., 3) float64
        In mm.
    """
    unit = _unit_mm.get()
    if unit == 1.0:
        return points.astype(np.float32).astype(np.float64)
    return (points * (1.0 / unit)).astype(np.float32).astype(np.float64) * unit


def spacing(points: NDArray[np.float64]) -> float:
    """Return the largest distance, in mm, of neighbouring values that a coordinate of these points can have."""
    unit = _unit_mm.get()
    return unit * float(np.spacing(np.float32(np.abs(points).max(initial=0.0) / unit)))
