from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapes import box, flipped, joined, moved, sphere

from vhp_cli.kernels import surface
from vhp_cli.kernels.spatial import Tree, gap
from vhp_cli.mesh import Mesh
from vhp_cli.stages.heal.crossings import cut_and_fill, default_reach, untangle
from vhp_cli.stages.heal.zones import connected, edges_of, find_zones, grown, normals_at


def hits(mesh):
    return Tree(mesh.vertices, mesh.faces).self_hits().n_pairs


def volume(mesh):
    topology = surface.topology(mesh.vertices, mesh.faces)
    return surface.quality(mesh.vertices, mesh.faces, topology.component, topology.n_components).volume


def components(mesh):
    """Return the components of a mesh, each as a mesh."""
    topology = surface.topology(mesh.vertices, mesh.faces)
    return [Mesh(mesh.vertices, mesh.faces[topology.component == k]) for k in range(topology.n_components)]


def ways(before, after):
    return np.linalg.norm(after.vertices - before.vertices, axis=1)


def with_bump(mesh, direction, height, width):
    """Return a mesh with a smooth bump of so many mm, about so many mm wide, where it faces a direction."""
    direction = np.asarray(direction, float) / np.linalg.norm(direction)
    radii = np.linalg.norm(mesh.vertices, axis=1)
    beside = np.linalg.norm(mesh.vertices / radii[:, None] - direction, axis=1) * radii
    vertices = mesh.vertices * (1 + height * np.exp(-((beside / width) ** 2)) / radii)[:, None]
    return Mesh(vertices.astype(np.float32).astype(float), mesh.faces)


def crossed_wall():
    """Return a hollow ball, 0.2 mm thick, the inner side of which comes out through the outer one in one place."""
    outer = sphere(20, subdivisions=4)
    inner = flipped(with_bump(sphere(19.8, subdivisions=4), (1, 2, 3), height=0.35, width=3))
    return joined(outer, inner)


def touching_spheres(depth):
    mesh = joined(sphere(10, subdivisions=3), moved(sphere(10, subdivisions=3), (20 - depth, 0, 0)))
    return Mesh(mesh.vertices.astype(np.float32).astype(float), mesh.faces)


def test_sound_mesh_is_handed_back():
    mesh = joined(sphere(), moved(sphere(), (30, 0, 0)))
    same, actions = untangle(mesh)
    assert same is mesh
    assert actions == []
    assert cut_and_fill(mesh) == (mesh, [])


def test_shallow_overlap_is_pushed_apart():
    mesh = touching_spheres(depth=0.06)
    assert hits(mesh) > 0
    apart, actions = untangle(mesh, reach_mm=0.2, gap_mm=0.01)
    assert hits(apart) == 0
    assert np.array_equal(apart.faces, mesh.faces)
    assert ways(mesh, apart).max() < 0.08
    first, second = components(apart)
    assert gap(Tree(first.vertices, first.faces), Tree(second.vertices, second.faces)).distance > 0
    # Only what is near the contact was moved.
    assert (ways(mesh, apart) > 0).sum() < 40
    assert volume(apart) == pytest.approx(volume(mesh), rel=1e-3)
    [action] = actions
    assert action["step"] == "untangle"
    assert action["count"] == 1
    assert action["places"][0]["value"] == pytest.approx(ways(mesh, apart).max())
    assert np.linalg.norm(np.array(action["places"][0]["xyz_mm"]) - [9.97, 0, 0]) < 3


def test_wall_that_crossed_itself_is_put_right():
    mesh = crossed_wall()
    assert hits(mesh) > 0
    mended, _ = untangle(mesh)
    assert hits(mended) == 0
    # The inner side is within the outer one again, and nothing was lost.
    tree = Tree(mended.vertices, mended.faces)
    label = surface.topology(mended.vertices, mended.faces).component
    assert tree.component_depths(label, 2)[0].tolist() == [0, 1]
    assert ways(mesh, mended).max() < 0.4
    assert volume(mended) == pytest.approx(volume(mesh), rel=0.02)
    untouched = np.linalg.norm(mesh.vertices - 20 * np.array([1, 2, 3]) / 14**0.5, axis=1) > 15
    assert untouched.sum() > 2000
    assert np.array_equal(mended.vertices[untouched], mesh.vertices[untouched])


def test_folded_vertex_is_smoothed():
    ball = sphere(10, subdivisions=3)
    vertices = ball.vertices.copy()
    beside = next(vertex for vertex in ball.faces[(ball.faces == 100).any(axis=1)][0] if vertex != 100)
    # Past its neighbour, and a little below.
    vertices[100] = 0.99 * (1.8 * vertices[beside] - 0.8 * vertices[100])
    mesh = Mesh(vertices.astype(np.float32).astype(float), ball.faces)
    assert hits(mesh) > 0
    mended, actions = untangle(mesh, reach_mm=1.0)
    assert hits(mended) == 0
    assert actions
    assert (ways(mesh, mended) > 0).sum() < 40


def test_touching_boxes_get_a_gap():
    mesh = joined(box(), moved(box((0, 0, 0), (4, 4, 4)), (3, 3, 10)))
    assert hits(mesh) > 0
    apart, _ = untangle(mesh, gap_mm=0.01)
    assert hits(apart) == 0
    first, second = components(apart)
    found = gap(Tree(first.vertices, first.faces), Tree(second.vertices, second.faces)).distance
    assert 1e-4 < found < 0.03


def test_deep_overlap_is_left_alone():
    mesh = touching_spheres(depth=5)
    same, actions = untangle(mesh, reach_mm=0.5)
    assert np.array_equal(same.vertices, mesh.vertices)
    assert actions == []


def test_easy_zone_is_cleared_beside_a_hard_one():
    easy = touching_spheres(depth=0.05)
    hard = moved(touching_spheres(depth=5), (0, 60, 0))
    mesh = joined(easy, hard)
    cleared, actions = untangle(mesh, reach_mm=0.3)
    n = len(easy.vertices)
    assert hits(Mesh(cleared.vertices, cleared.faces[: len(easy.faces)])) == 0
    assert np.array_equal(cleared.vertices[n:], mesh.vertices[n:])
    assert actions[0]["count"] == 1
    assert find_zones(cleared).count == 1


def test_result_is_in_float32():
    far = moved(touching_spheres(depth=0.06), (900, 900, 900))
    far = Mesh(far.vertices.astype(np.float32).astype(float), far.faces)
    apart, _ = untangle(far)
    assert hits(apart) == 0
    assert np.array_equal(apart.vertices, apart.vertices.astype(np.float32))


@settings(max_examples=8, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    height=st.floats(0.05, 0.9),
    width=st.floats(0.5, 4),
    reach=st.floats(0.05, 1.0),
)
def test_untangling_keeps_its_word(seed, height, width, reach):
    direction = np.random.default_rng(seed).normal(size=3)
    mesh = joined(sphere(10, subdivisions=3), flipped(with_bump(sphere(9.7, subdivisions=3), direction, height, width)))
    zones = find_zones(mesh)
    mended, actions = untangle(mesh, reach_mm=reach)
    assert np.array_equal(mended.faces, mesh.faces)
    assert ways(mesh, mended).max() <= reach
    assert np.array_equal(mended.vertices[zones.labels < 0], mesh.vertices[zones.labels < 0])
    left = find_zones(mended).count
    assert left <= zones.count
    assert (left == 0) == (hits(mended) == 0)
    assert bool(actions) == (not np.array_equal(mended.vertices, mesh.vertices))
    again, _ = untangle(mesh, reach_mm=reach)
    assert np.array_equal(again.vertices, mended.vertices)


def crumpled():
    """Return a ball on which one small patch is a mess."""
    ball = sphere(10, subdivisions=4)
    vertices = ball.vertices.copy()
    patch = np.linalg.norm(vertices - [0, 0, 10], axis=1) < 1.3
    vertices[patch] += np.random.default_rng(5).uniform(-0.5, 0.5, (patch.sum(), 3))
    return Mesh(vertices.astype(np.float32).astype(float), ball.faces), patch


def test_crumpled_patch_is_cut_out_and_filled():
    mesh, patch = crumpled()
    assert hits(mesh) > 3
    mended, actions = cut_and_fill(mesh, reach_mm=1.0)
    assert hits(mended) == 0
    topology = surface.topology(mended.vertices, mended.faces)
    assert not len(topology.boundary_edges)
    assert not len(topology.nonmanifold_vertices)
    assert topology.euler == 2
    assert volume(mended) == pytest.approx(volume(sphere(10, subdivisions=4)), rel=0.005)
    kept = {tuple(vertex) for vertex in mended.vertices}
    assert sum(tuple(vertex) in kept for vertex in mesh.vertices[~patch]) > (~patch).sum() - 40
    [action] = actions
    assert action["step"] == "cut"
    assert action["area_mm2"] > 0
    assert action["places"][0]["value"] <= 1.0
    assert np.linalg.norm(np.array(action["places"][0]["xyz_mm"]) - [0, 0, 10]) < 2


def test_cut_beyond_reach_is_refused():
    mesh, _ = crumpled()
    same, actions = cut_and_fill(mesh, reach_mm=1e-3)
    assert same is mesh
    assert actions == []


def test_reach_follows_the_size():
    assert default_reach(sphere(1)) == 0.2
    assert default_reach(sphere(1000)) == 1.0
    assert default_reach(box(upper=(60, 60, 60))) == pytest.approx(0.005 * 60 * 3**0.5)


def test_zones_take_in_what_is_on_the_wrong_side():
    mesh = joined(touching_spheres(depth=3), moved(touching_spheres(depth=0.05), (0, 50, 0)))
    zones = find_zones(mesh)
    assert zones.count == 2
    inside = [Tree(part.vertices, part.faces).inside(mesh.vertices) == 1 for part in components(mesh)]
    # Within exactly two balls, their own surface not counted: on the wrong side.
    wrong = np.zeros(len(mesh.vertices), bool)
    for k, part in enumerate(components(mesh)):
        others = np.any([inside[j] for j in range(4) if j != k], axis=0)
        own = np.unique(part.faces)
        wrong[own] |= others[own]
    assert wrong.sum() > 20
    assert zones.core[wrong].all()
    assert len(np.unique(zones.labels[wrong])) == 2 or (wrong[zones.labels == 1].sum() == 0)
    assert (zones.labels[zones.core] >= 0).all()


def test_connected_labels():
    links = np.array([[5, 1], [1, 3], [2, 7], [8, 8]])
    assert connected(9, links).tolist() == [0, 1, 2, 1, 4, 1, 6, 2, 8]
    assert connected(3, np.empty((0, 2), int)).tolist() == [0, 1, 2]


def test_edges_and_rings():
    faces = np.array([[0, 1, 2], [2, 1, 3], [3, 4, 2]], np.int32)
    edges = edges_of(faces)
    assert edges.tolist() == [[0, 1], [0, 2], [1, 2], [1, 3], [2, 3], [2, 4], [3, 4]]
    start = np.array([True, False, False, False, False])
    assert grown(start, edges).tolist() == [True, True, True, False, False]
    assert grown(start, edges, 2).all()


def test_normals_point_outward():
    ball = sphere(10, subdivisions=3)
    normals = normals_at(ball.vertices, ball.faces)
    assert np.einsum("ij,ij->i", normals, ball.vertices / 10).min() > 0.999
    # At the corner of a box the angles, not the areas or numbers of the faces, decide.
    corner = normals_at(box().vertices, box().faces)[7]
    assert corner == pytest.approx(np.full(3, 3**-0.5))
