"""Smooth curves through given values and points."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def monotone_curve(knots: Array, values: Array) -> Callable[[Array], Array]:
    """Return the monotone piecewise cubic through (knots, values), constant beyond the ends.

    Between two knots the curve never leaves the interval of their values (Fritsch and Carlson 1980,
    slopes by the weighted harmonic mean).
    """
    x, y = np.asarray(knots, float), np.asarray(values, float)
    width = np.diff(x)
    secant = np.diff(y) / width
    slope = np.zeros_like(y)
    before, after = secant[:-1], secant[1:]
    w1, w2 = 2 * width[1:] + width[:-1], width[1:] + 2 * width[:-1]
    same_sign = before * after > 0
    # Beside a denormal secant the sum overflows, and the mean is 0, as it should be.
    with np.errstate(over="ignore"):
        mean = (w1 + w2) / (w1 / np.where(same_sign, before, 1) + w2 / np.where(same_sign, after, 1))
    slope[1:-1] = np.where(same_sign, mean, 0)
    slope[0], slope[-1] = secant[0], secant[-1]

    def curve(at: Array) -> Array:
        at = np.clip(at, x[0], x[-1])
        i = np.clip(np.searchsorted(x, at, side="right") - 1, 0, len(width) - 1)
        t = (at - x[i]) / width[i]
        step = secant[i] * width[i] * t * t * (3 - 2 * t)
        result: Array = y[i] + step + width[i] * t * (1 - t) * ((1 - t) * slope[i] - t * slope[i + 1])
        return result

    return curve


def smooth_path(points: Array, samples: int = 161) -> Array:
    """Return `samples` points at equal distances on the natural cubic spline through `points` (n, 3)."""
    points = np.asarray(points, float)
    t = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    n = len(t)
    width = np.diff(t)
    system = np.eye(n)
    right = np.zeros((n, 3))
    for i in range(1, n - 1):
        system[i, i - 1 : i + 2] = width[i - 1], 2 * (width[i - 1] + width[i]), width[i]
        right[i] = 6 * ((points[i + 1] - points[i]) / width[i] - (points[i] - points[i - 1]) / width[i - 1])
    bend = np.linalg.solve(system, right)  # second derivatives at the knots
    fine = np.linspace(0, t[-1], 4 * samples)
    k = np.clip(np.searchsorted(t, fine, side="right") - 1, 0, n - 2)
    h, b = width[k][:, None], (fine - t[k])[:, None]
    a = h - b
    curve = (bend[k] * a**3 + bend[k + 1] * b**3) / (6 * h)
    curve += (points[k] / h - bend[k] * h / 6) * a + (points[k + 1] / h - bend[k + 1] * h / 6) * b
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
    even = np.linspace(0, length[-1], samples)
    return np.stack([np.interp(even, length, curve[:, k]) for k in range(3)], axis=1)
