"""Fitting curves to samples: least squares through the identity at rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vhp_cli.stages.breathe.curves import Curve, Interpolant, Polynomial, Power
from vhp_cli.stages.breathe.operations import Parameter

Array = NDArray[np.float64]

DEGREE = 6
# As a part of the largest coefficient.
_NO_COEFFICIENT = 1e-13


def fit_pinned(times: ArrayLike, values: ArrayLike, identity: float, degree: int = DEGREE) -> Polynomial:
    """Fit a polynomial by least squares, its value at t = 0 fixed.

    Parameters
    ----------
    times : (T,) float64
        Values of the sweep variable, above 0.
    values : (T,) float64
        The samples.
    identity
        The value at t = 0: 1 of a scale, 0 of a move or rotation.
    degree
        Of the polynomial; with fewer samples than this, their number.

    Raises
    ------
    ValueError
        If there are no samples, a time is not above 0, or a number is not finite.
    """
    moments = np.asarray(times, dtype=np.float64)
    samples = np.asarray(values, dtype=np.float64)
    if moments.shape != samples.shape or moments.ndim != 1 or not len(moments):
        raise ValueError("a fit needs as many samples as times, one or more")
    if not (np.isfinite(moments).all() and np.isfinite(samples).all() and (moments > 0.0).all()):
        raise ValueError("a fit needs finite samples at times above 0")
    if (samples == identity).all():
        return Polynomial((identity,))
    # Powers of t over the largest t keep the columns of one size.
    reach = float(moments.max())
    powers = np.arange(1, min(degree, len(np.unique(moments))) + 1)
    columns = (moments[:, None] / reach) ** powers
    solution = np.linalg.lstsq(columns, samples - identity, rcond=None)[0]
    return Polynomial((identity, *(solution / reach**powers).tolist()))


def residual(curve: Curve, times: ArrayLike, values: ArrayLike) -> float:
    """Return the largest distance of a curve from samples."""
    return float(np.max(np.abs(curve(times) - np.asarray(values, dtype=np.float64)), initial=0.0))


def turn_back(curve: Curve, end: float) -> float:
    """Return how far a curve goes back, at most, on its way from t = 0 to `end`; 0 if it never does.

    Back is against the direction from its first to its last value.
    """
    moments = _turning_points(curve, end)
    values = curve(moments)
    if values[-1] < values[0]:
        values = -values
    return float(np.max(np.maximum.accumulate(values) - values))


def fit_parameter(values: ArrayLike, identity: float, tolerance: float = np.inf) -> Parameter:
    """Fit the samples at t = 1, 2, ..., N of one parameter.

    Parameters
    ----------
    values : (N,) float64
        The samples.
    identity
        The value at t = 0.
    tolerance
        If the polynomial of degree 6 leaves a sample by more than this, the curve is the monotone one through all
        samples instead.

    Returns
    -------
    Parameter
        A polynomial with the samples as its table and its distance from them, or the monotone curve.
    """
    samples = np.asarray(values, dtype=np.float64)
    times = np.arange(1.0, len(samples) + 1.0)
    table = tuple(samples.tolist())
    polynomial = fit_pinned(times, samples, identity)
    distance = residual(polynomial, times, samples)
    return (
        Parameter(polynomial, table, distance) if distance <= tolerance else Parameter(Interpolant((identity, *table)))
    )


def _turning_points(curve: Curve, end: float) -> Array:
    """Return 0, `end` and all places between at which the curve may turn, ascending."""
    places = [0.0, end]
    if isinstance(curve, Polynomial):
        places += _roots(curve.derivative().coefficients, 0.0, end)
    elif isinstance(curve, Interpolant):
        for number, piece in enumerate(curve.pieces()):
            places.append(min(float(number), end))
            stop = end if number == len(curve.values) - 2 else min(number + 1.0, end)
            slope = Polynomial(tuple(piece.tolist())).derivative()
            places += [number + root for root in _roots(slope.coefficients, 0.0, stop - number)]
    else:
        assert isinstance(curve, Power)  # runs one way
    return np.unique(places)


def _roots(coefficients: tuple[float, ...], start: float, end: float) -> list[float]:
    """Return the real roots of a polynomial between two places, ascending."""
    reach = max(abs(start), abs(end))
    # Over [-1, 1] a leading coefficient that is next to nothing can go; kept, it would spoil the other roots.
    scaled = np.array(coefficients) * reach ** np.arange(len(coefficients))
    known = np.flatnonzero(np.abs(scaled) > _NO_COEFFICIENT * np.abs(scaled).max(initial=0.0))
    if not len(known):
        return []
    roots = reach * np.roots(scaled[known[-1] :: -1])
    # The place of a double root comes out with a small imaginary part.
    real = roots.real[np.abs(roots.imag) <= 1e-6 * (reach + np.abs(roots.real))]
    return sorted(float(root) for root in real if start < root < end)
