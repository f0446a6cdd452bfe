"""A displacement between those of several bodies."""

from __future__ import annotations

import numpy as np
import pytest
from breathing_motions import operations
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from vhp_cli.stages.breathe.blend import Blend, Holder, balls_around
from vhp_cli.stages.breathe.sequence import Motion

places = st.lists(st.floats(-40.0, 40.0), min_size=3, max_size=3)


@st.composite
def blends(draw: st.DrawFn) -> Blend:
    holders = []
    for index in range(draw(st.integers(1, 4))):
        moving = draw(st.booleans())
        steps = tuple(draw(st.lists(operations(), min_size=1, max_size=2))) if moving else ()
        balls = tuple((*draw(places), draw(st.floats(0.5, 6.0))) for _ in range(draw(st.integers(1, 3))))
        holders.append(Holder(f"body {index}", steps, balls))
    try:
        return Blend("blend", tuple(holders))
    except ValueError:
        assume(False)
        raise


@given(blends(), st.floats(0.0, 11.0))
@settings(max_examples=60, deadline=None)
def test_what_lies_in_a_ball_goes_with_its_body(blend: Blend, t: float) -> None:
    motion = Motion("strip", fields=(blend,))
    for index, holder in enumerate(blend.holders):
        body = Motion("body", holder.operations)
        for x, y, z, radius in holder.balls:
            inside = np.array([[x, y, z], [x + 0.9 * radius, y, z], [x, y - 0.5 * radius, z + 0.5 * radius]])
            assert (blend.held(inside) == index).all()
            assert motion.apply(inside, t) == pytest.approx(body.apply(inside, t), abs=1e-9)


@given(blends(), st.lists(places, min_size=1, max_size=5), st.floats(0.0, 10.0), st.floats(0.01, 1.0))
@settings(max_examples=25, deadline=None)
def test_no_point_goes_further_than_its_bound(blend: Blend, points: list, start: float, width: float) -> None:
    motion = Motion("strip", fields=(blend,))
    times = np.linspace(start, start + width, 50)
    track = np.stack([motion.apply(points, float(t)) for t in times])
    walked = np.linalg.norm(np.diff(track, axis=0), axis=2).sum(axis=0)
    bounds = motion.paths(points, [start, start + width])[0]
    assert (walked <= bounds + 1e-9).all()
    # It is a bound, not a guess: never many times too large on a short interval.
    assert (
        motion.paths(points, [start, start + 1e-3])[0]
        <= 1.5 * np.linalg.norm(motion.apply(points, start + 1e-3) - motion.apply(points, start), axis=1) + 1e-3
    ).all()


@given(blends(), st.lists(places, min_size=1, max_size=5))
@settings(max_examples=40, deadline=None)
def test_weights_are_shares_and_nothing_moves_at_rest(blend: Blend, points: list) -> None:
    weights = blend.weights(points)
    assert weights.sum(axis=1) == pytest.approx(1.0) and (weights >= 0.0).all()
    assert blend.rests() and not blend.displacement(points, 0.0).any()


def test_weights_fall_with_the_square_of_the_distance() -> None:
    blend = Blend("b", (Holder("a", (), ((0, 0, 0, 1.0),)), Holder("b", (), ((10, 0, 0, 2.0), (10, 5, 0, 2.0)))))
    # 3 mm from the ball of a, 4 mm from the nearer one of b.
    assert blend.weights([[4.0, 0.0, 0.0]])[0] == pytest.approx([16 / 25, 9 / 25])
    assert blend.held([[4.0, 0.0, 0.0], [0.5, 0.0, 0.0], [10.0, 4.0, 0.0]]).tolist() == [-1, 0, 1]


def test_balls_that_meet_or_are_missing_are_refused() -> None:
    near = Holder("near", (), ((0, 0, 0, 2.0),))
    with pytest.raises(ValueError, match="'near' and 'next' meet"):
        Blend("b", (near, Holder("next", (), ((3.5, 0, 0, 2.0),))))
    for holders in ((), (Holder("none", (), ()),), (Holder("point", (), ((0, 0, 0, 0.0),)),)):
        with pytest.raises(ValueError):
            Blend("b", holders)


@given(st.lists(places, min_size=1, max_size=40))
def test_balls_cover_all_points_with_a_margin(points: list) -> None:
    balls = np.array(balls_around(points, 4.0, 1.0))
    distances = np.linalg.norm(np.array(points)[:, None] - balls[None, :, :3], axis=2).min(axis=1)
    assert distances.max() <= 3.0 + 1e-9
    assert len(balls) <= len(points)
