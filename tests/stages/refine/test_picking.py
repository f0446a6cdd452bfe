"""Which triangles are picked: exactly so many, ties by number, and the largest."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from shapes import sphere

from vhp_cli.mesh import Mesh
from vhp_cli.stages.refine.picking import sizes, with_neighbours, worst


@pytest.mark.parametrize(
    ("count", "percent", "expected"),
    [(20, 15, 3), (10, 15, 2), (1280, 15, 192), (100, 0.1, 1), (7, 100, 7), (3, 50, 2), (9, 50, 5), (1, 1, 1)],
)
def test_so_many(count, percent, expected):
    values = np.random.default_rng(0).permutation(count).astype(float)
    picked = worst(values, percent)
    assert picked.sum() == expected
    assert sorted(values[picked]) == list(range(count - expected, count))


def test_of_equal_ones_the_first():
    assert np.flatnonzero(worst(np.ones(10), 30)).tolist() == [0, 1, 2]
    assert np.flatnonzero(worst(np.array([0, 5, 7, 5, 5, 0, 7, 0, 0, 0.0]), 40)).tolist() == [1, 2, 3, 6]


@given(st.lists(st.integers(0, 5), min_size=1, max_size=60), st.integers(1, 100))
def test_none_left_out_is_worse(values, percent):
    values = np.array(values, dtype=float)
    picked = worst(values, percent)
    assert picked.sum() == max(1, int(len(values) * percent / 100 + 0.5))
    if not picked.all():
        least = values[picked].min()
        assert values[~picked].max() <= least
        tied = values == least
        # Those of the lowest numbers.
        assert (np.diff(picked[tied].astype(int)) <= 0).all()


def test_sizes():
    points = [(0, 0, 0), (3, 0, 0), (0, 4, 0), (3 / 2, 27**0.5 / 2, 0), (1.5, 0.001, 0), (6, 0, 0)]
    faces = [(0, 1, 2), (0, 1, 3), (0, 1, 4), (0, 1, 5)]
    right, equilateral, cap, flat = sizes(Mesh(np.array(points), np.array(faces)))
    assert right == pytest.approx(2.5)
    # r_out = a / sqrt(3)
    assert equilateral == pytest.approx(3**0.5)
    assert cap == pytest.approx(1.5)
    assert flat == pytest.approx(3)


def test_sizes_are_the_circumradius_of_acute_triangles():
    mesh = sphere(10, subdivisions=3)
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    sides = [np.linalg.norm(p - q, axis=1) for p, q in ((a, b), (b, c), (c, a))]
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    assert np.allclose(sizes(mesh), sides[0] * sides[1] * sides[2] / (4 * area), rtol=1e-12)


def test_neighbours_have_a_vertex_in_common():
    mesh = sphere(subdivisions=2)
    picked = np.zeros(len(mesh.faces), dtype=bool)
    picked[11] = True
    mine = set(mesh.faces[11].tolist())
    assert with_neighbours(mesh, picked).tolist() == [bool(mine & set(face)) for face in mesh.faces.tolist()]
