"""Heal as a whole: what is handed on, healed, refused, and what is said about it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from shapes import box, flipped, joined, moved, sphere

from vhp_cli.formats import read_mesh
from vhp_cli.mesh import Mesh
from vhp_cli.stages.heal import heal
from vhp_cli.stages.heal.candidate import diagonal, judge
from vhp_cli.stages.heal.openings import is_jagged, turns
from vhp_cli.stages.heal.options import HealOptions

TOPOLOGY = HealOptions(only_topology=True)


def without(mesh: Mesh, gone: np.ndarray) -> Mesh:
    return Mesh(mesh.vertices, mesh.faces[~gone])


def centres(mesh: Mesh) -> np.ndarray:
    return mesh.vertices[mesh.faces].mean(axis=1)


def tube(radius: float = 2.0, length: float = 40.0, around: int = 16, along: int = 30) -> Mesh:
    """An open tube along z."""
    angle = 2 * np.pi * np.arange(around) / around
    ring = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(around)], axis=1)
    vertices = np.concatenate([ring + np.array([0, 0, z]) for z in np.linspace(0, length, along)])
    faces = []
    for row in range(along - 1):
        for k in range(around):
            a, b = row * around + k, row * around + (k + 1) % around
            faces += [[a, b, b + around], [a, b + around, a + around]]
    return Mesh(vertices.astype(np.float32), np.array(faces))


def sheet(n: int = 12, size: float = 20.0) -> Mesh:
    """A flat square in z = 0."""
    x, y = np.meshgrid(np.linspace(0, size, n), np.linspace(0, size, n), indexing="ij")
    vertices = np.stack([x.ravel(), y.ravel(), np.zeros(n * n)], axis=1)
    a = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate([np.stack([a, a + n, a + n + 1], axis=1), np.stack([a, a + n + 1, a + 1], axis=1)])
    return Mesh(vertices.astype(np.float32), faces)


def test_a_sound_surface_is_handed_on_whatever_its_triangles_with_only_topology() -> None:
    needles = box((0, 0, 0), (1, 1, 200))
    assert heal(needles, TOPOLOGY).status == "unchanged"
    assert heal(needles, TOPOLOGY).mesh is None


def test_well_shaped_triangles_are_left_alone() -> None:
    assert heal(sphere(radius=10.0), HealOptions()).status == "unchanged"


def test_triangles_that_no_limit_lets_improve_are_named() -> None:
    """Edges of 0.03 mm can only become longer than 0.2 mm if the surface may move."""
    tiny = sphere(0.5, subdivisions=4)
    found = heal(tiny, HealOptions(min_edge_mm=0.2, max_deviation_mm=1e-4))
    assert found.mesh is None and found.status == "refused"
    assert "within 0.0001 mm" in found.reason and "0.2 mm asked" in found.reason
    assert heal(tiny, HealOptions(min_edge_mm=0.2, max_deviation_mm=0.2)).status == "changed"


def test_a_hole_is_closed_and_named() -> None:
    ball = sphere(radius=10.0)
    hole = np.linalg.norm(centres(ball) - centres(ball)[5], axis=1) < 2.0
    outcome = heal(without(ball, hole), TOPOLOGY)
    assert outcome.status == "changed" and outcome.mesh is not None
    assert judge(outcome.mesh).sound
    (action,) = [action for action in outcome.actions if action["step"] == "holes"]
    assert action["area_mm2"] == pytest.approx(np.pi * 2.0**2, rel=0.5)
    assert np.linalg.norm(np.subtract(action["places"][0]["xyz_mm"], centres(ball)[5])) < 2.0


def test_open_ends_are_capped_or_kept() -> None:
    capped = heal(tube(), TOPOLOGY)
    assert capped.mesh is not None
    polygon = 16 / 2 * 2.0**2 * np.sin(2 * np.pi / 16)
    assert judge(capped.mesh).measures["volume_mm3"] == pytest.approx(40 * polygon, rel=1e-5)
    kept = HealOptions(only_topology=True, cap_openings=False)
    assert heal(tube(), kept).status == "unchanged"
    torn = without(tube(), np.arange(len(tube().faces)) == 400)
    mended = heal(torn, kept)
    assert mended.mesh is not None
    measures = judge(mended.mesh, may_be_open=True).measures
    assert measures["topology"]["boundary_loops"] == 2
    assert measures["triangles"] == len(tube().faces)


def test_openings_that_are_kept_do_not_hinder_remeshing() -> None:
    outcome = heal(tube(around=40, along=8), HealOptions(cap_openings=False))
    assert outcome.mesh is not None
    found = judge(outcome.mesh, may_be_open=True)
    assert found.sound and found.measures["topology"]["boundary_loops"] == 2
    assert found.mean_quality > judge(tube(around=40, along=8), may_be_open=True).mean_quality


def test_a_sheet_is_refused_or_made_a_plate() -> None:
    refused = heal(sheet(), HealOptions())
    assert refused.status == "refused" and refused.mesh is None
    assert "sheet" in refused.reason
    plate = heal(sheet(), HealOptions(thicken_mm=0.5, only_topology=True))
    assert plate.mesh is not None
    assert judge(plate.mesh).sound
    assert judge(plate.mesh).measures["volume_mm3"] == pytest.approx(20 * 20 * 0.5, rel=1e-5)


def test_a_patch_with_a_jagged_border_is_refused() -> None:
    ball = sphere(radius=10.0)
    waves = 4.0 * np.sin(5 * np.arctan2(centres(ball)[:, 1], centres(ball)[:, 0]))
    patch = without(ball, centres(ball)[:, 2] < waves)
    outcome = heal(patch, HealOptions())
    assert outcome.status == "refused"
    assert "patch" in outcome.reason


def test_a_solid_cut_in_a_plane_is_capped() -> None:
    ball = sphere(radius=10.0)
    outcome = heal(without(ball, centres(ball)[:, 2] < 0), TOPOLOGY)
    assert outcome.status == "changed"


def test_parts_that_overlap_are_united() -> None:
    first, second = sphere(subdivisions=4), sphere(centre=(12.0, 0.3, 0.2), subdivisions=4)
    outcome = heal(joined(first, second), TOPOLOGY)
    assert outcome.mesh is not None
    found = judge(outcome.mesh)
    assert found.sound and found.measures["components"] == 1
    # Two balls less the lens between them.
    lens = np.pi * (4 * 10 + 12.0) * (2 * 10 - 12.0) ** 2 / 12
    assert found.measures["volume_mm3"] == pytest.approx(2 * 4 / 3 * np.pi * 1000 - lens, rel=0.02)


def test_cavities_stay_and_are_turned_inward() -> None:
    hollow = joined(sphere(radius=10.0), sphere(radius=5.0))
    outcome = heal(hollow, TOPOLOGY)
    assert outcome.mesh is not None
    expected = judge(joined(sphere(radius=10.0), flipped(sphere(radius=5.0)))).measures["volume_mm3"]
    assert judge(outcome.mesh).measures["volume_mm3"] == pytest.approx(expected, rel=1e-6)


def test_specks_are_removed_and_listed_and_small_solids_kept() -> None:
    ball = sphere(radius=10.0)
    open_ball = without(ball, np.arange(len(ball.faces)) == 7)
    speck, small = sphere(0.01, (30, 0, 0), 0), sphere(1.0, (0, 30, 0))
    outcome = heal(joined(open_ball, speck, small), TOPOLOGY)
    assert outcome.mesh is not None
    assert judge(outcome.mesh).measures["components"] == 2
    assert judge(outcome.mesh).measures["triangles"] == len(ball.faces) + len(small.faces)
    (removed,) = [action for action in outcome.actions if "speck" in action["message"] or "part" in action["message"]]
    assert np.linalg.norm(np.subtract(removed["places"][0]["xyz_mm"], [30, 0, 0])) < 0.1


def test_triangles_become_well_shaped_within_the_deviation() -> None:
    bad = box((0, 0, 0), (30, 20, 1))
    outcome = heal(bad, HealOptions(max_deviation_mm=0.05))
    assert outcome.mesh is not None and outcome.deviation is not None
    found = judge(outcome.mesh)
    assert found.sound and found.min_quality >= 0.3 and found.mean_quality >= 0.85
    assert outcome.deviation["max"] <= 0.05
    assert found.measures["volume_mm3"] == pytest.approx(600.0, rel=1e-3)


@pytest.mark.slow
def test_slivers_at_a_knife_edge_are_rounded_off_unless_a_limit_is_set(shared_data: Path) -> None:
    given = read_mesh(shared_data / "thorax_r3" / "right_fourth_costal_cartilage.stl").mesh
    limit = 1e-3 * diagonal(given)
    outcome = heal(given, HealOptions())
    assert outcome.mesh is not None
    assert judge(outcome.mesh).min_quality >= 0.2
    (rounded,) = [action for action in outcome.actions if action["step"] == "round off"]
    (place,) = rounded["places"]
    assert limit < place["value"] <= 3 * limit
    strict = heal(given, HealOptions(max_deviation_mm=limit))
    assert strict.mesh is not None
    assert not [action for action in strict.actions if action["step"] == "round off"]


def test_a_triangle_budget_is_kept() -> None:
    outcome = heal(sphere(radius=10.0, subdivisions=4), HealOptions(max_triangles=2000, max_deviation_mm=0.3))
    assert outcome.mesh is not None
    assert len(outcome.mesh.faces) <= 2000


def test_what_comes_out_is_float32_and_the_same_every_time() -> None:
    ball = sphere(radius=10.0)
    damaged = joined(without(ball, centres(ball)[:, 2] > 9), moved(flipped(sphere(radius=3.0)), [20.0, 0.0, 0.0]))
    first, second = (heal(damaged, HealOptions()).mesh for _ in range(2))
    assert first is not None and second is not None
    assert np.array_equal(first.vertices, first.vertices.astype(np.float32))
    assert np.array_equal(first.vertices, second.vertices) and np.array_equal(first.faces, second.faces)


def test_jagged_borders_are_told_from_plane_cuts() -> None:
    angle = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle), np.zeros(60)], axis=1)
    assert turns(circle) == pytest.approx(1.0)
    assert not is_jagged(circle, 0.0)
    zigzag = circle + np.stack([0 * angle, 0 * angle, 0.3 * (-1.0) ** np.arange(60)], axis=1)
    assert turns(zigzag) > 2.5
    assert is_jagged(zigzag, 0.03)
