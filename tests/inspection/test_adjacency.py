"""How tetrahedra are joined."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from tetrahedron_grids import grid

from vhp_cli.inspection.adjacency import OUTSIDE, adjacency, connected_parts, interfaces
from vhp_cli.kernels import surface

PAIR = np.array([[0, 1, 2, 3], [0, 2, 1, 4]], np.int32)


def enclosed(points, faces):
    a, b, c = (points[faces[:, corner]] for corner in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def test_two_tetrahedra_share_a_face():
    found = adjacency(PAIR)
    assert found.pairs.tolist() == [[0, 1]]
    assert sorted(found.inner[0]) == [0, 1, 2]
    assert len(found.hull) == 6 and sorted(found.owners) == [0, 0, 0, 1, 1, 1]
    assert found.overfull == 0 and not len(found.folded)


def test_a_face_of_three_and_a_folded_one_are_noticed():
    assert adjacency(np.array([[0, 1, 2, 3], [0, 2, 1, 4], [0, 1, 2, 5]], np.int32)).overfull == 1
    # Both on the same side of their common face.
    folded = adjacency(np.array([[0, 1, 2, 3], [0, 1, 2, 4]], np.int32))
    assert folded.folded.tolist() == [0]


def test_hull_of_a_cube_is_its_surface():
    points, tetrahedra = grid(3)
    found = adjacency(tetrahedra)
    assert len(found.hull) == 6 * 9 * 2
    assert 2 * len(found.pairs) + len(found.hull) == 4 * len(tetrahedra)
    topology = surface.topology(points, found.hull)
    assert not len(topology.boundary_edges) and not len(topology.inconsistent_edges)
    assert enclosed(points, found.hull) == pytest.approx(1000)


def test_boundaries_of_labels_add_up():
    points, tetrahedra = grid(4)
    centroids = points[tetrahedra].mean(axis=1)
    labels = np.where(centroids[:, 0] < 5, 1, np.where(centroids[:, 1] < 5, 2, 3)).astype(np.int32)
    between = interfaces(adjacency(tetrahedra), labels)
    assert [enclosed(points, between.boundary(label)) for label in (1, 2, 3)] == pytest.approx([500, 250, 250])
    assert enclosed(points, between.boundary(2, 3)) == pytest.approx(500)
    assert enclosed(points, between.boundary(1, 2, 3)) == pytest.approx(1000)
    # The common wall of two and three is no boundary of both together.
    walls = ((between.sides == 2).any(axis=1) & (between.sides == 3).any(axis=1)).sum()
    assert walls > 0
    count = len(between.boundary(2)) + len(between.boundary(3)) - len(between.boundary(2, 3))
    assert count == 2 * walls
    assert (between.sides[:, 0] != OUTSIDE).all()


@given(st.integers(1, 30), st.lists(st.tuples(st.integers(0, 29), st.integers(0, 29)), max_size=40))
def test_connected_parts_are_those_of_scipy(count, pairs):
    joined = np.array([pair for pair in pairs if max(pair) < count], np.int32).reshape(-1, 2)
    graph = coo_matrix((np.ones(len(joined)), joined.T), shape=(count, count))
    number, expected = connected_components(graph, directed=False)
    found = connected_parts(count, joined)
    assert found.max() + 1 == number
    assert len({(int(a), int(b)) for a, b in zip(found, expected, strict=True)}) == number
    # Numbered by their first members.
    _, first = np.unique(found, return_index=True)
    assert (np.diff(first) > 0).all()
