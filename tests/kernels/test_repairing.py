from __future__ import annotations

import itertools
import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from repair_shapes import tube
from shapes import box, flipped, joined, sphere

from vhp_cli.kernels.repairing import (
    BOUNDARY,
    CROWDED,
    fill_band,
    fill_loop,
    mates,
    orient_patches,
    radial_order,
    split_fans,
)

NO_BANS = np.empty((0, 2), np.int32)


def no_rims(points):
    return np.full((len(points), 3), np.nan)


def triangulates(faces, n) -> bool:
    """Whether faces have the edges of a polygon of n corners as their only border, each in its direction."""
    edges = [(int(f[k]), int(f[(k + 1) % 3])) for f in faces for k in range(3)]
    known = set(edges)
    border = {edge for edge in edges if edge[::-1] not in known}
    return len(known) == len(edges) and border == {(i, (i + 1) % n) for i in range(n)}


def areas(points, faces):
    a, b, c = (points[faces[:, k]] for k in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def all_triangulations(first, last):
    """Every triangulation of the corners first..last."""
    if last - first < 2:
        yield []
        return
    for middle in range(first + 1, last):
        for left in all_triangulations(first, middle):
            for right in all_triangulations(middle, last):
                yield [(first, middle, last), *left, *right]


def test_mates_join_both_halves_of_every_edge_of_a_closed_mesh():
    mesh = sphere()
    glued, crowds = mates(mesh.faces, len(mesh.vertices))
    assert not crowds
    own = np.arange(glued.size)
    assert (glued.ravel()[glued.ravel()] == own).all()
    start, end = mesh.faces.ravel(), np.roll(mesh.faces, -1, axis=1).ravel()
    assert (start[glued.ravel()] == end).all() and (end[glued.ravel()] == start).all()


def test_mates_name_borders_and_crowded_edges():
    faces = np.array([(0, 1, 2), (1, 0, 3), (0, 1, 4)])
    glued, crowds = mates(faces, 5)
    assert glued[:, 0].tolist() == [CROWDED] * 3
    assert (glued[:, 1:] == BOUNDARY).all()
    assert [crowd.tolist() for crowd in crowds] == [[0, 3, 6]]


@given(st.lists(st.booleans(), min_size=320, max_size=320))
@settings(max_examples=20, deadline=None)
def test_any_faces_turned_round_are_found(turned):
    mesh = sphere()
    mixed = np.where(np.array(turned)[:, None], mesh.faces[:, ::-1], mesh.faces)
    glued, _ = mates(mixed, len(mesh.vertices))
    found, patch, twisted = orient_patches(mixed, glued)
    assert not twisted.any() and not patch.any()
    # Seen from the first face.
    assert (found == (np.array(turned) != turned[0])).all()


def test_a_moebius_strip_is_twisted_and_a_plain_one_is_not():
    n = 8
    pairs = [(2 * i, 2 * i + 1) for i in range(n)]
    for close, is_twisted in (((0, 1), False), ((1, 0), True)):
        rails = [*pairs, close]
        faces = np.array([f for (a, b), (c, d) in itertools.pairwise(rails) for f in ((a, c, b), (b, c, d))])
        glued, _ = mates(faces, 2 * n)
        _, _, twisted = orient_patches(faces, glued)
        assert twisted.tolist() == [is_twisted]


def test_fans_at_one_vertex_are_split():
    mesh = joined(box(), box((10, 10, 10), (20, 20, 20)))
    faces = np.where(mesh.faces == 8, 7, mesh.faces)  # corner 0 of the second is corner 7 of the first
    glued, _ = mates(faces, 16)
    split, origin = split_fans(faces, glued, 16)
    assert origin.tolist() == [7]
    assert (split[:12] == mesh.faces[:12]).all()
    assert ((split == 16) == (mesh.faces == 8)).all()


def test_split_fans_leaves_a_manifold_alone_whatever_the_orientation():
    mesh = sphere()
    mixed = mesh.faces.copy()
    mixed[::3] = mixed[::3, ::-1]
    glued, _ = mates(mixed, len(mesh.vertices))
    split, origin = split_fans(mixed, glued, len(mesh.vertices))
    assert len(origin) == 0 and (split == mixed).all()


@given(st.lists(st.tuples(*[st.integers(-3, 3)] * 3), min_size=2, max_size=8), st.integers(0, 2))
@settings(max_examples=200, deadline=None)
def test_radial_order_agrees_with_angles(points, axis):
    a, b = np.zeros(3), np.zeros(3)
    b[axis] = 2
    vertices = np.array([a, b, *points])
    ((order, angle),) = radial_order(vertices, np.array([[0, 1]]), [np.arange(2, len(vertices), dtype=np.int32)])
    u, v = (axis + 1) % 3, (axis + 2) % 3
    on_axis = [p[u] == p[v] == 0 for p in points]
    n_off = len(points) - sum(on_axis)
    assert [on_axis[i] for i in order] == [False] * n_off + [True] * sum(on_axis)
    assert (angle[n_off:] == -1).all()
    # Small integers: equal directions have equal reduced fractions, others differ by far more than rounding.
    if n_off:
        first = next(p for p, on in zip(points, on_axis, strict=True) if not on)
        zero = math.atan2(first[v], first[u])
        theta = [(math.atan2(points[i][v], points[i][u]) - zero + 1e-9) % (2 * math.pi) for i in order[:n_off]]
        assert theta == sorted(theta) or max(np.diff(theta) * -1) < 1e-8
        same = [abs(x - y) < 1e-8 for x, y in itertools.pairwise(theta)]
        assert [x == y for x, y in itertools.pairwise(angle[:n_off])] == same


def test_radial_order_tells_angles_apart_that_rounding_would_not():
    tiny = 2.0**-60
    vertices = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 0], [1, tiny, 0], [1, -tiny, 0], [1, 2 * tiny, 0]])
    ((order, angle),) = radial_order(vertices, np.array([[0, 1]]), [np.array([2, 3, 4, 5], np.int32)])
    assert order.tolist() == [0, 1, 3, 2]
    assert angle.tolist() == [0, 1, 2, 3]


def test_least_area_is_least_among_all_triangulations():
    random = np.random.default_rng(3)
    for n in (4, 5, 6, 7, 8):
        points = random.normal(size=(n, 3))
        faces = fill_loop(points, no_rims(points), NO_BANS, "area")
        assert triangulates(faces, n)
        best = min(areas(points, np.array(trial)).sum() for trial in all_triangulations(0, n - 1))
        assert areas(points, faces).sum() == pytest.approx(best)


def liepa(points, rims):
    """The recursion of Liepa 2003 as it is written there: weight and faces of the best triangulation."""
    best = {(i, i + 1): ((0.0, 0.0), rims[i], []) for i in range(len(points) - 1)}

    def bend(a, b):
        return math.floor((1 - a @ b / np.linalg.norm(a) / np.linalg.norm(b)) / 1e-3) * 1e-3

    last = len(points) - 1
    for gap in range(2, len(points)):
        for i in range(len(points) - gap):
            k = i + gap
            trials = []
            for j in range(i + 1, k):
                normal = np.cross(points[j] - points[i], points[k] - points[i])
                (left, left_normal, left_faces), (right, right_normal, right_faces) = best[i, j], best[j, k]
                bends = [left[0], right[0], bend(normal, left_normal), bend(normal, right_normal)]
                if gap == last:
                    bends.append(bend(normal, rims[last]))
                weight = (max(bends), left[1] + right[1] + np.linalg.norm(normal) / 2)
                trials.append((weight, normal, [(i, j, k), *left_faces, *right_faces]))
            best[i, k] = min(trials, key=lambda trial: trial[0])
    return best[0, last][2]


def test_the_fill_by_angles_is_that_of_the_recursion():
    random = np.random.default_rng(4)
    for n in (3, 4, 7, 12, 20):
        points, rims = random.normal(size=(2, n, 3))
        faces = fill_loop(points, rims, NO_BANS, "angle")
        assert triangulates(faces, n)
        assert sorted(map(tuple, faces.tolist())) == sorted(liepa(points, rims))


def test_rims_steer_the_fill():
    # A square bent along one diagonal: the surface beyond decides along which one it is closed.
    points = np.array([[0, 0, 0.3], [1, 0, 0], [1, 1, 0.3], [0, 1, 0]])
    for normal, chord in (((0.3, 0.3, 1), {1, 3}), ((0, 0, 1), None)):
        rims = np.tile(np.array(normal, float), (4, 1))
        if chord:
            # Beyond each edge the face of a valley along 1-3 goes on.
            rims = np.array([[0.3, 0.3, 1], [-0.3, -0.3, 1], [-0.3, -0.3, 1], [0.3, 0.3, 1]])
        faces = fill_loop(points, rims, NO_BANS, "angle")
        assert triangulates(faces, 4)
        if chord:
            assert chord == set(faces[0].tolist()) & set(faces[1].tolist())


@pytest.mark.parametrize("method", ["angle", "area", "plane"])
def test_banned_chords_are_not_used(method):
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]])
    for banned in ([0, 2], [3, 1]):
        faces = fill_loop(points, no_rims(points), np.array([banned]), method)
        assert set(banned) != set(faces[0].tolist()) & set(faces[1].tolist())
    both = np.array([[0, 2], [1, 3]])
    assert fill_loop(points, no_rims(points), both, method) is None


def comb(teeth):
    """A polygon with long narrow bays: neither convex nor star-shaped."""
    upper = [(x, 5 * (x % 2), 0) for x in range(2 * teeth)]
    return np.array([(-1, -1, 0), (2 * teeth, -1, 0), *upper[::-1]], float)


@pytest.mark.parametrize("method", ["angle", "area", "plane"])
def test_flat_polygons_are_covered_once(method):
    for points in (comb(3), comb(40), np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0.0]])):
        faces = fill_loop(points, no_rims(points), NO_BANS, method)
        assert triangulates(faces, len(points))
        x, y = points[:, 0], points[:, 1]
        shoelace = abs((x * np.roll(y, -1) - y * np.roll(x, -1)).sum()) / 2
        assert areas(points, faces).sum() == pytest.approx(shoelace)
        assert areas(points, faces).min() > 0


def test_plane_gives_the_constrained_delaunay_triangulation():
    random = np.random.default_rng(5)
    angles = np.sort(random.uniform(0, 2 * np.pi, 60))
    points = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1) * random.uniform(0.7, 1, 60)[:, None]
    faces = fill_loop(points, no_rims(points), NO_BANS, "plane")
    assert triangulates(faces, 60)
    beside = {(f[k], f[(k + 1) % 3]): f[(k + 2) % 3] for f in faces.tolist() for k in range(3)}
    exact = [[Fraction(float(x)) for x in p] for p in points]
    for (i, j), k in beside.items():
        other = beside.get((j, i))
        if other is None:
            continue
        rows = [[exact[p][d] - exact[other][d] for d in (0, 1)] for p in (i, j, k)]
        (ax, ay), (bx, by), (cx, cy) = rows
        inside = (
            (ax * ax + ay * ay) * (bx * cy - by * cx)
            + (bx * bx + by * by) * (cx * ay - cy * ax)
            + (cx * cx + cy * cy) * (ax * by - ay * bx)
        )
        quad = [np.cross(*(points[[k, other]] - points[p]))[2] for p in (i, j)]
        # Inside the circle only where the edge can't be flipped, as the two faces form no convex quadrangle.
        assert inside <= 1e-9 or quad[0] * quad[1] >= 0


def test_plane_refuses_what_crosses_itself():
    bow_tie = np.array([[0, 0, 0], [1, 1, 0], [1, 0, 0], [0, 2, 0.0]])
    assert fill_loop(bow_tie, no_rims(bow_tie), NO_BANS, "plane") is None


@pytest.mark.parametrize("method", ["angle", "area", "plane"])
def test_long_loops_are_filled_without_waste(method):
    t = np.linspace(0, 2 * np.pi, 2000, endpoint=False)
    points = np.stack([np.cos(t), np.sin(t), 0.05 * np.sin(3 * t)], axis=1) * (1 + 0.2 * np.cos(7 * t))[:, None]
    faces = fill_loop(points, no_rims(points), NO_BANS, method)
    assert triangulates(faces, 2000)
    flat = points * [1, 1, 0]
    x, y = flat[:, 0], flat[:, 1]
    assert areas(points, faces).sum() < 1.1 * abs((x * np.roll(y, -1) - y * np.roll(x, -1)).sum()) / 2


def test_equal_points_do_not_stop_the_fill():
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]])
    for method in ("angle", "area"):
        faces = fill_loop(points, no_rims(points), NO_BANS, method)
        assert triangulates(faces, 5)
        assert areas(points, faces).sum() == pytest.approx(1)


@given(st.integers(3, 20), st.integers(3, 20), st.floats(0, 6))
@settings(max_examples=40, deadline=None)
def test_a_band_covers_the_ring_between_two_circles(n, m, turned):
    def circle(k, radius, by):
        t = np.arange(k) * 2 * np.pi / k + by
        return radius * np.stack([np.cos(t), np.sin(t), 0 * t], axis=1)

    # The inner circle lies within the inscribed circle of the outer polygon.
    outer, inner = circle(n, 10, 0), circle(m, 4, turned)
    faces = fill_band(outer, inner, np.arange(m, dtype=np.int32), "length")
    edges = [(int(f[k]), int(f[(k + 1) % 3])) for f in faces for k in range(3)]
    border = {edge for edge in edges if edge[::-1] not in edges}
    assert border == {(i, (i + 1) % n) for i in range(n)} | {(n + (j + 1) % m, n + j) for j in range(m)}
    points = np.concatenate([outer, inner])
    ring = n * 50 * math.sin(2 * math.pi / n) - m * 8 * math.sin(2 * math.pi / m)
    assert areas(points, faces).sum() == pytest.approx(ring, rel=1e-9)


def test_wrong_arguments_are_refused():
    mesh = tube()
    glued, _ = mates(mesh.faces, len(mesh.vertices))
    with pytest.raises(ValueError, match="same shape"):
        orient_patches(mesh.faces, glued[:-1])
    with pytest.raises(ValueError, match="half-edges"):
        orient_patches(mesh.faces, np.full_like(glued, glued.size))
    with pytest.raises(ValueError, match="outside"):
        split_fans(mesh.faces, glued, 3)
    with pytest.raises(ValueError, match="axes"):
        radial_order(mesh.vertices, np.array([[0, 1]]), [])
    with pytest.raises(ValueError, match="outside"):
        radial_order(mesh.vertices, np.array([[0, 999]]), [np.array([2])])
    points = np.eye(3)
    with pytest.raises(ValueError, match="three finite"):
        fill_loop(points[:2], points[:2], NO_BANS, "angle")
    with pytest.raises(ValueError, match="three finite"):
        fill_loop(np.full((3, 3), np.inf), no_rims(points), NO_BANS, "angle")
    with pytest.raises(ValueError, match="outside"):
        fill_loop(points, no_rims(points), np.array([[0, 3]]), "angle")
    with pytest.raises(ValueError, match="start"):
        fill_band(points, points, np.array([3]), "length")
    with pytest.raises(ValueError, match="two loops"):
        fill_band(points[:2], points, np.array([0]), "length")


def test_flipped_and_plain_parts_are_separate_patches():
    mesh = joined(box(), flipped(box((20, 0, 0), (30, 10, 10))))
    glued, _ = mates(mesh.faces, len(mesh.vertices))
    turned, patch, _ = orient_patches(mesh.faces, glued)
    assert not turned.any()
    assert patch.tolist() == [0] * 12 + [1] * 12
