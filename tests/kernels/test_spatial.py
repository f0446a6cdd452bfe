"""Trees, contacts, gaps, nesting and overlap against exact references and closed forms."""

from __future__ import annotations

import itertools
import math
import time
import tracemalloc
from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction

import numpy as np
import pytest
from exact_reference import mesh_pairs, self_pairs
from hypothesis import given, settings
from hypothesis import strategies as st
from intersection_cases import grid_box, open_hemisphere, pair_cases, self_cases, torus
from shapes import box, flipped, joined, sphere

from vhp_cli.formats import read_mesh
from vhp_cli.kernels.spatial import (
    KIND_COPLANAR,
    KIND_CROSSING,
    KIND_DUPLICATE,
    KIND_FOLD,
    KIND_TOUCH,
    Tree,
    gap,
    overlap_volume,
    pair_hits,
)
from vhp_cli.mesh import Mesh

SELF_CASES = self_cases()
PAIR_CASES = pair_cases()
SEVERITY = {KIND_CROSSING: 0, KIND_COPLANAR: 1, KIND_FOLD: 2, KIND_DUPLICATE: 3, KIND_TOUCH: 4}


def tree_of(mesh):
    return Tree(mesh.vertices, mesh.faces)


def single(corners):
    return Tree(np.reshape(corners, (3, 3)), [(0, 1, 2)])


def as_dict(hits):
    return {tuple(pair): kind for pair, kind in zip(hits.pairs.tolist(), hits.kinds.tolist(), strict=True)}


def rotation(seed):
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


def volume(mesh):
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return np.einsum("ij,ij->", a, np.cross(b, c)) / 6


def soup(rng, count, size=1.0):
    """Faces without common vertices, at random."""
    centres = rng.normal(size=(count, 1, 3))
    return Mesh((centres + size * rng.normal(size=(count, 3, 3))).reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))


# ---- contacts


@pytest.mark.parametrize("name", SELF_CASES)
def test_self_hits_equal_the_exact_reference(name):
    mesh, expected = SELF_CASES[name]
    hits = tree_of(mesh).self_hits(limit=100_000)
    reference = self_pairs(mesh.vertices, mesh.faces)
    assert as_dict(hits) == reference
    if isinstance(expected, set):
        assert set(reference.values()) == expected
    else:
        assert list(reference.values()) == ([] if expected is None else [expected])
    assert hits.counts.tolist() == [list(reference.values()).count(kind) for kind in range(6)]
    assert hits.n_pairs == len(reference)
    assert hits.faces_a == len({face for pair in reference for face in pair})
    assert hits.faces_b == 0
    for kind, faces in ((KIND_CROSSING, hits.crossing_faces), (KIND_COPLANAR, hits.coplanar_faces)):
        assert faces == len({face for pair, k in reference.items() if k == kind for face in pair})


@pytest.mark.parametrize("name", PAIR_CASES)
def test_pair_hits_equal_the_exact_reference(name):
    a, b, distance, _ = PAIR_CASES[name]
    hits = pair_hits(tree_of(a), tree_of(b), limit=100_000)
    reference = mesh_pairs((a.vertices, a.faces), (b.vertices, b.faces))
    assert as_dict(hits) == reference
    assert (len(reference) > 0) == (distance == 0)
    assert hits.n_pairs == len(reference)
    assert hits.faces_a == len({i for i, _ in reference})
    assert hits.faces_b == len({j for _, j in reference})
    for kind, faces in ((KIND_CROSSING, hits.crossing_faces), (KIND_COPLANAR, hits.coplanar_faces)):
        of_a, of_b = ({pair[side] for pair, k in reference.items() if k == kind} for side in (0, 1))
        assert faces == len(of_a) + len(of_b)


def test_random_soup_equals_the_exact_reference():
    rng = np.random.default_rng(5)
    a, b = soup(rng, 60), soup(rng, 70)
    assert as_dict(tree_of(a).self_hits()) == self_pairs(a.vertices, a.faces)
    assert as_dict(pair_hits(tree_of(a), tree_of(b))) == mesh_pairs((a.vertices, a.faces), (b.vertices, b.faces))


@pytest.mark.parametrize("seed", range(4))
def test_crumpled_lattice_mesh_equals_the_exact_reference(seed):
    """Few lattice points and many faces: shared vertices and edges in every degenerate position."""
    rng = np.random.default_rng(seed)
    vertices = rng.integers(0, 4, (30, 3)).astype(float)
    faces = rng.integers(0, 30, (90, 3))
    assert as_dict(Tree(vertices, faces).self_hits(limit=10_000)) == self_pairs(vertices, faces)


def test_hits_move_and_renumber_with_the_mesh():
    rng = np.random.default_rng(8)
    vertices = rng.integers(0, 5, (40, 3)).astype(float)
    faces = rng.integers(0, 40, (80, 3))
    expected = as_dict(Tree(vertices, faces).self_hits(limit=10_000))
    assert as_dict(Tree(vertices + np.array([1000, -1000, 500]), faces).self_hits(limit=10_000)) == expected
    order, numbers = rng.permutation(80), rng.permutation(40)
    shuffled = Tree(vertices[np.argsort(numbers)], numbers[faces][order]).self_hits(limit=10_000)
    back = {tuple(sorted((int(order[i]), int(order[j])))): kind for (i, j), kind in as_dict(shuffled).items()}
    assert back == expected


def test_listed_pairs_are_the_worst_in_order():
    ball = sphere(10)
    folds = Mesh(np.array([(30, 0, 0), (40, 0, 0), (30, 9, 0), (33, 4, 0)], float), np.array([(0, 1, 2), (1, 0, 3)]))
    both = joined(folds, ball, ball, sphere(10, (3, 1, 0)))
    every = tree_of(both).self_hits(limit=100_000)
    assert every.counts[KIND_FOLD] == 1
    keys = [(SEVERITY[int(kind)], *pair) for kind, pair in zip(every.kinds, every.pairs.tolist(), strict=True)]
    assert keys == sorted(keys)
    assert (every.pairs[:, 0] < every.pairs[:, 1]).all()
    crossings = int(every.counts[KIND_CROSSING])
    assert crossings > 20
    assert every.counts[KIND_TOUCH] > 20
    for limit in (0, 7, crossings + 5):
        few = tree_of(both).self_hits(limit=limit)
        assert len(few.pairs) == len(few.kinds) == limit
        assert few.counts.tolist() == every.counts.tolist()
        assert (few.kinds[:crossings] == KIND_CROSSING).all()
        assert (few.faces_a, few.crossing_faces) == (every.faces_a, every.crossing_faces)
        assert set(as_dict(few)) <= set(as_dict(every))


def test_contacts_of_doubles_that_no_float_holds():
    rng = np.random.default_rng(2)
    for _ in range(300):
        point = rng.normal(size=3) * 10.0 ** rng.integers(-6, 6)
        side = np.sign(rng.normal(size=3))
        a = point + np.vstack([np.zeros(3), -side * rng.random((2, 3))])
        b = point + np.vstack([np.zeros(3), side * rng.random((2, 3))])
        assert pair_hits(single(a), single(b)).counts.tolist() == [0, 1, 0, 0, 0, 0]
        contact = gap(single(a), single(b), 0.0)
        assert contact is not None
        assert contact.contact_kind == KIND_TOUCH


def test_many_faces_in_one_place_need_little_memory():
    count = 2000
    duplicates = Tree([(0, 0, 0), (1, 0, 0), (0, 1, 0)], np.tile([0, 1, 2], (count, 1)))
    tracemalloc.start()
    hits = duplicates.self_hits(limit=10)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert hits.counts[KIND_DUPLICATE] == count * (count - 1) // 2
    assert len(hits.pairs) == 10
    assert hits.faces_a == count
    assert peak < 100_000


def test_faces_without_area_are_no_hits_and_cost_nothing():
    count = 100_000
    points = Tree([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0.25, 0.25, 0)], [(0, 1, 2), *[(3, 3, 3)] * count, (0, 1, 0)])
    assert points.self_hits().n_pairs == 0
    line = Tree([(0, 0, -1), (0, 0, 1), (0, 0, 2)], [(0, 1, 2)])
    assert pair_hits(points, line).n_pairs == 0
    assert pair_hits(line, points).n_pairs == 0


def test_a_far_outlier_leaves_the_tree_useful():
    ball = sphere(10, subdivisions=5)
    ball = Mesh(ball.vertices, np.random.default_rng(0).permutation(ball.faces))
    vertices = np.vstack([ball.vertices, [(1e30, 0, 0), (1e30, 1e30, 0), (1e30, 0, 1e30)]])
    n = len(ball.vertices)
    with_outlier = Tree(vertices, np.vstack([ball.faces, [(n, n + 1, n + 2)]]))
    assert with_outlier.upper.tolist() == [1e30, 1e30, 1e30]
    times = []
    for tree in (tree_of(ball), with_outlier):
        start = time.thread_time()
        assert tree.self_hits().n_pairs == 0
        times.append(time.thread_time() - start)
    assert times[1] < 10 * times[0]  # 100 times if all of the ball falls into one cell


# ---- gaps


def rational_distance2(a, b):
    """Squared distance of two disjoint triangles, as a fraction."""

    def vector(p):
        return [Fraction(float(x)) for x in p]

    def minus(p, q):
        return [x - y for x, y in zip(p, q, strict=True)]

    def dot(p, q):
        return sum(x * y for x, y in zip(p, q, strict=True))

    def point_segment(p, u, w):
        e, o = minus(w, u), minus(p, u)
        t = min(max(dot(o, e) / dot(e, e), Fraction(0)), Fraction(1)) if any(e) else Fraction(0)
        x = [oi - t * ei for oi, ei in zip(o, e, strict=True)]
        return dot(x, x)

    def solve(p, u, v):
        """s, t with p - s u - t v orthogonal to u and v; None if u and v are parallel."""
        uu, uv, vv = dot(u, u), dot(u, v), dot(v, v)
        det = uu * vv - uv * uv
        if not det:
            return None
        return (dot(p, u) * vv - dot(p, v) * uv) / det, (dot(p, v) * uu - dot(p, u) * uv) / det

    def rest(p, s, u, t, v):
        x = [pi - s * ui - t * vi for pi, ui, vi in zip(p, u, v, strict=True)]
        return dot(x, x)

    a, b = [vector(p) for p in a], [vector(p) for p in b]
    found = []
    for s, t in ((a, b), (b, a)):
        u, v = minus(t[1], t[0]), minus(t[2], t[0])
        for p in s:
            found += [point_segment(p, t[k], t[(k + 1) % 3]) for k in range(3)]
            place = solve(minus(p, t[0]), u, v)
            if place and min(place) >= 0 and sum(place) <= 1:
                found.append(rest(minus(p, t[0]), place[0], u, place[1], v))
    for i, j in itertools.product(range(3), range(3)):
        u, v = minus(a[(i + 1) % 3], a[i]), minus(b[j], b[(j + 1) % 3])
        place = solve(minus(b[j], a[i]), u, v)
        if place and all(0 <= x <= 1 for x in place):
            found.append(rest(minus(b[j], a[i]), place[0], u, place[1], v))
    return min(found)


def check_distance(a, b):
    """The relative error that distance.c promises: a few units times size over distance."""
    found = gap(single(a), single(b))
    assert found is not None
    if found.contact_kind:
        return 0.0
    exact = rational_distance2(a, b)
    root = math.sqrt(exact) if exact else 0.0
    size = max(np.ptp(np.vstack([a, b]), axis=0))
    error = abs(found.distance - root)
    assert error <= 20 * 2.0**-53 * (size + root), (error, root, size)
    assert abs(np.linalg.norm(found.points[1] - found.points[0]) - root) <= 1e-14 * max(np.abs([a, b]).max(), root)
    return root


@pytest.mark.parametrize("kind", ["any", "needles", "caps", "parallel edges", "nearly parallel", "degenerate", "close"])
def test_triangle_distance_is_accurate(kind):
    rng = np.random.default_rng(sum(map(ord, kind)))
    apart = 0
    for _ in range(60):
        a, b = rng.normal(size=(2, 3, 3))
        b += rng.normal(size=3) * 2
        if kind == "needles":
            a[1] = a[0] + rng.normal(size=3) * 10.0 ** rng.integers(-12, -2)
        elif kind == "caps":
            a[2] = a[0] + rng.random() * (a[1] - a[0]) + rng.normal(size=3) * 10.0 ** rng.integers(-12, -2)
        elif kind == "parallel edges":
            b[1] = b[0] + rng.normal() * (a[1] - a[0])
        elif kind == "nearly parallel":
            b = a + rng.normal(size=3) * 0.1 + rng.normal(size=(3, 3)) * 10.0 ** rng.integers(-14, -4)
        elif kind == "degenerate":
            a[1 if rng.random() < 0.5 else slice(1, 3)] = a[0]
            b[2] = (b[0] + b[1]) / 2
        elif kind == "close":
            a[:, 2] = 0
            b[:, 2] = np.abs(b[:, 2]) + 10.0 ** rng.integers(-9, -1)
        apart += check_distance(a, b) > 0
    assert apart > 30


def test_distance_of_edges_that_cross_at_a_small_angle():
    """A finite best distance, from the vertices, must not rule out the edges by their uncertain normal."""
    for seed in range(12):
        turn = rotation(seed)
        for angle, height in itertools.product(10.0 ** np.arange(-8, -2), (0.1, 4e-4, 1e-6)):
            a = np.array([(-1, 0, 0), (1, 0, 0), (0, 0, -1)])
            b = np.array([(-1, -angle, height), (1, angle, height), (0, 0, 1)])
            check_distance(a @ turn, b @ turn)


def test_distance_far_from_the_origin():
    rng = np.random.default_rng(3)
    for _ in range(40):
        a, b = np.float32(rng.normal(size=(2, 3, 3)) * 3).astype(float)
        b += (0, 0, 25)
        plain, shifted = gap(single(a), single(b)), gap(single(a + 1024), single(b + 1024))
        exact = math.sqrt(rational_distance2(a + 1024, b + 1024))
        assert shifted.distance == pytest.approx(exact, rel=1e-14)
        assert shifted.distance == pytest.approx(plain.distance, abs=1e-12)


@pytest.mark.parametrize("name", PAIR_CASES)
def test_gap_of_the_cases(name):
    a, b, distance, _ = PAIR_CASES[name]
    tree_a, tree_b = tree_of(a), tree_of(b)
    for first, second in ((tree_a, tree_b), (tree_b, tree_a)):
        found = gap(first, second)
        assert found is not None
        assert (found.contact_kind > 0) == (pair_hits(first, second).n_pairs > 0)
        if distance is not None:
            assert found.distance == pytest.approx(distance, rel=1e-12, abs=1e-15)
        assert np.linalg.norm(found.points[1] - found.points[0]) == pytest.approx(found.distance, abs=1e-13)


def test_gap_equals_the_least_of_all_pairs_of_faces():
    for seed in range(3):
        rng = np.random.default_rng(seed)
        ball = sphere(10, subdivisions=1)
        b = Mesh(sphere(6, subdivisions=1).vertices @ rotation(seed) + rng.normal(size=3) * 14, ball.faces)
        found = gap(tree_of(ball), tree_of(b))
        singles_a = [single(ball.vertices[face]) for face in ball.faces]
        singles_b = [single(b.vertices[face]) for face in b.faces]
        every = {
            (i, j): gap(one, other)
            for (i, one), (j, other) in itertools.product(enumerate(singles_a), enumerate(singles_b))
        }
        if any(g.contact_kind for g in every.values()):
            assert found.contact_kind > 0
        else:
            assert found.distance == min(g.distance for g in every.values())
            assert every[found.faces].distance == found.distance


def test_gap_of_soups_equals_the_least_of_all_pairs_of_faces():
    apart = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        a, b = soup(rng, 12, 0.25), soup(rng, 12, 0.25)
        found = gap(tree_of(a), tree_of(b))
        every = [gap(single(a.vertices[f]), single(b.vertices[g])) for f, g in itertools.product(a.faces, b.faces)]
        assert (found.contact_kind > 0) == any(g.contact_kind for g in every)
        if not found.contact_kind:
            apart += 1
            assert found.distance == min(g.distance for g in every)
    assert apart > 15


def test_gap_between_doubles_that_no_float_holds():
    """Boxes rounded to nearest would keep apart what is nearest, by half a float's unit of 6e-5."""
    rng = np.random.default_rng(6)
    for _ in range(8):
        height = rng.uniform(600, 1000)
        low = [np.array([(x, 0, height - rng.random() * 1e-5), (x + 1, 0, 500), (x, 1, 500)]) for x in range(8)]
        high = [corners * (1, 1, -1) + (0, 0, 2 * height + 1e-5) for corners in low]
        found = gap(*(Tree(np.vstack(part), np.arange(24).reshape(8, 3)) for part in (low, high)))
        exact = min(rational_distance2(one, other) for one, other in itertools.product(low, high))
        assert found.distance == pytest.approx(math.sqrt(exact), rel=1e-6)


@pytest.mark.parametrize("corner", [(0, 0, 0), (8, 8, 8)])
def test_contact_is_found_after_a_face_without_area_at_distance_zero(corner):
    cube = grid_box((0, 0, 0), (8, 8, 8), 4)
    point = np.subtract(8, corner)
    crossing = np.add(corner, [(-1, -0.5, 0.1), (1, 0.5, 0.2), (0.3, 1, -1)])
    mixed = Tree(np.vstack([crossing, [point]]), [(0, 1, 2), (3, 3, 3)])
    for a, b in ((mixed, tree_of(cube)), (tree_of(cube), mixed)):
        assert gap(a, b).contact_kind > 0
    alone = gap(Tree([point], [(0, 0, 0)]), tree_of(cube))
    assert (alone.contact_kind, alone.distance) == (0, 0)


def test_gap_limit():
    a, b = tree_of(box()), tree_of(box((10.5, 0, 0), (20, 10, 10)))
    assert gap(a, b, 0.5).distance == 0.5
    assert gap(a, b, np.nextafter(0.5, 0)) is None
    assert gap(a, b, 0.0) is None
    assert gap(a, Tree(np.empty((0, 3)), np.empty((0, 3), int))) is None


def test_contact_points_lie_on_both_faces():
    cases = [
        (sphere(10), sphere(10, (8, 3, 1))),
        (box(), box((2, 2, 10), (4, 4, 12))),
        (box(), box((5, 5, 5), (6, 6, 20))),
    ]
    for a, b in cases:
        found = gap(tree_of(a), tree_of(b))
        assert found.contact_kind > 0
        assert found.distance == 0
        for k, mesh in enumerate((a, b)):
            face = single(mesh.vertices[mesh.faces[found.faces[k]]])
            for xyz in found.points:
                assert gap(face, Tree([xyz], [(0, 0, 0)])).distance < 1e-13


def test_degenerate_faces_have_a_gap():
    point, segment = Tree([(0, 0, 3)], [(0, 0, 0)]), Tree([(-9, 0, 1), (9, 0, 1)], [(0, 1, 0)])
    plate = tree_of(box((-1, -1, -1), (1, 1, 0)))
    assert gap(plate, point).distance == 3
    assert gap(segment, plate).distance == 1
    assert gap(segment, point).distance == 2


# ---- inside


def test_inside_on_a_lattice():
    """Rays through vertices, along edges and within faces; the answer is known by construction."""
    cube = grid_box((0, 0, 0), (4, 4, 4), 4)
    points = np.array(list(itertools.product(np.arange(-1, 5.5, 0.5), repeat=3)))
    within = ((points > 0) & (points < 4)).all(axis=1)
    outside = ((points < 0) | (points > 4)).any(axis=1)
    expected = np.where(within, 1, np.where(outside, 0, -1))
    assert np.array_equal(tree_of(cube).inside(points), expected)
    assert np.array_equal(tree_of(flipped(cube)).inside(points), expected)
    turned = Mesh(cube.vertices[:, [2, 0, 1]], cube.faces)
    assert np.array_equal(tree_of(turned).inside(points[:, [2, 0, 1]]), expected)


def test_inside_to_one_ulp():
    tree = tree_of(box())
    for axis in range(3):
        for wall, inward in ((0.0, 1), (10.0, -1)):
            points = np.full((3, 3), 5.0)
            points[:, axis] = np.nextafter(wall, -inward * np.inf), wall, np.nextafter(wall, inward * np.inf)
            if wall == 0:
                points[[0, 2], axis] = -1e-60, 1e-60
            assert tree.inside(points).tolist() == [0, -1, 1]


def test_inside_of_a_wall_that_no_float_holds():
    for corner in (0.1, 0.3, 1000.7):
        cube = box([corner] * 3, [corner + 0.2] * 3)
        tree = tree_of(cube)
        low, high = cube.vertices.min(), cube.vertices.max()
        for axis in range(3):
            for wall, inward in ((low, np.inf), (high, -np.inf)):
                points = np.full((3, 3), corner + 0.1)
                points[:, axis] = np.nextafter(wall, -inward), wall, np.nextafter(wall, inward)
                assert tree.inside(points).tolist() == [0, -1, 1]


@pytest.mark.parametrize("mesh", [sphere(10, subdivisions=3), torus(10, 3), joined(sphere(9), flipped(sphere(5)))])
def test_inside_agrees_with_the_winding_number(mesh):
    points = np.random.default_rng(1).uniform(-12, 12, (2000, 3))
    tree = tree_of(mesh)
    winding = tree.winding(points, np.inf)
    assert np.allclose(winding, np.round(winding), atol=1e-9)
    assert np.array_equal(tree.inside(points), np.round(winding))
    assert set(np.round(winding)) == {0.0, 1.0}


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**31), st.integers(0, 3))
def test_inside_of_a_random_lattice_surface(seed, level):
    """The boundary of a random set of unit cubes, queried at the centres of all cubes."""
    rng = np.random.default_rng(seed)
    solid = np.zeros((5, 5, 5), bool)
    solid[1:4, 1:4, 1:4] = rng.random((3, 3, 3)) < (level + 1) / 5
    parts = [box(np.array(cell), np.array(cell) + 1) for cell in np.argwhere(solid)]
    if not parts:
        return
    # Walls between two cubes are there twice, which leaves the parity alone.
    tree = tree_of(joined(*parts))
    centres = np.argwhere(np.ones_like(solid)) + 0.5
    assert np.array_equal(tree.inside(centres), solid.ravel())


def test_inside_ignores_faces_without_area():
    cube = box()
    faces = np.vstack([cube.faces, [(0, 0, 0), (1, 7, 1)]])
    points = np.random.default_rng(0).uniform(-5, 15, (200, 3))
    assert np.array_equal(Tree(cube.vertices, faces).inside(points), tree_of(cube).inside(points))


# ---- components


def depths_of(*meshes):
    labels = np.repeat(np.arange(len(meshes)), [len(mesh.faces) for mesh in meshes]).astype(np.int32)
    depths, undecided = tree_of(joined(*meshes)).component_depths(labels, len(meshes))
    return depths.tolist(), undecided.tolist()


def test_component_depths():
    nest = [sphere(r) for r in (10, 8, 6, 4)]
    assert depths_of(*nest) == ([0, 1, 2, 3], [False] * 4)
    assert depths_of(*nest[::-1]) == ([3, 2, 1, 0], [False] * 4)
    assert depths_of(flipped(nest[0]), nest[2], sphere(1, (30, 0, 0))) == ([0, 1, 0], [False] * 3)
    # Two small boxes in one large one, on a lattice so that rays run along faces and edges.
    boxes = grid_box((0, 0, 0), (8, 8, 8), 8), box((1, 1, 1), (2, 2, 2)), box((4, 1, 1), (6, 2, 2))
    assert depths_of(*boxes) == ([0, 1, 1], [False] * 3)


def test_component_depths_try_other_vertices():
    large = grid_box((0, 0, 0), (8, 8, 8), 4)
    hanging = box((2, 2, 4), (4, 4, 8))  # four vertices on the lid
    standing = box((2, 2, 8), (4, 4, 10))
    assert depths_of(large, hanging) == ([0, 1], [False, False])
    assert depths_of(large, standing) == ([0, 0], [False, False])
    assert depths_of(box(), box()) == ([0, 0], [True, True])


def test_component_depths_ignore_labels_below_zero():
    outer, inner = sphere(10), sphere(5)
    labels = np.repeat([-1, 0], [len(outer.faces), len(inner.faces)])
    depths, undecided = tree_of(joined(outer, inner)).component_depths(labels, 2)
    assert depths.tolist() == [0, 0]
    assert undecided.tolist() == [False, True]  # the second has no faces
    with pytest.raises(ValueError, match="labels"):
        tree_of(outer).component_depths(labels, 2)
    with pytest.raises(ValueError, match="labels"):
        tree_of(outer).component_depths(np.full(len(outer.faces), 2), 2)


# ---- winding numbers


def solid_angles(mesh, points):
    """Sum over all faces of the solid angle of van Oosterom & Strackee, over 4 pi."""
    corners = mesh.vertices[mesh.faces][None] - points[:, None, None]
    a, b, c = corners[:, :, 0], corners[:, :, 1], corners[:, :, 2]
    la, lb, lc = (np.linalg.norm(x, axis=-1) for x in (a, b, c))
    top = (a * np.cross(b, c)).sum(-1)
    bottom = la * lb * lc + (a * b).sum(-1) * lc + (b * c).sum(-1) * la + (c * a).sum(-1) * lb
    return 2 * np.arctan2(top, bottom).sum(axis=1) / (4 * np.pi)


@pytest.mark.parametrize("mesh", [sphere(10), open_hemisphere(10), soup(np.random.default_rng(0), 50)])
def test_winding_equals_the_direct_sum(mesh):
    points = np.random.default_rng(4).uniform(-12, 12, (300, 3))
    expected = solid_angles(mesh, points)
    tree = tree_of(mesh)
    assert np.allclose(tree.winding(points, np.inf), expected, atol=1e-12)
    error = [np.abs(tree.winding(points, accuracy) - expected).max() for accuracy in (2.0, 8.0)]
    assert error[0] < 0.1
    assert error[1] < 0.005


def test_winding_of_an_open_hemisphere():
    # The centre of the mouth sees half of all directions; the points far below see next to nothing.
    tree = tree_of(open_hemisphere(10, subdivisions=4))
    centre, below = tree.winding([(0, 0, 0), (0, 0, -1000)], np.inf)
    assert centre == pytest.approx(0.5, abs=0.02)
    assert abs(below) < 1e-3


# ---- overlap


@pytest.mark.parametrize("name", [name for name, case in PAIR_CASES.items() if case[3] is not None])
def test_overlap_of_the_cases(name):
    a, b, _, expected = PAIR_CASES[name]
    expected = {"a": volume(a), "b": volume(b)}.get(expected, expected)
    for one, other in ((a, b), (b, a)):
        assert overlap_volume(tree_of(one), tree_of(other)) == pytest.approx(expected, rel=1e-9, abs=1e-6, nan_ok=True)


@settings(max_examples=80, deadline=None)
@given(*[st.tuples(*[st.integers(0, 6)] * 6)] * 2)
def test_overlap_of_boxes(first, second):
    """Boxes on a lattice: every kind of coincident corner, edge and face."""
    boxes = [(np.minimum(c[:3], c[3:]), np.maximum(c[:3], c[3:]) + 1.0) for c in map(np.array, (first, second))]
    (low_a, high_a), (low_b, high_b) = boxes
    expected = np.clip(np.minimum(high_a, high_b) - np.maximum(low_a, low_b), 0, None).prod()
    assert overlap_volume(tree_of(box(low_a, high_a)), tree_of(box(low_b, high_b))) == pytest.approx(expected, abs=1e-7)


def test_overlap_of_turned_boxes():
    """A box cut by another, turned one that covers a half-space: half of a centrally symmetric solid."""
    for seed in range(10):
        big = box((0, -50, -50), (100, 50, 50))
        turned = Mesh(big.vertices @ rotation(seed), big.faces)
        for solid in (box((-3, -2, -1), (3, 2, 1)), sphere(5, subdivisions=3)):
            half = overlap_volume(tree_of(turned), tree_of(solid))
            assert half == pytest.approx(volume(solid) / 2, rel=1e-8)


def test_overlap_of_two_spheres():
    """The lens of two balls of radius r at distance d: pi (4 r + d) (2 r - d)^2 / 12."""
    r, d = 10.0, 9.0
    a = sphere(r, subdivisions=5)
    lens = overlap_volume(tree_of(a), tree_of(sphere(r, (d, 0, 0), 5)))
    assert lens == pytest.approx(math.pi * (4 * r + d) * (2 * r - d) ** 2 / 12, rel=2e-3)


def test_overlap_with_a_cavity():
    shell = joined(sphere(10, subdivisions=3), flipped(sphere(6, subdivisions=3)))
    ball = sphere(8, subdivisions=3)
    assert overlap_volume(tree_of(shell), tree_of(ball)) == pytest.approx(
        volume(ball) - volume(sphere(6, subdivisions=3)), rel=1e-9
    )
    two = joined(box((0, 0, 0), (1, 1, 1)), box((2, 0, 0), (3, 1, 1)))
    assert overlap_volume(tree_of(two), tree_of(box((0.5, 0.5, 0.5), (2.5, 2, 2)))) == pytest.approx(0.25, rel=1e-9)


@pytest.mark.parametrize("angle", [1e-12, 1e-9, 1e-7, 1e-5])
def test_overlap_of_nearly_coincident_surfaces(angle):
    ball = sphere(10, subdivisions=3)
    turn = np.array([(math.cos(angle), math.sin(angle), 0), (-math.sin(angle), math.cos(angle), 0), (0, 0, 1)])
    common = overlap_volume(tree_of(ball), Tree(ball.vertices @ turn, ball.faces))
    assert volume(ball) * (1 - 1e-4 * angle / 1e-5 - 1e-9) < common <= volume(ball) * (1 + 1e-9)


def test_overlap_moves_with_the_meshes():
    a, b = sphere(10), sphere(7, (8, 3, 1))
    plain = overlap_volume(tree_of(a), tree_of(b))
    shift = np.array([1000.0, -1000, 500])
    moved = overlap_volume(Tree(a.vertices + shift, a.faces), Tree(b.vertices + shift, b.faces))
    assert moved == pytest.approx(plain, rel=1e-7)


def test_overlap_whichever_way_the_surfaces_are_oriented():
    for b in (sphere(7, (8, 3, 1)), sphere(5), joined(sphere(7, (8, 3, 1)), flipped(sphere(3, (8, 3, 1))))):
        a = sphere(10)
        expected = overlap_volume(tree_of(a), tree_of(b))
        assert expected > 100
        for one, other in ((flipped(a), b), (a, flipped(b)), (flipped(a), flipped(b))):
            assert overlap_volume(tree_of(one), tree_of(other)) == pytest.approx(expected, rel=1e-9)


def test_overlap_of_what_is_no_solid():
    ball, small = tree_of(sphere(10)), tree_of(sphere(5, (2, 0, 0)))
    opened = sphere(5, (2, 0, 0))
    one_turned = Mesh(opened.vertices, np.vstack([opened.faces[:1, ::-1], opened.faces[1:]]))
    for bad in (Mesh(opened.vertices, opened.faces[1:]), one_turned, Mesh(np.empty((0, 3)), np.empty((0, 3)))):
        assert math.isnan(overlap_volume(ball, tree_of(bad)))
        assert math.isnan(overlap_volume(tree_of(bad), ball))
    assert overlap_volume(ball, small) == pytest.approx(volume(opened), rel=1e-12)


@pytest.mark.slow
def test_overlap_equals_manifold3d():
    manifold3d = pytest.importorskip("manifold3d")

    def manifold(mesh):
        return manifold3d.Manifold(manifold3d.Mesh64(mesh.vertices.copy(), mesh.faces.astype(np.uint64)))

    rng = np.random.default_rng(0)
    for _ in range(60):
        a = sphere(10, subdivisions=3)
        a = Mesh(a.vertices * rng.uniform(0.9, 1.1, (len(a.vertices), 1)), a.faces)
        b = torus(10, 3) if rng.random() < 0.5 else sphere(8)
        b = Mesh(b.vertices @ rotation(rng.integers(1000)) + rng.normal(size=3) * 5, b.faces)
        expected = (manifold(a) ^ manifold(b)).volume()
        assert overlap_volume(tree_of(a), tree_of(b)) == pytest.approx(expected, rel=1e-7, abs=1e-7)


# ---- the tree


def test_bounds_and_unused_vertices():
    vertices = [(np.nan, 9, 9), (0, 0, 0), (1, 0, 0), (0, 2, -3), (1e300, 0, 0)]
    tree = Tree(vertices, [(1, 2, 3)])
    assert tree.n_faces == 1
    assert tree.lower.tolist() == [0, 0, -3]
    assert tree.upper.tolist() == [1, 2, 0]


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 2e38])
def test_coordinates_out_of_range(bad):
    with pytest.raises(ValueError, match="coordinate"):
        Tree([(0, 0, 0), (1, 0, 0), (0, bad, 0)], [(0, 1, 2)])


@pytest.mark.parametrize("face", [(0, 1, 3), (0, 1, -1)])
def test_faces_out_of_range(face):
    with pytest.raises(ValueError, match="outside"):
        Tree([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [face])


def test_coordinates_below_the_exact_range_are_zero():
    a = Tree([(0, 0, 1e-300), (1, 0, 5e-324), (0, 1, -1e-61)], [(0, 1, 2)])
    b = Tree([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])
    assert pair_hits(a, b).counts[KIND_COPLANAR] == 1
    collapsed = Tree([(0, 0, 0), (1, 0, 0), (0, 1e-100, 0)], [(0, 1, 2)])
    assert pair_hits(collapsed, b).n_pairs == 0


def test_empty_mesh():
    empty = Tree(np.empty((0, 3)), np.empty((0, 3), np.int32))
    full = tree_of(box())
    assert empty.self_hits().n_pairs == 0
    assert pair_hits(empty, full).n_pairs == pair_hits(full, empty).n_pairs == 0
    assert empty.inside([(0, 0, 0)]).tolist() == [0]
    assert empty.winding([(0, 0, 0)]).tolist() == [0]
    assert empty.component_depths([], 0)[0].shape == (0,)


def test_the_arrays_of_the_caller_may_change():
    ball = sphere(10)
    vertices, faces = ball.vertices.copy(), ball.faces.copy()
    tree = Tree(vertices, faces)
    vertices[:], faces[:] = 0, 0
    assert gap(tree, tree_of(sphere(5))).distance > 4


def test_memory_of_a_tree():
    ball = sphere(10, subdivisions=5)
    tree = tree_of(ball)
    assert sum(array.nbytes for array in tree._arrays) < 120 * tree.n_faces


def test_threads_share_a_tree():
    a, b = tree_of(sphere(10, subdivisions=4)), tree_of(sphere(10, (8, 3, 1), 4))
    expected = as_dict(pair_hits(a, b))
    points = np.random.default_rng(0).normal(size=(500, 3)) * 8
    winding = a.winding(points)
    fresh = tree_of(sphere(10, subdivisions=4))
    with ThreadPoolExecutor(4) as pool:
        hits = [pool.submit(pair_hits, a, b) for _ in range(8)]
        numbers = [pool.submit(fresh.winding, points) for _ in range(8)]
    assert all(as_dict(hit.result()) == expected for hit in hits)
    assert all(np.array_equal(number.result(), winding) for number in numbers)


# ---- real meshes


@pytest.mark.slow
@pytest.mark.parametrize("part", range(4))  # shared out over the cores
def test_real_meshes_equal_the_exact_reference(shared_data, part):
    paths = sorted(shared_data.glob("*/*.stl"))[part::4]
    assert paths
    for path in paths:
        mesh = read_mesh(path).mesh
        if len(mesh.faces):
            hits = Tree(mesh.vertices, mesh.faces).self_hits(limit=1_000_000)
            assert as_dict(hits) == self_pairs(mesh.vertices, mesh.faces), path.name
