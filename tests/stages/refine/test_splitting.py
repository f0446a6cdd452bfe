"""Splitting at midpoints, against examples by hand, a plain reference, and what has to stay as it is."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapes import box, joined, sphere
from smoothing_shapes import tube, volume

from vhp_cli.kernels import surface
from vhp_cli.mesh import Mesh
from vhp_cli.stages.refine.splitting import all_sides, cut_edges, shared_sides, sides_of

# Two triangles in question (0 and 1) that have a diagonal in common, and four around them:
#
#        6
#       / \
#      3---2
#     /| 1/|\
#    7 | / | 5
#     \|/ 0|/
#      0---1
#       \ /
#        4
CORNERS = [(0, 0), (2, 0), (2, 2), (0, 2), (1, -2), (4, 1), (1, 4), (-2, 1)]
PATCH = Mesh(
    np.column_stack([np.array(CORNERS, dtype=float), np.zeros(8)]),
    np.array([(0, 1, 2), (0, 2, 3), (1, 0, 4), (2, 1, 5), (3, 2, 6), (0, 3, 7)]),
)


def triangles(mesh):
    """The faces as sets of corners, each from its least one on."""
    found = set()
    for corners in mesh.vertices[mesh.faces][:, :, :2].tolist():
        first = corners.index(min(corners))
        found.add(tuple(tuple(corner) for corner in corners[first:] + corners[:first]))
    assert len(found) == len(mesh.faces)
    return found


def expected(*faces):
    return triangles(
        Mesh(np.array([(x, y, 0.0) for face in faces for x, y in face]), np.arange(3 * len(faces)).reshape(-1, 3))
    )


def split(mesh, picked, scenario):
    mask = np.zeros(len(mesh.faces), dtype=bool)
    mask[picked] = True
    sides = sides_of(mesh)
    return cut_edges(mesh, sides, scenario(sides, mask))


def test_scenario_a_of_the_figure():
    """New nodes at all edges of the two triangles; those around are halved."""
    made = split(PATCH, [0, 1], all_sides)
    assert triangles(made.mesh) == expected(
        # the first of the two, into four
        ((0, 0), (1, 0), (1, 1)), ((1, 0), (2, 0), (2, 1)), ((1, 1), (2, 1), (2, 2)), ((1, 0), (2, 1), (1, 1)),
        # the second
        ((0, 0), (1, 1), (0, 1)), ((1, 1), (2, 2), (1, 2)), ((0, 1), (1, 2), (0, 2)), ((1, 1), (1, 2), (0, 1)),
        # those around them, into two
        ((1, 0), (0, 0), (1, -2)), ((2, 0), (1, 0), (1, -2)), ((2, 1), (2, 0), (4, 1)), ((2, 2), (2, 1), (4, 1)),
        ((1, 2), (2, 2), (1, 4)), ((0, 2), (1, 2), (1, 4)), ((0, 1), (0, 2), (-2, 1)), ((0, 0), (0, 1), (-2, 1)),
    )  # fmt: skip
    assert made.n_cuts.tolist() == [3, 3, 1, 1, 1, 1]
    assert made.parents.tolist() == [0] * 4 + [1] * 4 + [2, 2, 3, 3, 4, 4, 5, 5]


def test_scenario_b_of_the_figure():
    """A new node only on the edge adjacent to the two triangles; no other triangle changes."""
    made = split(PATCH, [0, 1], shared_sides)
    whole = [tuple(CORNERS[number] for number in face) for face in PATCH.faces[2:].tolist()]
    assert triangles(made.mesh) == expected(
        ((0, 0), (2, 0), (1, 1)), ((2, 0), (2, 2), (1, 1)), ((0, 0), (1, 1), (0, 2)), ((1, 1), (2, 2), (0, 2)), *whole
    )
    assert made.n_cuts.tolist() == [1, 1, 0, 0, 0, 0]


def test_scenario_b_at_the_boundary():
    """New nodes on the boundary edges of a triangle in question, too."""
    made = split(PATCH, [0, 2], shared_sides)
    assert made.n_cuts.tolist() == [1, 0, 3, 0, 0, 0]
    assert sorted(made.mesh.vertices[8:, :2].tolist()) == [[0.5, -1], [1, 0], [1.5, -1]]


def test_one_triangle_alone():
    assert split(PATCH, [0], all_sides).n_cuts.tolist() == [3, 1, 1, 1, 0, 0]
    ball = sphere()
    assert not split(ball, [17], shared_sides).n_cuts.any()
    assert split(ball, [17], all_sides).n_cuts.sum() == 6


@pytest.mark.parametrize("turn", [0, 1, 2])
def test_two_cut_sides_leave_the_shorter_diagonal(turn):
    """Sides from (0, 0) to (8, 0) and to (0, 2) are cut: from (4, 0) to (0, 2), not from (0, 1) to (8, 0)."""
    mesh = Mesh(np.array([(0, 0, 0), (8, 0, 0), (0, 2, 0)], dtype=float), np.roll([[0, 1, 2]], turn, axis=1))
    sides = sides_of(mesh)
    made = cut_edges(mesh, sides, (sides.ends == 0).any(axis=1))
    assert triangles(made.mesh) == expected(
        ((0, 0), (4, 0), (0, 1)), ((4, 0), (0, 2), (0, 1)), ((4, 0), (8, 0), (0, 2))
    )


def test_equal_diagonals_are_decided_by_vertex_numbers():
    points = np.array([(0, 0, 0), (2, 0, 0), (0, 2, 0)], dtype=float)
    for faces in ([[0, 1, 2]], [[1, 2, 0]], [[2, 0, 1]]):
        mesh = Mesh(points, np.array(faces))
        sides = sides_of(mesh)
        made = cut_edges(mesh, sides, (sides.ends == 0).any(axis=1))
        assert ((0.0, 1.0), (1.0, 0.0), (2.0, 0.0)) in triangles(made.mesh)


SHAPES = {
    "sphere": sphere(subdivisions=1),
    "box": box((1, 2, 3), (11, 7, 4)),
    "tube": tube(rings=6, sides=5),
    "two": joined(box(), sphere(3, (20, 0, 0), subdivisions=1)),
    "open": Mesh(sphere(subdivisions=1).vertices, sphere(subdivisions=1).faces[9:]),
    "patch": PATCH,
}


def plain(mesh, cut_ends):
    """Cut one edge after the other, halving the faces at it: the same corners and areas, other triangles."""
    vertices, faces = [tuple(point) for point in mesh.vertices], [tuple(face) for face in mesh.faces.tolist()]
    for a, b in cut_ends:
        middle = len(vertices)
        vertices.append(tuple((np.array(vertices[a]) + vertices[b]) / 2))
        halved = []
        for face in faces:
            if a in face and b in face:
                halved += [tuple(middle if corner == end else corner for corner in face) for end in (a, b)]
            else:
                halved.append(face)
        faces = halved
    return np.array(vertices), faces


def areas(mesh):
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a) / 2


@settings(deadline=None)
@given(st.sampled_from(sorted(SHAPES)), st.randoms(use_true_random=False), st.sampled_from(["a", "b", "any"]))
def test_any_selection(name, random, scenario):
    mesh = SHAPES[name]
    share = random.random()
    picked = np.array([random.random() < share for _ in mesh.faces])
    sides = sides_of(mesh)
    if scenario == "any":
        cut = np.array([random.random() < share for _ in sides.ends])
    else:
        cut = (all_sides if scenario == "a" else shared_sides)(sides, picked)
    made = cut_edges(mesh, sides, cut)
    assert_conforming(mesh, sides, cut, made)
    if scenario == "a":
        assert (made.n_cuts[picked] == 3).all()
    if scenario == "b":
        assert not made.n_cuts[~picked].any()


def assert_conforming(mesh, sides, cut, made):
    after = made.mesh
    # Vertices: the old ones, and one in the middle of each cut edge.
    expected_vertices, reference = plain(mesh, sides.ends[cut].tolist())
    assert (after.vertices[: len(mesh.vertices)] == mesh.vertices).all()
    assert {tuple(point) for point in after.vertices} == {tuple(point) for point in expected_vertices}
    assert len(after.vertices) == len(expected_vertices)
    assert len(after.faces) == len(reference)
    # No edge that was cut is whole anywhere: nothing hangs.
    new = {tuple(sorted(edge)) for face in after.faces.tolist() for edge in zip(face, face[1:] + face[:1], strict=True)}
    assert not new & {tuple(edge) for edge in sides.ends[cut].tolist()}
    # Topology stays.
    before, now = (surface.topology(one.vertices, one.faces) for one in (mesh, after))
    for key in ("euler", "n_components", "n_boundary_loops"):
        assert getattr(now, key) == getattr(before, key)
    for key in (
        "nonmanifold_edges",
        "nonmanifold_vertices",
        "inconsistent_edges",
        "duplicate_faces",
        "collapsed_faces",
    ):
        assert len(getattr(now, key)) == len(getattr(before, key))
    # Parts lie in the plane of their face, with its normal, and make up its area.
    old, parts = areas(mesh), areas(after)
    sums = np.zeros_like(old)
    np.add.at(sums, made.parents, parts)
    scale = np.linalg.norm(old, axis=1)
    assert (np.linalg.norm(sums - old, axis=1) <= 1e-12 * scale).all()
    assert ((parts * old[made.parents]).sum(axis=1) > 0).all()
    assert np.linalg.norm(parts, axis=1).sum() == pytest.approx(scale.sum(), rel=1e-12)
    assert volume(after) == pytest.approx(volume(mesh), rel=1e-12, abs=1e-12)


def test_large_meshes_are_split_as_small_ones():
    """Many at once are what each of them is alone."""
    small = SHAPES["sphere"]
    many = joined(*[small] * 50)
    picked = np.zeros(len(many.faces), dtype=bool)
    picked[[3, 80 + 5, 80 + 6, 49 * 80 + 79]] = True
    sides = sides_of(many)
    made = cut_edges(many, sides, all_sides(sides, picked))
    assert_conforming(many, sides, all_sides(sides, picked), made)
    assert (made.n_cuts.reshape(50, 80).sum(axis=1) > 0).tolist() == [True, True, *[False] * 47, True]
