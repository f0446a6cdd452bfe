"""Target edge lengths against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapes import box, flipped, joined, moved, sphere

from vhp_cli.formats import read_mesh
from vhp_cli.mesh import Mesh
from vhp_cli.stages.heal.sizing import propose_limits, sizing, walls


def divided_box(lower, upper, counts):
    """A box with a grid of triangles on every side, outward."""
    lower, upper = np.asarray(lower, float), np.asarray(upper, float)
    triangles = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        i, j = (grid.reshape(-1, 1) for grid in np.meshgrid(np.arange(counts[u]), np.arange(counts[v]), indexing="ij"))
        for side in (0, 1):
            rings = np.empty((len(i), 4, 3))
            rings[:, :, axis] = side
            rings[:, :, u] = np.add(i, (0, 1, 1, 0)) / counts[u]
            rings[:, :, v] = np.add(j, (0, 0, 1, 1)) / counts[v]
            rings = rings if side else rings[:, ::-1]
            triangles += [rings[:, :3], rings[:, [0, 2, 3]]]
    return welded(lower + np.concatenate(triangles) * (upper - lower))


def welded(triangles):
    points, inverse = np.unique(np.round(triangles.reshape(-1, 3), 9), axis=0, return_inverse=True)
    return Mesh(points, inverse.reshape(-1, 3))


def tube(radius, length, around, along):
    """An open cylinder along z."""
    angles = np.linspace(0, 2 * math.pi, around, endpoint=False)
    heights = np.linspace(0, length, along + 1)
    z, angle = np.meshgrid(heights, angles, indexing="ij")
    points = np.stack((radius * np.cos(angle), radius * np.sin(angle), z), axis=-1).reshape(-1, 3)
    faces = []
    for k in range(along):
        for i in range(around):
            a, b = k * around + i, k * around + (i + 1) % around
            faces += [(a, b, b + around), (a, b + around, a + around)]
    return Mesh(points, faces)


def edges_of(mesh):
    return np.concatenate((mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]))


def area_of(mesh):
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2


def chord_length(radius, deviation):
    """Longest edge of which the middle is no more than 0.6 of the deviation below an arc."""
    return math.sqrt(8 * radius * 0.6 * deviation)


@pytest.mark.parametrize(("radius", "deviation"), [(10, 0.01), (10, 0.1), (400, 0.1), (0.5, 1e-3)])
def test_sphere(radius, deviation):
    mesh = sphere(radius, subdivisions=4)
    found = sizing(mesh, deviation_mm=deviation, longest_mm=radius, shortest_mm=1e-3 * radius)
    expected = chord_length(radius, deviation)
    assert found.vertex == pytest.approx(expected, rel=0.05)
    assert found.face == pytest.approx(expected, rel=0.05)
    assert found.estimate == pytest.approx(area_of(mesh) / (math.sqrt(3) / 4 * expected**2), rel=0.03)


def test_tube_of_needles_and_where_few_edges_go_around():
    # 0.13 by 2.5 mm: what counts is the bend across the long edges, none along them.
    mesh = tube(2, 50, 96, 20)
    middle = np.abs(mesh.vertices[:, 2] - 25) < 20
    found = sizing(mesh, deviation_mm=0.02, longest_mm=10, shortest_mm=0.01)
    assert found.vertex[middle] == pytest.approx(chord_length(2, 0.02), rel=0.02)
    # A large deviation does not make edges longer than 1.2 radii.
    coarse = sizing(mesh, deviation_mm=5, longest_mm=10, shortest_mm=0.01)
    assert coarse.vertex[middle] == pytest.approx(chord_length(2, 0.15 * 4), rel=0.02)
    wide = sizing(
        mesh, deviation_mm=5, longest_mm=10, shortest_mm=0.01, wall_thickness=np.full(len(mesh.faces), np.inf)
    )
    assert wide.vertex[middle] == pytest.approx(1.2 * 2, rel=0.02)


def test_box_has_no_curvature():
    mesh = divided_box((0, 0, 0), (30, 20, 10), (6, 5, 4))
    found = sizing(mesh, deviation_mm=0.01, longest_mm=3, shortest_mm=0.1)
    assert found.vertex == pytest.approx(3, rel=1e-12)
    assert found.estimate == round(area_of(mesh) / (math.sqrt(3) / 4 * 9))


def test_thin_plate_is_fine_at_its_rim_alone():
    mesh = divided_box((0, 0, 0), (40, 40, 0.2), (80, 80, 1))
    found = sizing(mesh, deviation_mm=0.02, longest_mm=5, shortest_mm=0.05)
    x, y = mesh.vertices[:, 0], mesh.vertices[:, 1]
    to_rim = np.minimum(np.minimum(x, 40 - x), np.minimum(y, 40 - y))
    # About two thicknesses, then 0.4 per mm; the averaging reaches one ring of 0.5 mm.
    assert (found.vertex[to_rim == 0] < 1.2).all()
    assert (found.vertex[to_rim == 0] > 0.3).all()
    assert found.vertex[to_rim > 14] == pytest.approx(5)
    assert (found.vertex <= 1.2 + 0.4 * to_rim * math.sqrt(2)).all()
    # All of it at twice the thickness would be 46 000 triangles.
    assert found.estimate < 10_000


def test_curved_wall_keeps_its_sides_apart():
    shell = joined(sphere(20, subdivisions=5), flipped(sphere(19.9, subdivisions=5)))
    found = sizing(shell, deviation_mm=0.5, longest_mm=10, shortest_mm=0.01)
    assert found.vertex == pytest.approx(chord_length(20, 0.15 * 0.1), rel=0.25)
    assert found.vertex.mean() == pytest.approx(chord_length(20, 0.15 * 0.1), rel=0.1)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.05, 1.0))
def test_targets_change_by_no_more_than_the_gradation(seed, gradation):
    generator = np.random.default_rng(seed)
    mesh = sphere(10, subdivisions=3)
    bumpy = Mesh(mesh.vertices * generator.uniform(0.9, 1.1, (len(mesh.vertices), 1)), mesh.faces)
    found = sizing(bumpy, deviation_mm=0.05, longest_mm=20, shortest_mm=0.01, gradation=gradation)
    edges = edges_of(bumpy)
    lengths = np.linalg.norm(bumpy.vertices[edges[:, 0]] - bumpy.vertices[edges[:, 1]], axis=1)
    assert (np.abs(found.vertex[edges[:, 0]] - found.vertex[edges[:, 1]]) <= gradation * lengths * (1 + 1e-12)).all()
    assert found.vertex.min() >= 0.01 and found.vertex.max() <= 20
    assert found.face == pytest.approx(found.vertex[bumpy.faces].mean(axis=1))


def test_gradation_lets_a_small_part_shrink_its_surroundings_alone():
    # One raised vertex on a large flat box.
    mesh = divided_box((0, 0, 0), (40, 40, 40), (40, 40, 40))
    vertices = mesh.vertices.copy()
    centre = np.array([20, 20, 40])
    distance = np.linalg.norm(vertices - centre, axis=1)
    vertices[distance == 0] += (0, 0, 0.4)
    found = sizing(Mesh(vertices, mesh.faces), deviation_mm=0.05, longest_mm=8, shortest_mm=0.1)
    assert found.vertex[distance == 0] < 3
    # Along the edges of a square grid, and over the bump.
    assert (found.vertex <= found.vertex[distance == 0] + 0.4 * (distance * math.sqrt(2) + 0.5)).all()
    assert found.vertex[distance > 22] == pytest.approx(8)


def test_slivers_and_noise_do_not_count_as_curvature():
    mesh = sphere(10, subdivisions=4)
    generator = np.random.default_rng(0)
    # A vertex close to a corner of every twentieth face, a little off its plane: needles and a tiny fan.
    chosen = np.arange(0, len(mesh.faces), 20)
    corners = mesh.vertices[mesh.faces[chosen]]
    inner = np.einsum("fkd,k->fd", corners, (0.998, 0.001, 0.001))
    inner += generator.normal(size=inner.shape) * 1e-4
    new = np.arange(len(chosen)) + len(mesh.vertices)
    a, b, c = mesh.faces[chosen].T
    fans = np.concatenate([np.column_stack(t) for t in ((a, b, new), (b, c, new), (c, a, new))])
    spoiled = Mesh(np.vstack((mesh.vertices, inner)), np.vstack((np.delete(mesh.faces, chosen, axis=0), fans)))
    limits = {"deviation_mm": 0.1, "longest_mm": 8, "shortest_mm": 0.5}
    expected = chord_length(10, 0.1)
    found = sizing(spoiled, **limits).vertex
    # Faces tilted by up to 40 degrees; without the signs of their angles the targets come down to half.
    assert np.median(found) == pytest.approx(expected, rel=0.05)
    assert np.quantile(found, 0.05) > 0.85 * expected
    assert found.min() > 0.65 * expected
    noisy = Mesh(mesh.vertices * (1 + 2e-4 * generator.normal(size=(len(mesh.vertices), 1))), mesh.faces)
    assert sizing(noisy, **limits).vertex == pytest.approx(expected, rel=0.25)
    assert sizing(noisy, **limits).vertex.mean() == pytest.approx(expected, rel=0.05)


def test_degenerate_open_and_non_manifold_surfaces_have_sizes():
    bad = Mesh(box().vertices, np.vstack((box().faces, [(0, 1, 4), (3, 3, 5), (0, 1, 1)])))
    lonely = Mesh(np.vstack((box().vertices, [(50, 50, 50)])), box().faces[1:])
    turned = Mesh(sphere().vertices, np.vstack((sphere().faces[:50, ::-1], sphere().faces[50:])))
    for mesh in (bad, lonely, turned, joined(box(), box())):
        found = sizing(mesh, deviation_mm=0.1, longest_mm=3, shortest_mm=0.3)
        assert ((found.vertex >= 0.3) & (found.vertex <= 3)).all()
        assert np.isfinite(found.face).all()
    # Two coincident sheets: no wall at all, so the shortest edges at the creases, and no nan.
    double = joined(box(), flipped(box()))
    assert sizing(double, deviation_mm=0.1, longest_mm=3, shortest_mm=0.3).vertex == pytest.approx(0.3)


def test_budget_makes_all_edges_longer():
    mesh = joined(sphere(10, subdivisions=4), moved(sphere(2, subdivisions=3), (30, 0, 0)))
    limits = {"deviation_mm": 0.01, "longest_mm": 2, "shortest_mm": 0.1}
    free = sizing(mesh, **limits)
    assert sizing(mesh, **limits, budget_triangles=free.estimate + 1).estimate == free.estimate
    for budget in (free.estimate // 3, 200, 20):
        found = sizing(mesh, **limits, budget_triangles=budget)
        assert 0.9 * budget <= found.estimate <= budget
        assert (found.vertex > free.vertex).all()
        # Graded within each sphere, far apart from the other: one factor for all.
        ratio = found.vertex / free.vertex
        assert ratio.max() < 1.1 * ratio.min()


def test_walls_of_plate_shell_and_wedge():
    plate = divided_box((0, 0, 0), (10, 10, 0.5), (4, 4, 1))
    found = walls(plate)
    flat = np.ptp(plate.vertices[plate.faces][:, :, 2], axis=1) == 0
    assert found[flat] == pytest.approx(0.5)
    assert found[~flat] == pytest.approx(10)
    # A wedge of 60 degrees: the side across is no other side of a wall.
    wedge = Mesh(
        [(0, 0, 0), (2, 0, 0), (1, 0, 3**0.5), (0, 9, 0), (2, 9, 0), (1, 9, 3**0.5)],
        [(0, 1, 2), (3, 5, 4), (0, 3, 4), (0, 4, 1), (1, 4, 5), (1, 5, 2), (2, 5, 3), (2, 3, 0)],
    )
    found = walls(wedge)
    assert found[:2] == pytest.approx(9)
    assert np.isinf(found[2:]).all()
    assert np.isinf(walls(flipped(box()))).all()


def test_limits_of_a_sphere():
    mesh = sphere(100, subdivisions=4)
    limits = propose_limits(mesh, deviation_mm=0.1)
    edges = edges_of(mesh)
    mean = np.linalg.norm(mesh.vertices[edges[:, 0]] - mesh.vertices[edges[:, 1]], axis=1).mean()
    assert limits.longest_mm == pytest.approx(mean, rel=0.02)
    assert limits.shortest_mm == pytest.approx(0.3 * limits.longest_mm)
    assert limits.deviation_mm == 0.1
    assert limits.wall_mm == pytest.approx(200, rel=0.01)
    assert propose_limits(mesh, deviation_mm=0.1, longest_mm=3).longest_mm == 3
    # Repair made ten faces of each: back to about twice as many as there were.
    few = propose_limits(mesh, deviation_mm=0.1, input_triangles=len(mesh.faces) // 10)
    assert few.longest_mm == pytest.approx(mean * math.sqrt(5), rel=0.02)


def test_limits_of_thin_walls_and_of_coarse_meshes():
    plate = divided_box((0, 0, 0), (100, 100, 0.2), (50, 50, 1))
    limits = propose_limits(plate, deviation_mm=0.1)
    assert limits.wall_mm == pytest.approx(0.2)
    assert limits.deviation_mm == pytest.approx(0.15 * 0.2)
    assert limits.shortest_mm == pytest.approx(0.12 * limits.longest_mm)
    # Not without end.
    film = divided_box((0, 0, 0), (100, 100, 1e-3), (50, 50, 1))
    size = math.hypot(100, 100, 1e-3)
    assert propose_limits(film, deviation_mm=0.1).deviation_mm == pytest.approx(2e-5 * size)
    assert propose_limits(film, deviation_mm=1e-4).deviation_mm == 1e-4
    coarse = propose_limits(box(), deviation_mm=0.01)
    assert coarse.longest_mm == pytest.approx(math.hypot(10, 10, 10) / 12)
    with pytest.raises(ValueError, match="area"):
        propose_limits(Mesh(np.zeros((3, 3)), [(0, 1, 2)]), deviation_mm=0.1)


@pytest.mark.parametrize(
    "wrong",
    [
        {"shortest_mm": 3.0, "longest_mm": 2.0},
        {"shortest_mm": 0.0},
        {"deviation_mm": 0.0},
        {"longest_mm": math.nan},
        {"gradation": 0.0},
        {"budget_triangles": 0},
    ],
)
def test_impossible_limits_are_refused(wrong):
    limits = {"deviation_mm": 0.1, "longest_mm": 2.0, "shortest_mm": 0.3, **wrong}
    with pytest.raises(ValueError, match="impossible"):
        sizing(box(), **limits)


def test_real_meshes_have_sizes_within_the_limits(shared_data):
    for path in sorted(shared_data.glob("*/*.stl"))[::25]:
        mesh = read_mesh(path).mesh
        if not area_of(mesh) > 0:
            continue
        thickness = walls(mesh)
        limits = propose_limits(mesh, deviation_mm=0.1, wall_thickness=thickness)
        assert limits == propose_limits(mesh, deviation_mm=0.1)
        assert 0 < limits.shortest_mm <= limits.longest_mm and 0 < limits.deviation_mm <= 0.1, path
        lengths = {
            "deviation_mm": limits.deviation_mm,
            "longest_mm": limits.longest_mm,
            "shortest_mm": limits.shortest_mm,
        }
        found = sizing(mesh, **lengths, wall_thickness=thickness)
        assert ((found.vertex >= limits.shortest_mm) & (found.vertex <= limits.longest_mm)).all(), path
        assert np.array_equal(found.vertex, sizing(mesh, **lengths).vertex)
