"""Inner shells: nested, as deep as asked, wherever the body is thin or bent."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapes import box, flipped, joined, sphere

from vhp_cli.errors import UsageError, VhpError
from vhp_cli.kernels.measuring import closest
from vhp_cli.kernels.spatial import Tree, gap
from vhp_cli.kernels.surface import topology
from vhp_cli.mesh import Mesh
from vhp_cli.stages.clearance.zero_surface import zero_surface
from vhp_cli.stages.heal.candidate import as_written, judge
from vhp_cli.stages.shells import shells
from vhp_cli.stages.shells.thickness import STEEPEST, FatPoint, at_vertices, from_map, gentle, interpolated, table

BODY = sphere(20, subdivisions=3)


def depths(skin: Mesh, mesh: Mesh):
    inside = Tree(skin.vertices, skin.faces).inside(mesh.vertices) == 1
    distances = closest(Tree(skin.vertices, skin.faces), mesh.vertices).distances
    return np.where(inside, distances, -distances)


@pytest.mark.slow
def test_shells_of_a_ball_are_as_deep_as_asked():
    fat, body = shells(BODY, 1.0, np.full(len(BODY.vertices), 4.0))
    assert (fat.name, body.name) == ("fat", "average_body")
    assert depths(BODY, fat.mesh) == pytest.approx(1.06, abs=0.12)
    assert depths(BODY, body.mesh) == pytest.approx(5.1, abs=0.3)
    assert 1.0 <= fat.gap_mm < 1.1 and 4.0 <= body.gap_mm < 4.2
    for outer, shell in ((BODY, fat.mesh), (fat.mesh, body.mesh)):
        candidate = judge(shell)
        assert candidate.sound and candidate.min_quality > 0.1
        assert (Tree(outer.vertices, outer.faces).inside(shell.vertices) == 1).all()


@pytest.mark.slow
def test_thickness_that_varies_is_followed():
    wanted = 5 + 3 * BODY.vertices[:, 2] / 20
    _, body = shells(BODY, 1.0, wanted)
    below = 1 + 5 + 3 * body.mesh.vertices[:, 2] / np.linalg.norm(body.mesh.vertices, axis=1)
    assert np.abs(depths(BODY, body.mesh) - below).max() < 0.4


@pytest.mark.slow
def test_between_fingers_shells_stay_apart_and_sound():
    def hand(points, _):
        def rod(start, end, radius):
            along = np.subtract(end, start).astype(float)
            part = np.clip((points - start) @ along / (along @ along), 0, 1)
            return np.linalg.norm(points - start - part[:, None] * along, axis=1) - radius

        rods = [rod((0, 0, 0), (30, 0, 0), 14)]
        rods += [rod((28, y, 0), (62, 1.25 * y, 0), 4.0) for y in (-10.5, 0.0, 10.5)]
        return np.min(rods, axis=0)

    skin = as_written(zero_surface(hand, [-20.0] * 3, [70.0, 20.0, 20.0], 1.5))
    assert judge(skin).sound
    fat, body = shells(skin, 1.0, np.full(len(skin.vertices), 1.5))
    for outer, shell, wanted in ((skin, fat, 1.0), (fat.mesh, body, 1.5)):
        assert judge(shell.mesh).sound and shell.gap_mm >= wanted
        assert gap(Tree(outer.vertices, outer.faces), Tree(shell.mesh.vertices, shell.mesh.faces)).contact_kind == 0
    # The fingers have kept their insides.
    assert body.mesh.vertices[:, 0].max() > 55


@pytest.mark.parametrize(
    ("skin", "message"),
    [
        (Mesh(BODY.vertices, BODY.faces[:-3]), "open edge"),
        (flipped(BODY), "inside out"),
        (joined(box(), box((5, 5, 5), (15, 15, 15))), "intersecting"),
    ],
)
def test_a_skin_that_is_not_sound_is_refused(skin, message):
    with pytest.raises(VhpError, match=message):
        shells(skin, 1.0, np.full(len(skin.vertices), 2.0))


def test_a_body_too_thin_for_its_layers_is_refused():
    with pytest.raises(VhpError, match="nothing of the body is left"):
        shells(sphere(5, subdivisions=3), 1.0, np.full(642, 8.0))


@settings(max_examples=20, deadline=None)
@given(st.lists(st.floats(0.5, 30), min_size=162, max_size=162))
def test_gentle_thickness_is_nowhere_steep_nor_larger(values):
    mesh, given_values = sphere(20, subdivisions=2), np.array(values)
    found = gentle(mesh, given_values)
    edges = topology(mesh.vertices, mesh.faces).inner_edges
    lengths = np.linalg.norm(mesh.vertices[edges[:, 0]] - mesh.vertices[edges[:, 1]], axis=1)
    assert (np.abs(found[edges[:, 0]] - found[edges[:, 1]]) <= STEEPEST * lengths + 1e-9).all()
    assert (found <= given_values).all() and found.min() == given_values.min()
    assert np.array_equal(gentle(mesh, found), found)


def test_points_are_met_and_blended():
    mesh = box((0, 0, 0), (100, 100, 100))
    found = interpolated(mesh, [FatPoint((0, 0, 0), 2.0), FatPoint((100, 100, 100), 6.0)])
    assert found[0] == pytest.approx(2, abs=1e-3) and found[-1] == pytest.approx(6, abs=1e-3)
    assert ((found >= 2) & (found <= 6)).all()


def test_the_table_of_the_thesis_by_place_and_age():
    groups, places = table()
    assert groups == ("20-29", "30-39", "40-49", "50-") and len(places) == 9
    points = from_map({"age": "40-49", "point": [{"xyz": [1, 2, 3], "place": "illiac"}]}, "map")
    assert points == [FatPoint((1.0, 2.0, 3.0), 20.8)]
    assert from_map({"point": [{"xyz": [0, 0, 0], "thickness": 3}]}, "map")[0].thickness_mm == 3


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({}, "point"),
        ({"point": [{"xyz": [1, 2], "thickness": 3}]}, "three numbers"),
        ({"point": [{"xyz": [1, 2, 3]}]}, "either"),
        ({"point": [{"xyz": [1, 2, 3], "place": "Nose"}], "age": "20-29"}, "not known"),
        ({"point": [{"xyz": [1, 2, 3], "place": "Deltoid"}]}, "age"),
        ({"point": [{"xyz": [1, 2, 3], "thickness": -1}]}, "above 0"),
    ],
)
def test_wrong_maps_are_refused(values, message):
    with pytest.raises(UsageError, match=message):
        from_map(values, "map.toml")


def test_numbers_for_vertices_or_triangles():
    mesh = sphere(10, subdivisions=1)
    by_vertex = np.arange(1.0, len(mesh.vertices) + 1)
    assert np.array_equal(at_vertices(mesh, by_vertex, "x"), by_vertex)
    assert at_vertices(mesh, np.full(len(mesh.faces), 3.0), "x") == pytest.approx(3)
    for wrong in (np.ones(5), np.zeros(len(mesh.vertices)), np.full(len(mesh.faces), np.nan)):
        with pytest.raises(UsageError):
            at_vertices(mesh, wrong, "x")
