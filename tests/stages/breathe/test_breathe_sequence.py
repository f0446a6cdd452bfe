"""Motions: where points are, how far they travel at most."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from breathing_motions import affine_motions, every_form, operations
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from vhp_cli.stages.breathe.curves import Interpolant, Polynomial
from vhp_cli.stages.breathe.field import Field
from vhp_cli.stages.breathe.operations import LocalFrame, Move, Operation, Parameter, Rotate, Scale
from vhp_cli.stages.breathe.sequence import Motion, Sequence

CORNERS = np.array([[x, y, z] for x in (-40.0, 60.0) for y in (-20.0, 90.0) for z in (-250.0, -100.0)])
WITHIN = np.random.default_rng(0).uniform(CORNERS.min(axis=0), CORNERS.max(axis=0), (60, 3))


def moved_by_hand(operation: Operation, points: np.ndarray, t: float) -> np.ndarray:
    """The textbook formulas, with the rotation of scipy."""
    basis, origin = operation.frame.basis, np.array(operation.frame.origin)
    local = (points - origin) @ basis
    values = {name: float(parameter.curve(t)) for name, parameter in operation.parameters().items()}
    if isinstance(operation, Scale):
        local = local * [values["x"], values["y"], values["z"]]
    elif isinstance(operation, Move):
        local = local + np.array([values["x"], values["y"], values["z"]])
    else:
        vector = np.eye(3)["xyz".index(operation.axis)]
        local = Rotation.from_rotvec(vector * values["angle"], degrees=True).apply(local)
    return local @ basis.T + origin


@given(st.lists(operations(), min_size=1, max_size=4), st.floats(0.0, 11.0))
@settings(max_examples=50)
def test_operations_are_applied_in_order(found: list[Operation], t: float) -> None:
    wanted = WITHIN
    for operation in found:
        wanted = moved_by_hand(operation, wanted, t)
    motion = Motion("m", tuple(found))
    assert motion.apply(WITHIN, t) == pytest.approx(wanted, abs=1e-9)
    matrix = motion.matrix(t)
    assert WITHIN @ matrix[:3, :3].T + matrix[:3, 3] == pytest.approx(wanted, abs=1e-9)
    assert list(matrix[3]) == [0.0, 0.0, 0.0, 1.0]


@given(affine_motions)
@settings(max_examples=50)
def test_at_rest_the_numbers_are_the_same(motion: Motion) -> None:
    assert np.array_equal(motion.apply(WITHIN, 0.0), WITHIN)
    assert np.array_equal(motion.matrix(0.0), np.eye(4))


@given(affine_motions, st.lists(st.floats(0.0, 11.0), min_size=1, max_size=5))
@settings(max_examples=30)
def test_matrices_of_many_times_are_those_of_each(motion: Motion, times: list[float]) -> None:
    together = motion.matrices(times)
    assert together.shape == (len(times), 4, 4)
    for matrix, t in zip(together, times, strict=True):
        assert matrix == pytest.approx(motion.matrix(t), rel=1e-12, abs=1e-12)


def test_turning_about_an_axis_lifts_by_the_right_hand() -> None:
    # About the axis from the left to the right head, a point in front goes up.
    frame = LocalFrame.along((20.0, 100.0, 0.0), (-1.0, 0.0, 0.0))
    motion = Motion("rib", (Rotate(frame, "x", Parameter(Polynomial((0.0, 1.0)))),))
    front = motion.apply([[20.0, 0.0, 0.0]], 10.0)[0]
    assert front == pytest.approx([20.0, 100.0 - 100.0 * np.cos(np.radians(10)), 100.0 * np.sin(np.radians(10))])


@given(affine_motions, st.floats(0.0, 11.0), st.floats(0.0, 11.0), st.integers(1, 4))
@settings(max_examples=60)
def test_no_point_travels_further_than_the_bound(motion: Motion, one: float, other: float, parts: int) -> None:
    """The corners of a box stand for every point in it, and the path is measured along a fine polygon."""
    start, end = min(one, other), max(one, other)
    bound = float(motion.travel_bounds(CORNERS, [start, end], parts)[0])
    path = np.zeros(len(WITHIN))
    times = np.linspace(start, end, 51)
    places = [motion.apply(WITHIN, t) for t in times]
    for before, after in pairwise(places):
        path += np.linalg.norm(after - before, axis=1)
    assert path.max() <= bound


@given(affine_motions)
@settings(max_examples=25)
def test_the_bound_closes_in_on_the_path(motion: Motion) -> None:
    """It exceeds the path by the square of the interval: an interval that is halved is soon proven."""

    def excess(width: float) -> float:
        places = [motion.apply(CORNERS, t) for t in np.linspace(4.0, 4.0 + width, 33)]
        path = sum(np.linalg.norm(b - a, axis=1) for a, b in pairwise(places)).max()
        return motion.travel_bound(CORNERS, 4.0, 4.0 + width) - path

    assert 0.0 <= excess(1.0 / 64.0) <= excess(1.0 / 8.0) / 16.0 + 1e-6


def test_bound_of_a_steady_move_is_its_length() -> None:
    motion = Motion(
        "m", (Move(LocalFrame(), x=Parameter(Polynomial((0.0, 3.0))), z=Parameter(Polynomial((0.0, -4.0)))),)
    )
    assert motion.travel_bounds(CORNERS, [0.0, 1.0, 3.0]) == pytest.approx([5.0, 10.0], abs=1e-6)


def test_bound_counts_the_way_there_and_back() -> None:
    motion = Motion("m", (Move(LocalFrame(), x=Parameter(Interpolant((0.0, 5.0, 0.0), "linear"))),))
    assert np.array_equal(motion.apply(CORNERS, 2.0), CORNERS)
    assert motion.travel_bound(CORNERS, 0.0, 2.0) == pytest.approx(10.0, abs=1e-6)


def test_bound_of_a_quarter_turn() -> None:
    motion = Motion("m", (Rotate(LocalFrame(), "z", Parameter(Polynomial((0.0, 90.0)))),))
    arc = 10.0 * np.pi / 2.0
    bound = float(motion.travel_bounds([[10.0, 0.0, 0.0]], [0.0, 1.0], parts=64)[0])
    assert arc <= bound <= 1.05 * arc


def test_what_does_not_move_travels_nothing() -> None:
    assert list(Motion("still").travel_bounds(CORNERS, [0.0, 1.0, 2.0])) == [0.0, 0.0]
    assert Motion("still").apply(CORNERS, 5.0) == pytest.approx(CORNERS, abs=0.0)


def field(**changes: object) -> Field:
    values: dict[str, object] = {
        "name": "chest",
        "amplitude": Parameter(Polynomial((0.0, 1.0))),
        "x_window": (-140.0, 170.0),
        "z_window": (-330.0, -150.0),
        "y_back": 64.0,
    }
    return Field(**(values | changes))  # type: ignore[arg-type]


def test_field_bulges_in_the_middle_and_ends_at_the_window() -> None:
    middle = [[15.0, -100.0, -240.0]]
    assert field().displacement(middle, 10.0) == pytest.approx(np.array([[0.0, -10.0, 0.0]]))
    edges = [[-140.0, -100, -240], [170.0, -100, -240], [15, -100, -330.0], [15, -100, -150.0], [15, 64.0, -240]]
    beyond = [[-150.0, -100, -240], [180.0, -100, -240], [15, -100, -340.0], [15, -100, -140.0], [15, 70.0, -240]]
    assert not field().displacement([*edges, *beyond], 10.0).any()
    assert not field().displacement(middle, 0.0).any()


def test_volume_of_the_bulge() -> None:
    """A window without tapers displaces 2/pi a w h (thesis A.8, by integration of the sine)."""
    x, z = np.meshgrid(np.linspace(-140, 170, 311), np.linspace(-330, -150, 721))
    points = np.stack([x.ravel(), np.full(x.size, -100.0), z.ravel()], axis=1)
    sharp = field(x_taper=0.0, y_taper=0.0)
    size = -sharp.displacement(points, 10.0)[:, 1].reshape(x.shape)
    volume = np.trapezoid(size[:, 1:-1].mean(axis=1), z[:, 0]) * 310.0
    assert volume == pytest.approx(2.0 / np.pi * 10.0 * 310.0 * 180.0, rel=1e-4)


@given(st.lists(st.floats(-400.0, 400.0), min_size=6, max_size=6))
def test_field_is_no_steeper_than_it_says(values: list[float]) -> None:
    a, b = np.array(values[:3]), np.array(values[3:])
    b = a + (b - a) / 400.0
    weights = field().weight([a, b])
    assert ((weights >= 0.0) & (weights <= 1.0)).all()
    assert abs(weights[1] - weights[0]) <= field().steepness() * np.linalg.norm(b - a) + 1e-12
    assert field(x_taper=0.0).steepness() == np.inf


@given(st.floats(0.0, 11.0), st.floats(0.0, 11.0))
@settings(max_examples=40)
def test_no_vertex_of_a_shell_travels_further_than_the_bound(one: float, other: float) -> None:
    start, end = min(one, other), max(one, other)
    amplitude = Parameter(Polynomial((0.0, 2.0, -0.4, 0.02)))
    motion = Motion("skin", fields=(field(amplitude=amplitude),))
    path = np.zeros(len(WITHIN))
    times = np.linspace(start, end, 51)
    for before, after in pairwise(times):
        path += np.linalg.norm(motion.apply(WITHIN, after) - motion.apply(WITHIN, before), axis=1)
    assert path.max() <= motion.travel_bound(WITHIN, start, end)
    assert np.array_equal(motion.apply(WITHIN, 0.0), WITHIN)


def test_fields_of_one_motion_add_up() -> None:
    wide, low = field(), field(name="belly", z_window=(-400.0, -200.0), direction=(0.0, 0.6, -0.8))
    both = Motion("skin", fields=(wide, low)).apply(WITHIN, 3.0)
    assert both - WITHIN == pytest.approx(wide.displacement(WITHIN, 3.0) + low.displacement(WITHIN, 3.0), abs=1e-12)


def test_unusable_values_are_refused() -> None:
    turn = Rotate(LocalFrame(), "x", Parameter(Polynomial((0.0, 1.0))))
    for make, said in (
        (lambda: field(x_window=(10.0, -10.0)), "low end"),
        (lambda: field(x_taper=200.0), "tapers"),
        (lambda: field(y_back=float("nan")), "finite"),
        (lambda: field(direction=(0.0, -2.0, 0.0)), "unit vector"),
        (lambda: Rotate(LocalFrame(), "w", Parameter(Polynomial((0.0,)))), "axis"),  # type: ignore[arg-type]
        (lambda: LocalFrame((0, 0, 0), (1, 0, 0), (0.1, 1, 0)), "right angle"),
        (lambda: LocalFrame((0, 0, float("inf"))), "finite"),
        (lambda: Motion("m", (turn,), (field(),)), "both operations and fields"),
        (lambda: Sequence("s", (), steps=0), "steps"),
        (lambda: Sequence("s", (), period_s=0.0), "period"),
        (lambda: Sequence("s", (), variable="a b"), "sweep variable"),
        (lambda: Sequence("s", (Motion("m"), Motion("m"))), "two motions have the name 'm'"),
    ):
        with pytest.raises(ValueError, match=said):
            make()


def test_a_sequence_starts_at_rest() -> None:
    lifted = Motion("m", (Rotate(LocalFrame(), "x", Parameter(Polynomial((0.5, 1.0)))),))
    bulged = Motion("s", fields=(field(amplitude=Parameter(Polynomial((0.1,)))),))
    for motion in (lifted, bulged):
        with pytest.raises(ValueError, match="at t = 0"):
            Sequence("s", (motion,))
        assert Sequence("s", (motion,), identity_at_rest=False).motions == (motion,)


def test_motions_are_found_by_name() -> None:
    sequence = every_form()
    assert sequence.motion("Lungs").role == "lung"
    with pytest.raises(KeyError):
        sequence.motion("liver")
