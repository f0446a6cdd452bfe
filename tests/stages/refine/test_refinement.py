"""Refine a tissue: what comes out is as sound, as near and as well shaped as it was."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapes import box, joined, moved, sphere
from smoothing_shapes import defects, fine_box, q_of, single, tube, volume

from vhp_cli.errors import UsageError
from vhp_cli.formats import read_mesh
from vhp_cli.kernels.spatial import Tree
from vhp_cli.mesh import Mesh
from vhp_cli.stages.heal.candidate import judge
from vhp_cli.stages.refine import refine, refinement
from vhp_cli.stages.refine.options import RefineOptions

BY_SIZE = RefineOptions(percent=15, by="size")


def local_errors(mesh):
    """Errors that fall off from the first face."""
    centres = mesh.vertices[mesh.faces].mean(axis=1)
    return np.exp(-np.linalg.norm(centres - centres[0], axis=1))


SHAPES = {
    "sphere": sphere(10, subdivisions=3),
    "box": box(),
    "fine box": fine_box(noise=0.2, seed=0),
    "nerve of 1 mm": tube(noise=0.3, seed=1),
    "two": joined(sphere(5, subdivisions=2), sphere(4, (0, 12, 0), subdivisions=2)),
}


@pytest.mark.parametrize("scenario", ["all-edges", "shared-edges"])
@pytest.mark.parametrize("name", SHAPES)
def test_sound_and_well_shaped(name, scenario):
    mesh = SHAPES[name]
    made = refine(mesh, RefineOptions(percent=20, scenario=scenario), local_errors(mesh))
    assert made.status == "changed"
    assert len(made.mesh.faces) > len(mesh.faces)
    after = judge(made.mesh)
    assert after.sound
    assert (made.mesh.vertices == single(made.mesh.vertices)).all()
    assert volume(made.mesh) == pytest.approx(volume(mesh), rel=1e-3)
    extent = np.linalg.norm(np.ptp(mesh.vertices, axis=0))
    assert made.deviation["max"] <= min(1e-3 * extent, 0.1)
    assert after.min_quality >= min(0.5, q_of(mesh).min())
    assert [action["step"] for action in made.actions][:2] == ["pick", "split"]
    before = judge(mesh).measures
    for key in ("components", "genus", "euler"):
        assert after.measures[key] == before[key]


@pytest.mark.parametrize("name", SHAPES)
def test_without_smoothing_nothing_moves(name):
    mesh = SHAPES[name]
    made = refine(mesh, RefineOptions(percent=20, smooth=False), local_errors(mesh))
    assert made.deviation["max"] <= 1e-6 * np.abs(mesh.vertices).max()
    assert {tuple(point) for point in mesh.vertices} <= {tuple(point) for point in made.mesh.vertices}
    assert volume(made.mesh) == pytest.approx(volume(mesh), rel=1e-6)
    assert judge(made.mesh).sound
    assert [action["step"] for action in made.actions] == ["pick", "split"]


def test_the_worst_are_split():
    mesh = sphere(10, subdivisions=3)
    errors = np.zeros(len(mesh.faces))
    errors[[5, 600, 1100]] = (3, 1, 2)
    made = refine(mesh, RefineOptions(percent=100 * 2 / len(mesh.faces), smooth=False), errors)
    old = {frozenset(map(tuple, corners)) for corners in mesh.vertices[mesh.faces].tolist()}
    new = {frozenset(map(tuple, corners)) for corners in made.mesh.vertices[made.mesh.faces].tolist()}
    for face, is_split in ((5, True), (1100, True), (600, False)):
        assert (frozenset(map(tuple, mesh.vertices[mesh.faces[face]].tolist())) not in new) == is_split
    # Two into four, the three around each into two.
    assert len(old - new) == 2 * (1 + 3)
    assert len(new - old) == 2 * (4 + 3 * 2)
    assert made.actions[0]["count"] == 2
    assert made.actions[1]["count"] == 8


def test_the_largest_are_split():
    mesh = joined(sphere(20, subdivisions=1), moved(sphere(3, subdivisions=2), (40, 0, 0)))
    made = refine(mesh, RefineOptions(percent=20, by="size", smooth=False))
    right = made.mesh.vertices[made.mesh.faces].mean(axis=1)[:, 0] > 30
    assert right.sum() == 320
    assert (~right).sum() == 320


def test_faces_that_collapse_keep_the_others_errors_in_order():
    """Faces with equal corners are left out, and duplicates are left whole."""
    mesh = sphere(10, subdivisions=2)
    faces = np.concatenate([[[7, 7, 3]], mesh.faces[:5], [[1, 2, 2]], mesh.faces[5:], mesh.faces[-1:]])
    errors = np.zeros(len(faces))
    errors[[0, 6, 8]] = (9, 9, 1)  # 8: the sixth of the true ones, as two collapsed ones precede it
    made = refine(Mesh(mesh.vertices, faces), RefineOptions(percent=0.01, smooth=False), errors)
    gone = frozenset(map(tuple, mesh.vertices[mesh.faces[6]].tolist()))
    assert gone not in {frozenset(map(tuple, corners)) for corners in made.mesh.vertices[made.mesh.faces].tolist()}
    assert made.actions[0]["message"].startswith("1 of 321 ")
    whole = refine(Mesh(mesh.vertices, faces), RefineOptions(percent=100, smooth=False), errors)
    assert len(judge(whole.mesh, may_be_open=True).measures["topology"]) > 0
    assert judge(whole.mesh, may_be_open=True).measures["topology"]["duplicate_faces"] == 1


def test_levels():
    """Each splits the picked triangles into four, and none is divided for the second time only to fit."""
    mesh = sphere(10, subdivisions=3)
    errors = local_errors(mesh)
    least = []
    for levels in (1, 2, 3):
        made = refine(mesh, RefineOptions(percent=5, levels=levels, smooth=False), errors)
        assert judge(made.mesh).sound
        least.append(q_of(made.mesh).min())
        centre = mesh.vertices[mesh.faces[0]].mean(axis=0)
        nearest = np.linalg.norm(made.mesh.vertices[made.mesh.faces].mean(axis=1) - centre, axis=1).argmin()
        corners = made.mesh.vertices[made.mesh.faces[nearest]]
        first = mesh.vertices[mesh.faces[0]]
        lengths = [np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1).mean() for points in (corners, first)]
        assert lengths[0] == pytest.approx(lengths[1] / 2**levels, rel=1e-3)
    assert min(least) >= 0.9 * least[0]


@pytest.mark.parametrize("scenario", ["all-edges", "shared-edges"])
def test_deterministic(scenario):
    mesh = SHAPES["fine box"]
    options = RefineOptions(percent=10, by="size", scenario=scenario, levels=2)
    first, second = (refine(mesh, options) for _ in range(2))
    assert first.mesh.vertices.tobytes() == second.mesh.vertices.tobytes()
    assert first.mesh.faces.tobytes() == second.mesh.faces.tobytes()
    assert first.actions == second.actions


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(1, 100), st.sampled_from(["all-edges", "shared-edges"]), st.integers(1, 2))
def test_any_errors(seed, percent, scenario, levels):
    mesh = tube(rings=12, sides=6)
    errors = np.random.default_rng(seed).random(len(mesh.faces))
    made = refine(mesh, RefineOptions(percent=percent, scenario=scenario, levels=levels), errors)
    if made.status == "refused":
        assert scenario == "shared-edges"
        return
    assert judge(made.mesh).sound
    assert volume(made.mesh) == pytest.approx(volume(mesh), rel=1e-3)


def book():
    """A book of three sheets on one spine."""
    points = [(0, 0, 0), (0, 0, 4), (4, 0, 0), (-3, 3, 0), (-3, -3, 0), (4, 0, 4), (-3, 3, 4), (-3, -3, 4)]
    faces = [(0, 2, 5), (0, 5, 1), (0, 3, 6), (0, 6, 1), (0, 4, 7), (0, 7, 1)]
    return Mesh(np.array(points, dtype=float), np.array(faces))


def turned_patch():
    ball = sphere(10, subdivisions=2)
    faces = np.array(ball.faces)
    faces[40:60] = faces[40:60, ::-1]
    return Mesh(ball.vertices, faces)


CROSSING = joined(sphere(10, subdivisions=2), moved(sphere(10, subdivisions=2), (12, 1, 2)))


@pytest.mark.parametrize("mesh", [CROSSING, book(), turned_patch()], ids=["crossing", "book", "turned"])
@pytest.mark.parametrize("smooth", [False, True])
def test_defects_do_not_multiply(mesh, smooth):
    made = refine(mesh, RefineOptions(percent=100, by="size", smooth=smooth))
    assert made.status == "changed"
    before, after = defects(mesh), defects(made.mesh)
    for key in ("nonmanifold", "pinched", "inconsistent", "duplicate", "contacts", "components", "euler"):
        assert after[key] == before[key]
    assert after["triangles"] > 1.5 * before["triangles"]
    assert (made.reason == "") == (mesh is not CROSSING)


def test_rims_are_divided_and_stay():
    cap = sphere(10, subdivisions=2)
    cap = Mesh(cap.vertices, cap.faces[cap.vertices[cap.faces].mean(axis=1)[:, 2] > 0])
    made = refine(cap, RefineOptions(percent=100, by="size"))
    assert judge(made.mesh, may_be_open=True).sound
    before, after = defects(cap), defects(made.mesh)
    assert after["open"] == 2 * before["open"]
    assert after["euler"] == before["euler"]
    assert made.deviation["max"] <= 1e-3 * np.linalg.norm(np.ptp(cap.vertices, axis=0))


def thin_plate(seed):
    """A slanted plate some units in the last place thick."""
    rng = np.random.default_rng(seed)
    n = 4
    grid = np.array([(x, y) for y in range(n) for x in range(n)], dtype=float) * 5
    slope = rng.uniform(0.3, 0.8, 2)
    lower = np.column_stack([grid, grid @ slope + 3000])
    upper = lower + np.array([0, 0, 4e-4])
    down, up, walls = [], [], []
    for y in range(n - 1):
        for x in range(n - 1):
            a, b, c, d = y * n + x, y * n + x + 1, (y + 1) * n + x + 1, (y + 1) * n + x
            down += [(a, c, b), (a, d, c)]
            up += [(a + n * n, b + n * n, d + n * n), (b + n * n, c + n * n, d + n * n)]
    rim = [*range(n), *range(2 * n - 1, n * n, n), *range(n * n - 2, n * n - n - 1, -1), *range(n * n - 2 * n, 0, -n)]
    for p, q in zip(rim, rim[1:] + rim[:1], strict=True):
        walls += [(p, q, q + n * n), (p, q + n * n, p + n * n)]
    return Mesh(single(np.concatenate([lower, upper]) + rng.uniform(-0.5, 0.5, 3)), np.array(down + up + walls))


def test_rounding_makes_no_contact(monkeypatch):
    """Midpoints are rounded to float32: where that would make a surface meet itself, triangles stay whole."""
    plates = [plate for plate in map(thin_plate, range(20)) if judge(plate).sound]
    assert len(plates) > 5
    options = RefineOptions(percent=60, by="size", smooth=False, fold_deg=0.0)

    def contacts(mesh):
        return Tree(mesh.vertices, mesh.faces).self_hits(0).n_pairs

    for plate in plates:
        made = refine(plate, options)
        assert made.mesh is None or judge(made.mesh).sound
    monkeypatch.setattr(refinement, "_broken_by_rounding", lambda *_: np.empty(0, dtype=np.int64))
    assert any(contacts(refine(plate, options).mesh) for plate in plates)


def test_nothing_to_split():
    tiny = sphere(0.01, subdivisions=1)
    made = refine(tiny, BY_SIZE)
    assert made.status == "refused" and "0.02 mm" in made.reason
    alone = refine(sphere(subdivisions=2), RefineOptions(percent=0.1, scenario="shared-edges"), np.arange(320.0))
    assert alone.status == "refused" and "shares no edge" in alone.reason
    assert refine(Mesh(np.zeros((0, 3)), np.zeros((0, 3))), BY_SIZE).status == "unchanged"


def test_short_edges_stay_whole():
    mesh = joined(sphere(10, subdivisions=1), sphere(0.05, (20, 0, 0), subdivisions=2))
    made = refine(mesh, RefineOptions(percent=100, by="size", smooth=False))
    right = made.mesh.vertices[made.mesh.faces].mean(axis=1)[:, 0] > 15
    assert right.sum() == 320 and (~right).sum() == 320
    assert made.reason.startswith("320 triangles picked and left whole")


def test_gentler_moves_less_and_then_not_at_all():
    options = RefineOptions(percent=15)
    limits = [options.gentler(level, 50).max_deviation_mm for level in (1, 2)]
    assert limits == [pytest.approx(0.05 / 4), pytest.approx(0.05 / 16)]
    assert not options.gentler(3, 50).smooth


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"refine": 0}, "refine"),
        ({"refine": 101}, "at most 100"),
        ({"refine": float("nan")}, "refine"),
        ({"by": "errors"}, "did you mean 'error'"),
        ({"scenario": "a"}, "one of all-edges, shared-edges"),
        ({"levels": 0}, "at least 1"),
        ({"levels": 1.5}, "whole"),
        ({"smooth": 1}, "true or false"),
        ({"errors": ""}, "not empty"),
        ({"errors": 3}, "expected a text"),
        ({"level": 2}, "did you mean 'levels'"),
    ],
)
def test_wrong_options_are_named(values, message):
    with pytest.raises(UsageError, match=message):
        RefineOptions().changed(values, "decimate")


def test_errors_are_needed():
    with pytest.raises(ValueError, match="one error for each face"):
        refine(sphere(), RefineOptions(percent=15))
    with pytest.raises(ValueError, match="one error for each face"):
        refine(sphere(), RefineOptions(percent=15), np.ones(3))
    with pytest.raises(ValueError, match="percentage"):
        refine(sphere(), RefineOptions(by="size"))


@pytest.mark.slow
def test_real_tissues(shared_data):
    """Raw ones: whatever is wrong with them, nothing gets worse."""
    seen = 0
    for path in sorted(shared_data.glob("*/*.stl"))[::29]:
        mesh = read_mesh(path).mesh
        if len(mesh.faces) > 30_000:
            continue
        before = judge(mesh, may_be_open=True)
        made = refine(mesh, BY_SIZE)
        if made.mesh is None:
            continue
        seen += 1
        after = judge(made.mesh, may_be_open=True)
        assert after.sound or not before.sound, path
        assert after.measures["self_intersections"]["pairs"] <= before.measures["self_intersections"]["pairs"], path
        for key in ("nonmanifold_edges", "nonmanifold_vertices", "inconsistent_edges", "duplicate_faces"):
            assert after.measures["topology"][key] <= before.measures["topology"][key], path
    assert seen > 3
