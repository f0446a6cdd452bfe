"""Interval arithmetic: the exact result is always within."""

from __future__ import annotations

from fractions import Fraction
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vhp_cli.stages.breathe.intervals import Interval, sine_and_cosine

numbers = st.floats(-1e6, 1e6, allow_subnormal=False)
pairs = st.tuples(numbers, numbers).map(sorted)


def interval(ends: list[float]) -> Interval:
    return Interval(np.array([ends[0]]), np.array([ends[1]]))


def holds(found: Interval, exact: Fraction) -> bool:
    return Fraction(float(found.low[0])) <= exact <= Fraction(float(found.high[0]))


@given(pairs, pairs)
def test_sums_and_products_hold_the_exact_ones(a: list[float], b: list[float]) -> None:
    one, other = interval(a), interval(b)
    for x, y in product(a, b):
        assert holds(one + other, Fraction(x) + Fraction(y))
        assert holds(one - other, Fraction(x) - Fraction(y))
        assert holds(one * other, Fraction(x) * Fraction(y))
        assert holds(-one, -Fraction(x))
        assert holds(one.union(other), Fraction(x)) and holds(one.union(other), Fraction(y))


@given(st.lists(pairs, min_size=12, max_size=12), st.randoms(use_true_random=False))
def test_products_of_matrices_hold_the_exact_ones(ends: list[list[float]], random: object) -> None:
    left = Interval(np.array([e[0] for e in ends[:6]]), np.array([e[1] for e in ends[:6]])).reshape(1, 2, 3)
    right = Interval(np.array([e[0] for e in ends[6:]]), np.array([e[1] for e in ends[6:]])).reshape(1, 3, 2)
    chosen = [random.choice(e) for e in ends]  # type: ignore[attr-defined]
    a, b = np.array(chosen[:6]).reshape(2, 3), np.array(chosen[6:]).reshape(3, 2)
    found = left.matmul(right)
    for i, j in product(range(2), range(2)):
        exact = sum(Fraction(a[i, k]) * Fraction(b[k, j]) for k in range(3))
        assert Fraction(float(found.low[0, i, j])) <= exact <= Fraction(float(found.high[0, i, j]))


@given(st.floats(-50.0, 50.0), st.floats(0.0, 8.0))
def test_sine_and_cosine_hold_all_values(start: float, width: float) -> None:
    sine, cosine = sine_and_cosine(interval([start, start + width]))
    angles = np.linspace(start, start + width, 997)
    for found, values in ((sine, np.sin(angles)), (cosine, np.cos(angles))):
        assert found.low[0] <= values.min() and values.max() <= found.high[0]
        # And hardly more than that.
        assert found.high[0] - found.low[0] <= np.ptp(values) + 1e-4


@pytest.mark.parametrize("turns", [-3, 0, 2])
def test_extremes_between_the_ends_are_held(turns: int) -> None:
    middle = np.pi / 2.0 + 2.0 * np.pi * turns
    sine, cosine = sine_and_cosine(interval([middle - 0.1, middle + 0.1]))
    assert sine.high[0] == 1.0 and sine.low[0] == pytest.approx(np.cos(0.1))
    assert (cosine.low[0], cosine.high[0]) == pytest.approx((-np.sin(0.1), np.sin(0.1)))
    sine, cosine = sine_and_cosine(interval([middle + np.pi / 2.0 - 0.1, middle + np.pi + 0.1]))
    assert sine.low[0] == cosine.low[0] == -1.0


@given(pairs)
def test_middle_and_radius_cover(ends: list[float]) -> None:
    middle, radius = interval(ends).middle_and_radius()
    assert Fraction(middle[0]) - Fraction(radius[0]) <= Fraction(ends[0])
    assert Fraction(ends[1]) <= Fraction(middle[0]) + Fraction(radius[0])
    around = Interval.around(middle, radius)
    assert around.low[0] <= ends[0] and ends[1] <= around.high[0]
    assert interval(ends).largest()[0] == max(abs(ends[0]), abs(ends[1]))
