"""The motion of a strut with its two ends."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from vhp_cli.stages.breathe.bridges import bridge
from vhp_cli.stages.breathe.curves import Polynomial
from vhp_cli.stages.breathe.operations import LocalFrame, Move, Parameter, Rotate, Scale
from vhp_cli.stages.breathe.sequence import Motion, Sequence

TIMES = np.arange(0.25, 11.01, 0.25)
ANCHOR = np.array([20.0, -30.0, -240.0])


def straight(direction: list[float], size: float) -> np.ndarray:
    return ANCHOR + (TIMES / 11.0)[:, None] * np.array(direction) * size


@given(
    st.lists(st.floats(-90.0, 90.0), min_size=3, max_size=3),
    st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3),
    st.floats(0.0, 8.0),
    st.floats(0.0, 6.0),
)
@settings(max_examples=40)
def test_both_ends_are_met(arm: list[float], way: list[float], theta: float, phi: float) -> None:
    """An anchor that moves straight and a tip on a turning rib, as a cartilage has them."""
    if np.linalg.norm(arm) < 25.0:
        return
    tip = ANCHOR + np.array(arm)
    head = np.array([40.0, 100.0, -210.0])
    rib = Motion(
        "rib",
        (
            Rotate(LocalFrame.along(head, (-1.0, 0.05, 0.02)), "x", Parameter(Polynomial((0.0, theta / 11.0)))),
            Rotate(LocalFrame(tuple(head)), "z", Parameter(Polynomial((0.0, phi / 11.0)))),
        ),
    )
    tip_path = np.stack([rib.apply(tip, t)[0] for t in TIMES])
    anchor_path = straight(way, 8.0)
    motion = Motion("cartilage", bridge(ANCHOR, tip, TIMES, anchor_path, tip_path))
    Sequence("at rest", (motion,))
    worst = max(
        np.linalg.norm(motion.apply([ANCHOR, tip], t) - [p, q], axis=1).max()
        for t, p, q in zip(TIMES, anchor_path, tip_path, strict=True)
    )
    assert worst < 0.02


def test_steady_stretch_is_met_exactly() -> None:
    tip = ANCHOR + np.array([0.0, -50.0, 0.0])
    path = tip + (TIMES / 11.0)[:, None] * np.array([0.0, -5.0, 0.0])
    motion = Motion("m", bridge(ANCHOR, tip, TIMES, np.tile(ANCHOR, (len(TIMES), 1)), path))
    assert motion.apply([ANCHOR, tip, ANCHOR + np.array([3.0, 0.0, 4.0])], 11.0) == pytest.approx(
        np.array([ANCHOR, tip + np.array([0.0, -5.0, 0.0]), ANCHOR + np.array([3.0, 0.0, 4.0])]), abs=1e-9
    )


def test_turn_is_nearly_the_shortest() -> None:
    """Against the rotation about m_o x m_n by the angle between them (thesis A.4), for 8 degrees."""
    tip = ANCHOR + np.array([40.0, -40.0, 10.0])
    full = Rotation.from_rotvec([0.0, 6.0, 6.0], degrees=True)
    path = np.stack([ANCHOR + Rotation.from_rotvec(full.as_rotvec() * t / 11.0).apply(tip - ANCHOR) for t in TIMES])
    motion = Motion("m", bridge(ANCHOR, tip, TIMES, np.tile(ANCHOR, (len(TIMES), 1)), path))
    m_o, m_n = tip - ANCHOR, path[-1] - ANCHOR
    angle = np.arccos(m_o @ m_n / np.linalg.norm(m_o) / np.linalg.norm(m_n))
    axis = np.cross(m_o, m_n) / np.linalg.norm(np.cross(m_o, m_n))
    wanted = Rotation.from_rotvec(axis * angle).as_matrix()
    between = Rotation.from_matrix(motion.matrix(11.0)[:3, :3] @ wanted.T).magnitude()
    assert np.degrees(between) < 0.6


def test_operations_are_scale_turns_and_move() -> None:
    tip = ANCHOR + np.array([0.0, -50.0, 0.0])
    found = bridge(ANCHOR, tip, TIMES, straight([0, 0, 1], 3.0), straight([1, 0, 0], 3.0) + np.array([0.0, -50.0, 0.0]))
    assert [type(operation) for operation in found] == [Scale, Rotate, Rotate, Move]
    assert max(p.residual for operation in found for p in operation.parameters().values()) < 1e-3


def test_impossible_struts_are_refused() -> None:
    still = np.tile(ANCHOR, (len(TIMES), 1))
    with pytest.raises(ValueError, match="one place"):
        bridge(ANCHOR, ANCHOR, TIMES, still, still)
    with pytest.raises(ValueError, match="right angle"):
        bridge(ANCHOR, ANCHOR + np.array([10.0, 0.0, 0.0]), TIMES, still, still - [10.0, 0.0, 0.0])
