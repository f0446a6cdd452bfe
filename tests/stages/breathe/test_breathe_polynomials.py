"""Curves of the sweep variable and their fits."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.interpolate import PchipInterpolator
from scipy.optimize import minimize_scalar

import vhp_cli
from vhp_cli.stages.breathe.curves import Curve, Interpolant, Polynomial, Power, added
from vhp_cli.stages.breathe.polynomials import fit_parameter, fit_pinned, residual, turn_back

READINGS = tomllib.loads((Path(vhp_cli.__file__).parent / "data" / "vhp_female_readings.toml").read_text())
FITS = [
    (tissue, name)
    for tissue, entry in READINGS.items()
    if isinstance(entry, dict) and tissue not in ("lungs", "shells", "unit_steps")
    for name in entry
]

numbers = st.floats(-5.0, 5.0)
polynomials = st.lists(numbers, min_size=1, max_size=7).map(
    lambda values: Polynomial(tuple(value / 8.0**power for power, value in enumerate(values)))
)
interpolants = st.builds(
    lambda values, joining: Interpolant(tuple(values), joining),
    st.lists(numbers, min_size=2, max_size=14),
    st.sampled_from(["monotone", "linear"]),
)
curves = polynomials | interpolants | st.builds(Power, st.floats(0.8, 1.3))


@pytest.mark.parametrize(("tissue", "name"), FITS)
def test_pinned_fit_gives_the_readings(tissue: str, name: str) -> None:
    reading = READINGS[tissue][name]
    values = np.array(reading["values"])
    found = fit_pinned(np.arange(1.0, 12.0), values[1:], values[0])
    assert found.coefficients[0] == values[0]
    times = np.arange(0.0, 11.01, 0.05)
    wanted = np.polynomial.polynomial.polyval(times, reading["pinned"])
    assert np.abs(found(times) - wanted).max() < 1e-7
    assert residual(found, np.arange(1.0, 12.0), values[1:]) == pytest.approx(reading["max_residual_pinned"], rel=2e-3)
    assert turn_back(found, 11.0) == pytest.approx(reading["overshoot_pinned"], rel=0.05, abs=2e-6)


@given(st.lists(numbers, min_size=6, max_size=6))
def test_pinned_fit_finds_a_polynomial_again(values: list[float]) -> None:
    wanted = Polynomial((1.0, *(value / 10.0**power for power, value in enumerate(values))))
    times = np.linspace(0.5, 11.0, 22)
    found = fit_pinned(times, wanted(times), 1.0)
    assert found.coefficients[0] == 1.0
    assert residual(found, times, wanted(times)) < 1e-9


def test_pinned_fit_is_least_squares() -> None:
    """No other polynomial through the identity comes closer in the sum of squares."""
    times, samples = np.arange(1.0, 12.0), np.array([0, 2, 1, 4, 4, 7, 5, 9, 8, 8, 11.0])
    found = fit_pinned(times, samples, 0.0)
    error = found(times) - samples
    for power in range(1, 7):
        assert abs(error @ (times / 11.0) ** power) < 1e-9


def test_pinned_fit_of_few_samples_goes_through_them() -> None:
    found = fit_pinned([1.0, 2.0, 3.0], [1.0, 3.0, 2.0], 0.0)
    assert len(found.coefficients) == 4
    assert found([0.0, 1.0, 2.0, 3.0]) == pytest.approx([0.0, 1.0, 3.0, 2.0])


def test_fit_of_nothing_is_refused() -> None:
    for times, samples in (([], []), ([0.0, 1.0], [0.0, 1.0]), ([1.0], [np.nan]), ([1.0, 2.0], [1.0])):
        with pytest.raises(ValueError, match="a fit needs"):
            fit_pinned(times, samples, 0.0)


def test_fit_of_the_identity_is_the_identity() -> None:
    assert fit_pinned([1.0, 2.0], [1.0, 1.0], 1.0) == Polynomial((1.0,))


def test_poor_fit_gives_way_to_the_monotone_curve() -> None:
    samples = [0, 0, 0, 0, 0, 5, 5, 5, 5, 5, 5.0]
    loose, strict = fit_parameter(samples, 0.0), fit_parameter(samples, 0.0, tolerance=0.01)
    assert isinstance(loose.curve, Polynomial) and loose.table == tuple(samples)
    assert loose.residual == residual(loose.curve, np.arange(1, 12), samples) > 0.01
    assert isinstance(strict.curve, Interpolant)
    assert list(strict.curve(np.arange(12.0))) == [0.0, *samples]
    assert turn_back(loose.curve, 11.0) > 0.1
    assert turn_back(strict.curve, 11.0) == 0.0


@given(curves, st.floats(1.0, 11.0))
@example(Polynomial((0.0, 0.0625, -0.03125, -0.001953125, 0.000244140625, 3e-30)), 1.0)
def test_turn_back_is_the_largest_way_back(curve: Curve, end: float) -> None:
    times = np.linspace(0.0, end, 4001)
    values = curve(times) if curve(end) >= curve(0.0) else -curve(times)
    sampled = float((np.maximum.accumulate(values) - values).max())
    found = turn_back(curve, end)
    assert sampled - 1e-9 <= found <= sampled + 1e-3 * (1.0 + np.ptp(values))


def test_turn_back_of_a_parabola() -> None:
    # 4t - t^2 rises to 4 at t = 2 and comes back to 3 at t = 3.
    assert turn_back(Polynomial((0.0, 4.0, -1.0)), 3.0) == pytest.approx(1.0)
    assert turn_back(Polynomial((0.0, 4.0, -1.0)), 2.0) == 0.0


@given(interpolants)
def test_interpolant_goes_through_its_values(curve: Interpolant) -> None:
    times = np.arange(len(curve.values))
    assert curve(times) == pytest.approx(curve.values, abs=1e-12)


@given(st.lists(numbers, min_size=3, max_size=14))
def test_monotone_interpolant_is_that_of_scipy(values: list[float]) -> None:
    steps = np.diff(values)
    if np.any((np.abs(steps) < 1e-6) & (steps != 0.0)):
        return  # where products of slopes underflow the two differ
    times = np.linspace(0.0, len(values) - 1.0, 301)
    wanted = PchipInterpolator(np.arange(len(values)), values)(times)
    assert Interpolant(tuple(values))(times) == pytest.approx(wanted, abs=1e-9)


@given(st.lists(st.floats(0.0, 3.0), min_size=2, max_size=14))
def test_monotone_interpolant_never_turns_back(steps: list[float]) -> None:
    curve = Interpolant((0.0, *np.cumsum(steps).tolist()))
    assert turn_back(curve, float(len(steps))) < 1e-12


@given(curves, st.floats(0.0, 12.0), st.floats(0.0, 12.0))
def test_bounds_hold_all_values_and_slopes(curve: Curve, one: float, other: float) -> None:
    start, end = min(one, other), max(one, other)
    times = np.linspace(start, end, 201)
    values, slopes = curve.bounds(start, end), curve.slope_bounds(start, end)
    assert (values.low <= curve(times)).all() and (curve(times) <= values.high).all()
    if end - start > 1e-3:
        differences = np.diff(curve(times)) / np.diff(times)
        rounding = 1e-12 * (1.0 + np.abs(curve(times)).max()) / np.diff(times).min()
        assert (slopes.low - rounding <= differences).all() and (differences <= slopes.high + rounding).all()


@given(polynomials, st.floats(0.0, 10.0))
def test_bounds_close_in(curve: Polynomial, start: float) -> None:
    """On a short interval the enclosure is hardly wider than the values."""
    width = 1e-3
    bounds = curve.bounds(start, start + width)
    steepest = float(curve.slope_bounds(start, start + width).largest())
    assert bounds.high - bounds.low <= 2.0 * steepest * width + 1e-9


@given(curves, st.floats(0.0, 11.0))
def test_terms_add_up_to_the_curve(curve: Curve, t: float) -> None:
    text = added(curve.terms("x"))
    value = eval(text.replace("^", "**"), {"x": t, "abs": abs, "__builtins__": {}})
    assert value == pytest.approx(float(curve(t)), abs=1e-9)


def test_a_curve_needs_finite_numbers() -> None:
    for make in (
        lambda: Polynomial(()),
        lambda: Polynomial((float("nan"),)),
        lambda: Interpolant((1.0,)),
        lambda: Interpolant((1.0, float("inf"))),
        lambda: Interpolant((1.0, 2.0), "round"),  # type: ignore[arg-type]
        lambda: Power(0.0),
    ):
        with pytest.raises(ValueError):
            make()


def test_extremes_of_a_polynomial_are_bounded() -> None:
    """Between samples too: the largest value that an optimizer finds is within the bounds."""
    curve = Polynomial((0.0, 2.397, -1.388, 0.4366, -0.0656, 0.004709, -0.00013))
    found = minimize_scalar(lambda t: -float(curve(t)), bounds=(0.0, 12.0), method="bounded")
    assert curve.bounds(0.0, 12.0).high >= -found.fun
