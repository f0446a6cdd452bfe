"""Measures of single surfaces against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from shapes import box, flipped, joined, moved, sphere

from vhp_cli.inspection.tissue import ShapeLimits, inspect_tissue, restore_surface
from vhp_cli.mesh import Mesh

LIMITS = ShapeLimits(quality=0.01, edge_mm=0.01, fold_deg=0.1)


def inspect(mesh, limits=LIMITS):
    measures, defects, _ = inspect_tissue(mesh, limits)
    return measures, defects


def without(mesh, *faces):
    return Mesh(mesh.vertices, np.delete(mesh.faces, faces, axis=0))


def test_a_box():
    measures, defects = inspect(box((1, 2, 3), (11, 12, 13)))
    assert defects == {}
    assert (measures["triangles"], measures["vertices"], measures["components"]) == (12, 8, 1)
    assert (measures["euler"], measures["genus"]) == (2, 0)
    assert measures["closed"] and measures["manifold"] and measures["oriented"] and measures["outward"]
    assert measures["volume_mm3"] == pytest.approx(1000, rel=1e-12)
    assert measures["area_mm2"] == pytest.approx(600, rel=1e-12)
    assert measures["centroid_mm"] == pytest.approx([6, 7, 8])
    assert measures["bounds_mm"] == {"min": [1, 2, 3], "max": [11, 12, 13]}
    # r_in / r_out of a right isosceles triangle, thesis eq. 2.4
    q = 2 * (1 - 1 / math.sqrt(2)) * math.sqrt(2)
    assert measures["quality"]["min"] == pytest.approx(q, rel=1e-12)
    assert measures["quality"]["mean"] == pytest.approx(q, rel=1e-12)
    assert sum(measures["quality"]["histogram"]) == 12
    assert measures["edge_mm"]["min"] == 10 and measures["edge_mm"]["max"] == pytest.approx(10 * math.sqrt(2))
    assert measures["size_mm"]["max"] == pytest.approx(10 / math.sqrt(2))
    assert measures["min_dihedral_deg"] == pytest.approx(90)
    assert measures["self_intersections"]["pairs"] == 0


def test_a_torus_has_one_handle():
    rows, columns = 24, 12
    u, v = np.meshgrid(*(np.arange(n) * 2 * np.pi / n for n in (rows, columns)), indexing="ij")
    ring = 20 + 5 * np.cos(v)
    vertices = np.stack((ring * np.cos(u), ring * np.sin(u), 5 * np.sin(v)), -1).reshape(-1, 3)
    index = np.arange(rows * columns).reshape(rows, columns)
    right, up, both = np.roll(index, -1, 0), np.roll(index, -1, 1), np.roll(index, (-1, -1), (0, 1))
    faces = np.concatenate([np.stack(t, -1).reshape(-1, 3) for t in ((index, right, both), (index, both, up))])
    measures, defects = inspect(Mesh(vertices, faces))
    assert defects == {} and measures["genus"] == 1 and measures["outward"]
    assert measures["volume_mm3"] == pytest.approx(2 * np.pi**2 * 20 * 25, rel=0.06)


def test_a_hole_is_located():
    mesh = sphere(subdivisions=2)
    measures, defects = inspect(without(mesh, 7))
    assert list(defects) == ["T001"] and defects["T001"]["count"] == 3
    assert not measures["closed"] and measures["manifold"] and measures["genus"] is None
    assert defects["T001"]["places"][0]["xyz_mm"] == pytest.approx(mesh.vertices[mesh.faces[7]].mean(0), abs=1e-5)
    two, defects = inspect(without(mesh, 7, 200))
    assert two["topology"]["boundary_loops"] == 2 and "2 holes" in defects["T001"]["detail"]


def test_a_flipped_face_is_located():
    mesh = sphere()
    faces = mesh.faces.copy()
    faces[11] = faces[11][::-1]
    measures, defects = inspect(Mesh(mesh.vertices, faces))
    assert set(defects) == {"T004"} and defects["T004"]["count"] == 3 and not measures["oriented"]
    near = np.linalg.norm(np.array(defects["T004"]["places"][0]["xyz_mm"]) - mesh.vertices[mesh.faces[11]].mean(0))
    assert near < 3


def test_inside_out_and_cavities():
    shell = joined(sphere(10), flipped(sphere(5)))
    measures, defects = inspect(shell)
    assert defects == {} and measures["outward"] and measures["components"] == 2
    assert set(inspect(flipped(sphere(10)))[1]) == {"T005"}
    for wrong in (joined(sphere(10), sphere(5)), flipped(shell), joined(flipped(sphere(10)), flipped(sphere(5)))):
        measures, defects = inspect(wrong)
        assert "T005" in defects and not measures["outward"]
    # A ball inside the cavity is outward again.
    nested = joined(sphere(10), flipped(sphere(5)), sphere(2))
    assert inspect(nested)[1] == {} and inspect(nested)[0]["outward"]
    side_by_side = joined(sphere(10), moved(sphere(10), (30, 0, 0)))
    assert inspect(side_by_side)[1] == {}
    _, defects = inspect(joined(sphere(10), moved(flipped(sphere(5)), (30, 0, 0))))
    assert defects["T005"]["count"] == 1 and defects["T005"]["places"][0]["xyz_mm"][0] > 20


def test_duplicate_degenerate_and_short():
    mesh = sphere()
    doubled = Mesh(mesh.vertices, np.concatenate((mesh.faces, mesh.faces[5:6])))
    measures, defects = inspect(doubled)
    assert defects["T006"]["count"] == 1 and defects["T006"]["places"][0]["face"] == len(mesh.faces)
    assert "T002" in defects and measures["self_intersections"]["duplicate"] == 1
    needle = Mesh([[0, 0, 0], [10, 0, 0], [10, 1e-4, 0]], [[0, 1, 2]])
    measures, defects = inspect(needle)
    assert defects["Q001"]["count"] == 1 and defects["Q001"]["detail"] == "a needle"
    assert defects["Q002"]["count"] == 1 and defects["Q002"]["value"] == pytest.approx(1e-4)
    flat = Mesh([[0, 0, 0], [5, 0, 0], [10, 0, 0]], [[0, 1, 2]])
    assert inspect(flat)[1]["Q003"]["count"] == 1
    collapsed = Mesh(mesh.vertices, np.concatenate((mesh.faces, [[4, 4, 7]])))
    measures, defects = inspect(collapsed)
    assert measures["topology"]["collapsed_faces"] == 1 and defects["Q003"]["count"] == 1
    assert measures["closed"] and measures["components"] == 1


def test_two_boxes_at_an_edge_and_at_a_corner():
    """Voxel surfaces: welded where they meet."""

    def welded(*meshes):
        mesh = joined(*meshes)
        vertices, index = np.unique(mesh.vertices, axis=0, return_inverse=True)
        return Mesh(vertices, index.reshape(-1)[mesh.faces])

    edge, defects = inspect(welded(box(), box((10, 10, 0), (20, 20, 10))))
    assert defects["T002"]["count"] == 1 and edge["topology"]["nonmanifold_vertices"] == 2
    assert edge["closed"] and not edge["manifold"] and not edge["outward"]
    _, defects = inspect(welded(box(), box((10, 10, 10), (20, 20, 20))))
    assert set(defects) == {"T003"} and defects["T003"]["count"] == 1
    assert defects["T003"]["places"][0]["xyz_mm"] == [10, 10, 10]
    # Three faces at an edge: no way to tell inside from outside.
    fin = Mesh(np.append(box().vertices, [[5, 5, 30]], 0), np.append(box().faces, [[4, 5, 8]], 0))
    assert not inspect(fin)[0]["closed"]


def test_a_crossing_is_located_where_it_is():
    both = joined(sphere(10), moved(sphere(10), (14, 0.5, 0.25)))
    measures, defects = inspect(both)
    assert set(defects) == {"X001"}
    assert defects["X001"]["count"] == measures["self_intersections"]["crossing"] > 10
    for place in defects["X001"]["places"]:
        assert 6 < place["xyz_mm"][0] < 8  # both spheres meet in the plane half way


def test_a_solid_too_flat_to_have_an_outside_is_no_pass():
    for height in (1e-12, -1e-12):
        ring = [(50 * math.cos(t), 50 * math.sin(t), 0) for t in np.arange(6) * math.pi / 3]
        faces = [f for k in range(6) for f in ((k, (k + 1) % 6, 6), ((k + 1) % 6, k, 7))]
        measures, defects = inspect(Mesh([*ring, (0, 0, height), (0, 0, -height)], faces))
        assert "T005" in defects and not measures["outward"]


def test_a_fold_is_measured():
    roof = Mesh([[0, 0, 0], [10, 0, 0], [5, 8, 0], [5, 8, 0.001]], [[0, 1, 2], [1, 0, 3]])
    measures, defects = inspect(roof)
    angle = math.degrees(math.atan2(0.001, 8))
    assert measures["min_dihedral_deg"] == pytest.approx(angle, rel=1e-3)
    assert defects["X005"]["count"] == 1 and "X003" not in defects
    flat = Mesh([[0, 0, 0], [10, 0, 0], [5, 8, 0], [5, 7, 0]], [[0, 1, 2], [1, 0, 3]])
    assert "X003" in inspect(flat)[1] and "X005" not in inspect(flat)[1]


def test_limits_decide_what_counts():
    mesh = box()
    assert inspect(mesh, ShapeLimits(0.9, 0.01, 0.1))[1]["Q001"]["count"] == 12
    assert inspect(mesh, ShapeLimits(0.01, 12.0, 0.1))[1]["Q002"]["count"] == 12
    assert "X005" in inspect(mesh, ShapeLimits(0.01, 0.01, 91))[1]


def test_restored_surface_is_the_inspected_one():
    for mesh in (sphere(), joined(sphere(10), flipped(sphere(5))), without(sphere(), 3)):
        measures, _, surface = inspect_tissue(mesh, LIMITS)
        again = restore_surface(mesh, measures)
        assert (again.closed, again.solid) == (surface.closed, surface.solid)
        assert again.representatives.tolist() == surface.representatives.tolist()


def test_a_hopeless_soup_ends_soon():
    """Triangles that nearly all cross each other: their pairs are counted up to a bound only."""
    corners = np.random.default_rng(5).uniform(0, 100, (20_000, 3, 3))
    soup = Mesh(corners.reshape(-1, 3), np.arange(60_000).reshape(-1, 3))
    measures, defects = inspect(soup)
    assert not measures["self_intersections"]["complete"]
    assert 10_000_000 <= measures["self_intersections"]["pairs"] < 10_100_000
    assert "counting stopped" in defects["X001"]["detail"]
