from __future__ import annotations

import numpy as np
import pytest
from repair_shapes import area, flaws, volume, welded, without
from shapes import box, flipped, joined, moved, sphere

from vhp_cli.kernels.surface import topology
from vhp_cli.mesh import Mesh
from vhp_cli.stages.heal.manifold import make_manifold
from vhp_cli.stages.heal.orientation import orient
from vhp_cli.stages.heal.separation import separate


def grid_box(lower, upper, n=2) -> Mesh:
    """A box with n x n squares on each side, so that boxes beside each other share all vertices."""
    lower, upper = np.asarray(lower, float), np.asarray(upper, float)
    vertices, faces = [], []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        for end in (0, 1):
            base = len(vertices)
            for i in range(n + 1):
                for j in range(n + 1):
                    share = np.zeros(3)
                    share[axis], share[u], share[v] = end, i / n, j / n
                    vertices.append(lower + share * (upper - lower))
            for i in range(n):
                for j in range(n):
                    a = base + i * (n + 1) + j
                    quad = (a, a + n + 1, a + n + 2, a + 1)
                    # The same diagonal on either side of a wall.
                    quad = quad if end else (quad[0], quad[3], quad[2], quad[1])
                    faces += [(quad[0], quad[1], quad[2]), (quad[0], quad[2], quad[3])]
    return welded(Mesh(np.array(vertices), np.array(faces)))


def apart(mesh: Mesh) -> Mesh:
    return separate(orient(make_manifold(mesh)[0])[0])[0]


def test_a_manifold_mesh_comes_back_as_it_is():
    for mesh in (box(), without(sphere(), [0, 1]), joined(box(), moved(box(), (20, 0, 0)))):
        same, actions = make_manifold(mesh)
        assert same is mesh and actions == []
        same, actions = separate(mesh)
        assert same is mesh and actions == []


def test_boxes_that_share_a_corner_are_parted():
    pair = welded(joined(box(), box((10, 10, 10), (20, 20, 20))))
    assert flaws(pair) == {"pinched": 1}
    parted = apart(pair)
    assert flaws(parted) == {}
    assert volume(parted) == pytest.approx(2000, rel=1e-3)
    assert np.abs(parted.vertices[:, None] - pair.vertices[None]).max(axis=2).min(axis=1).max() < 0.021


def test_boxes_that_share_an_edge_are_parted():
    pair = welded(joined(grid_box((0, 0, 0), (10, 10, 10)), grid_box((10, 10, 0), (20, 20, 10))))
    assert flaws(pair)["crowded"] == 2
    parted = apart(pair)
    assert flaws(parted) == {}
    assert topology(parted.vertices, parted.faces).n_components == 2
    assert volume(parted) == pytest.approx(2000, rel=1e-3)


def test_boxes_that_touch_in_a_wall_cut_in_other_ways_are_parted():
    # The squares of the wall are cut along one diagonal by the first box and along the other by the second.
    second = grid_box((10, 0, 0), (20, 10, 10))
    mirrored = Mesh(np.array([10, 10, 0]) + second.vertices * [1, -1, 1], flipped(second).faces)
    pair = welded(joined(grid_box((0, 0, 0), (10, 10, 10)), moved(mirrored, (-10, 0, 0))))
    assert volume(pair) == pytest.approx(2000)
    assert flaws(pair)["crowded"] == 12 and flaws(pair)["hits"] > 0
    parted = apart(pair)
    assert flaws(parted) == {}
    assert topology(parted.vertices, parted.faces).n_components == 2
    assert volume(parted) == pytest.approx(2000, rel=2e-3)


def test_an_edge_with_joined_ends_is_cut_in_its_middle():
    # Two boxes that share an edge, both standing on a plate and under another: the ends of the edge are one fan.
    cells = [(0, 0, 1), (1, 1, 1), *((x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 2))]
    unit = grid_box((0, 0, 0), (1, 1, 1), 1)
    parts = joined(*(moved(unit, cell) for cell in cells))
    solid = welded(parts)
    # Faces between two cells go in pairs.
    key = np.sort(solid.faces, axis=1)
    _, group, count = np.unique(key, axis=0, return_inverse=True, return_counts=True)
    solid = Mesh(solid.vertices, solid.faces[count[group.reshape(-1)] == 1])
    assert flaws(solid) == {"crowded": 1, "pinched": 2}
    parted = apart(solid)
    assert flaws(parted) == {}
    assert topology(parted.vertices, parted.faces).n_components == 1
    assert volume(parted) == pytest.approx(10, rel=1e-3)


def test_inward_solids_are_parted_across_the_solid_too():
    pair = welded(joined(grid_box((0, 0, 0), (10, 10, 10)), grid_box((10, 10, 0), (20, 20, 10))))
    parted, _ = make_manifold(flipped(pair))
    assert topology(parted.vertices, parted.faces).n_components == 2
    assert volume(parted) == pytest.approx(-2000)


def test_a_cavity_that_touches_the_outside_is_parted_outward():
    outer = box()
    # A tetrahedron inside with its tip on the corner of the box.
    corners = np.array([[0, 0, 0], [4, 3, 3], [3, 4, 3], [3, 3, 4.0]])
    tip = Mesh(corners, np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]]))
    cavity = tip if volume(tip) < 0 else flipped(tip)
    pair = welded(joined(outer, cavity))
    assert flaws(pair) == {"pinched": 1}
    parted = apart(pair)
    assert flaws(parted) == {}
    assert volume(parted) == pytest.approx(volume(pair), rel=1e-3)


def test_a_wall_within_a_solid_is_dropped():
    both = welded(joined(grid_box((0, 0, 0), (10, 10, 10)), grid_box((10, 0, 0), (25, 10, 10))))
    wall = np.flatnonzero((both.vertices[both.faces][:, :, 0] == 10).all(axis=1))
    walled = without(both, wall[: len(wall) // 2])
    assert flaws(walled)["crowded"] == 8
    solid, actions = make_manifold(walled)
    assert flaws(solid) == {}
    assert volume(solid) == pytest.approx(2500)
    assert actions[0]["area_mm2"] == pytest.approx(100)


def test_a_fin_is_dropped():
    mesh = box()
    finned = Mesh(np.vstack([mesh.vertices, [[-3, -3, 4.0]]]), np.vstack([mesh.faces, [[0, 4, 8]]]))
    solid, actions = make_manifold(finned)
    assert flaws(solid) == {} and len(solid.faces) == 12
    assert actions[0]["area_mm2"] == pytest.approx(area(finned) - area(mesh))


def test_a_part_with_a_hole_that_shares_an_edge_is_no_fin():
    # The second box lacks a face and shares an edge: no sheet, so nothing of it is lost.
    second = without(grid_box((10, 10, 0), (15, 15, 5), 1), [0])
    pair = welded(joined(grid_box((0, 0, 0), (10, 10, 5), 1), second))
    cut, actions = make_manifold(pair)
    assert len(cut.faces) == len(pair.faces)
    assert not any("dropped" in action["message"] for action in actions)


def test_a_cavity_with_a_hole_that_shares_an_edge_is_no_wall():
    # A slender cavity on the edge 0-1 of the outer surface, there without a small face (0, 1, 4).
    corners = np.array([[0, 0, 0], [1, 0, 0], [0.5, 8, 1], [0.5, 1, 8], [0.5, 0.5, 0.1]])
    cavity = Mesh(corners, np.array([[1, 4, 2], [4, 0, 2], [0, 1, 3], [0, 3, 2], [1, 2, 3]]))
    pair = welded(joined(grid_box((0, 0, 0), (10, 10, 10), 10), cavity))
    assert flaws(pair)["crowded"] == 1 and flaws(pair)["open"] == 2
    cut, actions = make_manifold(pair)
    assert len(cut.faces) == len(pair.faces)
    assert not any("dropped" in action["message"] for action in actions)


def test_open_fans_stay_together_and_closed_ones_part():
    mesh = sphere()
    around = np.flatnonzero((mesh.faces == 0).any(axis=1))
    pair = next((f, g) for f in around for g in around if len(set(mesh.faces[f]) & set(mesh.faces[g])) == 1)
    bow = without(mesh, list(pair))
    assert make_manifold(bow)[0] is bow
    tip = moved(box(), mesh.vertices[0])
    both = welded(joined(bow, tip))
    parted, _ = make_manifold(both)
    assert len(parted.vertices) == len(both.vertices) + 1


def test_touching_faces_are_separated_where_they_share_points_only():
    # Three boxes in a row, each touching the next in a corner.
    chain = welded(joined(*(box((10 * i, 10 * i, 10 * i), (10 * i + 10,) * 3) for i in range(3))))
    parted = apart(chain)
    assert flaws(parted) == {}
    assert len(parted.vertices) == 24
