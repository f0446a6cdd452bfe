"""Nearest points and wall thickness against closed forms, brute force and an independent library."""

from __future__ import annotations

import math
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapes import box, flipped, joined, moved, sphere

from vhp_cli.formats import read_mesh
from vhp_cli.kernels.measuring import closest, thickness
from vhp_cli.kernels.spatial import Tree

GRID = st.integers(-4, 4)
POINT = st.tuples(GRID, GRID, GRID)


def tree_of(mesh):
    return Tree(mesh.vertices, mesh.faces)


def normals_of(mesh):
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def centres_of(mesh):
    return mesh.vertices[mesh.faces].mean(axis=1)


def segment_distance(p, a, b):
    length = (b - a) @ (b - a)
    t = np.clip((p - a) @ (b - a) / length, 0, 1) if length > 0 else 0.0
    return np.linalg.norm(p - a - t * (b - a))


def triangle_distance(p, a, b, c):
    """By least squares in the plane of the triangle, its edges where the foot lies outside."""
    edges = min(segment_distance(p, a, b), segment_distance(p, b, c), segment_distance(p, c, a))
    basis = np.column_stack((b - a, c - a))
    if np.linalg.matrix_rank(basis) < 2:
        return edges
    u, v = np.linalg.lstsq(basis, p - a, rcond=None)[0]
    if u < 0 or v < 0 or u + v > 1:
        return edges
    return min(edges, np.linalg.norm(p - a - basis @ (u, v)))


@settings(max_examples=150, deadline=None)
@given(st.lists(st.tuples(POINT, POINT, POINT), min_size=1, max_size=12), st.lists(POINT, min_size=1, max_size=6))
def test_closest_is_the_least_distance_of_all_faces(triangles, points):
    # Small integers: many of the triangles are segments or points.
    corners = np.array(triangles, float)
    queries = np.array(points) * 0.7 + 0.1
    found = closest(Tree(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3)), queries)
    for k, query in enumerate(queries):
        distances = [triangle_distance(query, *triangle) for triangle in corners]
        assert found.distances[k] == pytest.approx(min(distances), abs=1e-12)
        assert np.linalg.norm(found.points[k] - query) == pytest.approx(found.distances[k], abs=1e-12)
        named = corners[found.faces[k]]
        assert triangle_distance(query, *named) == pytest.approx(min(distances), abs=1e-12)
        assert triangle_distance(found.points[k], *named) < 1e-12


def test_closest_of_a_box_has_a_closed_form():
    points = np.random.default_rng(0).uniform(-10, 20, (20_000, 3))
    outside = np.maximum(np.maximum(-points, points - 10), 0)
    inside = np.minimum(points, 10 - points).min(axis=1)
    expected = np.where(inside > 0, inside, np.linalg.norm(outside, axis=1))
    assert closest(tree_of(box()), points).distances == pytest.approx(expected, abs=1e-12)


def test_each_answer_depends_on_its_point_alone():
    mesh = sphere(subdivisions=4)
    # Vertices and middles of edges are as near to several faces; the centre to almost all.
    points = np.concatenate((mesh.vertices, mesh.vertices[mesh.faces[:, :2]].mean(axis=1), np.zeros((1, 3))))
    points = np.concatenate((points, points * 1.1))
    tree = tree_of(mesh)
    order = np.random.default_rng(1).permutation(len(points))
    together, shuffled = closest(tree, points), closest(tree, points[order])
    for one, other in zip(together, shuffled, strict=True):
        assert np.array_equal(one[order], other)
    alone = closest(tree, points[-1:])
    assert (alone.distances[0], alone.faces[0]) == (together.distances[-1], together.faces[-1])


def test_limit_is_the_largest_distance_found():
    points = [(5, 5, 12), (5, 5, 13), (5, 5, 13.001)]
    found = closest(tree_of(box()), points, limit=3)
    assert found.distances.tolist() == [2, 3, math.inf]
    assert found.faces[2] == -1 and np.isnan(found.points[2]).all()
    assert found.points[1].tolist() == [5, 5, 10]
    assert closest(tree_of(box()), [(5, 5, 10), (5, 5, 10.1)], limit=0).distances.tolist() == [0, math.inf]


def test_closest_without_faces_or_points():
    nothing = closest(Tree(np.empty((0, 3)), np.empty((0, 3), int)), [(0, 0, 0)])
    assert nothing.distances.tolist() == [math.inf] and nothing.faces.tolist() == [-1]
    assert [len(array) for array in closest(tree_of(box()), [])] == [0, 0, 0]


@pytest.mark.parametrize("bad", [math.nan, math.inf, 1e39])
def test_points_must_be_finite(bad):
    with pytest.raises(ValueError, match="finite"):
        closest(tree_of(box()), [(0, bad, 0)])
    with pytest.raises(ValueError, match="finite"):
        thickness(tree_of(box()), [(0, 0, 0)], [(0, bad, 1)], [-1])


def test_shapes_and_limit_are_checked():
    with pytest.raises(ValueError, match="shape"):
        closest(tree_of(box()), [(0, 0)])
    with pytest.raises(ValueError, match="limit"):
        closest(tree_of(box()), [(0, 0, 0)], limit=-1)
    with pytest.raises(ValueError, match="directions"):
        thickness(tree_of(box()), [(0, 0, 0)], [(0, 0, 1)], [-1, -1])


def test_closest_agrees_with_libigl(shared_data):
    igl = pytest.importorskip("igl")
    generator = np.random.default_rng(2)
    for path in sorted(shared_data.glob("*/*.stl"))[::20]:
        mesh = read_mesh(path).mesh
        if not len(mesh.faces):
            continue
        corners = mesh.vertices[mesh.faces[generator.integers(0, len(mesh.faces), 600)]]
        points = corners.mean(axis=1)
        size = np.ptp(mesh.vertices, axis=0).max()
        points += generator.normal(size=points.shape) * size * generator.choice([0, 1e-4, 1e-1], (len(points), 1))
        squared, _, _ = igl.point_mesh_squared_distance(
            points, np.ascontiguousarray(mesh.vertices), mesh.faces.astype(np.int64)
        )
        # Its rounding, of the absolute coordinates, is the larger one.
        tolerance = 1e-7 * np.abs(mesh.vertices).max()
        assert closest(tree_of(mesh), points).distances == pytest.approx(np.sqrt(squared), abs=tolerance), path


def test_thickness_of_a_plate_and_of_a_gap():
    plate = box((0, 0, 0), (10, 10, 0.25))
    faces = np.arange(12)
    found = thickness(tree_of(plate), centres_of(plate), -normals_of(plate), faces)
    flat = np.abs(normals_of(plate)[:, 2]) > 0.5
    assert found.distances[flat] == pytest.approx(0.25, abs=1e-15)
    assert found.distances[~flat] == pytest.approx(10, abs=1e-12)
    assert found.cosines == pytest.approx(1, abs=1e-12)
    # Outward there is nothing, or another plate that faces the first.
    assert np.isinf(thickness(tree_of(plate), centres_of(plate), normals_of(plate), faces).distances).all()
    two = joined(plate, moved(plate, (0, 0, 1)))
    found = thickness(tree_of(two), centres_of(two), normals_of(two), np.arange(24))
    met = np.isfinite(found.distances)
    assert met.sum() == 4
    assert found.distances[met] == pytest.approx(0.75, abs=1e-15)
    assert found.cosines[met] == pytest.approx(-1, abs=1e-12)


def test_thickness_of_a_spherical_shell():
    shell = joined(sphere(10, subdivisions=4), flipped(sphere(9, subdivisions=4)))
    found = thickness(tree_of(shell), centres_of(shell), -normals_of(shell), np.arange(len(shell.faces)))
    assert found.distances == pytest.approx(1, abs=0.03)
    assert (found.cosines > 0.99).all()


def test_a_face_at_the_start_counts_and_the_own_face_does_not():
    double = joined(box(), flipped(box()))
    found = thickness(tree_of(double), centres_of(double), -normals_of(double), np.arange(24))
    assert (found.distances == 0).all()
    far = moved(double, (700.1, -300.7, 0.3))
    found = thickness(tree_of(far), centres_of(far), -normals_of(far), np.arange(24))
    assert (found.distances < 1e-12).all()
    assert thickness(tree_of(box()), [(5, 5, 0)], [(0, 0, 3)], [-1]).distances.tolist() == [0]


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6))
def test_no_ray_slips_out_of_a_closed_surface(seed):
    generator = np.random.default_rng(seed)
    mesh = sphere(10, centre=generator.uniform(-900, 900, 3), subdivisions=2)
    centre = mesh.vertices.mean(axis=0)
    # Toward vertices, through edges, and anywhere.
    edges = mesh.vertices[mesh.faces[:, :2]]
    share = generator.random((len(edges), 1))
    targets = np.concatenate(
        (mesh.vertices, share * edges[:, 0] + (1 - share) * edges[:, 1], generator.normal(size=(300, 3)) + centre)
    )
    starts = np.broadcast_to(centre, targets.shape)
    found = thickness(tree_of(mesh), starts, targets - starts, np.full(len(targets), -1))
    assert found.distances == pytest.approx(10, rel=0.05)
    assert (found.cosines > 0.9).all()


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6))
def test_first_hits_are_those_of_brute_force(seed):
    generator = np.random.default_rng(seed)
    corners = generator.integers(-6, 7, (40, 3, 3)).astype(float)
    starts, directions = generator.normal(size=(30, 3)) * 3, generator.normal(size=(30, 3))
    found = thickness(Tree(corners.reshape(-1, 3), np.arange(120).reshape(-1, 3)), starts, directions, np.full(30, 7))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for k in range(30):
        places = np.full(40, math.inf)
        for i, (a, b, c) in enumerate(corners):
            system = np.column_stack((b - a, c - a, -directions[k]))
            if i == 7 or abs(np.linalg.det(system)) < 1e-9:
                continue
            u, v, t = np.linalg.solve(system, starts[k] - a)
            if u >= 0 and v >= 0 and u + v <= 1 and t >= 0:
                places[i] = t
        assert found.distances[k] == pytest.approx(places.min(), abs=1e-9)
        if np.isfinite(places.min()):
            assert found.faces[k] == places.argmin()


def test_rays_along_the_axes_and_without_direction():
    # Along the sides of many boxes of the tree, where slopes are infinite.
    cubes = joined(*(box((x, y, 0), (x + 1, y + 1, 1)) for x in range(4) for y in range(4)))
    starts = [(x, y, -1) for x in range(5) for y in range(5)]
    found = thickness(tree_of(cubes), starts, [(0, 0, 1)] * 25, [-1] * 25)
    assert found.distances.tolist() == [1] * 25
    nowhere = thickness(tree_of(cubes), [(0.5, 0.5, 0.5)], [(0, 0, 0)], [-1])
    assert nowhere.distances.tolist() == [math.inf] and nowhere.faces.tolist() == [-1]


def test_faces_without_area_stop_no_ray_but_are_near():
    vertices = [(0, 0, 0), (1, 0, 0), (2, 0, 0), (0, 0, 5), (4, 0, 5), (0, 4, 5)]
    tree = Tree(vertices, [(0, 1, 2), (3, 4, 5), (3, 3, 3)])
    assert thickness(tree, [(1, 0.5, -1)], [(0, 0, 1)], [-1]).distances.tolist() == [6]
    found = closest(tree, [(1, 0, -1), (-1, -1, 5)])
    assert found.distances == pytest.approx([1, math.sqrt(2)])
    assert found.faces[0] == 0


def test_rays_along_the_axes_are_as_fast_as_others():
    # Two sheets of a grid; if a slope of zero kept boxes from being ruled out, this would take a minute.
    n = 128
    x, y = (grid.reshape(-1) for grid in np.meshgrid(np.arange(n + 1.0), np.arange(n + 1.0), indexing="ij"))
    i = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).reshape(-1)
    sheet = np.concatenate((np.column_stack((i, i + n + 1, i + n + 2)), np.column_stack((i, i + n + 2, i + 1))))
    vertices = np.concatenate([np.column_stack((x, y, np.full(len(x), z))) for z in (0.0, 0.5)])
    faces = np.concatenate((sheet[:, ::-1], sheet + len(x)))
    centres = vertices[faces].mean(axis=1)
    directions = np.where(centres[:, 2:] == 0, (0, 0, 1), (0, 0, -1))
    tree = Tree(vertices, faces)
    start = time.perf_counter()
    found = thickness(tree, centres, directions, np.arange(len(faces)))
    assert time.perf_counter() - start < 3
    assert (found.distances == 0.5).all()
    assert (found.cosines == 1).all()


def test_near_points_take_microseconds():
    mesh = sphere(100, subdivisions=5)
    points = np.repeat(centres_of(mesh), 5, axis=0) * 1.0001
    tree = tree_of(mesh)
    start = time.perf_counter()
    closest(tree, points)
    # Five to ten times what it takes on one slow core; without pruning it would take minutes.
    assert time.perf_counter() - start < 1.0
