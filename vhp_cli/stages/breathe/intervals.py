"""Interval arithmetic over arrays: enclosures that rounding cannot break."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

# The library's sine and cosine are off by a few units in the last place at most.
_TRIGONOMETRIC_ERROR = 4.0 * np.finfo(np.float64).eps


@dataclass(frozen=True, slots=True, eq=False)
class Interval:
    """Every number between `low` and `high`, element by element.

    Sums and products are rounded outwards, so that an interval holds the exact result for every choice of
    operands from its operands' intervals.

    Parameters
    ----------
    low, high : (...) float64
        Ends, of one shape, ``low <= high``.
    """

    low: Array
    high: Array

    @classmethod
    def exactly(cls, values: ArrayLike) -> Interval:
        """Return the intervals that hold one number each."""
        array = np.asarray(values, dtype=np.float64)
        return cls(array, array)

    @classmethod
    def around(cls, middle: Array, radius: Array) -> Interval:
        """Return the intervals of all numbers no further than `radius` from `middle`."""
        return cls(_down(middle - radius), _up(middle + radius))

    def __add__(self, other: Interval) -> Interval:
        return Interval(_down(self.low + other.low), _up(self.high + other.high))

    def __sub__(self, other: Interval) -> Interval:
        return Interval(_down(self.low - other.high), _up(self.high - other.low))

    def __neg__(self) -> Interval:
        return Interval(-self.high, -self.low)

    def __mul__(self, other: Interval) -> Interval:
        products = np.stack(
            np.broadcast_arrays(
                self.low * other.low, self.low * other.high, self.high * other.low, self.high * other.high
            )
        )
        return Interval(_down(products.min(axis=0)), _up(products.max(axis=0)))

    def reshape(self, *shape: int) -> Interval:
        """Return the same intervals in another shape."""
        return Interval(self.low.reshape(shape), self.high.reshape(shape))

    def union(self, other: Interval) -> Interval:
        """Return the smallest intervals that hold both."""
        return Interval(np.minimum(self.low, other.low), np.maximum(self.high, other.high))

    def sum(self, axis: int) -> Interval:
        """Return the sum along `axis`."""
        lows, highs = np.moveaxis(self.low, axis, 0), np.moveaxis(self.high, axis, 0)
        total = Interval(lows[0], highs[0])
        for low, high in zip(lows[1:], highs[1:], strict=True):
            total = total + Interval(low, high)
        return total

    def matmul(self, other: Interval) -> Interval:
        """Return the matrix products of (..., n, m) by (..., m, p) intervals."""
        left = Interval(self.low[..., :, :, None], self.high[..., :, :, None])
        right = Interval(other.low[..., None, :, :], other.high[..., None, :, :])
        return (left * right).sum(axis=-2)

    def largest(self) -> Array:
        """Return the largest absolute value that each interval holds."""
        return np.maximum(np.abs(self.low), np.abs(self.high))

    def middle_and_radius(self) -> tuple[Array, Array]:
        """Return a middle and a radius that cover each interval."""
        middle = 0.5 * (self.low + self.high)
        return middle, _up(np.maximum(self.high - middle, middle - self.low))


def sine_and_cosine(angle: Interval) -> tuple[Interval, Interval]:
    """Return enclosures of the sine and the cosine of angles in radians."""
    return _sine(angle, 0.0), _sine(angle, 0.5 * np.pi)


def _sine(angle: Interval, shift: float) -> Interval:
    """Return the enclosure of ``sin(angle + shift)``, for a shift of 0 or a quarter turn."""
    function = np.sin if shift == 0.0 else np.cos
    ends = np.stack([function(angle.low), function(angle.high)])
    low, high = ends.min(axis=0) - _TRIGONOMETRIC_ERROR, ends.max(axis=0) + _TRIGONOMETRIC_ERROR
    # An extreme missed by rounding lies within rounding of an end, where the function is flat.
    high = np.where(_holds_turn(angle, 0.5 * np.pi - shift), 1.0, high)
    low = np.where(_holds_turn(angle, -0.5 * np.pi - shift), -1.0, low)
    return Interval(np.maximum(low, -1.0), np.minimum(high, 1.0))


def _holds_turn(angle: Interval, place: float) -> NDArray[np.bool_]:
    """Tell whether an interval holds `place` plus a whole number of turns."""
    turn = 2.0 * np.pi
    held: NDArray[np.bool_] = np.floor((angle.high - place) / turn) >= np.ceil((angle.low - place) / turn)
    return held


def _down(values: Array) -> Array:
    return np.nextafter(values, -np.inf)


def _up(values: Array) -> Array:
    return np.nextafter(values, np.inf)
