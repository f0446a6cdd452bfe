"""Signed distances, and the rooms that follow from them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapes import box, flipped, sphere

from vhp_cli.mesh import Mesh
from vhp_cli.stages.clearance.cell import Bound, Cell
from vhp_cli.stages.clearance.distance import SignedDistance
from vhp_cli.stages.clearance.sampling import excess_of, samples_of

BALL = sphere(10, subdivisions=4)
SOME = np.random.default_rng(3).uniform(-16, 16, (1500, 3))


def slab(points, lower, upper):
    """Return the signed distance to a box."""
    middle, half = (np.add(lower, upper)) / 2, np.subtract(upper, lower) / 2
    away = np.abs(points - middle) - half
    return np.linalg.norm(np.maximum(away, 0), axis=1) + np.minimum(away.max(axis=1), 0)


@pytest.mark.parametrize("mesh", [box((-8, -5, -3), (8, 5, 3)), flipped(box((-8, -5, -3), (8, 5, 3)))])
def test_signed_distance_to_a_box_either_way_round(mesh):
    distance = SignedDistance(mesh)
    exact = slab(SOME, (-8, -5, -3), (8, 5, 3))
    assert distance(SOME) == pytest.approx(exact, abs=1e-12)
    assert (distance.least(SOME) <= exact + 1e-12).all()
    limited = distance(SOME, 2.0)
    assert limited == pytest.approx(np.minimum(exact, 2.0), abs=1e-12)
    for outer, inner in ((2.0, 1.0), (1.0, 2.0), (np.inf, 1.5)):
        clipped = np.clip(exact, -inner, outer)
        assert distance(SOME, outer, inner) == pytest.approx(clipped, abs=1e-12)
        located = distance.located(SOME, outer, inner)
        assert located.values == pytest.approx(clipped, abs=1e-12)
        lengths = np.linalg.norm(located.gradients, axis=1)
        assert lengths == pytest.approx(np.where(clipped == exact, 1.0, 0.0), abs=1e-9)


def test_gradients_lead_away_from_the_surface_inside_and_outside():
    distance = SignedDistance(BALL)
    points = SOME[np.abs(np.linalg.norm(SOME, axis=1) - 10) > 0.5]
    found = distance.located(points)
    outward = points / np.linalg.norm(points, axis=1, keepdims=True)
    assert np.linalg.norm(found.gradients, axis=1) == pytest.approx(1.0, abs=1e-9)
    assert (np.einsum("ij,ij->i", found.gradients, outward) > 0.9).mean() > 0.95
    # On the surface itself it is the normal.
    middles = BALL.vertices[BALL.faces].mean(axis=1)
    at = distance.located(middles)
    assert np.abs(at.values).max() < 1e-12
    assert (np.einsum("ij,ij->i", at.gradients, middles) > 9.5).all()


def test_an_open_surface_has_an_inside_too():
    lower_half = BALL.vertices[BALL.faces].mean(axis=1)[:, 2] < 8
    cup = SignedDistance(Mesh(BALL.vertices, BALL.faces[lower_half]))
    values = cup(np.array([[0.0, 0, 0], [0, 0, -9], [0, 0, -12], [0, 0, 30]]))
    assert not cup.closed and (values[:2] < 0).all() and (values[2:] > 0).all()


@settings(max_examples=8, deadline=None)
@given(st.floats(0, 1), st.floats(0.1, 2), st.tuples(*[st.floats(-18, 18)] * 3), st.floats(3, 12))
def test_all_that_stays_in_its_room_keeps_the_gap(share, gap, centre, radius):
    other = sphere(radius, centre, subdivisions=2)
    a, b = SignedDistance(BALL), SignedDistance(other)
    first = Cell(a, [Bound("apart", b, gap, share)]).excess(SOME, 1.0)
    second = Cell(b, [Bound("apart", a, gap, 1 - share)]).excess(SOME, 1.0)
    # Who does not give way may only go where the other one, which keeps to its side, does not come.
    first = np.where((share == 0) & (a(SOME) > 0), 1.0, first)
    second = np.where((share == 1) & (b(SOME) > 0), 1.0, second)
    mine, theirs = SOME[first <= 0], SOME[second <= 0]
    if len(mine) and len(theirs):
        apart = np.linalg.norm(mine[:, None] - theirs[None], axis=2).min()
        assert apart >= gap * (1 - 1e-9)


@settings(max_examples=8, deadline=None)
@given(st.floats(0.05, 1), st.floats(0.1, 2), st.floats(0, 5))
def test_bounds_by_boxes_change_nothing_that_counts(share, gap, band):
    others = [SignedDistance(sphere(6, (13, 2, 0), 2)), SignedDistance(box((-3, -20, -3), (3, -9, 3)))]
    own = SignedDistance(BALL)
    cell = Cell(own, [Bound("apart", other, gap, share) for other in others])
    exact = np.max([(1 - share) * own(SOME) + share * (gap - other(SOME)) for other in others], axis=0)
    found = cell.excess(SOME, band)
    near = exact > -band
    assert found[near] == pytest.approx(exact[near], abs=1e-9)
    assert (found[~near] >= exact[~near] - 1e-9).all() and (found[~near] <= -band + 1e-9).all()
    assert cell.located(SOME, band).values[near] == pytest.approx(exact[near], abs=1e-9)


def test_a_spike_in_the_middle_of_a_large_face_is_seen():
    plate = box((-40, -40, -5), (40, 40, 0))
    needle = sphere(0.5, (13, 7, 0.9), subdivisions=1)  # 0.4 mm above the plate, far from corners and centres
    cell = Cell(SignedDistance(plate), [Bound("apart", SignedDistance(needle), 1.0, 1.0)])
    lowest = float(needle.vertices[:, 2].min())
    assert excess_of(plate, cell, spacing_mm=0.1) == pytest.approx(1.0 - lowest, abs=0.1)
    samples = samples_of(plate, cell, spacing_mm=0.25, margin_mm=0.05)
    points = samples.points(plate.vertices)
    assert len(points) < 3000
    assert np.abs(slab(points, (-40, -40, -5), (40, 40, 0))).max() < 1e-9
    assert np.linalg.norm(points - (13, 7, 0), axis=1).min() < 0.25
    assert (
        excess_of(
            plate, Cell(cell.own, [Bound("apart", SignedDistance(sphere(3, (0, 0, 9))), 1.0, 0.5)]), spacing_mm=0.25
        )
        < 0
    )


def test_no_more_is_looked_at_than_is_asked_for():
    """A ball deep in another one exceeds its room everywhere by about the same."""
    inner = sphere(3, subdivisions=2)
    cell = Cell(SignedDistance(inner), [Bound("apart", SignedDistance(BALL), 1.0, 1.0)])
    most = excess_of(inner, cell, spacing_mm=0.2)
    assert 8.0 < most <= 8.0 + 0.2
    assert 2.0 < excess_of(inner, cell, spacing_mm=0.2, enough_mm=2.0) <= most
