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
from vhp_cli.stages.decimate import decimate
from vhp_cli.stages.decimate.options import DecimateOptions
from vhp_cli.stages.heal.candidate import as_written, judge
from vhp_cli.stages.shells import shells
from vhp_cli.stages.shells.thickness import STEEPEST, FatPoint, at_vertices, from_map, gentle, interpolated, table

BODY = sphere(20, subdivisions=3)


def depths(skin: Mesh, mesh: Mesh):
    inside = Tree(skin.vertices, skin.faces).inside(mesh.vertices) == 1
    distances = closest(Tree(skin.vertices, skin.faces), mesh.vertices).distances
    return np.where(inside, distances, -distances)


def assert_fits(outer: Mesh, shell, wanted, most=1.55):
    """Look at a shell by means that it was not made with: exact contacts, and depths at other points."""
    assert judge(shell.mesh).sound
    found = gap(Tree(outer.vertices, outer.faces), Tree(shell.mesh.vertices, shell.mesh.faces))
    assert found.contact_kind == 0 and found.distance == shell.gap_mm
    weights = np.random.default_rng(1).dirichlet([1, 1, 1], len(shell.mesh.faces))
    points = np.concatenate([shell.mesh.vertices, (weights[:, None] @ shell.mesh.vertices[shell.mesh.faces])[:, 0]])
    depth = depths(outer, Mesh(points, np.empty((0, 3), np.int32)))
    assert depth.min() >= np.min(wanted) * (1 - 1e-6)
    assert np.quantile(depth, 0.99) <= most * np.max(wanted)


def rod(points, start, end, radius):
    along = np.subtract(end, start).astype(float)
    part = np.clip((points - start) @ along / (along @ along), 0, 1)
    return np.linalg.norm(points - start - part[:, None] * along, axis=1) - radius


def marched(function, lower, upper, cell_mm):
    """Return a skin with about the triangles of real ones: better ones than marching gives."""
    skin = as_written(zero_surface(lambda points, _: function(points), lower, upper, cell_mm))
    made = judge(decimate(skin, DecimateOptions(triangles=len(skin.faces) // 5)).mesh)
    assert made.sound
    return made.mesh


def test_shells_of_a_ball_are_as_deep_as_asked_and_keep_its_triangles():
    fat, body = shells(BODY, 1.0, np.full(len(BODY.vertices), 4.0))
    assert (fat.name, body.name) == ("fat", "average_body")
    for outer, shell, wanted in ((BODY, fat, 1.0), (fat.mesh, body, 4.0)):
        assert len(shell.mesh.faces) == len(BODY.faces) and not shell.ends and not shell.dropped
        assert_fits(outer, shell, wanted, most=1.02)
        assert (Tree(outer.vertices, outer.faces).inside(shell.mesh.vertices) == 1).all()
    given = 20 - np.linalg.norm(body.mesh.vertices, axis=1)
    assert given == pytest.approx(5 * 1.01, abs=0.03)


def test_shells_of_a_box_are_smaller_boxes():
    skin = box((0, 0, 0), (40, 30, 20))
    fat, body = shells(skin, 1.0, np.full(8, 5.0))
    for shell, depth in ((fat, 1.01), (body, 6 * 1.01)):
        assert len(shell.mesh.faces) == 12
        assert shell.mesh.vertices.min(axis=0) == pytest.approx([depth] * 3, abs=0.01)
        assert shell.mesh.vertices.max(axis=0) == pytest.approx([40 - depth, 30 - depth, 20 - depth], abs=0.01)


def test_shells_of_a_capsule_are_capsules():
    def capsule(points):
        return rod(points, (0, 0, 0), (40, 0, 0), 12)

    skin = marched(capsule, [-15.0] * 3, [55.0, 15.0, 15.0], 2.0)
    fat, body = shells(skin, 1.0, np.full(len(skin.vertices), 3.0))
    assert_fits(fat.mesh, body, 3.0)
    # Its skin has planes where the capsule is round.
    assert capsule(body.mesh.vertices) == pytest.approx(-4.04, abs=0.35)


def test_thickness_that_varies_is_followed():
    wanted = 5 + 3 * BODY.vertices[:, 2] / 20
    fat, body = shells(BODY, 1.0, wanted)
    below = 5 + 3 * body.mesh.vertices[:, 2] / np.linalg.norm(body.mesh.vertices, axis=1)
    found = depths(fat.mesh, body.mesh) / below
    assert found.min() >= 1.0 and found.max() < 1.04
    assert body.thickness_mm == pytest.approx((2, 8), abs=0.3)


@pytest.fixture(scope="module")
def hand():
    def parts(points):
        fingers = [rod(points, (28, y, 0), (62, 1.25 * y, 0), 4.0) for y in (-10.5, 0.0, 10.5)]
        return np.min([rod(points, (0, 0, 0), (30, 0, 0), 14), *fingers], axis=0)

    return marched(parts, [-20.0] * 3, [70.0, 20.0, 20.0], 1.5)


@pytest.mark.slow
def test_between_fingers_shells_stay_apart_and_sound(hand):
    fat, body = shells(hand, 1.0, np.full(len(hand.vertices), 1.5))
    for outer, shell, wanted in ((hand, fat, 1.0), (fat.mesh, body, 1.5)):
        assert_fits(outer, shell, wanted)
    # The fingers have kept their insides.
    assert body.mesh.vertices[:, 0].max() > 55


def test_fingers_that_are_too_thin_are_left_out_and_told(hand):
    _, body = shells(hand, 1.0, np.full(len(hand.vertices), 5.0))
    assert judge(body.mesh).sound and body.gap_mm >= 5.0
    assert body.mesh.vertices[:, 0].max() < 45
    tips = [end for end in body.ends if end.distance_mm > 15]
    assert tips and all(end.xyz_mm[0] > 55 for end in tips)


@pytest.mark.slow
def test_a_sheet_thinner_than_two_layers_has_no_inside():
    def ear(points):
        sheet = np.abs(points - [22, 0, 0]) - [12, 0.8, 8]
        return np.minimum(np.linalg.norm(points, axis=1) - 15, np.linalg.norm(np.maximum(sheet, 0), axis=1) - 0.1)

    skin = marched(ear, [-17.0] * 3, [36.0, 17.0, 17.0], 0.8)
    fat, _ = shells(skin, 1.0, np.full(len(skin.vertices), 2.0))
    assert_fits(skin, fat, 1.0)
    assert fat.mesh.vertices[:, 0].max() < 17
    assert fat.ends[0].xyz_mm[0] > 30 and fat.ends[0].area_mm2 > 300


@pytest.mark.slow
def test_an_armpit_is_rounded():
    def armpit(points):
        return np.minimum(rod(points, (0, 0, -30), (0, 0, 30), 15), rod(points, (14, 0, 28), (30, 0, -30), 7))

    skin = marched(armpit, [-18.0, -18.0, -48.0], [40.0, 18.0, 48.0], 1.8)
    fat, body = shells(skin, 1.0, np.full(len(skin.vertices), 2.5))
    assert_fits(skin, fat, 1.0)
    assert_fits(fat.mesh, body, 2.5)


def test_a_cavity_stays_a_cavity():
    skin = joined(sphere(20, subdivisions=3), flipped(sphere(6, subdivisions=2)))
    fat, body = shells(skin, 1.0, np.full(len(skin.vertices), 3.0))
    for shell, depth in ((fat, 1.01), (body, 4 * 1.01)):
        radii = np.linalg.norm(shell.mesh.vertices, axis=1)
        assert judge(shell.mesh).sound
        assert radii.max() == pytest.approx(20 - depth, abs=0.1) and radii.min() == pytest.approx(6 + depth, abs=0.5)


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 0.25), st.floats(0.5, 4.0))
def test_shells_of_any_star_keep_their_distance(seed, rough, fat_mm):
    skin = star(seed, rough)
    fat, body = shells(skin, 1.0, np.full(len(skin.vertices), fat_mm))
    assert_fits(skin, fat, 1.0)
    assert_fits(fat.mesh, body, fat_mm)


def star(seed: int, rough: float) -> Mesh:
    """Return a body of which all is seen from its middle, with waves by random directions."""
    ball = sphere(20, subdivisions=3)
    ways = np.random.default_rng(seed).normal(size=(6, 3))
    waves = np.cos(ball.vertices @ ways.T / 4).mean(axis=1)
    return as_written(Mesh(ball.vertices * (1 + rough * waves)[:, None], ball.faces))


@pytest.mark.slow
def test_the_same_bytes_again(hand):
    first, second = (shells(hand, 1.0, np.full(len(hand.vertices), 3.0)) for _ in range(2))
    for one, other in zip(first, second, strict=True):
        assert np.array_equal(one.mesh.vertices, other.mesh.vertices)
        assert np.array_equal(one.mesh.faces, other.mesh.faces)


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
