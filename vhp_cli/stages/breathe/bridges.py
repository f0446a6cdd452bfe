"""The affine motion of a strut between two moving points: a costal cartilage between sternum and rib tip."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vhp_cli.stages.breathe.operations import LocalFrame, Move, Operation, Parameter, Rotate, Scale
from vhp_cli.stages.breathe.polynomials import fit_pinned, residual

Array = NDArray[np.float64]


def bridge(
    anchor: ArrayLike, tip: ArrayLike, times: ArrayLike, anchor_path: ArrayLike, tip_path: ArrayLike
) -> tuple[Operation, ...]:
    """Return the operations that carry a strut along with both its ends.

    With m the vector from anchor to tip, the strut is stretched along m by the growth of |m|, turned about the
    anchor so that m gets its new direction, and moved with the anchor (thesis A.4, its angle being
    ``acos(m_n . m_o / (|m_n| |m_o|))``). The turn is one about the local y and one about the local z axis of a
    coordinate system with x along m, which are fixed: about m itself the strut turns by half the product of both
    angles, to second order.

    Parameters
    ----------
    anchor, tip : (3,) float64
        The ends at rest, in mm.
    times : (T,) float64
        Values of the sweep variable, above 0.
    anchor_path, tip_path : (T, 3) float64
        Where the ends are at these times.

    Returns
    -------
    tuple of Operation
        Scale, two rotations and a move. Polynomials of degree 6 follow the paths, so the ends meet them as far as
        the residuals of the parameters say.

    Raises
    ------
    ValueError
        If the ends are in one place, or the direction turns by a right angle or more.
    """
    start = np.asarray(anchor, dtype=np.float64)
    arm = np.asarray(tip, dtype=np.float64) - start
    length = float(np.linalg.norm(arm))
    anchors = np.asarray(anchor_path, dtype=np.float64)
    arms = np.asarray(tip_path, dtype=np.float64) - anchors
    lengths = np.linalg.norm(arms, axis=1)
    if length == 0.0 or not lengths.all():
        raise ValueError("the ends of a strut must not be in one place")
    frame = LocalFrame.along(start, arm)
    x, y, z = (arms / lengths[:, None] @ frame.basis).T
    if (x <= 0.0).any():
        raise ValueError("a strut must not turn by a right angle or more")
    moves = anchors - start
    world = LocalFrame()
    return (
        Scale(frame, x=_fitted(times, lengths / length, 1.0)),
        Rotate(frame, "y", _fitted(times, np.degrees(-np.arcsin(np.clip(z, -1.0, 1.0))), 0.0)),
        Rotate(frame, "z", _fitted(times, np.degrees(np.arctan2(y, x)), 0.0)),
        Move(world, *(_fitted(times, moves[:, axis], 0.0) for axis in range(3))),
    )


def _fitted(times: ArrayLike, values: Array, identity: float) -> Parameter:
    curve = fit_pinned(times, values, identity)
    return Parameter(curve, residual=residual(curve, times, values))
