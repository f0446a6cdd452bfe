"""Deviation of two surfaces and lost parts against closed forms and brute force."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapes import box, flipped, joined, moved, sphere

from vhp_cli.formats import read_mesh
from vhp_cli.inspection.deviation import deviation, lost_parts
from vhp_cli.kernels.measuring import closest
from vhp_cli.kernels.spatial import Tree
from vhp_cli.mesh import Mesh


def soup(mesh):
    """The same triangles without shared vertices, every other one turned."""
    faces = np.arange(3 * len(mesh.faces)).reshape(-1, 3)
    faces[::2] = faces[::2, ::-1]
    return Mesh(mesh.vertices[mesh.faces].reshape(-1, 3), faces)


def refined(mesh, times=1):
    """Each triangle in four, without shared vertices."""
    corners = mesh.vertices[mesh.faces]
    for _ in range(times):
        a, b, c = (corners[:, k] for k in range(3))
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        corners = np.concatenate([np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
    return Mesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))


def cornerless(size=10.0, cut=4.0):
    """A box of which the corner at (size, size, size) is cut away as a cube, outward."""
    levels = [0.0, size - cut, size]
    quads = []
    for axis in range(3):
        for side in (0, 1):
            for i in range(2):
                for j in range(2):
                    notched = side == 1 and i == 1 and j == 1
                    height = levels[1] if notched else levels[2] * side
                    quads.append((axis, side, height, levels[i], levels[i + 1], levels[j], levels[j + 1]))
    triangles = []
    for axis, side, height, u0, u1, v0, v1 in quads:
        ring = [(u0, v0), (u1, v0), (u1, v1), (u0, v1)]
        points = [np.roll([height, u, v], axis) for u, v in (ring if side else ring[::-1])]
        triangles += [points[:3], [points[0], points[2], points[3]]]
    points, inverse = np.unique(np.reshape(triangles, (-1, 3)), axis=0, return_inverse=True)
    return Mesh(points, inverse.reshape(-1, 3))


def test_a_surface_does_not_deviate_from_itself():
    for mesh in (box(), sphere(), soup(sphere())):
        found = deviation(mesh, mesh, lost_limit_mm=0.001)
        assert found["max"] < 1e-12 and found["mean"] < 1e-12
        assert found["lost_area_mm2"] == 0 and found["lost_places"] == []
        assert lost_parts(mesh, mesh, limit_mm=0.001) == []


def test_shifted_box():
    # Sides across the shift are off by it, those along it only where they stick out: triangles of distance.
    shift = 0.5
    found = deviation(box(), moved(box(), (shift, 0, 0)), lost_limit_mm=0.4)
    assert found["max"] == pytest.approx(shift, abs=1e-12)
    for way in ("to_output", "to_input"):
        assert found[way]["max"] == pytest.approx(shift, abs=1e-12)
        # x = 0 and x = 10 are both off: one sticks out, the other lies inside, no nearer to anything but its rim.
        inner = np.mean(np.minimum(shift, _to_rim(shift)))
        assert found[way]["mean"] == pytest.approx((shift + inner + 4 * shift**2 / 2 / 10) / 6, rel=2e-3)
    # Strips of 0.1 beside the side that sticks out, and the inner side without its rim.
    expected = 100 + (10 - 2 * 0.4) ** 2 + 4 * 10 * 0.1
    assert found["lost_area_mm2"] == pytest.approx(expected, rel=5e-3)
    assert json.loads(json.dumps(found)) == found


def _to_rim(shift):
    """Distance of the points of a square of 10 mm from its rim, no more than the shift."""
    x, y = np.meshgrid(*[(np.arange(2000) + 0.5) / 200] * 2)
    return np.minimum(np.minimum(np.minimum(x, 10 - x), np.minimum(y, 10 - y)), shift)


def test_concentric_spheres():
    found = deviation(sphere(10, subdivisions=4), sphere(11, subdivisions=4), lost_limit_mm=2)
    for way in ("to_output", "to_input"):
        assert found[way]["mean"] == pytest.approx(1, abs=0.01)
        assert found[way]["max"] == pytest.approx(1, abs=0.03)
    # Smaller by the sagitta of the large triangles on the one hand, exact at the vertices on the other.
    coarse = deviation(sphere(10, subdivisions=1), sphere(10, subdivisions=5), lost_limit_mm=2)
    corners = sphere(10, subdivisions=1)
    centres = corners.vertices[corners.faces].mean(axis=1)
    depth = 10 - np.linalg.norm(centres, axis=1).min()
    assert coarse["to_output"]["max"] == pytest.approx(depth, abs=0.02)


def test_missing_corner_is_one_lost_part_outside():
    whole, cut = refined(box(), 5), cornerless()
    assert lost_parts(soup(cut), box(), limit_mm=10) == []
    found = deviation(box(), cut, lost_limit_mm=1)
    # The corner itself is as far from the three inner sides as the cut is deep.
    assert found["to_output"]["max"] == pytest.approx(4, abs=1e-12)
    assert found["to_output"]["xyz_mm"] == [10, 10, 10]
    # Each side of the corner, a square of 4 with 1 left along two sides: nearer to what is left of the box.
    assert found["lost_area_mm2"] == pytest.approx(3 * 3 * 3, rel=0.02)
    assert [place["xyz_mm"] for place in found["lost_places"]] == [[10, 10, 10]]
    assert found["lost_places"][0]["value"] == pytest.approx(4)
    points, inverse = np.unique(whole.vertices, axis=0, return_inverse=True)
    parts = lost_parts(Mesh(points, inverse.reshape(-1, 3)), cut, limit_mm=1)
    assert len(parts) == 1
    assert parts[0].area_mm2 == pytest.approx(27, rel=0.05)
    assert parts[0].distance_mm == pytest.approx(4, abs=1e-12)
    assert parts[0].xyz_mm == [10, 10, 10]
    assert parts[0].share_outside == 1
    assert (10, 10, 10) in [tuple(corner) for corner in whole.vertices[whole.faces[parts[0].face]]]


def test_inner_wall_and_filled_cavity_are_lost_inside():
    hollow = joined(sphere(10), flipped(sphere(5)))
    parts = lost_parts(hollow, sphere(10), limit_mm=1)
    assert len(parts) == 1
    assert parts[0].share_outside == 0
    assert parts[0].faces == len(sphere(5).faces)
    # All of the inner sphere.
    corners = sphere(5).vertices[sphere(5).faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    assert parts[0].area_mm2 == pytest.approx(area, rel=1e-9)


def test_lost_parts_are_told_apart_and_the_farthest_comes_first():
    before = joined(sphere(10), moved(sphere(1), (30, 0, 0)), moved(sphere(2), (0, 50, 0)))
    parts = lost_parts(before, sphere(10), limit_mm=0.5)
    assert [part.faces for part in parts] == [len(sphere().faces)] * 2
    assert [round(part.distance_mm) for part in parts] == [42, 21]
    assert parts[0].xyz_mm == pytest.approx([0, 52, 0], abs=0.3)
    assert parts[1].share_outside == 1
    found = deviation(before, sphere(10), lost_limit_mm=0.5)
    assert [place["value"] for place in found["lost_places"]] == [part.distance_mm for part in parts]
    assert found["lost_area_mm2"] == pytest.approx(sum(part.area_mm2 for part in parts))
    assert found["to_input"]["max"] < 1e-12


def test_soups_open_and_non_manifold_surfaces():
    open_box = Mesh(box().vertices, box().faces[2:])
    fin = Mesh(np.vstack((box().vertices, [(5, 5, 15)])), np.vstack((box().faces, [(0, 7, 8)])))
    for broken in (soup(box()), open_box, fin, Mesh(box().vertices, np.vstack((box().faces, [(0, 0, 1), (2, 2, 2)])))):
        found = deviation(broken, box(), lost_limit_mm=1)
        back = deviation(box(), broken, lost_limit_mm=1)
        assert found["max"] == pytest.approx(back["max"])
        assert found["to_input"] == back["to_output"]
    assert deviation(soup(box()), box(), lost_limit_mm=1)["max"] < 1e-12
    # The middle of the side that is missing.
    assert deviation(box(), open_box, lost_limit_mm=1)["max"] == pytest.approx(5, abs=0.05)
    parts = lost_parts(fin, box(), limit_mm=1)
    assert [part.face for part in parts] == [12]
    assert parts[0].distance_mm == pytest.approx(5)
    assert parts[0].xyz_mm == [5, 5, 15]
    # A face without an area is a part without an area.
    needle = Mesh(np.vstack((box().vertices, [(30, 0, 0), (40, 0, 0)])), np.vstack((box().faces, [(8, 9, 9)])))
    (part,) = lost_parts(needle, box(), limit_mm=1)
    assert (part.area_mm2, part.distance_mm, part.face, part.share_outside) == (0, 30, 12, 1)


def test_faces_that_meet_at_a_vertex_are_separate_parts():
    # Two lost triangles and their common vertex: one sample too few for three parts.
    vertices = [(0, 0, 20), (1, 0, 20), (0, 1, 20), (-1, 0, 20), (0, -1, 20)]
    bow = joined(box(), Mesh(vertices, [(0, 1, 2), (0, 3, 4)]))
    parts = lost_parts(bow, box(), limit_mm=1)
    assert [part.faces for part in parts] == [1, 1]
    assert [part.area_mm2 for part in parts] == pytest.approx([0.5, 0.5])


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6))
def test_no_point_is_far_from_a_sample(seed):
    """The maximum is too small by no more than the bound that the module states."""
    generator = np.random.default_rng(seed)
    corners = generator.normal(size=(20, 3, 3)) * 10.0 ** generator.uniform(-2, 2, (20, 1, 1))
    mesh = Mesh(corners.reshape(-1, 3), np.arange(60).reshape(-1, 3))
    other = Mesh(generator.normal(size=(30, 3)) * 50, np.arange(30).reshape(-1, 3))
    found = deviation(mesh, other, lost_limit_mm=1)["to_output"]
    weights = generator.dirichlet((0.7, 0.7, 0.7), (20, 2000))
    points = np.einsum("fpk,fkd->fpd", weights, corners).reshape(-1, 3)
    dense = closest(Tree(other.vertices, other.faces), points).distances.max()
    spacing = np.linalg.norm(np.ptp(mesh.vertices, axis=0)) / 200
    assert dense - 1.7 * spacing <= found["max"]
    # Never too large: the farthest point of a triangle soup from an upper bound of it.
    upper = closest(Tree(other.vertices, other.faces), corners.mean(axis=1)).distances
    reach = np.linalg.norm(corners - corners.mean(axis=1, keepdims=True), axis=2).max(axis=1)
    assert found["max"] <= (upper + reach).max() + 1e-9


def test_mean_is_that_of_random_points():
    mesh, other = sphere(10, subdivisions=2), box((-9, -8, -7), (9, 8, 7))
    corners = mesh.vertices[mesh.faces]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    generator = np.random.default_rng(3)
    chosen = corners[generator.choice(len(corners), 200_000, p=areas / areas.sum())]
    points = np.einsum("pk,pkd->pd", generator.dirichlet((1, 1, 1), len(chosen)), chosen)
    expected = closest(Tree(other.vertices, other.faces), points).distances
    found = deviation(mesh, other, lost_limit_mm=2)
    assert found["to_output"]["mean"] == pytest.approx(expected.mean(), rel=0.01)
    assert found["lost_area_mm2"] == pytest.approx((expected > 2).mean() * areas.sum() / 2, rel=0.02)
    assert found["max"] >= expected.max() - 1e-3


def test_the_same_twice():
    first = deviation(sphere(), moved(sphere(), (0.1, 0.2, 0.3)), lost_limit_mm=0.1)
    assert first == deviation(sphere(), moved(sphere(), (0.1, 0.2, 0.3)), lost_limit_mm=0.1)


def test_nothing_to_measure_is_an_error():
    empty = Mesh(np.empty((0, 3)), np.empty((0, 3), int))
    for pair in ((empty, box()), (box(), empty)):
        with pytest.raises(ValueError, match="without faces"):
            deviation(*pair, lost_limit_mm=1)
        with pytest.raises(ValueError, match="without faces"):
            lost_parts(*pair, limit_mm=1)
    with pytest.raises(ValueError, match="limit"):
        deviation(box(), sphere(), lost_limit_mm=-1)


def test_all_real_meshes_against_themselves_moved(shared_data):
    for path in sorted(shared_data.glob("*/*.stl"))[::30]:
        mesh = read_mesh(path).mesh
        if not len(mesh.faces):
            continue
        size = float(np.ptp(mesh.vertices, axis=0).max())
        shift = np.array([1e-3 * size, 0, 0])
        found = deviation(mesh, moved(mesh, shift), lost_limit_mm=2e-3 * size)
        assert 0 < found["max"] <= 1e-3 * size * (1 + 1e-9), path
        assert found["lost_area_mm2"] == 0
        assert found["to_output"]["mean"] == pytest.approx(found["to_input"]["mean"], rel=0.02)
