"""One tissue brought into its room: gaps, volumes and shapes against what geometry says."""

from __future__ import annotations

import math

import numpy as np
import pytest
from shapes import box, joined, sphere

from vhp_cli.kernels.spatial import Tree, gap
from vhp_cli.mesh import Mesh
from vhp_cli.stages.clearance import separate
from vhp_cli.stages.clearance.attempt import Attempt
from vhp_cli.stages.clearance.carving import carved, known_vertices
from vhp_cli.stages.clearance.cell import Bound, Cell
from vhp_cli.stages.clearance.cutting import SQUEEZED
from vhp_cli.stages.clearance.displacement import displaced
from vhp_cli.stages.clearance.distance import SignedDistance
from vhp_cli.stages.clearance.options import ClearanceOptions
from vhp_cli.stages.heal.candidate import judge


def tube(radius=1.5, length=40.0, around=16, rings=40, centre=(0.0, 0.0, 0.0)) -> Mesh:
    """Return a closed tube along z with flat ends."""
    angles = 2 * np.pi * np.arange(around) / around
    heights = np.linspace(-length / 2, length / 2, rings)
    circle = radius * np.column_stack([np.cos(angles), np.sin(angles)])
    side = np.concatenate([np.column_stack([circle, np.full(around, z)]) for z in heights])
    points = np.concatenate([side, [[0, 0, heights[0]], [0, 0, heights[-1]]]]) + centre
    faces = []
    for ring in range(rings - 1):
        for k in range(around):
            a, b = ring * around + k, ring * around + (k + 1) % around
            faces += [(a, b, b + around), (a, b + around, a + around)]
    bottom, top, last = len(side), len(side) + 1, (rings - 1) * around
    for k in range(around):
        faces += [(bottom, (k + 1) % around, k), (top, last + k, last + (k + 1) % around)]
    return Mesh(points.astype(np.float32).astype(float), np.array(faces))


def brought(mesh, *bounds, may_shrink=False, level=0, **options):
    """Return the outcome for a tissue whose neighbours are (kind, mesh, gap, share)."""
    cell = Cell(
        SignedDistance(mesh), [Bound(kind, SignedDistance(other), g, share) for kind, other, g, share in bounds]
    )
    return separate(mesh, cell, ClearanceOptions(**options), Attempt(level), may_shrink=may_shrink)


def apart(a: Mesh, b: Mesh) -> float:
    found = gap(Tree(a.vertices, a.faces), Tree(b.vertices, b.faces))
    return 0.0 if found.contact_kind else found.distance


def volume(mesh: Mesh) -> float:
    return judge(mesh).measures["volume_mm3"]


def both(a, b, share, **options):
    """Return both tissues of a pair, and the actions on the first."""
    first = brought(a, ("apart", b, 1.0, share), **options) if share > 0 else None
    second = brought(b, ("apart", a, 1.0, 1 - share), **options) if share < 1 else None
    made = [given if out is None or out.mesh is None else out.mesh for given, out in ((a, first), (b, second))]
    return (*made, first)


def cap(radius: float, height: float) -> float:
    return math.pi * height**2 * (3 * radius - height) / 3


A, B = sphere(20, (0, 0, 0), 4), sphere(20, (38, 0, 0), 4)


def test_shallow_overlap_is_moved_and_keeps_its_triangles():
    a, b, outcome = both(A, B, 0.5)
    assert [action["step"] for action in outcome.actions] == ["move"]
    assert np.array_equal(a.faces, A.faces) and np.array_equal(b.faces, B.faces)
    assert 1.0 <= apart(a, b) < 1.15
    assert judge(a).sound and judge(b).sound
    # The middle plane lies 1 mm deep, the gap takes half a millimetre of each.
    assert np.linalg.norm(a.vertices - A.vertices, axis=1).max() == pytest.approx(1.5, abs=0.1)
    assert -0.012 < volume(a) / volume(A) - 1 < -0.003
    far = A.vertices[:, 0] < 0
    assert np.array_equal(a.vertices[far], A.vertices[far])


@pytest.mark.parametrize("distance", [38.0, pytest.param(31.0, marks=pytest.mark.slow)])
def test_cut_spheres_lose_their_caps(distance):
    b = sphere(20, (distance, 0, 0), 4)
    first, second, outcome = both(A, b, 0.5, method="cut")
    assert next(action["step"] for action in outcome.actions) == "cut"
    assert 1.0 <= apart(first, second) < 1.35
    depth = 20 - (distance - 1) / 2
    for made in (first, second):
        candidate = judge(made)
        assert candidate.sound and candidate.min_quality > 0.1 and candidate.measures["components"] == 1
        lost = volume(A) - candidate.measures["volume_mm3"]
        assert cap(20, depth) * 0.95 < lost < cap(20, depth + 0.25)
    # What is 8 mm from the cut is as it was.
    beyond = A.vertices[A.vertices[:, 0] < 20 - depth - 8]
    assert known_vertices(Mesh(beyond, np.empty((0, 3), np.int32)), first).all()


def test_a_rigid_neighbour_stays_and_the_other_one_yields_for_both():
    a, b, _ = both(A, B, 0.0)
    assert a is A
    assert 0.99 <= apart(a, b) < 1.1
    _, fine, _ = both(A, B, 0.0, level=1)
    assert 1.0 <= apart(a, fine) < 1.2


def test_boxes_that_share_a_face():
    a, b, _ = both(box((0, 0, 0), (10, 10, 10)), box((10, 2, 2), (20, 12, 12)), 0.5)
    assert apart(a, b) >= 1.0
    assert judge(a).sound and judge(b).sound
    assert min(volume(a), volume(b)) > 850


def test_a_thin_tube_is_moved_as_a_whole_and_loses_next_to_nothing():
    thin = tube(centre=(20.5, 0, 0))
    outcome = brought(thin, ("apart", A, 1.0, 1.0))
    assert [action["step"] for action in outcome.actions] == ["move"]
    assert apart(outcome.mesh, A) >= 0.98
    assert abs(volume(outcome.mesh) / volume(thin) - 1) < 0.02
    cut = brought(thin, ("apart", A, 1.0, 1.0), method="cut")
    assert volume(cut.mesh) / volume(thin) < 0.9


@pytest.mark.slow
def test_what_sticks_out_of_its_parent_is_brought_inside():
    inner, parent = sphere(10, (6, 0, 0), 4), sphere(15, (0, 0, 0), 4)
    outcome = brought(inner, ("parent", parent, 1.0, 1.0))
    assert judge(outcome.mesh).sound and judge(outcome.mesh).measures["components"] == 1
    assert 1.0 <= apart(outcome.mesh, parent) < 1.25
    assert (Tree(parent.vertices, parent.faces).inside(outcome.mesh.vertices) == 1).all()
    # What a ball of radius 10 and one of radius 14, 6 mm off, have in common.
    d, r, s = 6.0, 14.0, 10.0
    common = math.pi * (r + s - d) ** 2 * (d * d + 2 * d * s - 3 * s * s + 2 * d * r + 6 * r * s - 3 * r * r) / (12 * d)
    assert volume(outcome.mesh) == pytest.approx(common, rel=0.02)


@pytest.mark.parametrize("method", ["auto", "cut"])
def test_a_tissue_grows_around_a_rigid_core(method):
    core, around = sphere(5, (11, 0, 0), 3), sphere(15, (0, 0, 0), 4)
    outcome = brought(around, ("core", core, 1.0, 1.0), method=method, level=1)
    assert apart(outcome.mesh, core) >= 1.0
    assert (Tree(outcome.mesh.vertices, outcome.mesh.faces).inside(core.vertices) == 1).all()
    assert judge(outcome.mesh).sound and volume(outcome.mesh) > volume(around)


def test_a_neighbour_keeps_away_from_a_core_that_pushes_its_tissue_out():
    outcome = brought(B, ("beyond", sphere(5, (14, 0, 0), 3), 2.0, 1.0))
    assert apart(outcome.mesh, sphere(5, (14, 0, 0), 3)) >= 1.99


def test_what_is_squeezed_keeps_as_much_of_the_gap_as_leaves_it_whole():
    plate = joined(box((-10, -10, 0), (10, 10, 1.6)))
    lower, upper = box((-20, -20, -9), (20, 20, 0.2)), box((-20, -20, 1.4), (20, 20, 11))
    outcome = brought(plate, ("apart", lower, 1.0, 1.0), ("apart", upper, 1.0, 1.0))
    assert outcome.status == "changed"
    assert any(action["step"] == SQUEEZED for action in outcome.actions)
    made = judge(outcome.mesh)
    assert made.measures["components"] == 1 and made.measures["genus"] == 0
    assert 0.0 < apart(outcome.mesh, lower) < 1.0 and 0.0 < apart(outcome.mesh, upper) < 1.0


def test_nothing_is_done_where_there_is_nothing_to_do():
    assert brought(A, ("apart", sphere(20, (41.1, 0, 0), 4), 1.0, 0.5)).status == "unchanged"


@pytest.mark.slow
def test_what_would_vanish_is_refused():
    small = sphere(3, (0, 0, 0), 2)
    outcome = brought(small, ("apart", A, 1.0, 1.0))
    assert outcome.status == "refused" and outcome.mesh is None and "room" in outcome.reason


def test_an_open_surface_can_be_moved_but_not_cut():
    cup = Mesh(A.vertices, A.faces[A.vertices[A.faces].mean(axis=1)[:, 0] > -15])
    moved = brought(cup, ("apart", B, 1.0, 0.5))
    assert moved.status == "changed" and [action["step"] for action in moved.actions] == ["move"]
    deep = brought(cup, ("apart", sphere(20, (31, 0, 0), 4), 1.0, 0.5))
    assert deep.status == "refused" and "heal it first" in deep.reason


@pytest.mark.slow
def test_moving_alone_says_when_it_fails():
    outcome = brought(A, ("apart", sphere(20, (25, 0, 0), 4), 1.0, 0.5), method="move")
    assert outcome.status == "refused" or apart(outcome.mesh, A) >= 0
    cell = Cell(SignedDistance(A), [Bound("apart", SignedDistance(B), 1.0, 0.5)])
    found = displaced(A, cell, margin_mm=0.03, max_move_mm=0.5, thin_mm=4.5)
    assert found.excess_mm > 0.5 and found.moved_mm <= 0.5 + 1e-6


def test_a_thin_tissue_does_not_go_into_what_keeps_away_from_where_it_was():
    """A nerve between a bone and a muscle: the bone pushes it, and the muscle is 1.2 mm from its given surface."""
    nerve, bone = tube(centre=(20.5, 0, 0)), A
    muscle = box((23.2, -30, -30), (40, 30, 30))
    pushed = brought(nerve, ("apart", bone, 1.0, 1.0))
    assert apart(pushed.mesh, muscle) < 0.9
    held = brought(nerve, ("apart", bone, 1.0, 1.0), ("apart", muscle, 1.0, 0.0))
    assert apart(held.mesh, bone) >= 0.98 and apart(held.mesh, muscle) >= 0.95


def test_what_only_shrinks_moves_nothing_but_what_is_too_close():
    thin = tube(centre=(20.5, 0, 0))
    outcome = brought(thin, ("apart", A, 0.3, 1.0))
    cell = Cell(SignedDistance(thin), [Bound("apart", SignedDistance(A), 0.3, 1.0)])
    less = separate(thin, cell, ClearanceOptions(), Attempt(), may_shrink=False, shrinks_only=True)
    far = thin.vertices[:, 0] > 21.5
    moved = [
        (~known_vertices(Mesh(thin.vertices[far], np.empty((0, 3), int)), made.mesh)).sum() for made in (outcome, less)
    ]
    assert moved[1] < moved[0]
    assert apart(less.mesh, A) >= 0.29


def test_small_pieces_left_over_by_a_cut_are_dropped_and_larger_ones_are_not():
    dumbbell = tube(radius=2.0, length=40.0)
    for middle, parts in ((0.0, 2), (18.9, 1)):
        blade = box((-9, -9, middle - 0.3), (9, 9, middle + 0.3))
        cell = Cell(SignedDistance(dumbbell), [Bound("apart", SignedDistance(blade), 0.4, 1.0)])
        made, crumbs = carved(dumbbell, cell, grid_mm=0.4, margin_mm=0.02)
        assert judge(made).measures["components"] == parts
        assert (crumbs > 0) == (parts == 1)


@pytest.mark.slow
def test_what_was_squeezed_is_not_squeezed_more():
    plate = box((-10, -10, 0), (10, 10, 1.6))
    lower, upper = box((-20, -20, -9), (20, 20, 0.2)), box((-20, -20, 1.4), (20, 20, 11))
    bounds = (("apart", lower, 1.0, 1.0), ("apart", upper, 1.0, 1.0))
    made = brought(plate, *bounds).mesh
    again = brought(made, *bounds)
    assert again.status == "refused" and SQUEEZED in again.reason and again.mesh is None
