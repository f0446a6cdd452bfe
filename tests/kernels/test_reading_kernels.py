"""Welding and number parsing against numpy, Python's own parser and exact arithmetic."""

from __future__ import annotations

import locale
import struct
import time
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from vhp_cli.kernels.reading import parse_numbers, weld, weld_facets, weld_stl_records

# ---------------------------------------------------------------- weld


def reference_weld(points):
    """Vertices in order of first appearance, by a dictionary (in which -0.0 equals 0.0)."""
    number: dict[tuple[float, ...], int] = {}
    index = [number.setdefault(tuple(point), len(number)) for point in points.tolist()]
    return np.array(list(number), dtype=float).reshape(-1, 3), np.array(index, dtype=np.int32)


@given(st.lists(st.tuples(*[st.sampled_from([0.0, -0.0, 1.0, -1.0, 0.1, 1e-38, 1e30])] * 3), max_size=60))
@settings(max_examples=200, deadline=None)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_exact_weld(dtype, points):
    points = np.array(points, dtype=dtype).reshape(-1, 3)
    vertices, index = weld(points)
    expected_vertices, expected_index = reference_weld(points.astype(float))
    assert_array_equal(vertices, expected_vertices)
    assert_array_equal(index, expected_index)
    assert not np.signbit(vertices[vertices == 0]).any()


def test_exact_weld_of_many_points():
    """More vertices than the table starts with: it has to grow."""
    points = np.random.default_rng(0).integers(0, 60, (100_000, 3)).astype(float)
    vertices, index = weld(points)
    expected_vertices, expected_index = reference_weld(points)
    assert_array_equal(vertices, expected_vertices)
    assert_array_equal(index, expected_index)
    distinct = np.random.default_rng(1).normal(size=(50_000, 3))
    assert_array_equal(weld(distinct)[0], distinct)


def test_neighbours_one_unit_in_the_last_place_apart_stay_apart():
    x = np.float32(12.345)
    points = np.array([[x, 0, 0], [np.nextafter(x, np.float32(99)), 0, 0]], dtype=np.float32)
    assert len(weld(points)[0]) == 2


def reference_links(points, tolerance):
    """Smallest member of each single-linkage set, by comparing all pairs."""
    distance = ((points[:, None] - points[None]) ** 2).sum(axis=2)
    near = distance <= tolerance * tolerance
    root = np.arange(len(points))
    while True:
        better = np.array([root[row].min() for row in near])
        if (better == root).all():
            return root
        root = better


@given(st.integers(0, 2**32 - 1), st.integers(0, 60), st.sampled_from([0.01, 0.05, 0.2, 1.0, 50.0]))
@settings(max_examples=150, deadline=None)
def test_weld_with_tolerance(seed, n, tolerance):
    points = np.random.default_rng(seed).normal(size=(n, 3)).round(2) + 100
    vertices, index = weld(points, tolerance)
    root = reference_links(points, tolerance) if n else np.empty(0, dtype=int)
    assert_array_equal(vertices, points[np.unique(root)])
    assert_array_equal(vertices[index], points[root])


def test_weld_with_tolerance_is_linear_in_dense_clouds():
    points = np.random.default_rng(0).normal(size=(40_000, 3))
    begin = time.process_time()
    vertices, index = weld(points, 3.0)  # hundreds of neighbours each
    assert time.process_time() - begin < 3
    assert len(vertices) < 10
    assert index.max() == len(vertices) - 1


def test_weld_with_a_tolerance_below_the_resolution_is_exact():
    points = np.array([[1e20, 0, 0], [np.nextafter(1e20, 2e20), 0, 0], [1e20, 0, 0]])
    vertices, index = weld(points, 1e-9)
    assert len(vertices) == 2
    assert index.tolist() == [0, 1, 0]


def record(corners, attribute=0):
    return struct.pack("<12fH", 0, 0, 0, *np.ravel(corners).tolist(), attribute)


def test_stl_records():
    good = [[0, 0, 0], [1, 0, 0], [-0.0, 1, 0]]
    records = [
        record(good),
        record([[0, 0, 0], [np.nan, 0, 0], [5, 5, 5]]),
        record([[1, 0, 0], [0, 1, 0], [0, 0, np.inf]]),
        record([[1, 0, 0], [0, 0, 0], [0, 0, 2e30]], attribute=7),
        record([[1, 0, 0], [0, 0, 0], [0, 0, 1e30]], attribute=256),
    ]
    for data in (b"".join(records), np.frombuffer(b"".join(records), dtype=np.uint8)):
        vertices, faces, unusable, n_attributes = weld_stl_records(data, 5)
        assert_array_equal(vertices, [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, np.float64(np.float32(1e30))]])
        assert faces.tolist() == [[0, 1, 2], [1, 0, 3]]
        assert unusable.tolist() == [1, 2, 3]
        assert n_attributes == 2
    corners = np.frombuffer(b"".join(records), dtype=np.uint8).reshape(5, 50)[:, 12:48].copy().view("<f4")
    again = weld_facets(corners.reshape(5, 3, 3))
    for mine, other in zip(again, weld_stl_records(b"".join(records), 5)[:3], strict=True):
        assert_array_equal(mine, other)
    with pytest.raises(ValueError, match="bytes"):
        weld_stl_records(b"".join(records)[:-1], 5)


def test_no_points():
    assert [array.shape for array in weld(np.empty((0, 3)))] == [(0, 3), (0,)]
    assert [array.shape for array in weld(np.empty((0, 3)), 1.0)] == [(0, 3), (0,)]
    assert [array.shape for array in weld_stl_records(b"", 0)[:3]] == [(0, 3), (0, 3), (0,)]


# ---------------------------------------------------------------- numbers


def parse_one(text, dtype=np.float64):
    values, stop = parse_numbers(text.encode(), dtype)
    assert stop == len(text), text
    assert len(values) == 1, text
    return values[0]


FLOAT32_MAX = float(np.finfo(np.float32).max)
FLOAT32_LIMIT = Fraction(2**128 - 2**103)  # half a step beyond the largest float32: rounds to infinity


def nearest_float32(text):
    """Round the decimal number itself, not a double, to the nearest float32; ties to even."""
    exact = Fraction(text)
    if abs(exact) >= FLOAT32_LIMIT:
        return np.float32(np.inf if exact > 0 else -np.inf)
    guess = np.float32(np.clip(float(exact), -FLOAT32_MAX, FLOAT32_MAX))
    candidates = [guess, np.nextafter(guess, np.float32(FLOAT32_MAX)), np.nextafter(guess, np.float32(-FLOAT32_MAX))]
    return min(candidates, key=lambda value: (abs(Fraction(float(value)) - exact), value.view(np.uint32) & 1))


decimal_text = st.one_of(
    st.floats(allow_nan=False, allow_infinity=False).map(repr),
    st.floats(-1e6, 1e6, width=32).map(repr),
    st.builds(
        lambda sign, whole, point, fraction, exponent: f"{sign}{whole}{'.' * point}{fraction * point}{exponent}",
        st.sampled_from(["", "-", "+"]),
        st.integers(0, 10**25).map(str) | st.sampled_from(["0", "000123", "4" * 60]),
        st.booleans(),
        st.text("0123456789", max_size=30),
        st.sampled_from(["", "e0", "E5", "e-7", "e+22", "e-23", "e-300", "e12"]),
    ),
)


@given(decimal_text)
@example("9007199254740993")  # 2^53 + 1: a tie between two doubles
@example("9007199254740993." + "0" * 900 + "1")  # decided by a digit far behind
@example("2.2250738585072011e-308")
@example("4.9e-324")
@example("1e-400")
@example("0e99999999999")
@settings(max_examples=800, deadline=None)
def test_doubles_are_correctly_rounded(text):
    assert struct.pack("d", parse_one(text)) == struct.pack("d", float(text))


# 1.000000059604644775390625 lies exactly between two float32: rounding to a double first would round twice.
@given(decimal_text)
@example("1.000000059604644775390625")
@example("1.00000005960464477539062500000000000000001")
@example("1.00000005960464477539062499999999999999999")
@example("1.401298464324817e-45")
@example("1.1754943e-38")
@example("3.4028235677973366e38")
@example("3.4028235677973365e38")
@settings(max_examples=800, deadline=None)
def test_floats_are_correctly_rounded(text):
    assert parse_one(text, np.float32) == nearest_float32(text)


def test_a_tie_between_floats_goes_to_even():
    assert parse_one("1.000000059604644775390625", np.float32) == np.float32(1)
    above = parse_one("1.00000005960464477539062500000000000000001", np.float32)
    assert above == np.nextafter(np.float32(1), np.float32(2))
    assert Fraction("1.000000059604644775390625") == Fraction(2**24 + 1, 2**24)


@pytest.mark.parametrize("text", ["nan", "NaN", "-nan", "nan(ind)", "-1.#IND", "1.#QNAN"])
def test_words_for_not_a_number(text):
    assert np.isnan(parse_one(text))
    assert np.isnan(parse_one(text, np.float32))


@pytest.mark.parametrize("text", ["inf", "Infinity", "+INF", "-inf", "1.#INF", "1e999", "-1e40"])
def test_words_for_infinity(text):
    assert np.isinf(parse_one(text, np.float32))
    assert np.signbit(parse_one(text)) == text.startswith("-")


@pytest.mark.parametrize(
    "text", ["", "-", ".", "e5", "1e", "1e+", "0x10", "1,5", "1.2.3", "--1", "1_0", "abc", "n", "na", "1\0"]
)
def test_what_is_no_number(text):
    values, stop = parse_numbers(f"2 {text}".encode(), np.float64)
    assert values.tolist() == [2]
    assert stop == 2


def test_fortran_exponents_and_separators():
    values, stop = parse_numbers(b"\t1D2\r\n-3d-1 \x0b\x0c .5 6.\n", np.float64)
    assert values.tolist() == [100, -0.3, 0.5, 6]
    assert stop == len(b"\t1D2\r\n-3d-1 \x0b\x0c .5 6.\n")


def test_the_locale_plays_no_part():
    old = locale.setlocale(locale.LC_NUMERIC)
    for name in ("de_DE.UTF-8", "de_DE", "fr_FR.UTF-8"):
        try:
            locale.setlocale(locale.LC_NUMERIC, name)
            break
        except locale.Error:
            continue
    else:
        pytest.skip("no locale with a decimal comma is installed")
    try:
        assert parse_one("3.14159265358979323846264") == 3.141592653589793
    finally:
        locale.setlocale(locale.LC_NUMERIC, old)
