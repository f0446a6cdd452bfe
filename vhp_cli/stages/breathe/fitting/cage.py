"""Sternum and costal cartilages: they follow the tips of the ribs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vhp_cli.kernels.measuring import closest
from vhp_cli.stages.breathe.bridges import bridge
from vhp_cli.stages.breathe.fitting.curves import even_move
from vhp_cli.stages.breathe.fitting.scene import Scene, near
from vhp_cli.stages.breathe.sequence import Motion

Array = NDArray[np.float64]

_REACH_MM = 40.0
_ITERATIONS = 12
_FORWARD_STEP_MM, _MOST_FORWARD_MM = 0.25, 12.0


@dataclass(frozen=True, slots=True, eq=False)
class Strut:
    """A cartilage and what its ends go with.

    Parameters
    ----------
    name, side, number
        Of the cartilage.
    rib
        Whose tip it goes on from.
    holder
        What the other end goes with: a part of the sternum, or the cartilage above.
    tip, anchor : (3,) float64
        Its points nearest to the rib and to the holder, in mm.
    """

    name: str
    side: str
    number: int
    rib: str
    holder: str
    tip: Array
    anchor: Array


def make_struts(
    scene: Scene, cartilages: Mapping[tuple[str, int], str], ribs: Mapping[tuple[str, int], str], sternum: Sequence[str]
) -> list[Strut]:
    """Return the cartilages between a rib and the sternum or the cartilage above, the upper ones first."""
    struts = []
    for (side, number), name in sorted(cartilages.items(), key=lambda item: (item[0][1], item[0][0])):
        rib = ribs.get((side, number))
        above = cartilages.get((side, number - 1))
        holders = [*sternum, *([above] if above is not None and number > 1 else [])]
        if rib is None or not holders:
            continue
        points = scene.tissues[name].mesh.vertices
        distance = {holder: closest(scene.tissues[holder].tree, points).distances for holder in holders}
        # An upper cartilage may pass near the one above; it is held by the sternum all the same.
        near_sternum = [holder for holder in holders if holder in sternum]
        holder = min(
            near_sternum if number <= 7 and near_sternum else holders, key=lambda item: float(distance[item].min())
        )
        anchor = points[int(distance[holder].argmin())]
        tip = points[int(closest(scene.tissues[rib].tree, points).distances.argmin())]
        if np.linalg.norm(tip - anchor) > 1.0:
            struts.append(Strut(name, side, number, rib, holder, tip, anchor))
    return struts


def fit_sternum(scene: Scene, sternum: Sequence[str], struts: Sequence[Strut], obstacles: Sequence[str]) -> Array:
    """Move the sternum so that the cartilages change their lengths least, and give them their motions.

    Where sternum or cartilages would hit something, it moves further forward, or less.

    Parameters
    ----------
    scene
        Holds the motion of the ribs already.
    sternum
        Its parts, which move as one.
    struts
        The cartilages; those that the sternum does not hold don't count.
    obstacles
        What must be cleared.

    Returns
    -------
    (3,) float64
        The translation at t = N, in mm; x is 0.
    """
    best = _least_stretch(scene, [strut for strut in struts if strut.holder in sternum])
    forward = np.arange(0.0, _MOST_FORWARD_MM, _FORWARD_STEP_MM)
    choices = [best - [0.0, extra, 0.0] for extra in forward]
    choices += [best * share - [0.0, extra, 0.0] for share in (0.75, 0.5, 0.25, 0.0) for extra in forward[::4]]
    if any(scene.touching(name) for name in sternum):
        # Whatever moves it tears at what it is joined to: there is little to choose.
        choices = [best, 0.5 * best, 0.0 * best]
    moving = [*sternum, *(strut.name for strut in struts)]
    around = {name: near(scene, name, [*obstacles, *moving], _REACH_MM) for name in moving}

    def place(shift: Array) -> float:
        move = (even_move(shift, scene.steps),) if shift.any() else ()
        for name in sternum:
            scene.set(name, Motion(name, move, tissues=(name,), role="sternum"))
        fit_cartilages(scene, struts)
        return round(
            sum(
                scene.badness(name, scene.motions.get(name), around[name], scene.times, contacts=True)
                for name in around
            ),
            6,
        )

    if not sternum:
        fit_cartilages(scene, struts)
        return np.zeros(3)
    least, chosen = np.inf, best
    for shift in choices:
        missing = place(shift)
        if missing < least:
            least, chosen = missing, shift
        if missing == 0.0:
            break
    place(chosen)
    result: Array = chosen
    return result


def _least_stretch(scene: Scene, struts: Sequence[Strut]) -> Array:
    """Return the translation (0, y, z) that minimises the sum of squares of the changes of length (Gauss-Newton)."""
    shift = np.zeros(3)
    if not struts:
        return shift
    t = float(scene.steps)
    tips = np.array([_path(scene, strut.rib, strut.tip, np.array([t]))[0] for strut in struts])
    anchors = np.array([strut.anchor for strut in struts])
    lengths = np.array([np.linalg.norm(strut.tip - strut.anchor) for strut in struts])
    if np.array_equal(tips, [strut.tip for strut in struts]):
        return shift
    for _ in range(_ITERATIONS):
        arms = tips - anchors - shift
        now = np.linalg.norm(arms, axis=1)
        slopes = -(arms / now[:, None])[:, 1:]
        shift[1:] += np.linalg.lstsq(slopes, lengths - now, rcond=None)[0]
    return shift


def fit_cartilages(scene: Scene, struts: Sequence[Strut]) -> None:
    """Stretch and turn each cartilage with its two ends."""
    times = np.linspace(0.0, scene.steps, 2 * scene.steps + 1)[1:]
    for strut in struts:
        tips = _path(scene, strut.rib, strut.tip, times)
        anchors = _path(scene, strut.holder, strut.anchor, times)
        if np.array_equal(tips, np.tile(strut.tip, (len(times), 1))) and np.array_equal(
            anchors, np.tile(strut.anchor, (len(times), 1))
        ):
            scene.set(strut.name, None)
            continue
        operations = bridge(strut.anchor, strut.tip, times, anchors, tips)
        motion = Motion(
            strut.name, operations, tissues=(strut.name,), role="cartilage", side=strut.side, number=strut.number
        )
        scene.set(strut.name, motion)


def _path(scene: Scene, name: str, point: Array, times: Array) -> Array:
    """Return where a point of a tissue that moves as a rigid or an affine body is at some times, (T, 3)."""
    motion = scene.motions.get(name)
    if motion is None:
        return np.tile(point, (len(times), 1))
    matrices = motion.matrices(times)
    path: Array = matrices[:, :3, :3] @ point + matrices[:, :3, 3]
    return path
