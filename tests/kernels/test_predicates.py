"""The exact predicates against rational arithmetic."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from exact_reference import degenerate, pair_kinds
from hypothesis import given, settings
from hypothesis import strategies as st

from vhp_cli.kernels._library import address, function, i64, pointer

_orient2d = function("vhp_orient2d", None, [pointer, i64, pointer])
_orient3d = function("vhp_orient3d", None, [pointer, i64, pointer])
_triangle_pairs = function("vhp_triangle_pairs", None, [pointer, i64, pointer])


def orient(points):
    """Signs of (n, d + 1, d) simplices by the kernels."""
    points = np.ascontiguousarray(points, dtype=np.float64)
    signs = np.empty(len(points), np.int8)
    call = _orient2d if points.shape[2] == 2 else _orient3d
    call(address(points), len(points), address(signs))
    return signs


def determinant_sign(points):
    """Sign of one simplex in rational arithmetic."""
    rows = [[Fraction(float(x)) - Fraction(float(y)) for x, y in zip(p, points[0], strict=True)] for p in points[1:]]
    if len(rows) == 2:
        (a, b), (c, d) = rows
        value = a * d - b * c
    else:
        (a, b, c), (d, e, f), (g, h, i) = rows
        value = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    return (value > 0) - (value < 0)


def kinds_of(a, b):
    pairs = np.ascontiguousarray(np.stack([a, b], axis=1), dtype=np.float64)
    kinds = np.empty(len(pairs), np.uint8)
    _triangle_pairs(address(pairs), len(pairs), address(kinds))
    return kinds


def number(low, high):
    """Doubles with any mantissa and an exponent from low to high, or 0; often neighbours of others."""
    mantissas = st.one_of(
        st.integers(-8, 8), st.integers(-(2**53) + 1, 2**53 - 1), st.sampled_from([2**52 + 1, 2**53 - 1, -(2**52) - 1])
    )

    def build(mantissa, exponent):
        return math.ldexp(mantissa, exponent - max(mantissa.bit_length(), 1))

    return st.builds(build, mantissas, st.integers(low, high))


# All of 1e-60 <= |x| <= 1e38, and ranges in which the exponents often agree.
numbers = st.one_of(number(-198, 126), number(-2, 4), number(100, 126), number(-198, -190))


@settings(max_examples=400, deadline=None)
@given(st.lists(st.tuples(numbers, numbers), min_size=3, max_size=3))
def test_orient2d_is_exact(points):
    assert orient([points])[0] == determinant_sign(points)


@settings(max_examples=400, deadline=None)
@given(st.lists(st.tuples(numbers, numbers, numbers), min_size=4, max_size=4))
def test_orient3d_is_exact(points):
    assert orient([points])[0] == determinant_sign(points)


@settings(max_examples=300, deadline=None)
@given(
    st.lists(st.tuples(numbers, numbers, numbers), min_size=3, max_size=3),
    st.tuples(st.integers(-4, 4), st.integers(-4, 4)),
    st.tuples(*[st.integers(-2, 2)] * 3),
)
def test_orient3d_is_exact_next_to_the_plane(points, weights, steps):
    a, b, c = np.array(points)
    d = a + weights[0] / 4 * (b - a) + weights[1] / 4 * (c - a)
    for k, step in enumerate(steps):
        for _ in range(abs(step)):
            d[k] = np.nextafter(d[k], math.copysign(math.inf, step))
    d[(np.abs(d) < 1e-60) | (np.abs(d) > 1e38)] = 0
    simplex = [a, b, c, d]
    expected = determinant_sign(simplex)
    assert orient([simplex])[0] == expected
    assert orient([[b, a, c, d]])[0] == -expected
    assert orient([[d, b, c, a]])[0] == -expected


def test_orient2d_is_exact_next_to_the_line():
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(2, 2000, 2)) * 10.0 ** rng.integers(-3, 3, (2, 2000, 1))
    c = a + rng.uniform(-2, 2, (2000, 1)) * (b - a)
    points = np.stack([a, b, c], axis=1)
    expected = np.array([determinant_sign(p) for p in points])
    assert set(expected) == {-1, 1} or set(expected) == {-1, 0, 1}
    assert np.array_equal(orient(points), expected)


def test_one_ulp_decides():
    up, down = np.nextafter(0.5, 1), np.nextafter(0.5, 0)
    assert orient([[(0, 0), (1, 1), (0.5, y)] for y in (up, 0.5, down)]).tolist() == [1, 0, -1]
    plane = [(12, 12, 12), (24, 24, 25), (25, 24, 24)]
    x = (12 + 24 + 25) / 3
    for z in (20.0, np.nextafter(20.0, 21), np.nextafter(20.0, 19)):
        points = [*plane, (x, 20.0, z)]
        assert orient([points])[0] == determinant_sign(points)


def test_orientation_convention():
    assert orient([[(0, 0), (1, 0), (0, 1)]])[0] == 1
    assert orient([[(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]])[0] == 1


def lattice_pairs(rng, count, size):
    return rng.integers(0, size + 1, (2, count, 3, 3))


def flat_pairs(rng, count, size):
    """Pairs in one plane through lattice points."""
    a = rng.integers(-2, 3, (count, 2, 3))
    weights = rng.integers(-size, size + 1, (2, count, 3, 2))
    pairs = np.einsum("sncw,nwd->sncd", weights, a)
    return pairs[:, (np.abs(pairs) <= 8).all(axis=(0, 2, 3))]


def compare_with_reference(pairs):
    a, b = pairs
    found, expected = kinds_of(a, b), pair_kinds(a, b)
    wrong = np.nonzero(found != expected)[0]
    assert len(wrong) == 0, f"{len(wrong)} wrong, such as {a[wrong[0]].tolist()} {b[wrong[0]].tolist()}"
    return expected


@pytest.mark.parametrize("size", [1, 2, 3, 5, 8])
def test_lattice_triangles(size):
    kinds = compare_with_reference(lattice_pairs(np.random.default_rng(size), 4000, size))
    assert len(np.unique(kinds)) >= 3  # every kind but the coplanar one, which is rare for larger sizes


def test_flat_lattice_triangles():
    kinds = compare_with_reference(flat_pairs(np.random.default_rng(7), 12000, 2))
    assert np.bincount(kinds, minlength=4)[:3].min() > 50


def test_lattice_triangles_far_from_the_origin_and_scaled():
    a, b = lattice_pairs(np.random.default_rng(3), 5000, 3)
    expected = pair_kinds(a, b)
    for scale, shift in ((2.0**-20, 1024.0), (2.0**90, 0.0), (2.0**-150, 0.0), (2.0**-30, 2.0**20)):
        assert np.array_equal(kinds_of(a * scale + shift, b * scale + shift), expected)


def test_order_of_corners_and_triangles_is_irrelevant():
    a, b = lattice_pairs(np.random.default_rng(4), 3000, 2)
    expected = kinds_of(a, b)
    assert np.array_equal(kinds_of(b, a), expected)
    for order in ((1, 2, 0), (2, 1, 0), (0, 2, 1)):
        assert np.array_equal(kinds_of(a[:, order], b), expected)
        assert np.array_equal(kinds_of(a, b[:, order]), expected)


def test_the_lattices_hold_degenerate_triangles():
    a, b = lattice_pairs(np.random.default_rng(1), 4000, 1)
    flat = degenerate(a) | degenerate(b)
    assert flat.any()
    assert not kinds_of(a, b)[flat].any()


@pytest.mark.slow
def test_a_million_lattice_triangles():
    rng = np.random.default_rng(11)
    for size in (1, 2, 3, 4, 6, 8):
        for _ in range(9):
            compare_with_reference(lattice_pairs(rng, 20000, size))
    for _ in range(8):
        compare_with_reference(flat_pairs(rng, 20000, 2))
