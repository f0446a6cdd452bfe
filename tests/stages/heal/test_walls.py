from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from repair_shapes import flaws, tube, volume, welded
from shapes import flipped, joined, moved, sphere

from vhp_cli.mesh import Mesh
from vhp_cli.stages.heal.holes import fill_holes, holes
from vhp_cli.stages.heal.orientation import orient
from vhp_cli.stages.heal.walls import _bridged, join_walls


def section(radius, corners):
    return corners / 2 * radius**2 * np.sin(2 * np.pi / corners)


@given(st.integers(8, 30), st.integers(8, 30), st.floats(0, 1), st.booleans(), st.booleans())
@settings(max_examples=30, deadline=None)
def test_the_wall_of_a_vessel(outer_corners, inner_corners, turned, flip_outer, flip_inner):
    outer, inner = tube(5, corners=outer_corners), tube(3.5, corners=inner_corners, turned=turned)
    sheets, _ = orient(joined(flipped(outer) if flip_outer else outer, flipped(inner) if flip_inner else inner))
    wall, actions = join_walls(sheets)
    assert len(actions) == 2
    assert flaws(wall) == {}
    expected = 30 * (section(5, outer_corners) - section(3.5, inner_corners))
    assert volume(wall) == pytest.approx(expected, rel=1e-6)
    rims = section(5, outer_corners) - section(3.5, inner_corners)
    assert [action["area_mm2"] for action in actions] == [pytest.approx(rims, rel=1e-6)] * 2
    assert orient(wall)[0] is wall


def test_the_wall_of_a_cup_is_joined_at_its_rim_alone():
    # Outer and inner sheet closed at one end each: two parts with one loop each.
    outer, inner = tube(5, 30), tube(4, 26, start=4.0)
    ends = []
    for part, x in ((outer, 0), (inner, 4)):
        ends.append(fill_holes(part, [hole for hole in holes(part) if abs(hole.centre[0] - x) < 1])[0])
    cup, actions = join_walls(orient(joined(*ends))[0])
    assert len(actions) == 1
    assert flaws(cup) == {}
    assert volume(cup) == pytest.approx(30 * section(5, 12) - 26 * section(4, 12), rel=1e-6)


def test_loops_of_one_component():
    # The same cup, its bottoms left out but the sheets joined there by a band: a wall that is one component.
    outer, inner = tube(5, 30), tube(4, 30)
    both, _ = join_walls(orient(joined(outer, inner))[0])
    n = len(both.faces)
    centroids = both.vertices[both.faces].mean(axis=1)
    opened = Mesh(both.vertices, both.faces[~((centroids[:, 0] > 29.9) & (np.arange(n) >= len(outer.faces) * 2))])
    assert flaws(opened)["open"] == 24
    closed, (action,) = join_walls(opened)
    assert flaws(closed) == {} and volume(closed) == pytest.approx(volume(both))
    assert action["count"] == 1


def test_a_plain_tube_long_or_short_is_no_wall():
    ring = tube(5, 2, rings=3)
    # It bulges, so that a band between its ends would meet nothing.
    bulging = ring.vertices.copy()
    bulging[12:24, 1:] *= 1.2
    for mesh in (tube(), tube(5, 2, rings=2), tube(5, 0.5, rings=2), Mesh(bulging, ring.faces)):
        same, actions = join_walls(mesh)
        assert same is mesh and actions == []


def test_two_tubes_side_by_side_are_no_wall():
    mesh = joined(tube(), moved(tube(), (0, 11, 0)), sphere(2, (100, 0, 0)))
    same, actions = join_walls(mesh)
    assert same is mesh and actions == []


def test_the_rim_of_a_fork():
    # One outer tube, two lumens within it, joined at the far end by a flat rim made by hand.
    outer, one, two = tube(10, 30, 24), flipped(tube(3, 30, 10)), flipped(tube(3.5, 30, 12))
    parts = joined(outer, moved(one, (0, 4.5, 0)), moved(two, (0, -4.5, 0)))
    far = sorted((hole for hole in holes(parts) if hole.centre[0] > 29), key=lambda hole: -hole.area_mm2)
    rim = _bridged(parts, far[0].loop, [hole.loop for hole in far[1:]], "angle")
    one_piece = Mesh(parts.vertices, np.vstack([parts.faces, rim.faces]))
    closed, (action,) = join_walls(one_piece)
    assert flaws(closed) == {}
    assert volume(closed) == pytest.approx(30 * (section(10, 24) - section(3, 10) - section(3.5, 12)), rel=1e-5)
    assert action["area_mm2"] == pytest.approx(section(10, 24) - section(3, 10) - section(3.5, 12), rel=1e-5)
    assert welded(closed).faces.shape == closed.faces.shape


@pytest.mark.parametrize("aside", [1.0, 2.5, 4.0, 8.0])
def test_bands_are_no_worse_than_caps_where_the_wall_crosses_itself(aside):
    inner = tube(3.5, 30)
    bent = inner.vertices.copy()
    bent[-12:, 1] += aside
    sheets, _ = orient(joined(tube(), Mesh(bent, inner.faces)))
    joined_sheets, actions = join_walls(sheets)
    bands, caps = (flaws(orient(fill_holes(mesh)[0])[0]) for mesh in (joined_sheets, sheets))
    assert "open" not in bands
    assert bands.get("hits", 0) <= caps.get("hits", 0)
    if aside == 1.0:
        assert len(actions) == 2 and bands == {}
