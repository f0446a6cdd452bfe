"""The ribs: each pair turns about its own heads by two angles, so little that the lungs keep their room.

A rib that is joined to the spine glides a little as it turns, so that the joint gets no tighter.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vhp_cli.kernels.spatial import Tree, gap
from vhp_cli.stages.breathe.fitting.curves import at, even, even_move
from vhp_cli.stages.breathe.fitting.ends import RibEnds
from vhp_cli.stages.breathe.fitting.joints import glide, is_unmeasured, joint_of
from vhp_cli.stages.breathe.fitting.scene import Scene, near
from vhp_cli.stages.breathe.operations import LocalFrame, Operation, Rotate
from vhp_cli.stages.breathe.sequence import Motion

Array = NDArray[np.float64]

# Largest angles that are tried, in degrees: those of the published sequence reach 7.3 and 9.2 (thesis A.2).
MOST_LIFT, MOST_SPREAD = 8.0, 10.0
_STEP = 1.0
_HALVINGS = 6
_FEW = 8
# The lowest ribs have no cartilage to the sternum and may also go down, like callipers.
FREE_RIBS = (11, 12)
# What ribs leave to lungs if they can, or what they leave at rest if that is less; the limit counts if they can't.
ROOM_MM = 2.5
# How far what is around a rib may come towards it.
_REACH_MM = 40.0

Angles = tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """The ribs of one number.

    Parameters
    ----------
    number
        1 to 12.
    ribs
        Names by side.
    ends
        By side.
    axis : (3,) float64
        From the left head to the right one; a positive angle lifts the tips.
    attached
        Cartilages that go with the tips while room for the lungs is made, by side.
    """

    number: int
    ribs: Mapping[str, str]
    ends: Mapping[str, RibEnds]
    axis: Array
    attached: Mapping[str, str]

    def operations(self, side: str, angles: Angles, steps: int) -> tuple[Operation, ...]:
        """Return the two rotations of one rib: about the axis of the pair, then about z through its head."""
        head = self.ends[side].head
        lift, spread = angles[0], angles[1] if side == "left" else -angles[1]
        turns: list[Operation] = []
        if lift:
            turns.append(Rotate(LocalFrame.along(head, self.axis), "x", even(lift, steps)))
        if spread:
            turns.append(Rotate(at(head), "z", even(spread, steps)))
        return tuple(turns)

    def motion(self, side: str, angles: Angles, steps: int, shift: Array | None = None) -> Motion:
        """Return the motion of one rib, which glides by `shift` (3,) mm up to t = N."""
        name = self.ribs[side]
        operations = self.operations(side, angles, steps)
        if shift is not None and shift.any():
            operations = (*operations, even_move(shift, steps))
        return Motion(name, operations, tissues=(name,), role="rib", side=side, number=self.number)


def make_pairs(
    ribs: Mapping[tuple[str, int], str], ends: Mapping[str, RibEnds], cartilages: Mapping[tuple[str, int], str]
) -> list[Pair]:
    """Return the pairs in order of their numbers; a rib without a twin turns about its neighbours' axis.

    Parameters
    ----------
    ribs, cartilages
        Names by side and number.
    ends
        By name of the rib.
    """
    numbers = sorted({number for _, number in ribs})
    axes: dict[int, Array] = {}
    for number in numbers:
        if ("left", number) in ribs and ("right", number) in ribs:
            axis = ends[ribs["right", number]].head - ends[ribs["left", number]].head
            axes[number] = axis / np.linalg.norm(axis)
    pairs = []
    for number in numbers:
        sides = [side for side in ("left", "right") if (side, number) in ribs]
        nearest = min(axes, key=lambda known: (abs(known - number), known), default=None)
        axis = np.array([-1.0, 0.0, 0.0]) if nearest is None else axes[nearest]
        own = {side: ribs[side, number] for side in sides}
        attached = {side: cartilages[side, number] for side in sides if (side, number) in cartilages}
        pairs.append(Pair(number, own, {side: ends[own[side]] for side in sides}, axis, attached))
    return pairs


def lift_for(pair: Pair, forward_mm: float) -> float:
    """Return the angle in degrees by which a pair lifts its tips until they are this much further forward."""
    if pair.number in FREE_RIBS:
        return 0.0
    drops = [float(ends.head[2] - ends.tip[2]) for ends in pair.ends.values()]
    drop = float(np.mean(drops))
    return min(float(np.degrees(np.arctan2(forward_mm, drop))), MOST_LIFT) if drop > forward_mm else MOST_LIFT


def fit_ribs(
    scene: Scene,
    pairs: Sequence[Pair],
    lungs: Sequence[str],
    fixed: Sequence[str],
    spine: Sequence[str],
    forward_mm: float = 0.0,
) -> dict[int, Angles] | None:
    """Give every rib its motion and return the angles of each pair at t = N.

    Parameters
    ----------
    scene
        Holds the motion of the lungs already.
    pairs
        In order of their numbers.
    lungs
        What needs room.
    fixed
        Bones that stay.
    spine
        Those of them that ribs may be joined to.
    forward_mm
        How far the tips move forward at least, as by the pull of muscles; 0: no further than the lungs push them.

    Returns
    -------
    dict or None
        Lift and spread in degrees by number; None if a pair can't go forward so far.
    """
    found: dict[int, Angles] = {}
    for pair in pairs:
        above = [name for p in pairs if p.number < pair.number for name in p.ribs.values()]
        least_lift = lift_for(pair, forward_mm) if forward_mm else 0.0
        search = _Search(scene, pair, lungs, [*fixed, *above], spine, least_lift)
        angles = search.smallest(following=forward_mm > 0.0)
        if angles is None:
            return None
        found[pair.number] = angles
        search.place(angles)
    for number, angles in _evened(found).items():
        pair = next(p for p in pairs if p.number == number)
        others = [*fixed, *(name for p in pairs if p is not pair for name in p.ribs.values())]
        search = _Search(scene, pair, lungs, others, spine)
        if angles != found[number] and search.fits(angles, ROOM_MM):
            found[number] = angles
            search.place(angles)
    return found


def _evened(found: Mapping[int, Angles]) -> dict[int, Angles]:
    """Raise angles that lag behind those of both neighbours to half way between these."""
    evened = {}
    for number, angles in found.items():
        if number - 1 in found and number + 1 in found and number not in FREE_RIBS:
            before, after = np.array(found[number - 1]), np.array(found[number + 1])
            lift, spread = np.maximum(angles, 0.5 * (before + after)).tolist()
            evened[number] = (lift, spread)
    return evened


class _Search:
    """The search for the angles of one pair."""

    def __init__(
        self,
        scene: Scene,
        pair: Pair,
        lungs: Sequence[str],
        others: Sequence[str],
        spine: Sequence[str],
        least_lift: float = 0.0,
    ) -> None:
        self.scene, self.pair, self.least_lift = scene, pair, least_lift
        self.lungs = lungs
        self.joints = {name: joint_of(scene, name, spine) for name in pair.ribs.values()}
        around = {name: near(scene, name, [*lungs, *others], _REACH_MM) for name in pair.ribs.values()}
        self.obstacles = {n: [o for o in found if o not in self.joints[n]] for n, found in around.items()}
        self._motions: dict[tuple[str, Angles], Motion | None] = {}
        # A joint whose tightness can't be measured, as of open surfaces, must not be turned.
        self.locked = any(is_unmeasured(scene, name, joint) for name, joint in self.joints.items())

    def smallest(self, *, following: bool) -> Angles | None:
        """Return the smallest angles with room, else with the gap that must be kept, else the least bad ones.

        A pair whose tips follow the lungs has little choice: None if the first few angles leave no room.
        """
        candidates = [(0.0, 0.0)] if self.locked else self._candidates()
        if following and self.locked and self.least_lift:
            return None
        if following and self.pair.number not in FREE_RIBS:
            candidates = candidates[:_FEW]
        for room in (ROOM_MM, 0.0):
            for angles in candidates:
                if self.fits(angles, room):
                    return self._reduced(angles, room)
        if following:
            return None
        return min(candidates, key=lambda angles: (round(self._badness(angles), 3), _size(angles)))

    def fits(self, angles: Angles, room_mm: float) -> bool:
        """Tell if nothing is too near at these angles, and the lungs have this much room (or as much as at rest)."""
        if self.locked and any(angles):
            return False
        turning = {side: self.pair.motion(side, angles, self.scene.steps) for side in self.pair.ribs}
        if not all(self._has_place(side, turning[side], room_mm) for side in turning):
            return False
        gliding = {side: self.motion(side, angles) for side in turning}
        return all(
            motion is not None and (motion == turning[side] or self._has_place(side, motion, room_mm))
            for side, motion in gliding.items()
        )

    def motion(self, side: str, angles: Angles) -> Motion | None:
        """Return the motion of one rib, with the glide that its joint needs; None if that is too much."""
        key = (side, angles)
        if key not in self._motions:
            name = self.pair.ribs[side]
            motion = self.pair.motion(side, angles, self.scene.steps)
            shift = glide(self.scene, name, self.joints[name], motion) if motion.operations else np.zeros(3)
            self._motions[key] = None if shift is None else self.pair.motion(side, angles, self.scene.steps, shift)
        return self._motions[key]

    def place(self, angles: Angles) -> None:
        """Give the ribs their motions; where no glide is enough, they turn alone."""
        for side, name in self.pair.ribs.items():
            motion = self.motion(side, angles)
            self.scene.set(name, self.pair.motion(side, angles, self.scene.steps) if motion is None else motion)

    def _has_place(self, side: str, motion: Motion, room_mm: float) -> bool:
        """Tell if a rib hits nothing but its joint, and the lungs have room."""
        scene, name, cartilage = self.scene, self.pair.ribs[side], self.pair.attached.get(side)
        for t in scene.times:
            if room_mm and not self._has_room(name, scene.moved(name, motion, t), t, room_mm):
                return False
            if scene.shortfalls(name, motion, self.obstacles[name], [t], contacts=True):
                return False
            # While the ribs are placed, cartilages go with them.
            if (
                room_mm
                and cartilage is not None
                and not self._has_room(cartilage, scene.moved(cartilage, motion, t), t, room_mm)
            ):
                return False
        return True

    def _has_room(self, name: str, tree: Tree, t: float, room_mm: float) -> bool:
        for lung in self.lungs:
            if frozenset((name, lung)) in self.scene.in_contact:
                continue
            room = self.scene.room(name, lung, room_mm)
            if gap(tree, self.scene.tree(lung, t), room * (1.0 - 1e-9)) is not None:
                return False
        return True

    def _badness(self, angles: Angles) -> float:
        scene = self.scene
        total = 0.0
        for side, name in self.pair.ribs.items():
            motion = self.pair.motion(side, angles, scene.steps)
            obstacles = [*self.obstacles[name], *self.joints[name]]
            total += scene.badness(name, motion, obstacles, scene.times, contacts=True)
        return total

    def _candidates(self) -> list[Angles]:
        lowest = -MOST_LIFT if self.pair.number in FREE_RIBS else self.least_lift
        lifts = np.arange(lowest, max(MOST_LIFT, lowest) + 0.5 * _STEP, _STEP).tolist()
        spreads = np.arange(0.0, MOST_SPREAD + 0.5 * _STEP, _STEP).tolist()
        pairs = [(lift, spread) for lift in lifts for spread in spreads]
        return sorted(pairs, key=lambda item: (_size((item[0] - self.least_lift, item[1])), -item[0]))

    def _reduced(self, angles: Angles, room: float) -> Angles:
        """Halve the way back to rest as long as there is room."""
        low, high = 0.0, 1.0
        start = (self.least_lift, 0.0)
        if angles == start:
            return angles
        for _ in range(_HALVINGS):
            share = 0.5 * (low + high)
            if self.fits(_between(start, angles, share), room):
                high = share
            else:
                low = share
        return _between(start, angles, high)


def _between(start: Angles, end: Angles, share: float) -> Angles:
    return start[0] + (end[0] - start[0]) * share, start[1] + (end[1] - start[1]) * share


def _size(angles: Angles) -> float:
    return float(np.hypot(*angles))
