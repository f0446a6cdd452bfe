"""The smooth displacement field of the shells (skin, fat, average body)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vhp_cli.stages.breathe.operations import Parameter, Triple

Array = NDArray[np.float64]
Window = tuple[float, float]

ANTERIOR: Triple = (0.0, -1.0, 0.0)


@dataclass(frozen=True, slots=True)
class Field:
    """A displacement ``a(t) w(x, y, z) u`` of points at rest, all in mm.

    The weight w, between 0 and 1, is the product of ``sin(pi (z - z0) / (z1 - z0))`` within the window in z, of
    smooth steps (``3 s^2 - 2 s^3``) that rise and fall over `x_taper` inside the window in x, and of one that falls
    from 1 to 0 over `y_taper` towards the back at `y_back` (thesis A.8; tapers keep a step from the window's edge).
    With tapers it is continuous, so that nested shells that share it keep their order.

    Parameters
    ----------
    name
        Of the field.
    amplitude
        a(t) in mm; 0 at t = 0.
    x_window, z_window
        Ends of the window, low before high.
    y_back
        Where the field ends towards the back; points further back stay.
    x_taper, y_taper
        Widths of the tapers; two of `x_taper` fit into the window. 0 is a step, which tears what crosses it.
    direction
        The unit vector u, to the front by default.

    Raises
    ------
    ValueError
        If a window is empty, a taper does not fit, or the direction is no unit vector.
    """

    name: str
    amplitude: Parameter
    x_window: Window
    z_window: Window
    y_back: float
    x_taper: float = 60.0
    y_taper: float = 60.0
    direction: Triple = ANTERIOR

    def __post_init__(self) -> None:
        numbers = [*self.x_window, *self.z_window, self.y_back, self.x_taper, self.y_taper, *self.direction]
        if not all(math.isfinite(number) for number in numbers):
            raise ValueError("a field needs finite numbers")
        if self.x_window[0] >= self.x_window[1] or self.z_window[0] >= self.z_window[1]:
            raise ValueError("the window of a field must have its low end before its high end")
        if not (0.0 <= 2.0 * self.x_taper <= self.x_window[1] - self.x_window[0]) or self.y_taper < 0.0:
            raise ValueError("the tapers of a field must not be below 0 and must fit into its window")
        if abs(math.hypot(*self.direction) - 1.0) > 1e-9:
            raise ValueError("the direction of a field must be a unit vector")

    def weight(self, points: ArrayLike) -> Array:
        """Return w at `points` (P, 3), (P,)."""
        x, y, z = np.asarray(points, dtype=np.float64).reshape(-1, 3).T
        low, high = self.z_window
        inside = np.clip((z - low) / (high - low), 0.0, 1.0)
        # sin(pi) is not quite 0 in floating point.
        lengthwise = np.where((inside <= 0.0) | (inside >= 1.0), 0.0, np.sin(np.pi * inside))
        left, right = self.x_window
        sideways = _rise(x - left, self.x_taper) * _rise(right - x, self.x_taper)
        weight: Array = lengthwise * sideways * _rise(self.y_back - y, self.y_taper)
        return weight

    def displacement(self, points: ArrayLike, t: float) -> Array:
        """Return the displacement of `points` (P, 3) at `t`, (P, 3) mm."""
        sizes: Array = float(self.amplitude.curve(t)) * self.weight(points)
        return np.outer(sizes, self.direction)

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
        """Return an upper bound of the slope of w, per mm; infinite if a taper is a step."""
        low, high = self.z_window
        if not (self.x_taper and self.y_taper):
            return math.inf
        return math.hypot(math.pi / (high - low), 1.5 / self.x_taper, 1.5 / self.y_taper)


def _rise(depth: Array, width: float) -> Array:
    """Return the smooth step from 0 to 1 over `width` of depths into the window."""
    if width == 0.0:
        return np.where(depth > 0.0, 1.0, 0.0)
    s = np.clip(depth / width, 0.0, 1.0)
    step: Array = s * s * (3.0 - 2.0 * s)
    return step
