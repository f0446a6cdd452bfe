"""Topology and quality against slow references, closed forms, and hostile sizes."""

from __future__ import annotations

import itertools
import time
from collections import Counter, defaultdict
from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from vhp_cli.kernels.surface import Topology, dihedral_angles, quality, topology

CUBE = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], dtype=float)
CUBE_FACES = np.array(
    [[0, 2, 3], [0, 3, 1], [4, 5, 7], [4, 7, 6], [0, 1, 5], [0, 5, 4],
     [2, 6, 7], [2, 7, 3], [0, 4, 6], [0, 6, 2], [1, 3, 7], [1, 7, 5]], dtype=np.int32
)  # fmt: skip


# ---------------------------------------------------------------- references


def pieces(items, links):
    """Connected pieces of a graph, by depth-first search."""
    neighbours = defaultdict(set)
    for a, b in links:
        neighbours[a].add(b)
        neighbours[b].add(a)
    found, seen = [], set()
    for start in items:
        if start in seen:
            continue
        piece, stack = set(), [start]
        while stack:
            item = stack.pop()
            if item not in piece:
                piece.add(item)
                stack.extend(neighbours[item] - piece)
        seen |= piece
        found.append(piece)
    return found


def reference_topology(faces):
    """Everything that `topology` counts, from the definitions, with dictionaries and sets."""
    kept = {f: tuple(face) for f, face in enumerate(faces.tolist()) if len(set(face)) == 3}
    edges = defaultdict(list)
    for f, (a, b, c) in kept.items():
        for start, end in ((a, b), (b, c), (c, a)):
            edges[frozenset((start, end))].append((f, start))
    at_vertex = defaultdict(set)
    for f, face in kept.items():
        for vertex in face:
            at_vertex[vertex].add(f)
    face_links = [pair for uses in edges.values() for pair in itertools.pairwise(f for f, _ in uses)]
    crowded = {v for edge, uses in edges.items() if len(uses) > 2 for v in edge}
    pinched = set(crowded)
    for vertex, around in at_vertex.items():
        links = [
            pair for edge, uses in edges.items() if vertex in edge for pair in itertools.pairwise(f for f, _ in uses)
        ]
        if len(pieces(around, links)) > 1:
            pinched.add(vertex)
    boundary = [tuple(sorted(edge)) for edge, uses in edges.items() if len(uses) == 1]
    seen: set[frozenset[int]] = set()
    duplicates = []
    for f, face in kept.items():
        if frozenset(face) in seen:
            duplicates.append(f)
        seen.add(frozenset(face))
    return {
        "n_edges": len(edges),
        "components": sorted(sorted(piece) for piece in pieces(kept, face_links)),
        "n_boundary_loops": len(pieces({v for edge in boundary for v in edge}, boundary)),
        "n_referenced": len(at_vertex),
        "euler": len(at_vertex) - len(edges) + len(kept),
        "boundary": sorted(boundary),
        "nonmanifold": sorted(tuple(sorted(edge)) for edge, uses in edges.items() if len(uses) > 2),
        "inconsistent": sorted(
            tuple(sorted(edge)) for edge, uses in edges.items() if len(uses) == 2 and uses[0][1] == uses[1][1]
        ),
        "inner": sorted(
            (tuple(sorted(edge)), tuple(sorted(f for f, _ in uses))) for edge, uses in edges.items() if len(uses) == 2
        ),
        "pinched": sorted(pinched),
        "duplicates": duplicates,
        "collapsed": [f for f in range(len(faces)) if f not in kept],
        "at_edge": {tuple(sorted(edge)): {f for f, _ in uses} for edge, uses in edges.items()},
        "at_vertex": at_vertex,
    }


def pairs(array):
    return sorted(map(tuple, array.tolist()))


def check_against_reference(faces, n_vertices):
    vertices = np.random.default_rng(len(faces)).normal(size=(n_vertices, 3))
    found, expected = topology(vertices, faces), reference_topology(faces)
    for key in ("n_edges", "n_boundary_loops", "n_referenced", "euler"):
        assert getattr(found, key) == expected[key], key
    assert pairs(found.boundary_edges) == expected["boundary"]
    assert pairs(found.nonmanifold_edges) == expected["nonmanifold"]
    assert pairs(found.inconsistent_edges) == expected["inconsistent"]
    assert found.nonmanifold_vertices.tolist() == expected["pinched"]
    assert found.duplicate_faces.tolist() == expected["duplicates"]
    assert found.collapsed_faces.tolist() == expected["collapsed"]
    inner = zip(found.inner_edges.tolist(), np.sort(found.inner_edge_faces, axis=1).tolist(), strict=True)
    assert sorted((tuple(edge), tuple(two)) for edge, two in inner) == expected["inner"]
    # Labels: the same partition, numbered by the first faces.
    parts = defaultdict(list)
    for face, label in enumerate(found.component.tolist()):
        if label >= 0:
            parts[label].append(face)
    assert [parts[label] for label in range(found.n_components)] == expected["components"]
    assert (found.component[found.collapsed_faces] == -1).all()
    # The named faces have the edge or vertex they are named for.
    for edges, named in (
        (found.boundary_edges, found.boundary_faces),
        (found.nonmanifold_edges, found.nonmanifold_edge_faces),
        (found.inconsistent_edges, found.inconsistent_faces),
    ):
        for edge, face in zip(edges.tolist(), named.tolist(), strict=True):
            assert face in expected["at_edge"][tuple(edge)]
    for vertex, face in zip(found.nonmanifold_vertices, found.nonmanifold_vertex_faces, strict=True):
        assert face in expected["at_vertex"][vertex]
    # Edges of one loop are connected, edges of two are not.
    loops = defaultdict(set)
    for edge, loop in zip(found.boundary_edges.tolist(), found.boundary_loop.tolist(), strict=True):
        loops[loop].update(edge)
    assert sum(len(vertices) for vertices in loops.values()) == len(set().union(*loops.values()))
    assert sorted(loops) == list(range(found.n_boundary_loops))
    if found.n_edges:
        all_edges = np.array(list(expected["at_edge"]))
        lengths = np.sqrt(((vertices[all_edges[:, 0]] - vertices[all_edges[:, 1]]) ** 2).sum(axis=1))
        assert_allclose(
            [found.edge_length_min, found.edge_length_mean, found.edge_length_max],
            [lengths.min(), lengths.mean(), lengths.max()],
            rtol=1e-12,
        )
        shortest = found.shortest_edge
        assert np.linalg.norm(vertices[shortest[0]] - vertices[shortest[1]]) == pytest.approx(lengths.min(), rel=1e-12)
        assert found.shortest_edge_face in expected["at_edge"][tuple(sorted(shortest))]
    else:
        assert np.isnan(found.edge_length_min)
        assert found.shortest_edge == (-1, -1)


# ---------------------------------------------------------------- topology


@given(
    st.integers(3, 9).flatmap(
        lambda n: st.tuples(
            st.lists(st.tuples(*[st.integers(0, n - 1)] * 3), max_size=24).map(
                lambda rows: np.array(rows, dtype=np.int32).reshape(-1, 3)
            ),
            st.just(n + 1),
        )
    )
)
@settings(max_examples=250, deadline=None)
def test_random_soup(case):
    check_against_reference(*case)


@given(st.integers(0, 2**32 - 1), st.integers(0, 6), st.integers(0, 4))
@settings(max_examples=60, deadline=None)
def test_damaged_grid(seed, n_removed, n_flipped):
    """Mostly regular surfaces: holes, flipped faces and an extra face here and there."""
    random = np.random.default_rng(seed)
    side = 5
    corner = np.arange(side * side).reshape(side, side)
    a, b, c, d = corner[:-1, :-1].ravel(), corner[:-1, 1:].ravel(), corner[1:, 1:].ravel(), corner[1:, :-1].ravel()
    faces = np.vstack([np.c_[a, b, c], np.c_[a, c, d]]).astype(np.int32)
    faces = np.delete(faces, random.choice(len(faces), n_removed, replace=False), axis=0)
    flipped = random.choice(len(faces), n_flipped, replace=False)
    faces[flipped] = faces[flipped][:, ::-1]
    faces = np.vstack([faces, random.integers(0, side * side, (2, 3))]).astype(np.int32)
    check_against_reference(random.permutation(faces), side * side)


@pytest.mark.parametrize(
    ("faces", "expected"),
    [
        pytest.param(CUBE_FACES, {"euler": 2, "n_components": 1, "n_edges": 18}, id="cube"),
        pytest.param(CUBE_FACES[2:], {"boundary_edges": 4, "n_boundary_loops": 1, "euler": 1}, id="open"),
        pytest.param([*CUBE_FACES, CUBE_FACES[0]], {"duplicate_faces": 1, "nonmanifold_edges": 3}, id="twice"),
        pytest.param([[0, 1, 2], [0, 2, 1]], {"duplicate_faces": 1, "euler": 2, "boundary_edges": 0}, id="pillow"),
        pytest.param([[0, 1, 2], [1, 2, 0]], {"duplicate_faces": 1, "inconsistent_edges": 3}, id="doubled"),
        pytest.param([[0, 1, 2], [1, 0, 3]], {"nonmanifold_vertices": 0, "n_components": 1}, id="two faces"),
        pytest.param([[0, 1, 2], [0, 3, 4]], {"nonmanifold_vertices": 1, "n_components": 2}, id="bow-tie"),
        pytest.param([[0, 0, 1]], {"collapsed_faces": 1, "n_components": 0, "n_referenced": 0}, id="collapsed"),
        pytest.param(np.empty((0, 3)), {"n_edges": 0, "euler": 0, "n_components": 0}, id="nothing"),
    ],
)
def test_known_shapes(faces, expected):
    found = topology(CUBE, np.array(faces, dtype=np.int32))
    for name, value in expected.items():
        field = getattr(found, name)
        assert (len(field) if isinstance(field, np.ndarray) else field) == value, name


def test_torus_and_moebius_band():
    n = 12
    corner = np.arange(n * n).reshape(n, n)
    right, up = np.roll(corner, -1, axis=1), np.roll(corner, -1, axis=0)
    both = np.roll(right, -1, axis=0)
    lower, upper = np.stack([corner, right, both], axis=-1), np.stack([corner, both, up], axis=-1)
    faces = np.vstack([lower.reshape(-1, 3), upper.reshape(-1, 3)])
    found = topology(np.random.default_rng(0).normal(size=(n * n, 3)), faces)
    assert (found.euler, len(found.boundary_edges), len(found.nonmanifold_vertices)) == (0, 0, 0)
    band = np.array([[i, i + 1, i + 2] if i % 2 == 0 else [i + 1, i, i + 2] for i in range(7)]) % 7
    found = topology(CUBE, band)
    assert found.euler == 0
    assert found.n_boundary_loops == 1
    assert len(found.inconsistent_edges) == 1  # one-sided: it can't be oriented
    assert len(found.nonmanifold_vertices) == 0


def best_time(action, repeats=3):
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        action()
        times.append(time.process_time() - begin)
    return min(times)


def test_cost_stays_linear_at_crowded_places():
    """A vertex or an edge with 100,000 faces costs about as much as a regular mesh of that size."""
    n = 100_000
    ring = np.arange(n)
    vertex_fan = np.c_[np.full(n, n), ring, (ring + 1) % n]
    edge_fan = np.c_[np.full(n, n), np.full(n, n + 1), ring]
    copies = np.tile([[0, 1, 2]], (n, 1))
    soup = np.random.default_rng(0).integers(0, 200, (n, 3))
    vertices = np.random.default_rng(1).normal(size=(n + 2, 3))
    for faces in (vertex_fan, edge_fan, copies, soup):
        assert best_time(lambda faces=faces: topology(vertices, faces), 1) < 2.0
    found = topology(vertices, edge_fan)
    assert (len(found.nonmanifold_edges), found.n_components, len(found.boundary_edges)) == (1, 1, 2 * n)
    assert found.nonmanifold_vertices.tolist() == [n, n + 1]
    found = topology(vertices, vertex_fan)
    assert (len(found.nonmanifold_vertices), len(found.boundary_edges), found.euler) == (0, n, 1)
    assert len(topology(vertices, copies).duplicate_faces) == n - 1


def test_repeated_calls_agree_bit_for_bit():
    faces = np.random.default_rng(3).integers(0, 300, (900, 3))
    vertices = np.random.default_rng(4).normal(size=(300, 3))
    first, second = topology(vertices, faces), topology(vertices, faces)
    for field in fields(Topology):
        assert_array_equal(getattr(first, field.name), getattr(second, field.name))


@pytest.mark.parametrize("bad", [[[0, 1, 8]], [[-1, 0, 1]], [[0, 1]]])
def test_wrong_indices_are_refused(bad):
    with pytest.raises(ValueError, match=r"vertices"):
        topology(CUBE, np.array(bad))
    with pytest.raises(ValueError, match=r"vertices"):
        quality(CUBE, np.array(bad), np.zeros(1), 1)


# ---------------------------------------------------------------- quality


def measure(vertices, faces):
    joined = topology(vertices, faces)
    return quality(vertices, faces, joined.component, joined.n_components)


def reference_q(triangle):
    """Thesis eq. 2.4 in extended precision."""
    corners = triangle.astype(np.longdouble)
    a, b, c = (np.sqrt(((corners[i] - corners[i - 1]) ** 2).sum()) for i in range(3))
    return float((b + c - a) * (c + a - b) * (a + b - c) / (a * b * c))


def test_closed_forms():
    equilateral = np.array([[0, 0, 0], [1, 0, 0], [0.5, np.sqrt(3) / 2, 0]])
    found = measure(equilateral, np.array([[0, 1, 2]]))
    assert found.q[0] == pytest.approx(1, abs=1e-15)
    assert found.r_out_mean == pytest.approx(1 / np.sqrt(3), rel=1e-14)
    right = measure(np.array([[0, 0, 0], [1, 0, 0], [0, 1.0, 0]]), np.array([[0, 1, 2]]))
    assert right.q[0] == pytest.approx(2 * (np.sqrt(2) - 1), rel=1e-14)
    assert right.r_out_max == pytest.approx(np.sqrt(0.5), rel=1e-14)


def test_cube():
    found = measure(CUBE * 10 + [1, 2, 3], CUBE_FACES)
    assert found.volume == pytest.approx(1000, rel=1e-13)
    assert found.area == pytest.approx(600, rel=1e-13)
    assert_allclose(found.volume_centroid, [6, 7, 8], rtol=1e-13)
    assert_allclose(found.area_centroid, [6, 7, 8], rtol=1e-13)
    assert measure(CUBE, CUBE_FACES[:, ::-1]).volume == pytest.approx(-1, rel=1e-13)
    assert_allclose(measure(CUBE, CUBE_FACES[:, ::-1]).volume_centroid, [0.5] * 3, rtol=1e-13)


def test_centroids_of_volume_and_area_differ():
    tetrahedron = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    found = measure(tetrahedron, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]))
    assert found.volume == pytest.approx(1 / 6, rel=1e-14)
    assert_allclose(found.volume_centroid, [0.25] * 3, rtol=1e-14)
    slanted = np.sqrt(3) / 2  # three right-angled faces of area 1/2, and this one
    assert_allclose(found.area_centroid, [(2 / 2 / 3 + slanted / 3) / (1.5 + slanted)] * 3, rtol=1e-14)


def test_volume_far_from_the_origin():
    # The vertices are exact there, so the volume must be too.
    found = measure(CUBE + 2.0**30, CUBE_FACES)
    assert found.volume == pytest.approx(1, rel=1e-12)
    assert_allclose(found.volume_centroid, [2.0**30 + 0.5] * 3, rtol=1e-15)


def test_components_have_their_own_volume():
    vertices = np.vstack([CUBE, 1e-3 * CUBE + 1e4, 2 * CUBE - 50])
    faces = np.vstack([CUBE_FACES, CUBE_FACES[:, ::-1] + 8, CUBE_FACES + 16, [[0, 0, 1]]])
    found = measure(vertices, faces)
    small = (vertices[9, 0] - vertices[8, 0]) ** 3  # the rounded edge of the small cube
    assert_allclose(found.component_volume, [1, -small, 8], rtol=1e-6)
    assert found.component_volume[1] < 0
    assert_allclose(found.component_area, [6, 6e-6, 24], rtol=1e-6)
    assert found.component_area.sum() == pytest.approx(found.area, rel=1e-13)
    assert found.degenerate.tolist() == [36]


coordinate = st.floats(-100, 100, width=32)


@given(st.lists(st.tuples(coordinate, coordinate, coordinate), min_size=3, max_size=3))
@settings(max_examples=300, deadline=None)
def test_q_against_the_other_formula(corners):
    triangle = np.array(corners, dtype=float)
    found = measure(triangle, np.array([[0, 1, 2]]))
    edges = np.sqrt(((triangle - np.roll(triangle, 1, axis=0)) ** 2).sum(axis=1))
    if edges.min() > 1e-3 * edges.max() > 0:
        # a + b - c cancels near degenerate triangles, hence the absolute tolerance.
        assert found.q[0] == pytest.approx(reference_q(triangle), rel=1e-9, abs=1e-12)
    assert 0 <= found.q[0] <= 1


@pytest.mark.parametrize("power", [-330, -200, -190, 150, 190, 300])
def test_scale_changes_nothing(power):
    """Edges whose fourth power leaves the range of a double."""
    triangles = np.random.default_rng(0).normal(size=(30, 3))
    faces = np.arange(30).reshape(10, 3)
    plain, scaled = measure(triangles, faces), measure(np.ldexp(triangles, power), faces)
    assert_allclose(scaled.q, plain.q, rtol=1e-13)
    assert scaled.r_out_mean == pytest.approx(np.ldexp(plain.r_out_mean, power), rel=1e-13)
    assert len(scaled.degenerate) == 0


def test_degenerate_faces():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [3, 0, 0], [3, 1e-11, 0], [3, 1e-13, 0], [0, 0, 0]])
    faces = np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4], [0, 0, 1], [0, 5, 1], [0, 0, 0]])
    found = measure(vertices, faces)
    # Areas 0; 5e-12 against 9e-12; 5e-14; collapsed; two equal positions; a point.
    assert found.degenerate.tolist() == [0, 1, 2, 3, 4, 5]
    assert_allclose(found.q, 0, atol=1e-11)
    assert found.r_out_max == 1.5  # half the longest edge
    assert found.r_out_min == 0
    thin = measure(np.array([[0, 0, 0], [1, 0, 0], [3, 3e-11, 0]]), np.array([[0, 1, 2]]))
    assert len(thin.degenerate) == 0
    assert 0 < thin.q[0] < 1e-9


def test_values_that_are_not_finite_never_look_good():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, np.nan, 0], [0, np.inf, 0]])
    found = measure(vertices, np.array([[0, 1, 2], [0, 1, 3]]))
    assert found.degenerate.tolist() == [0, 1]
    assert_array_equal(found.q, 0)


def test_no_face():
    found = measure(np.empty((0, 3)), np.empty((0, 3), dtype=np.int32))
    assert (found.area, found.volume, len(found.q)) == (0, 0, 0)
    assert np.isnan([found.r_out_min, found.r_out_mean, found.r_out_max, *found.area_centroid]).all()


# ---------------------------------------------------------------- dihedral angles


@pytest.mark.parametrize("degrees", [0, 1e-6, 0.05, 1, 45, 90, 135, 179, 179.99, 180])
@pytest.mark.parametrize("flip", [False, True])
def test_known_angles(degrees, flip):
    radians = np.radians(degrees)
    vertices = np.array([[0, 0, 0], [2, 0, 0], [0.3, 1, 0], [0.9, 3 * np.cos(radians), 3 * np.sin(radians)]])
    turn = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
    faces = np.array([[0, 1, 2], [0, 1, 3] if flip else [1, 0, 3]])
    joined = topology(vertices, faces)
    for points in (vertices, vertices @ turn * 7 + 11):
        angle = dihedral_angles(points, faces, joined.inner_edges, joined.inner_edge_faces)
        assert angle == pytest.approx([degrees], abs=1e-6 if points is not vertices else 1e-12 + 1e-9 * degrees)


def test_angles_of_a_cube_and_of_a_face_without_area():
    joined = topology(CUBE, CUBE_FACES)
    angles = dihedral_angles(CUBE, CUBE_FACES, joined.inner_edges, joined.inner_edge_faces)
    assert Counter(np.round(angles, 9).tolist()) == {90.0: 12, 180.0: 6}
    vertices = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1.0, 0]])
    faces = np.array([[0, 1, 2], [1, 0, 3]])
    joined = topology(vertices, faces)
    assert np.isnan(dihedral_angles(vertices, faces, joined.inner_edges, joined.inner_edge_faces)).all()


def test_edges_and_faces_must_fit_together():
    joined = topology(CUBE, CUBE_FACES)
    with pytest.raises(ValueError, match="do not both have edge"):
        dihedral_angles(CUBE, CUBE_FACES, joined.inner_edges, joined.inner_edge_faces[::-1])
