from __future__ import annotations

import numpy as np
import pytest
from shapes import box, flipped, joined, moved, sphere

from vhp_cli.kernels.measuring import closest
from vhp_cli.kernels.spatial import Tree
from vhp_cli.kernels.untangling import opposite


def reference(mesh, vertex, normal, side, reach):
    """Return distance to the nearest face that qualifies, one face at a time."""
    best = np.inf
    for face in mesh.faces:
        if vertex in face:
            continue
        corners = mesh.vertices[face]
        across = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        if not across @ normal < 0:
            continue
        if (mesh.vertices[vertex] - corners[0]) @ across * side > 0:
            continue
        found = closest(Tree(corners, [[0, 1, 2]]), mesh.vertices[vertex][None]).distances[0]
        best = min(best, found)
    return best if best <= reach else np.inf


@pytest.mark.parametrize("reach", [2.0, 100.0])
def test_nearest_opposite_face(reach):
    mesh = joined(
        sphere(10, subdivisions=1),
        moved(sphere(8, subdivisions=1), (16, 1, 2)),
        flipped(moved(sphere(5, subdivisions=1), (4, 0, 0))),
    )
    rng = np.random.default_rng(1)
    vertices = rng.choice(len(mesh.vertices), 60, replace=False)
    normals = rng.normal(size=(60, 3))
    sides = np.where(rng.random(60) < 0.5, 1, -1)
    found = opposite(
        Tree(mesh.vertices, mesh.faces), mesh.faces, vertices, mesh.vertices[vertices], normals, sides, reach
    )
    expected = [reference(mesh, *query, reach) for query in zip(vertices, normals, sides, strict=True)]
    there = found.faces >= 0
    assert there.tolist() == np.isfinite(expected).tolist()
    assert there.any()
    distances = np.linalg.norm(found.points - mesh.vertices[vertices], axis=1)
    assert distances[there] == pytest.approx(np.array(expected)[there], abs=1e-12)
    # The point lies on the face that is named.
    for face, place in zip(found.faces[there], found.points[there], strict=True):
        own = Tree(mesh.vertices[mesh.faces[face]], [[0, 1, 2]])
        assert closest(own, place[None]).distances[0] < 1e-12


def test_faces_at_the_vertex_do_not_count():
    mesh = box()
    tree = Tree(mesh.vertices, mesh.faces)
    found = opposite(tree, mesh.faces, [7], mesh.vertices[[7]], [[1, 1, 1]], [1], 9.999)
    assert found.faces.tolist() == [-1]
    found = opposite(tree, mesh.faces, [7], mesh.vertices[[7]], [[1, 1, 1]], [1], 10.0)
    assert found.faces[0] >= 0


def test_shapes_must_agree():
    mesh = box()
    tree = Tree(mesh.vertices, mesh.faces)
    with pytest.raises(ValueError, match="do not agree"):
        opposite(tree, mesh.faces, [7], mesh.vertices[:2], [[1, 1, 1]], [1], 1.0)
    with pytest.raises(ValueError, match="do not agree"):
        opposite(tree, mesh.faces[1:], [7], mesh.vertices[[7]], [[1, 1, 1]], [1], 1.0)
