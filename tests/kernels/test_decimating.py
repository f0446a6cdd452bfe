"""Decimation by guarded collapses."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from remeshing_checks import assert_valid, hausdorff, is_closed, measure, n_contacts, single, tube
from shapes import box, joined, moved, sphere

from vhp_cli.kernels import surface
from vhp_cli.kernels.decimating import decimate, want_volumes, wanted_volumes
from vhp_cli.kernels.remeshing import Remesher
from vhp_cli.mesh import Mesh

METHODS = ("quadric", "midpoint", "removal")


def volume(vertices, faces) -> float:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float((a * np.cross(b, c)).sum() / 6)


def fine_box(parts: int) -> Mesh:
    """A box of 10 mm with a grid of squares, each cut in two, on each side."""
    grid = np.linspace(0, 10, parts + 1)
    number: dict[tuple[float, ...], int] = {}
    faces = []
    for axis in range(3):
        for side in (0.0, 10.0):
            for i in range(parts):
                for j in range(parts):
                    square = []
                    for u, v in ((i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)):
                        point = [0.0, 0.0, 0.0]
                        point[axis], point[(axis + 1) % 3], point[(axis + 2) % 3] = side, grid[u], grid[v]
                        square.append(number.setdefault(tuple(point), len(number)))
                    a, b, c, d = square if side else square[::-1]
                    faces += [(a, b, c), (a, c, d)]
    return Mesh(single(np.array(list(number))), np.array(faces))


def y_nerve(radius=0.5) -> Mesh:
    """Three tubes of 1 mm width that meet, as one surface with triangles of many sizes."""
    trimesh = pytest.importorskip("trimesh")
    manifold3d = pytest.importorskip("manifold3d")
    ends = [(0, 0, -60), (40, 0, 60), (-40, 0, 60)]
    parts = []
    for end in ends:
        made = trimesh.creation.cylinder(radius, segment=[(0, 0, 0), end], sections=16)
        mesh = manifold3d.Mesh(made.vertices.astype(np.float32), made.faces.astype(np.uint32))
        parts.append(manifold3d.Manifold(mesh))
    whole = sum(parts[1:], parts[0]).refine_to_length(2.0).to_mesh()
    return Mesh(np.asarray(whole.vert_properties[:, :3], float), np.asarray(whole.tri_verts, np.int32))


def bumpy(subdivisions=4) -> Mesh:
    ball = sphere(10, subdivisions=subdivisions)
    x, y, z = ball.vertices.T
    return Mesh(single(ball.vertices * (1 + 0.05 * np.sin(x) * np.cos(y + 0.5 * z))[:, None]), ball.faces)


@pytest.mark.parametrize("method", METHODS)
def test_decimate_to_a_third(method):
    mesh = bumpy()
    made = decimate(mesh.vertices, mesh.faces, target_triangles=1740, method=method, min_quality=0.1)
    topology, quality = assert_valid(made.vertices, made.faces)
    assert made.ending == "target"
    assert len(made.faces) == 1740
    assert topology.n_components == 1
    assert quality.q.min() >= 0.1
    assert (np.diff(made.errors) >= 0).all()
    assert len(made.errors) == (len(mesh.faces) - 1740) // 2


def test_quadric_keeps_volume_and_shape():
    mesh = bumpy()
    made = decimate(mesh.vertices, mesh.faces, target_triangles=len(mesh.faces) // 3, min_quality=0.2)
    assert volume(made.vertices, made.faces) == pytest.approx(volume(mesh.vertices, mesh.faces), rel=1e-4)
    halves = decimate(mesh.vertices, mesh.faces, target_triangles=len(mesh.faces) // 3, method="midpoint")
    ours = hausdorff((mesh.vertices, mesh.faces), (made.vertices, made.faces))
    assert ours < 0.6 * hausdorff((mesh.vertices, mesh.faces), (halves.vertices, halves.faces))


def test_planes_are_left_with_their_corners():
    mesh = fine_box(8)
    exact = decimate(mesh.vertices, mesh.faces, max_error=1e-4)
    assert exact.ending == "error"
    assert len(exact.faces) == 12
    corners = {tuple(corner) for corner in np.abs(exact.vertices.round(6)).tolist()}
    assert corners == {(x, y, z) for x in (0.0, 10.0) for y in (0.0, 10.0) for z in (0.0, 10.0)}
    assert volume(exact.vertices, exact.faces) == pytest.approx(1000, rel=1e-9)


def quadrics(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Weight, and (V, 4, 4) sums of the planes of the faces at each vertex, by their definition."""
    sums, weights = np.zeros((len(mesh.vertices), 4, 4)), np.zeros(len(mesh.vertices))
    for face in mesh.faces:
        a, b, c = mesh.vertices[face]
        normal = np.cross(b - a, c - a)
        area = np.linalg.norm(normal) / 2
        plane = np.append(normal / (2 * area), -normal @ a / (2 * area))
        for vertex in face:
            sums[vertex] += area * np.outer(plane, plane)
            weights[vertex] += area
    return sums, weights


def test_first_error_is_the_least_of_all_edges():
    rng = np.random.default_rng(3)
    ball = sphere(10, subdivisions=1)
    mesh = Mesh(single(ball.vertices * (1 + 0.1 * rng.random((len(ball.vertices), 1)))), ball.faces)
    sums, weights = quadrics(mesh)
    edges = np.unique(np.sort(mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    best, at_ends = [], []
    for a, b in edges:
        q, weight = sums[a] + sums[b], weights[a] + weights[b]
        x = np.append(np.linalg.solve(q[:3, :3], -q[:3, 3]), 1)
        best.append(x @ q @ x / weight)
        at_ends += [np.append(mesh.vertices[v], 1) @ q @ np.append(mesh.vertices[v], 1) / weight for v in (a, b)]
    n = len(mesh.faces)
    found = decimate(mesh.vertices, mesh.faces, target_triangles=n - 2, method="quadric")
    # Costs are taken in classes a factor of 1.03 wide; edges add 1e-7 of their squared length.
    assert found.errors[0] == pytest.approx(np.sqrt(min(best)), rel=0.02)
    found = decimate(mesh.vertices, mesh.faces, target_triangles=n - 2, method="removal")
    assert found.errors[0] == pytest.approx(np.sqrt(min(at_ends)), rel=0.02)


def test_midpoint_takes_the_shortest_edge():
    ball = sphere(10, subdivisions=1)
    vertices = ball.vertices.copy()
    a, b = ball.faces[0, :2]
    vertices[b] += 0.5 * (vertices[a] - vertices[b])
    vertices = single(vertices)
    made = decimate(vertices, ball.faces, target_triangles=len(ball.faces) - 2, method="midpoint")
    middle = single((vertices[a] + vertices[b]) / 2)
    assert (np.abs(made.vertices - middle).sum(axis=1) == 0).sum() == 1
    assert len(made.vertices) == len(vertices) - 1
    assert made.errors[0] == pytest.approx(np.linalg.norm(vertices[a] - vertices[b]), rel=1e-6)


def test_removal_adds_no_vertex():
    mesh = bumpy(3)
    made = decimate(mesh.vertices, mesh.faces, target_triangles=400, method="removal")
    given_vertices = {tuple(vertex) for vertex in mesh.vertices.tolist()}
    assert all(tuple(vertex) in given_vertices for vertex in made.vertices.tolist())


@pytest.mark.parametrize("limit", [0.3, 0.1, 0.03])
def test_deviation_stays_within_the_limit(limit):
    mesh = bumpy()
    made = decimate(mesh.vertices, mesh.faces, max_deviation=limit)
    assert_valid(made.vertices, made.faces)
    assert made.ending == "refused"
    assert max(made.last_refused, key=made.last_refused.get) == "deviation"
    assert len(made.faces) < 0.9 * len(mesh.faces)
    # Guards look at vertices and centres.
    assert hausdorff((mesh.vertices, mesh.faces), (made.vertices, made.faces)) < 1.5 * limit


def test_edge_length():
    mesh = bumpy()
    edges = surface.topology(mesh.vertices, mesh.faces).inner_edges
    before = np.linalg.norm(np.subtract(*mesh.vertices[edges.T]), axis=1).mean()
    made = decimate(mesh.vertices, mesh.faces, edge_length=2 * before)
    edges = surface.topology(made.vertices, made.faces).inner_edges
    mean = np.linalg.norm(np.subtract(*made.vertices[edges.T]), axis=1).mean()
    assert made.ending == "edge length"
    assert 2 * before <= mean < 2.1 * before


@pytest.mark.parametrize("bend", [0.0, 20.0])
@pytest.mark.parametrize("method", METHODS)
def test_thin_tube_stays_sound(method, bend):
    mesh = tube(radius=0.5, sides=12, rings=200, bend=bend)
    target = round(0.34 * len(mesh.faces))
    made = decimate(mesh.vertices, mesh.faces, target_triangles=target, method=method)
    assert_valid(made.vertices, made.faces)
    assert len(made.faces) <= target
    if method == "quadric":
        assert volume(made.vertices, made.faces) == pytest.approx(volume(mesh.vertices, mesh.faces), rel=1e-3)


def test_y_nerve_stays_sound():
    mesh = y_nerve()
    assert is_closed(measure(mesh.vertices, mesh.faces)[0])
    made = decimate(mesh.vertices, mesh.faces, target_triangles=round(0.34 * len(mesh.faces)))
    topology, _ = measure(made.vertices, made.faces)
    assert is_closed(topology)
    assert n_contacts(made.vertices, made.faces) <= n_contacts(mesh.vertices, mesh.faces)
    assert volume(made.vertices, made.faces) == pytest.approx(volume(mesh.vertices, mesh.faces), rel=1e-2)


def test_near_sheets_do_not_meet():
    # Unguarded, the coarse inner ball would come out of the outer one.
    inner, outer = sphere(10, subdivisions=4), sphere(10.02, subdivisions=4)
    both = joined(outer, Mesh(inner.vertices, inner.faces[:, ::-1]))
    both = Mesh(single(both.vertices), both.faces)
    free = decimate(both.vertices, both.faces, target_triangles=700, check_contacts=False)
    assert n_contacts(free.vertices, free.faces) > 0
    made = decimate(both.vertices, both.faces, target_triangles=700)
    assert_valid(made.vertices, made.faces)


def test_boundary_stays():
    ball = bumpy(4)
    faces = ball.faces[ball.vertices[ball.faces].mean(axis=1)[:, 2] > 0]
    topology = surface.topology(ball.vertices, faces)
    rim = {tuple(v) for v in ball.vertices[np.unique(topology.boundary_edges)].tolist()}
    made = decimate(ball.vertices, faces, target_triangles=len(faces) // 3)
    after = surface.topology(made.vertices, made.faces)
    assert {tuple(v) for v in made.vertices[np.unique(after.boundary_edges)].tolist()} == rim
    assert len(after.boundary_edges) == len(topology.boundary_edges)
    assert len(made.faces) <= len(faces) // 3
    assert n_contacts(made.vertices, made.faces) == 0
    assert np.isnan(made.volumes).all()


def test_parts_are_kept():
    mesh = joined(bumpy(3), moved(box(), (50, 0, 0)), moved(bumpy(2), (0, 50, 0)))
    mesh = Mesh(single(mesh.vertices), mesh.faces)
    made = decimate(mesh.vertices, mesh.faces, target_triangles=4)
    topology, _ = measure(made.vertices, made.faces)
    assert topology.n_components == 3
    assert is_closed(topology)
    assert len(np.unique(made.volumes)) == 3
    assert 1000.0 in made.volumes.round(9)


def test_volumes_are_restored():
    mesh = bumpy(3)
    made = decimate(mesh.vertices, mesh.faces, target_triangles=400, method="midpoint")
    wanted = volume(mesh.vertices, mesh.faces)
    assert volume(made.vertices, made.faces) < 0.995 * wanted
    remesher = Remesher(made.vertices, made.faces, sizes=2.0, deviation=1.0)
    want_volumes(remesher, made.volumes)
    assert np.allclose(wanted_volumes(remesher), wanted)
    remesher.restore_volume(rounds=20)
    assert volume(*remesher.result()) == pytest.approx(wanted, rel=1e-3)


def test_same_input_same_result():
    mesh = bumpy()
    runs = [decimate(mesh.vertices, mesh.faces, target_triangles=1000, max_deviation=0.5) for _ in range(2)]
    assert runs[0].vertices.tobytes() == runs[1].vertices.tobytes()
    assert runs[0].faces.tobytes() == runs[1].faces.tobytes()


def test_nothing_to_do():
    mesh = sphere(subdivisions=1)
    made = decimate(mesh.vertices, mesh.faces, target_triangles=len(mesh.faces))
    assert (made.vertices == mesh.vertices).all() and (made.faces == mesh.faces).all()
    assert not len(made.errors)
    assert len(decimate(np.empty((0, 3)), np.empty((0, 3), int)).faces) == 0


@pytest.mark.parametrize(
    "wrong",
    [{"method": "best"}, {"edge_length": 0}, {"max_error": -1}, {"max_deviation": np.nan}, {"min_quality": 2}],
)
def test_wrong_settings_are_refused(wrong):
    mesh = sphere(subdivisions=1)
    with pytest.raises(ValueError, match=next(iter(wrong)) if "method" not in wrong else "method"):
        decimate(mesh.vertices, mesh.faces, **wrong)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    noise=st.floats(0, 0.5),
    share=st.floats(0.05, 0.9),
    method=st.sampled_from(METHODS),
    limited=st.booleans(),
)
def test_sound_stays_sound(seed, noise, share, method, limited):
    rng = np.random.default_rng(seed)
    ball = sphere(10, subdivisions=2)
    squash = np.diag(10 ** rng.uniform(-1.5, 0, 3))
    # A star-shaped surface has no contact with itself.
    vertices = single(ball.vertices * (1 - noise * rng.random((len(ball.vertices), 1))) @ squash)
    if n_contacts(vertices, ball.faces):
        return
    made = decimate(
        vertices,
        ball.faces,
        target_triangles=int(share * len(ball.faces)),
        method=method,
        max_deviation=0.2 if limited else np.inf,
    )
    assert_valid(made.vertices, made.faces)
    assert made.ending in ("target", "refused")


def test_broken_input_gets_no_worse():
    crossing = joined(sphere(10, subdivisions=3), sphere(10, (8, 0, 0), subdivisions=3), moved(sphere(5), (0, 15, 0)))
    crossing = Mesh(single(crossing.vertices), crossing.faces)
    before = n_contacts(crossing.vertices, crossing.faces)
    made = decimate(crossing.vertices, crossing.faces, target_triangles=700)
    assert 0 < n_contacts(made.vertices, made.faces) <= before
    assert is_closed(measure(made.vertices, made.faces)[0])


@pytest.mark.slow
def test_time_grows_linearly():
    def seconds(subdivisions):
        mesh = bumpy(subdivisions)
        started = time.process_time()
        decimate(mesh.vertices, mesh.faces, target_triangles=len(mesh.faces) // 3)
        return time.process_time() - started

    assert min(seconds(7) for _ in range(2)) < 4 * 2 * min(seconds(6) for _ in range(3))
