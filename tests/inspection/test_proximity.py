"""Relations between two surfaces against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from shapes import box, flipped, joined, moved, sphere

from vhp_cli.inspection.nesting import nesting
from vhp_cli.inspection.proximity import inspect_pair, near_pairs
from vhp_cli.inspection.tissue import ShapeLimits, inspect_tissue
from vhp_cli.mesh import Mesh

LIMITS = ShapeLimits(quality=0.01, edge_mm=0.01, fold_deg=0.1)


def pair(a, b, search=1.0):
    return inspect_pair(inspect_tissue(a, LIMITS)[2], inspect_tissue(b, LIMITS)[2], search)


def test_boxes_apart():
    far = pair(box(), moved(box(), (15, 0, 0)))
    assert far is None
    near = pair(box(), moved(box(), (15, 0, 0)), search=math.inf)
    assert near["relation"] == "disjoint" and near["min_gap_mm"] == pytest.approx(5, rel=1e-12)
    assert abs(near["points_mm"][0][0] - near["points_mm"][1][0]) == pytest.approx(5)
    corner = pair(box(), moved(box(), (10.5, 10.5, 10.5)))
    assert corner["min_gap_mm"] == pytest.approx(0.5 * math.sqrt(3), rel=1e-12)


@pytest.mark.parametrize("shift", [(10, 0, 0), (10, 3, 4), (10, 10, 0), (10, 10, 10)])
def test_boxes_in_contact(shift):
    touching = pair(box(), moved(box(), shift))
    assert touching["relation"] == "touching" and touching["inside"] == ""
    assert touching["min_gap_mm"] == 0 and touching["contact_faces"] > 0
    assert touching["overlap_mm3"] == pytest.approx(0, abs=1e-3)
    assert (touching["coplanar_faces"] > 0) == (shift[1] < 10)


@pytest.mark.parametrize("shift", [(4, 3, 2), (9.75, 9.75, 9.75), (0, 0, 5), (5, 0, 0), (0.5, 0.25, -0.125)])
def test_overlap_volume_of_boxes(shift):
    crossing = pair(box(), moved(box(), shift))
    assert crossing["relation"] == "crossing"
    assert crossing["overlap_mm3"] == pytest.approx(np.prod(10 - np.abs(shift)), rel=1e-6)


def test_enclosed_both_ways_and_with_contact():
    inner, outer = sphere(5), sphere(10)
    assert pair(inner, outer)["relation"] == "a_inside_b"
    assert pair(outer, inner)["relation"] == "b_inside_a"
    close = pair(sphere(9.5, subdivisions=4), sphere(10, subdivisions=4))
    assert close["relation"] == "a_inside_b" and 0.45 < close["min_gap_mm"] < 0.5
    inside_touching = pair(box((0, 2, 2), (5, 5, 5)), box())
    assert inside_touching["relation"] == "touching" and inside_touching["inside"] == "a"
    assert inside_touching["overlap_mm3"] == pytest.approx(45, rel=1e-6)


def test_a_cavity_is_outside():
    shell = joined(sphere(10), flipped(sphere(8)))
    in_cavity = pair(shell, sphere(3), search=math.inf)
    assert in_cavity["relation"] == "disjoint" and in_cavity["inside"] == ""
    assert pair(shell, sphere(3)) is None


def test_every_part_must_be_inside():
    scattered = joined(sphere(1), moved(sphere(1), (0, 0, 8)))
    assert pair(scattered, sphere(20))["inside"] == "a"
    halfway = joined(sphere(1, subdivisions=1), moved(sphere(1, subdivisions=1), (30, 0, 0)))
    found = pair(halfway, sphere(20))
    assert found["relation"] == "crossing" and found["inside"] == "" and found["crossing_faces"] == 0
    assert found["overlap_mm3"] == pytest.approx(volume(sphere(1, subdivisions=1)), rel=1e-6)


def volume(mesh):
    corners = mesh.vertices[mesh.faces]
    return np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6


def test_a_solid_in_the_wall_around_a_cavity_is_not_enclosed():
    """Its surface runs in the wall, yet it fills the cavity too: it is no subset of what surrounds it."""
    hollow = joined(box((0, 0, 0), (20, 20, 20)), flipped(box((7, 7, 7), (13, 13, 13))))
    found = pair(box((5, 5, 5), (15, 15, 15)), hollow)
    assert found["relation"] == "crossing" and found["overlap_mm3"] == pytest.approx(1000 - 216, rel=1e-6)
    shell = joined(box((5, 5, 5), (15, 15, 15)), flipped(box((6, 6, 6), (14, 14, 14))))
    assert pair(shell, hollow)["relation"] == "a_inside_b"


def test_one_solid_in_two_triangulations_is_no_mere_contact():
    cut = box()
    faces = cut.faces.copy()
    faces[0], faces[1] = (0, 2, 1), (1, 2, 3)  # the other diagonal of one side
    found = pair(box(), Mesh(cut.vertices, faces))
    assert found["relation"] == "crossing" and found["overlap_mm3"] == pytest.approx(1000)


def test_a_shallow_overlap_with_flush_sides_is_an_overlap():
    found = pair(box((0, 0, 0), (20, 20, 20)), box((20 - 1e-5, 0, 0), (40, 20, 20)))
    assert found["relation"] == "crossing" and found["overlap_mm3"] == pytest.approx(0.004, rel=1e-3)


def test_gaps_too_small_to_measure_are_gaps():
    tip = Mesh([[0, 0, 1e-16], [1, 0, 5], [0, 1, 5], [-1, -1, 5]], [[0, 2, 1], [0, 3, 2], [0, 1, 3], [1, 2, 3]])
    floor = box((-5, -5, -5), (5, 5, 0))
    found = pair(tip, floor)
    assert found["relation"] == "disjoint" and 0 <= found["min_gap_mm"] < 1e-15


def test_identical_whatever_the_order():
    mesh = sphere()
    order = np.random.default_rng(1).permutation(len(mesh.faces))
    other = Mesh(mesh.vertices, np.roll(mesh.faces[order], 1, axis=1))
    found = pair(mesh, other)
    assert found["relation"] == "identical"
    almost = mesh.vertices.copy()
    almost[0] += 1e-3
    assert pair(mesh, Mesh(almost, mesh.faces))["relation"] != "identical"


def test_one_ulp_apart_and_one_ulp_across():
    step = float(np.spacing(np.float32(512)))
    lower, upper = (500.0, 500.0, 500.0), (512.0, 512.0, 512.0)
    base = box(lower, upper)
    assert pair(base, box((512 + step, 500, 500), (530, 512, 512)))["relation"] == "disjoint"
    assert pair(base, box((512, 500, 500), (530, 512, 512)))["relation"] == "touching"
    across = pair(base, box((512 - step, 501, 501), (530, 511, 511)))
    assert across["relation"] == "crossing"


def test_open_surfaces_do_not_enclose_for_certain():
    mesh = sphere(10, subdivisions=3)
    bowl = Mesh(mesh.vertices, mesh.faces[mesh.vertices[mesh.faces].mean(1)[:, 2] < 0])
    in_mouth = pair(sphere(0.5, (0, 0, -0.8)), bowl)
    assert in_mouth["undecided"] and in_mouth["inside"] == ""
    pinhole = Mesh(mesh.vertices, mesh.faces[1:])
    assert pair(sphere(2), pinhole)["inside"] == "a"


def test_near_pairs_are_complete():
    rng = np.random.default_rng(3)
    lower = rng.uniform(0, 50, (40, 3))
    upper = lower + rng.uniform(0, 10, (40, 3))
    expected = [
        (i, j)
        for i in range(40)
        for j in range(i + 1, 40)
        if all(max(lower[i, k], lower[j, k]) - min(upper[i, k], upper[j, k]) <= 1.5 for k in range(3))
    ]
    assert [tuple(row) for row in near_pairs(lower, upper, 1.5)] == expected
    assert len(near_pairs(lower, upper, math.inf)) == 40 * 39 // 2


def test_nesting_takes_the_smallest_container():
    pairs = [
        {"a": "skin", "b": "fat", "inside": "b"},
        {"a": "heart", "b": "skin", "inside": "a"},
        {"a": "fat", "b": "heart", "inside": "b"},
        {"a": "arm", "b": "heart", "inside": ""},
    ]
    volumes = {"skin": 3.0, "fat": 2.0, "heart": 1.0, "arm": 1.0}
    assert nesting(volumes, pairs, volumes) == {"skin": None, "fat": "skin", "heart": "fat", "arm": None}
