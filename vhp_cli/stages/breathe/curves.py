"""Curves of the sweep variable: what the parameters of a motion are."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vhp_cli.stages.breathe.intervals import Interval

Array = NDArray[np.float64]
Joining = Literal["monotone", "linear"]

# Rounding of the values of a polynomial of degree below 16, as a multiple of the sum of its terms' sizes.
_ROUNDING = 64.0 * np.finfo(np.float64).eps


@dataclass(frozen=True, slots=True)
class Polynomial:
    """A polynomial of the sweep variable t.

    Parameters
    ----------
    coefficients
        In ascending powers of t, the constant first.
    """

    coefficients: tuple[float, ...]

    def __post_init__(self) -> None:
        if not self.coefficients or not all(math.isfinite(value) for value in self.coefficients):
            raise ValueError("a polynomial needs one finite coefficient or more")

    def __call__(self, t: ArrayLike) -> Array:
        """Return the values at `t`, in its shape."""
        return _horner(np.asarray(t, dtype=np.float64), self.coefficients)

    def bounds(self, start: ArrayLike, end: ArrayLike) -> Interval:
        """Enclose the values over each of the intervals from `start` to `end`."""
        return _enclosure(self.coefficients, np.asarray(start, np.float64), np.asarray(end, np.float64))

    def slope_bounds(self, start: ArrayLike, end: ArrayLike) -> Interval:
        """Enclose the derivative over each of the intervals from `start` to `end`."""
        return self.derivative().bounds(start, end)

    def derivative(self) -> Polynomial:
        """Return the derivative."""
        return Polynomial(_derivative(self.coefficients))

    def terms(self, variable: str) -> tuple[str, ...]:
        """Return texts in `variable`, with ``* ^`` alone, that add up to the curve."""
        return tuple(
            repr(value) if power == 0 else f"{value!r}*{variable}" + (f"^{power}" if power > 1 else "")
            for power, value in enumerate(self.coefficients)
            if value != 0.0
        )


@dataclass(frozen=True, slots=True)
class Interpolant:
    """A curve through given values at t = 0, 1, 2 ...

    Beyond the last value the last piece goes on.

    Parameters
    ----------
    values
        At t = 0, 1, ..., two or more.
    joining
        ``"monotone"``: cubics with a continuous slope that rise and fall only where the values do
        (Fritsch and Butland 1984); ``"linear"``: straight lines.
    """

    values: tuple[float, ...]
    joining: Joining = "monotone"

    def __post_init__(self) -> None:
        if len(self.values) < 2 or not all(math.isfinite(value) for value in self.values):
            raise ValueError("a curve through values needs two finite values or more")
        if self.joining not in ("monotone", "linear"):
            raise ValueError(f"values are joined 'monotone' or 'linear', not {self.joining!r}")

    def __call__(self, t: ArrayLike) -> Array:
        """Return the values at `t`, in its shape."""
        times = np.asarray(t, dtype=np.float64)
        pieces = self.pieces()
        index = np.clip(np.floor(times).astype(np.int64), 0, len(pieces) - 1)
        return _horner(times - index, tuple(pieces[index, power] for power in range(pieces.shape[1])))

    def bounds(self, start: ArrayLike, end: ArrayLike) -> Interval:
        """Enclose the values over each of the intervals from `start` to `end`."""
        return self._over_pieces(start, end, slope=False)

    def slope_bounds(self, start: ArrayLike, end: ArrayLike) -> Interval:
        """Enclose the derivative (both, where it jumps) over each of the intervals from `start` to `end`."""
        return self._over_pieces(start, end, slope=True)

    def pieces(self) -> Array:
        """Return the coefficients of each piece in ascending powers of t minus the piece's start, (P, 4)."""
        return _pieces(self.values, self.joining)

    def terms(self, variable: str) -> tuple[str, ...]:
        """Return texts in `variable`, with ``+ - * ^`` and ``abs()`` alone, that add up to the curve.

        The jumps of the derivatives at the joints are powers of ``(u + |u|) / 2``, u being t minus the joint.
        """
        pieces = self.pieces()
        terms = list(Polynomial(tuple(float(value) for value in pieces[0])).terms(variable))
        for joint in range(1, len(pieces)):
            # The piece before, written about this joint, differs in what its derivatives jump by.
            before = _shifted(tuple(float(value) for value in pieces[joint - 1]), 1.0)
            past = f"({variable} - {joint} + abs({variable} - {joint}))"
            for power in (1, 2, 3):
                jump = float(pieces[joint][power] - before[power]) / 2.0**power
                # Below that it is the rounding of the pieces.
                if abs(jump) > 1e-15 * max(map(abs, self.values)):
                    terms.append(f"{jump!r}*{past}" + (f"^{power}" if power > 1 else ""))
        return tuple(terms)

    def _over_pieces(self, start: ArrayLike, end: ArrayLike, *, slope: bool) -> Interval:
        first, last = np.broadcast_arrays(np.asarray(start, np.float64), np.asarray(end, np.float64))
        pieces = self.pieces()
        low, high = np.full(first.shape, np.inf), np.full(first.shape, -np.inf)
        for number, piece in enumerate(pieces):
            begin = -np.inf if number == 0 else float(number)
            finish = np.inf if number == len(pieces) - 1 else float(number + 1)
            touched = (first <= finish) & (last >= begin)
            if not touched.any():
                continue
            coefficients = tuple(float(value) for value in piece)
            part = _enclosure(
                _derivative(coefficients) if slope else coefficients,
                np.clip(first, begin, finish) - number,
                np.clip(last, begin, finish) - number,
            )
            low = np.where(touched, np.minimum(low, part.low), low)
            high = np.where(touched, np.maximum(high, part.high), high)
        return Interval(low, high)


@dataclass(frozen=True, slots=True)
class Power:
    """The curve base^t, a growth by the same factor in each step.

    Parameters
    ----------
    base
        The factor per step, above 0.
    """

    base: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.base) and self.base > 0.0):
            raise ValueError(f"the base of a power must be above 0, not {self.base}")

    def __call__(self, t: ArrayLike) -> Array:
        """Return the values at `t`, in its shape."""
        return np.asarray(np.power(self.base, np.asarray(t, dtype=np.float64)), dtype=np.float64)

    def bounds(self, start: ArrayLike, end: ArrayLike) -> Interval:
        """Enclose the values over each of the intervals from `start` to `end`."""
        ends = np.stack(np.broadcast_arrays(self(start), self(end)))
        slack = _ROUNDING * ends.max(axis=0)
        return Interval(ends.min(axis=0) - slack, ends.max(axis=0) + slack)

    def slope_bounds(self, start: ArrayLike, end: ArrayLike) -> Interval:
        """Enclose the derivative over each of the intervals from `start` to `end`."""
        return self.bounds(start, end) * Interval.exactly(math.log(self.base))

    def terms(self, variable: str) -> tuple[str, ...]:
        """Return the text of the curve in `variable`, with ``^`` alone."""
        return (f"{self.base!r}^{variable}",)


Curve = Polynomial | Interpolant | Power


def added(terms: Sequence[str]) -> str:
    """Return the sum of terms as text; ``"0"`` of none."""
    return " + ".join(terms).replace("+ -", "- ") or "0"


def _horner(t: Array, coefficients: Sequence[float | Array]) -> Array:
    value: Array = np.zeros_like(t) + np.asarray(coefficients[-1], dtype=np.float64)
    for coefficient in reversed(coefficients[:-1]):
        value = value * t + coefficient
    return value


def _derivative(coefficients: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(power * value for power, value in enumerate(coefficients))[1:] or (0.0,)


def _shifted(coefficients: tuple[float, ...], by: float) -> tuple[float, ...]:
    """Return the coefficients in powers of ``t - by``."""
    return tuple(
        sum(value * math.comb(power, k) * by ** (power - k) for power, value in enumerate(coefficients) if power >= k)
        for k in range(len(coefficients))
    )


def _enclosure(coefficients: tuple[float, ...], start: Array, end: Array) -> Interval:
    """Enclose a polynomial over intervals by its Taylor form about their middles."""
    start, end = np.broadcast_arrays(start, end)
    middle = 0.5 * (start + end)
    radius = np.maximum(end - middle, middle - start)
    spread, derivative, factorial = np.zeros(middle.shape), coefficients, 1.0
    for order in range(1, len(coefficients)):
        derivative, factorial = _derivative(derivative), factorial * order
        spread = spread + np.abs(_horner(middle, derivative)) * radius**order / factorial
    reach = np.abs(middle) + radius
    # The terms of the value and of the spread are, in size, no more than this together.
    size = _horner(reach, tuple(abs(value) for value in coefficients))
    return Interval.around(_horner(middle, coefficients), spread * (1.0 + _ROUNDING) + _ROUNDING * size)


@lru_cache(maxsize=1024)
def _pieces(values: tuple[float, ...], joining: Joining) -> Array:
    heights = np.asarray(values, dtype=np.float64)
    rises = np.diff(heights)
    if joining == "linear":
        zero = np.zeros_like(rises)
        pieces = np.stack([heights[:-1], rises, zero, zero], axis=1)
    else:
        slopes = _monotone_slopes(rises)
        left, right = slopes[:-1], slopes[1:]
        pieces = np.stack([heights[:-1], left, 3.0 * rises - 2.0 * left - right, left + right - 2.0 * rises], axis=1)
    pieces.flags.writeable = False
    return pieces


def _monotone_slopes(rises: Array) -> Array:
    """Return the slopes at unit-spaced samples of Fritsch and Butland's monotone cubic."""
    if len(rises) == 1:
        return np.repeat(rises, 2)
    slopes = np.zeros(len(rises) + 1)
    product = rises[:-1] * rises[1:]
    rising = product > 0.0
    slopes[1:-1][rising] = 2.0 * product[rising] / (rises[:-1] + rises[1:])[rising]
    slopes[0], slopes[-1] = _end_slope(rises[0], rises[1]), _end_slope(rises[-1], rises[-2])
    return slopes


def _end_slope(nearest: float, next_one: float) -> float:
    """Return the three-point slope at an end, held back where it would overshoot."""
    slope = 1.5 * nearest - 0.5 * next_one
    if slope * nearest <= 0.0:
        return 0.0
    if nearest * next_one <= 0.0 and abs(slope) > 3.0 * abs(nearest):
        return 3.0 * nearest
    return slope
