"""Shape of tetrahedra, against closed forms and a slow computation by other formulas."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from vhp_cli.inspection.tetrahedra import tetrahedron_quality

REGULAR = np.array([[1, 1, 1], [-1, 1, -1], [1, -1, -1], [-1, -1, 1]], float)
CORNER = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)


def one(points, order=(0, 1, 2, 3)):
    quality = tetrahedron_quality(np.asarray(points, float), np.array([order], np.int32))
    return {name: float(getattr(quality, name)[0]) for name in quality.__slots__}


def by_hand(points):
    """The same measures by linear algebra: spheres from equations, angles from heights."""
    a, b, c, d = points
    volume = np.linalg.det([b - a, c - a, d - a]) / 6
    # |x - p|^2 is the same for all corners.
    centre = np.linalg.solve(2 * (points[1:] - a), (points[1:] ** 2).sum(axis=1) - a @ a)
    r_out = np.linalg.norm(centre - a)
    triples = list(itertools.combinations(range(4), 3))
    area = [np.linalg.norm(np.cross(points[j] - points[i], points[k] - points[i])) / 2 for i, j, k in triples]
    r_in = 3 * abs(volume) / sum(area)
    angles = []
    for i, j in itertools.combinations(range(4), 2):
        k, m = (n for n in range(4) if n not in (i, j))
        axis = (points[j] - points[i]) / np.linalg.norm(points[j] - points[i])
        across = [(points[n] - points[i]) - ((points[n] - points[i]) @ axis) * axis for n in (k, m)]
        cosine = across[0] @ across[1] / np.linalg.norm(across[0]) / np.linalg.norm(across[1])
        angles.append(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
    length = {pair: np.linalg.norm(points[pair[0]] - points[pair[1]]) for pair in itertools.permutations(range(4), 2)}
    at_corner = [np.prod([length[i, j] for j in range(4) if j != i]) for i in range(4)]
    return {
        "volume": volume,
        "radius_ratio": 3 * r_in / r_out,
        "min_dihedral_deg": min(angles),
        "max_dihedral_deg": max(angles),
        "scaled_jacobian": np.sqrt(2) * 6 * volume / max(at_corner),
        "mean_edge_mm": np.mean(list(length.values())),
    }


def test_regular_tetrahedron():
    found = one(REGULAR)
    assert found["volume"] == pytest.approx(8 / 3)
    assert found["radius_ratio"] == pytest.approx(1)
    assert found["min_dihedral_deg"] == pytest.approx(np.degrees(np.arccos(1 / 3)))
    assert found["max_dihedral_deg"] == pytest.approx(np.degrees(np.arccos(1 / 3)))
    assert found["scaled_jacobian"] == pytest.approx(1)
    assert found["mean_edge_mm"] == pytest.approx(np.sqrt(8))


def test_corner_of_a_cube():
    found = one(CORNER)
    assert found["volume"] == pytest.approx(1 / 6)
    assert found["min_dihedral_deg"] == pytest.approx(np.degrees(np.arccos(1 / np.sqrt(3))))
    assert found["max_dihedral_deg"] == pytest.approx(90)
    # r_in = 1 / (3 + sqrt 3), r_out = sqrt(3) / 2.
    assert found["radius_ratio"] == pytest.approx(6 / (np.sqrt(3) * (3 + np.sqrt(3))))


def test_inverted_and_flat():
    inverted = one(CORNER, (1, 0, 2, 3))
    assert inverted["volume"] == pytest.approx(-1 / 6)
    assert inverted["scaled_jacobian"] == pytest.approx(-one(CORNER)["scaled_jacobian"])
    assert inverted["min_dihedral_deg"] == pytest.approx(one(CORNER)["min_dihedral_deg"])
    flat = one([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    assert flat["volume"] == flat["radius_ratio"] == flat["scaled_jacobian"] == 0
    assert flat["min_dihedral_deg"] == pytest.approx(0, abs=1e-6)
    assert one([[0, 0, 0]] * 4)["radius_ratio"] == 0


def test_none_at_all():
    assert len(tetrahedron_quality(REGULAR, np.empty((0, 4), np.int32)).volume) == 0


@settings(max_examples=100, deadline=None)
@given(arrays(np.float64, (4, 3), elements=st.floats(-10, 10, width=32)), st.permutations(range(4)))
def test_other_formulas_agree(points, order):
    assume(abs(np.linalg.det(points[1:] - points[0])) > 1e-2)
    expected = by_hand(points[list(order)])
    found = one(points, order)
    for name, value in expected.items():
        assert found[name] == pytest.approx(value, rel=1e-6, abs=1e-6), name


def test_many_are_measured_as_each_by_itself():
    rng = np.random.default_rng(0)
    points = rng.normal(size=(40, 3))
    tetrahedra = np.array([rng.choice(40, 4, replace=False) for _ in range(50)], np.int32)
    found = tetrahedron_quality(points, tetrahedra)
    for number, row in enumerate(tetrahedra):
        assert found.radius_ratio[number] == one(points, row)["radius_ratio"]
