"""Smoothing against its equations written plainly, other programs, and closed forms."""

from __future__ import annotations

import itertools
import math
import time
from fractions import Fraction

import numpy as np
import pytest
import smoothing_reference as reference
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from shapes import box, flipped, joined, moved, sphere

from vhp_cli.kernels.smoothing import (
    CORRECTIONS,
    METHODS,
    UPDATES,
    Smoothing,
    adjacency,
    delaunay_flips,
    smooth_vertices,
    smoothing_steps,
)
from vhp_cli.kernels.surface import topology
from vhp_cli.mesh import Mesh

GOLDEN = (1 + 5**0.5) / 2


def torus(around=12, across=8, seed=1):
    """A torus, outward, slightly noisy; every vertex has six neighbours."""
    i, j = np.meshgrid(np.arange(around), np.arange(across), indexing="ij")
    u, w = 2 * np.pi * i / around, 2 * np.pi * j / across
    points = np.stack([(3 + np.cos(w)) * np.cos(u), (3 + np.cos(w)) * np.sin(u), np.sin(w)], axis=-1).reshape(-1, 3)
    a, b = (i * across + j).ravel(), ((i + 1) % around * across + j).ravel()
    c, d = ((i + 1) % around * across + (j + 1) % across).ravel(), (i * across + (j + 1) % across).ravel()
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return Mesh(points + np.random.default_rng(seed).normal(scale=0.03, size=points.shape), faces)


def noisy_sphere(seed=0, scale=0.04, subdivisions=1):
    mesh = sphere(1, subdivisions=subdivisions)
    noise = np.random.default_rng(seed).normal(scale=scale, size=mesh.vertices.shape)
    return Mesh(mesh.vertices + noise, mesh.faces)


def opened(mesh):
    """Without the faces around some vertices, which remain unreferenced."""
    return Mesh(mesh.vertices, mesh.faces[(mesh.faces > 2).all(axis=1)])


def grid(n=6, seed=0):
    """A square in the plane z = 0 with random inner vertices."""
    x, y = (values.ravel() for values in np.meshgrid(np.arange(n + 1.0), np.arange(n + 1.0), indexing="ij"))
    inner = (x > 0) & (x < n) & (y > 0) & (y < n)
    points = np.stack([x, y, 0 * x], axis=1)
    points[inner, :2] += np.random.default_rng(seed).uniform(-0.3, 0.3, (inner.sum(), 2))
    a = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    faces = np.concatenate([np.stack([a, a + n + 1, a + n + 2], axis=1), np.stack([a, a + n + 2, a + 1], axis=1)])
    return Mesh(points, faces), inner


SHAPES = {"closed": noisy_sphere(), "open": opened(noisy_sphere(1)), "torus": torus(6, 4)}
EXTRA = {"hc": {"alpha": 0.2, "beta": 0.6}, "taubin": {"step": 0.4, "taubin_mu": -0.45}}


# ---------------------------------------------------------------- against the equations


@pytest.mark.parametrize("correction", CORRECTIONS)
@pytest.mark.parametrize("update", UPDATES)
@pytest.mark.parametrize("method", METHODS)
def test_agrees_with_the_equations(method, update, correction):
    for (name, mesh), tangential in itertools.product(SHAPES.items(), (False, True)):
        chosen = {"method": method, "update": update, "correction": correction, "tangential": tangential}
        chosen |= EXTRA.get(correction, {"step": 0.8})
        fixed = np.zeros(len(mesh.vertices), bool)
        fixed[7] = name == "torus"
        found = smooth_vertices(mesh.vertices, mesh.faces, iterations=2, fixed=fixed, **chosen)
        expected = reference.smooth(mesh.vertices, mesh.faces, 2, fixed=fixed, **chosen)
        assert abs(expected - mesh.vertices).max() > 1e-3
        assert_allclose(found, expected, rtol=0, atol=1e-12, err_msg=f"{name} {chosen}")


coordinates = st.integers(-4, 4)


@st.composite
def soups(draw):
    """Faces at random, collapsed and repeated ones too, and each once more reversed: so no edge is a boundary."""
    n_vertices = draw(st.integers(3, 9))
    points = draw(st.lists(st.tuples(coordinates, coordinates, coordinates), min_size=n_vertices, max_size=n_vertices))
    vertex = st.integers(0, n_vertices - 1)
    faces = draw(st.lists(st.tuples(vertex, vertex, vertex), max_size=8))
    doubled = draw(st.booleans())
    return np.array(points, float), np.array(faces + [face[::-1] for face in faces] * doubled, int).reshape(-1, 3)


@given(soups(), st.sampled_from(METHODS), st.sampled_from(UPDATES), st.booleans())
@settings(max_examples=150, deadline=None)
def test_soups_agree_with_the_equations(soup, method, update, tangential):
    points, faces = soup
    # Once vertices have moved, rounding decides whether collinear corners have an area.
    update = "simultaneous" if method.startswith("wcc") else update
    found = smooth_vertices(points, faces, method=method, update=update, tangential=tangential, step=0.7)
    expected = reference.smooth(points, faces, 1, method=method, update=update, tangential=tangential, step=0.7)
    # Circumradii reach 1e3 here.
    assert_allclose(found, expected, rtol=1e-12, atol=1e-10 if method.startswith("wcc") else 1e-12)


@given(soups())
@settings(max_examples=120, deadline=None)
def test_adjacency(soup):
    points, faces = soup
    found = adjacency(len(points), faces)
    corners = [c for f, face in enumerate(faces) if len(set(face.tolist())) == 3 for c in range(3 * f, 3 * f + 3)]
    assert sorted(found.corners.tolist()) == corners
    neighbours = reference.neighbours_of(len(points), faces)
    for v in range(len(points)):
        mine = found.corners[found.corner_offsets[v] : found.corner_offsets[v + 1]].tolist()
        assert mine == sorted(mine)
        assert all(faces.ravel()[corner] == v for corner in mine)
        near = found.neighbours[found.neighbour_offsets[v] : found.neighbour_offsets[v + 1]].tolist()
        assert len(near) == len(neighbours[v])
        assert set(near) == neighbours[v]
    assert_array_equal(found.boundary, reference.boundary_of(len(points), faces))


@given(soups(), st.sampled_from(METHODS), st.sampled_from(UPDATES), st.sampled_from(CORRECTIONS), st.booleans())
@settings(max_examples=150, deadline=None)
def test_any_soup_gives_finite_vertices_and_the_boundary_stays(soup, method, update, correction, tangential):
    points, faces = soup
    found = smooth_vertices(
        points, faces, method=method, update=update, correction=correction, tangential=tangential, iterations=3
    )
    assert np.isfinite(found).all()
    stays = reference.boundary_of(len(points), faces)
    stays[[v for v in range(len(points)) if v not in faces]] = True
    assert_array_equal(found[stays], points[stays])


# ---------------------------------------------------------------- against other programs


def by_meshlab(pymeshlab, mesh, filter_name, **parameters):
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(mesh.vertices, mesh.faces))
    getattr(meshes, filter_name)(**parameters)
    return meshes.current_mesh().vertex_matrix()


def test_meshlab_laplacian(pymeshlab):
    """MeshLab's mean holds every neighbour twice and the vertex once: a step of 2 k / (2 k + 1), here 12 / 13."""
    mesh = torus()
    theirs = by_meshlab(
        pymeshlab, mesh, "apply_coord_laplacian_smoothing", stepsmoothnum=4, cotangentweight=False, boundary=True
    )
    assert_allclose(theirs, smooth_vertices(mesh.vertices, mesh.faces, step=12 / 13, iterations=4), atol=1e-12)


def test_meshlab_laplacian_moves_the_boundary(pymeshlab):
    """There, a boundary vertex moves towards its two neighbours on the boundary; the inner ones are as here."""
    mesh = torus()
    mesh = Mesh(mesh.vertices, mesh.faces[:-1])
    theirs = by_meshlab(
        pymeshlab, mesh, "apply_coord_laplacian_smoothing", stepsmoothnum=1, cotangentweight=False, boundary=True
    )
    ours = smooth_vertices(mesh.vertices, mesh.faces, step=12 / 13)
    boundary = adjacency(len(mesh.vertices), mesh.faces).boundary
    assert boundary.sum() == 3
    assert_allclose(theirs[~boundary], ours[~boundary], atol=1e-12)
    assert_array_equal(ours[boundary], mesh.vertices[boundary])
    assert (theirs[boundary] != mesh.vertices[boundary]).any(axis=1).all()


def test_meshlab_taubin(pymeshlab):
    mesh = noisy_sphere(subdivisions=2)
    # Two float32 numbers, which is what MeshLab makes of its parameters.
    theirs = by_meshlab(pymeshlab, mesh, "apply_coord_taubin_smoothing", lambda_=0.5, mu=-0.53125, stepsmoothnum=5)
    ours = smooth_vertices(mesh.vertices, mesh.faces, correction="taubin", step=0.5, taubin_mu=-0.53125, iterations=5)
    assert_allclose(theirs, ours, atol=1e-12)


def test_meshlab_hc_has_the_other_sign(pymeshlab):
    """With alpha = 0 and beta = 1/2, MeshLab adds the mean of b over the neighbours; Vollmer et al. subtract it."""
    mesh = torus()
    theirs = by_meshlab(pymeshlab, mesh, "apply_coord_hc_laplacian_smoothing")
    p = smooth_vertices(mesh.vertices, mesh.faces)
    b = p - mesh.vertices
    mean_b = smooth_vertices(b, mesh.faces)
    assert_allclose(theirs, p - 0.5 * b + 0.5 * mean_b, atol=1e-12)
    ours = smooth_vertices(mesh.vertices, mesh.faces, correction="hc", alpha=0, beta=0.5)
    assert_allclose(ours, p - 0.5 * b - 0.5 * mean_b, atol=1e-12)


def test_trimesh_filters():
    """On closed meshes all three are the same there; trimesh counts each of Taubin's passes as an iteration."""
    trimesh = pytest.importorskip("trimesh")
    smoothing = pytest.importorskip("trimesh.smoothing")
    pytest.importorskip("scipy")
    mesh = noisy_sphere(subdivisions=2)

    def theirs(name, **parameters):
        copy = trimesh.Trimesh(mesh.vertices.copy(), mesh.faces.copy(), process=False)
        return getattr(smoothing, name)(copy, **parameters).vertices

    def ours(**parameters):
        return smooth_vertices(mesh.vertices, mesh.faces, **parameters)

    assert_allclose(
        ours(step=0.6, iterations=7),
        theirs("filter_laplacian", lamb=0.6, iterations=7, volume_constraint=False),
        atol=1e-12,
    )
    assert_allclose(
        ours(correction="hc", alpha=0.1, beta=0.7, iterations=7),
        theirs("filter_humphrey", alpha=0.1, beta=0.7, iterations=7),
        atol=1e-12,
    )
    assert_allclose(
        ours(correction="taubin", step=0.5, taubin_mu=-0.53, iterations=4),
        theirs("filter_taubin", lamb=0.5, nu=0.53, iterations=8),
        atol=1e-12,
    )


# ---------------------------------------------------------------- closed forms


def test_icosahedron():
    """The mean of the neighbours lies at 1 / sqrt 5 of the radius; all other methods end at a third plus two thirds
    of that, its triangles being equal and equilateral."""
    mesh = sphere(1, subdivisions=0)
    points = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    mean = 1 / 5**0.5
    lumped = 1 / 3 + 2 / 3 * mean
    for method in METHODS:
        factor = mean if method == "standard" else lumped
        assert_allclose(smooth_vertices(points, mesh.faces, method=method), factor * points, atol=1e-14)
        twice = smooth_vertices(points, mesh.faces, method=method, iterations=2, step=0.5)
        assert_allclose(twice, ((1 + factor) / 2) ** 2 * points, atol=1e-14)
        # Perpendicular to the surface: nothing is left of it in the tangent plane.
        assert_allclose(smooth_vertices(points, mesh.faces, method=method, tangential=True), points, atol=1e-14)
        back = smooth_vertices(points, mesh.faces, method=method, correction="volume", iterations=5)
        assert_allclose(back, points, atol=1e-12)
    taubin = smooth_vertices(points, mesh.faces, correction="taubin", step=0.5, taubin_mu=-0.6)
    assert_allclose(taubin, (1 + 0.5 * (mean - 1)) * (1 - 0.6 * (mean - 1)) * points, atol=1e-14)
    hc = smooth_vertices(points, mesh.faces, correction="hc", alpha=0.3, beta=0.6)
    b = mean - 1
    assert_allclose(hc, (mean - (0.6 * b + 0.4 * b * mean)) * points, atol=1e-14)


def test_equal_weight_cvt_is_lumped_at_inner_vertices():
    mesh = torus()
    lumped = smooth_vertices(mesh.vertices, mesh.faces, method="lumped", iterations=5)
    equal = smooth_vertices(mesh.vertices, mesh.faces, method="cvt-equal", iterations=5)
    assert_allclose(equal, lumped, atol=1e-13)


def test_hc_without_freedom_does_not_smooth():
    mesh = noisy_sphere()
    for alpha in (0, 1):
        held = smooth_vertices(mesh.vertices, mesh.faces, correction="hc", alpha=alpha, beta=1, iterations=3)
        assert_allclose(held, mesh.vertices, atol=1e-14)


def test_sequential_uses_positions_already_moved():
    """Two free vertices between five at rest: the second mean holds the first new position."""
    points = np.array([[1, 1, 0], [2, 1, 0], [0, 0, 0], [3, 0, 0], [4, 2, 0], [1, 3, 0], [-1, 2, 0]], float)
    faces = [[0, 2, 3], [0, 3, 1], [1, 3, 4], [1, 4, 5], [0, 1, 5], [0, 5, 6], [0, 6, 2]]
    found = smooth_vertices(points, faces, update="sequential")
    first = points[[1, 2, 3, 5, 6]].mean(axis=0)
    second = np.mean([first, points[3], points[4], points[5]], axis=0)
    assert_allclose(found[:2], [first, second], atol=1e-15)
    assert_array_equal(found[2:], points[2:])


@pytest.mark.parametrize("method", METHODS)
def test_regular_sphere_keeps_its_centre_and_plane_stays_plane(method):
    ball = sphere(10, subdivisions=2)
    found = smooth_vertices(ball.vertices, ball.faces, method=method, iterations=10)
    assert_allclose(found.mean(axis=0), 0, atol=1e-13)
    assert np.linalg.norm(found, axis=1).max() < 10
    flat, inner = grid()
    for update in UPDATES:
        found = smooth_vertices(flat.vertices, flat.faces, method=method, update=update, iterations=10)
        assert_array_equal(found[:, 2], 0)
        assert_array_equal(found[~inner], flat.vertices[~inner])
        assert (found[inner] != flat.vertices[inner]).any()


def test_standard_smoothing_of_a_square_converges_to_the_regular_grid():
    """The harmonic positions, whether simultaneous or sequential (thesis 2.3.4: the limits are the same)."""
    flat, inner = grid(5)
    for update in UPDATES:
        found = smooth_vertices(flat.vertices, flat.faces, update=update, iterations=400)
        assert_allclose(found[:, 0], np.repeat(np.arange(6.0), 6), atol=1e-10)
        assert_allclose(found[:, 1], np.tile(np.arange(6.0), 6), atol=1e-10)
    assert inner.sum() == 16


@given(
    st.sampled_from(METHODS), st.sampled_from(UPDATES), st.sampled_from(CORRECTIONS), st.booleans(), st.integers(0, 99)
)
@settings(max_examples=60, deadline=None)
def test_moves_with_the_mesh(method, update, correction, tangential, seed):
    """Rotation, shift and scaling of the mesh do the same to the result."""
    mesh = noisy_sphere(seed)
    chosen = {"method": method, "update": update, "correction": correction, "tangential": tangential}
    rotation, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    rotation *= np.linalg.det(rotation)
    plain = smooth_vertices(mesh.vertices, mesh.faces, iterations=2, **chosen)
    placed = smooth_vertices(3 * mesh.vertices @ rotation + [7, -2, 5], mesh.faces, iterations=2, **chosen)
    assert_allclose(placed, 3 * plain @ rotation + [7, -2, 5], atol=1e-11)


# ---------------------------------------------------------------- volume


def exact_volume(vertices, faces):
    """In rational arithmetic."""
    total = Fraction(0)
    for face in np.asarray(faces).tolist():
        (ax, ay, az), (bx, by, bz), (cx, cy, cz) = ([Fraction(x) for x in vertices[v].tolist()] for v in face)
        total += ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    return total / 6


@pytest.mark.parametrize("tangential", [False, True])
@pytest.mark.parametrize("method", ["standard", "cvt"])
def test_volume_is_kept_exactly_in_every_component(method, tangential):
    parts = [noisy_sphere(2), moved(torus(), (900, -300, 1500)), flipped(moved(noisy_sphere(3), (5, 0, 0)))]
    mesh = joined(*parts)
    found = smooth_vertices(
        mesh.vertices, mesh.faces, method=method, tangential=tangential, correction="volume", iterations=20
    )
    start = 0
    for part in parts:
        vertices = found[start : start + len(part.vertices)]
        start += len(part.vertices)
        before, after = exact_volume(part.vertices, part.faces), exact_volume(vertices, part.faces)
        assert abs(float((after - before) / before)) < 1e-12
        assert abs(vertices - part.vertices).max() > 0.01


def test_volume_under_an_open_surface_is_kept():
    """With its boundary at rest, the volume between a surface and its old place does not depend on the origin."""
    mesh = opened(noisy_sphere(4))
    found = smooth_vertices(mesh.vertices, mesh.faces, correction="volume", iterations=5)
    for origin in ([0, 0, 0], [3, -1, 2]):
        between = exact_volume(found + origin, mesh.faces) - exact_volume(mesh.vertices + origin, mesh.faces)
        assert abs(float(between)) < 1e-12
    assert abs(found - mesh.vertices).max() > 0.01


def test_volume_on_a_thin_tube_far_away():
    i, j = np.meshgrid(np.arange(200), np.arange(6), indexing="ij")
    points = np.stack([0.4 * np.cos(j * np.pi / 3), 0.4 * np.sin(j * np.pi / 3), 0.3 * i], axis=-1).reshape(-1, 3)
    a, b = 6 * i[:-1] + j[:-1], 6 * i[:-1] + (j[:-1] + 1) % 6
    sides = np.concatenate([np.stack([a, b, b + 6], axis=-1), np.stack([a, b + 6, a + 6], axis=-1)]).reshape(-1, 3)
    low, high = len(points), len(points) + 1
    caps = [[low, (k + 1) % 6, k] for k in range(6)] + [[high, 1194 + k, 1194 + (k + 1) % 6] for k in range(6)]
    points = np.vstack([points, [[0, 0, -0.2], [0, 0, 59.9]]]) + np.array([800, -400, 1300])
    faces = np.concatenate([sides, caps])
    before = exact_volume(points, faces)
    found = smooth_vertices(points, faces, method="lumped", correction="volume", iterations=5)
    assert abs(float((exact_volume(found, faces) - before) / before)) < 1e-12
    shrunk = smooth_vertices(points, faces, method="lumped", iterations=5)
    assert float(exact_volume(shrunk, faces) / before) < 0.5


@pytest.mark.parametrize("flips", [False, True])
def test_a_component_that_would_lose_its_volume_skips_the_iteration(flips):
    """A tetrahedron turns inside out, as each vertex goes to the middle of the three others; a step of 3/4 makes it a
    point. The component beside it is smoothed as it would be alone."""
    points = np.array([[0, 0, 0], [0, 0, 1], [0, 1, 0], [1.5, 0, 0]], float)
    faces = np.array([[1, 2, 0], [3, 1, 0], [2, 3, 0], [2, 1, 3]])
    assert exact_volume(points, faces) > 0
    assert exact_volume(smooth_vertices(points, faces), faces) < 0
    ball = noisy_sphere(6, 0.1, 2)
    mesh = joined(moved(ball, (5, 0, 0)), Mesh(points, faces))
    for step in (1.0, 0.75):
        chosen = Smoothing(step=step, correction="volume")
        alone = itertools.islice(smoothing_steps(moved(ball, (5, 0, 0)).vertices, ball.faces, chosen, flips=flips), 3)
        both = itertools.islice(smoothing_steps(mesh.vertices, mesh.faces, chosen, flips=flips), 3)
        for one, two in zip(alone, both, strict=True):
            assert (one.held, two.held) == (0, 1)
            assert one.flips == two.flips
            assert_array_equal(two.vertices[-4:], points)
            assert_array_equal(two.vertices[:-4], one.vertices)
            assert_array_equal(two.faces[:-4], one.faces)
            assert_array_equal(two.faces[-4:], mesh.faces[-4:])
        assert two.flips >= 0


# ---------------------------------------------------------------- flips


def edges_of(faces):
    """(a, b) -> opposite vertex, for every directed edge."""
    return {(face[k], face[(k + 1) % 3]): face[(k + 2) % 3] for face in np.asarray(faces).tolist() for k in range(3)}


def angle(tip, a, b):
    u, v = a - tip, b - tip
    return math.atan2(np.linalg.norm(np.cross(u, v)), np.dot(u, v))


def surface_area(vertices, faces):
    corners = vertices[faces]
    return np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2


def test_flips_make_a_plane_delaunay():
    spatial = pytest.importorskip("scipy.spatial")
    for seed in range(5):
        points = np.random.default_rng(seed).uniform(size=(300, 2))
        faces = spatial.Delaunay(points).simplices
        sheared = points @ [[1, 0], [4, 1]]
        corners = sheared[faces]
        clockwise = np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0
        faces[clockwise] = faces[clockwise][:, ::-1]
        found, flips = delaunay_flips(np.column_stack([sheared, np.zeros(300)]), faces)
        assert flips > 100
        # Qhull's hull may lack triangles without area at its edge, and so may the one we started from.
        expected = {frozenset(face) for face in spatial.Delaunay(sheared).simplices.tolist()}
        assert len(expected ^ {frozenset(face) for face in found.tolist()}) <= 4


@pytest.mark.parametrize("seed", range(6))
def test_flips_keep_a_manifold_and_leave_no_edge_that_could_be_flipped(seed):
    mesh = noisy_sphere(seed, 0.12, 2)
    mesh = opened(mesh) if seed % 2 else mesh
    found, flips = delaunay_flips(mesh.vertices, mesh.faces)
    assert flips > 10
    assert (len(topology(mesh.vertices, mesh.faces).boundary_edges) > 0) == (seed % 2 == 1)
    before, after = topology(mesh.vertices, mesh.faces), topology(mesh.vertices, found)
    assert (after.euler, after.n_edges, after.n_components) == (before.euler, before.n_edges, before.n_components)
    for defect in (
        after.nonmanifold_edges,
        after.nonmanifold_vertices,
        after.inconsistent_edges,
        after.duplicate_faces,
    ):
        assert len(defect) == 0
    assert_array_equal(after.boundary_edges[np.lexsort(after.boundary_edges.T)],
                       before.boundary_edges[np.lexsort(before.boundary_edges.T)])  # fmt: skip
    assert surface_area(mesh.vertices, found) < surface_area(mesh.vertices, mesh.faces)
    edges, points = edges_of(found), mesh.vertices
    for (a, b), c in edges.items():
        d = edges.get((b, a))
        if d is None or (c, d) in edges or (d, c) in edges:
            continue
        assert angle(points[c], points[a], points[b]) + angle(points[d], points[a], points[b]) < math.pi + 1e-8


def test_flips_leave_constrained_edges_and_tetrahedra():
    # A flat quadrilateral split along its long diagonal.
    points = np.array([[0, 0, 0], [4, 0, 0], [2, 1, 0], [2, -1, 0]], float)
    faces = [[0, 1, 2], [1, 0, 3]]
    found, flips = delaunay_flips(points, faces)
    assert flips == 1
    assert {frozenset(face) for face in found.tolist()} == {frozenset((0, 2, 3)), frozenset((1, 2, 3))}
    corners = points[found]
    assert (np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] > 0).all()
    for constrained, expected in (([1, 1, 0, 0], 0), ([1, 0, 1, 1], 1)):
        assert delaunay_flips(points, faces, constrained=np.array(constrained, bool))[1] == expected
    # The same quadrilateral with a face on the other diagonal's edge: flipping would double that edge.
    apex = np.vstack([points, [[2, 0, 3]]])
    assert delaunay_flips(apex, [*faces, [2, 3, 4]])[1] == 0
    # A third face at the edge, or two that run the same way: no flip.
    assert delaunay_flips(apex, [*faces, [0, 1, 4]])[1] == 0
    assert delaunay_flips(points, [[0, 1, 2], [0, 1, 3]])[1] == 0


@given(soups())
@settings(max_examples=120, deadline=None)
def test_flips_survive_any_soup(soup):
    points, faces = soup
    found, flips = delaunay_flips(points, faces)
    assert flips >= 0
    assert set(np.unique(found)) <= set(np.unique(faces))
    before, after = topology(points, faces), topology(points, found)
    assert len(after.nonmanifold_edges) == len(before.nonmanifold_edges)
    assert len(after.boundary_edges) == len(before.boundary_edges)
    assert len(after.inconsistent_edges) == len(before.inconsistent_edges)
    assert after.n_edges == before.n_edges


# ---------------------------------------------------------------- hostile input, determinism, size


def test_small_and_odd_meshes():
    triangle = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], float)
    none = np.empty((0, 3), np.int32)
    for correction, method in itertools.product(CORRECTIONS, METHODS):
        chosen = {"correction": correction, "method": method, "iterations": 3}
        assert_array_equal(smooth_vertices(triangle, [[0, 1, 2]], **chosen), triangle)
        assert_array_equal(smooth_vertices(triangle, none, **chosen), triangle)
        assert smooth_vertices(np.empty((0, 3)), none, **chosen).shape == (0, 3)
        # A vertex that no face uses stays, wherever it is.
        mesh = noisy_sphere()
        more = np.vstack([[[1e6, 0, 0]], mesh.vertices, [[0, 1e6, 0]]])
        found = smooth_vertices(more, mesh.faces + 1, **chosen)
        assert_array_equal(found[[0, -1]], more[[0, -1]])
        assert_array_equal(found[1:-1], smooth_vertices(mesh.vertices, mesh.faces, **chosen))


def test_vertices_without_area_around_them():
    points = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]], float)
    line = [[0, 1, 2], [2, 1, 0], [1, 2, 3], [3, 2, 1]]
    for method in ("cvt", "wcc", "wcc-equal"):
        assert_array_equal(smooth_vertices(points, line, method=method), points)
    assert_array_equal(smooth_vertices(points, line, tangential=True), points)
    assert smooth_vertices(points, line)[0].tolist() == [1.5, 0, 0]


def test_input_is_left_alone_and_results_repeat():
    mesh = noisy_sphere(5, 0.12, 2)
    vertices, faces = mesh.vertices.copy(), mesh.faces.copy()
    for method, update, correction in itertools.product(METHODS, UPDATES, CORRECTIONS):
        chosen = {"method": method, "update": update, "correction": correction, "step": 0.3}
        once, again = (smooth_vertices(vertices, faces, iterations=2, **chosen) for _ in range(2))
        assert once.tobytes() == again.tobytes()
    chosen = Smoothing(correction="hc", tangential=True)
    runs = [list(itertools.islice(smoothing_steps(vertices, faces, chosen, flips=True), 4)) for _ in range(2)]
    for step, again in zip(*runs, strict=True):
        assert (step.vertices.tobytes(), step.faces.tobytes()) == (again.vertices.tobytes(), again.faces.tobytes())
        assert step.flips == again.flips
    assert runs[0][0].flips > 0
    assert_array_equal(vertices, mesh.vertices)
    assert_array_equal(faces, mesh.faces)
    # What was yielded does not change afterwards.
    kept = [step.vertices.copy() for step in itertools.islice(smoothing_steps(vertices, faces, chosen), 3)]
    late = [step.vertices for step in itertools.islice(smoothing_steps(vertices, faces, chosen), 3)]
    assert_array_equal(kept, late)


def test_wrong_settings():
    mesh = box()
    for wrong in (
        {"method": "laplace"}, {"update": "parallel"}, {"correction": "scale"}, {"step": 0.0}, {"step": math.nan},
        {"alpha": -0.1}, {"beta": 1.5}, {"correction": "taubin", "taubin_mu": -0.4}, {"iterations": -1},
        {"correction": "taubin", "step": 10.0}, {"fixed": np.zeros(3, bool)}, {"fixed": np.zeros(8)},
    ):  # fmt: skip
        with pytest.raises(ValueError):
            smooth_vertices(mesh.vertices, mesh.faces, **wrong)
    with pytest.raises(ValueError, match="vertices outside"):
        smooth_vertices(mesh.vertices[:7], mesh.faces)
    with pytest.raises(ValueError, match="shapes"):
        adjacency(3, np.zeros((2, 4), np.int32))


def fastest(call, n=5):
    def once():
        start = time.process_time()
        call()
        return time.process_time() - start

    return min(once() for _ in range(n))


@pytest.mark.slow
def test_speed_and_growth():
    """At least 5 million vertex updates a second by the standard method, even with vertices in random order; in the
    order of the surface, time is linear in the size."""
    seconds = {}
    for subdivisions in (5, 7):
        mesh = sphere(100, subdivisions=subdivisions)
        seconds[subdivisions] = fastest(lambda m=mesh: smooth_vertices(m.vertices, m.faces, iterations=20))
    assert seconds[7] < 4 * 16 * seconds[5]  # 4: the larger one does not fit into the caches
    assert 20 * len(mesh.vertices) / seconds[7] > 5e6
    shuffled = np.random.default_rng(0).permutation(len(mesh.vertices))
    vertices = np.empty_like(mesh.vertices)
    vertices[shuffled] = mesh.vertices
    faces = shuffled[mesh.faces].astype(np.int32)
    assert 20 * len(vertices) / fastest(lambda: smooth_vertices(vertices, faces, iterations=20)) > 5e6
