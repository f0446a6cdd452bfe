"""Sternum and costal cartilages: they follow the tips of the ribs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vhp_cli.kernels.measuring import closest
from vhp_cli.stages.breathe.bridges import bridge
from vhp_cli.stages.breathe.fitting.cartilages import Joined, place_joined
from vhp_cli.stages.breathe.fitting.curves import even_move
from vhp_cli.stages.breathe.fitting.scene import Scene, near
from vhp_cli.stages.breathe.sequence import Motion

Array = NDArray[np.float64]

_REACH_MM = 40.0
_ITERATIONS = 12
# How much further forward the sternum may go than changes the cartilages least, in mm, and what share of that it may
# take part in, with how much further forward then.
_FURTHER_MM = (0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0)
_SHARES, _FEW_FURTHER_MM = (0.75, 0.5, 0.25, 0.0), (0.0, 1.0, 2.0, 4.0)


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


def find_escorts(scene: Scene, sternum: Sequence[str], bones: Sequence[str]) -> list[str]:
    """Return the bones that are in contact with the sternum, or nearer than the gap to keep, and with no other bone."""

    def joined(first: str, second: str) -> bool:
        return scene.room(first, second, scene.gap_mm) < scene.gap_mm

    return [
        bone
        for bone in bones
        if any(joined(bone, part) for part in sternum)
        and not any(joined(bone, other) for other in bones if other != bone)
    ]


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


@dataclass(frozen=True, slots=True)
class Cage:
    """What goes with the ribs.

    Parameters
    ----------
    sternum
        Its parts, which move as one.
    escorts
        Bones that are joined to it and to nothing that stays, such as the clavicles: they may go along.
    struts
        The cartilages that span from a rib to the sternum or to another cartilage.
    joined
        Those of all cartilages that are joined to something, by name.
    """

    sternum: tuple[str, ...]
    escorts: tuple[str, ...]
    struts: tuple[Strut, ...]
    joined: Mapping[str, Joined]

    @property
    def tissues(self) -> tuple[str, ...]:
        """All of them."""
        return (*self.sternum, *self.escorts, *dict.fromkeys([*(strut.name for strut in self.struts), *self.joined]))


def fit_cage(scene: Scene, cage: Cage, obstacles: Sequence[str]) -> None:
    """Move the sternum so that the cartilages change their lengths least, and give them their motions.

    Where sternum or cartilages would hit something, it moves further forward, or less; the bones that it holds go
    along, or stay if that is better.

    Parameters
    ----------
    scene
        Holds the motion of the ribs already.
    cage
        What is to be placed.
    obstacles
        What must be cleared.
    """
    best = _least_stretch(scene, [strut for strut in cage.struts if strut.holder in cage.sternum])
    choices = [best - [0.0, extra, 0.0] for extra in _FURTHER_MM]
    choices += [best * share - [0.0, extra, 0.0] for share in _SHARES for extra in _FEW_FURTHER_MM]
    around = {name: near(scene, name, [*obstacles, *cage.tissues], _REACH_MM) for name in cage.tissues}

    def place(shift: Array, *, escorted: bool) -> None:
        move = (even_move(shift, scene.steps),) if shift.any() else ()
        for name in cage.sternum:
            scene.set(name, Motion(name, move, tissues=(name,), role="sternum"))
        for name in cage.escorts:
            scene.set(name, Motion(name, move if escorted else (), tissues=(name,), role="bone"))
        fit_cartilages(scene, cage)

    def missing(most: float) -> float:
        """Return how much room is missing, or somewhat more than `most` if that much is."""
        total = 0.0
        for name, others in around.items():
            total += scene.badness(name, scene.motions.get(name), others, scene.times, contacts=True)
            if total > most:
                break
        return round(total, 6)

    if not cage.sternum:
        fit_cartilages(scene, cage)
        return
    least, chosen, along = np.inf, best, True
    for escorted in (True, False) if cage.escorts else (True,):
        for shift in choices:
            place(shift, escorted=escorted)
            lack = missing(least)
            if lack < least:
                least, chosen, along = lack, shift, escorted
            if lack == 0.0:
                break
        if least == 0.0:
            break
    place(chosen, escorted=along)


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


def fit_cartilages(scene: Scene, cage: Cage) -> None:
    """Stretch and turn each cartilage with its two ends; what is joined to anything bends between its joints."""
    times = np.linspace(0.0, scene.steps, 2 * scene.steps + 1)[1:]
    place_joined(scene, cage.joined)
    for strut in cage.struts:
        if strut.name in cage.joined:
            continue
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
    """Return where a point of a tissue is at some times, (T, 3)."""
    motion = scene.motions.get(name)
    if motion is None:
        return np.tile(point, (len(times), 1))
    if motion.fields:
        return np.concatenate([motion.apply(point[None], float(t)) for t in times])
    matrices = motion.matrices(times)
    path: Array = matrices[:, :3, :3] @ point + matrices[:, :3, 3]
    return path
