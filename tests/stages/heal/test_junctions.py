from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from repair_shapes import flaws, soup, volume, welded, without
from shapes import box, joined, moved, sphere

from vhp_cli.mesh import Mesh
from vhp_cli.stages.heal.junctions import join_cracks


def with_t_junctions(mesh: Mesh, faces, shift=0.0) -> Mesh:
    """Cut the first edge of some faces in its middle, in this face only; the new vertex is moved by `shift`."""
    vertices, cut = mesh.vertices.tolist(), mesh.faces.tolist()
    for face in faces:
        a, b, c = cut[face]
        middle = (np.array(vertices[a]) + vertices[b]) / 2 + shift
        cut[face] = [a, len(vertices), c]
        cut.append([len(vertices), b, c])
        vertices.append(middle.tolist())
    return Mesh(np.array(vertices), np.array(cut))


def test_a_closed_or_plainly_open_mesh_comes_back_as_it_is():
    for mesh in (sphere(), without(sphere(), [0, 1, 2, 50])):
        same, actions = join_cracks(mesh)
        assert same is mesh and actions == []


@pytest.mark.parametrize("shift", [0.0, 1e-3])
def test_t_junctions_are_joined(shift):
    mesh = sphere()
    chosen = [0, 17, 60, 200]
    cracked = with_t_junctions(mesh, chosen, shift)
    assert flaws(cracked)["open"] == 12
    closed, (action,) = join_cracks(cracked)
    assert flaws(closed) == {}
    assert action["count"] == 4
    assert volume(closed) == pytest.approx(volume(mesh), rel=1e-3)


def test_several_vertices_on_one_edge():
    mesh = box((0, 0, 0), (10, 10, 10))
    face = 0
    a, b, c = mesh.faces[face]
    points = [mesh.vertices[a] + t * (mesh.vertices[b] - mesh.vertices[a]) for t in (0.7, 0.2, 0.4)]
    chain = [a, 9, 10, 8, b]
    faces = np.vstack([mesh.faces[1:], [(x, y, c) for x, y in pairwise(chain)]])
    closed, _ = join_cracks(Mesh(np.vstack([mesh.vertices, points]), faces))
    assert flaws(closed) == {}
    assert volume(closed) == pytest.approx(1000)


def test_a_crack_between_vertices_that_nearly_coincide_is_joined():
    mesh = sphere()
    upper = mesh.vertices[mesh.faces].mean(axis=1)[:, 2] > 0
    halves = joined(
        Mesh(mesh.vertices, mesh.faces[upper]), moved(Mesh(mesh.vertices, mesh.faces[~upper]), (0, 0, 1e-3))
    )
    halves = welded(soup(halves))
    assert flaws(halves)["open"] > 30
    closed, _ = join_cracks(halves)
    assert flaws(closed) == {}
    assert volume(closed) == pytest.approx(volume(mesh), rel=1e-3)


def test_a_wide_gap_is_no_crack():
    cracked = with_t_junctions(sphere(), [0], 0.5)
    same, actions = join_cracks(cracked)
    assert same is cracked and actions == []
    assert join_cracks(with_t_junctions(sphere(), [0], 1e-3), width=1e-5)[1] == []


def test_faces_smaller_than_the_width_are_not_collapsed():
    mesh = without(sphere(0.05), [0, 1, 2])
    same, _ = join_cracks(mesh, width=0.02)
    assert len(same.faces) == len(mesh.faces)
