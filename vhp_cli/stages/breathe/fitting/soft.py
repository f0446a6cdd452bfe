"""Organs, muscles and what lies between: pushed and carried by the lungs and the cage."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from vhp_cli.stages.breathe.fitting.curves import at, even, even_move
from vhp_cli.stages.breathe.fitting.lungs import LungMotion
from vhp_cli.stages.breathe.fitting.scene import Scene
from vhp_cli.stages.breathe.operations import Operation, Scale, Triple
from vhp_cli.stages.breathe.profile import Profile
from vhp_cli.stages.breathe.sequence import Motion

Array = NDArray[np.float64]

# Above the lungs the forward motion dies out over this height, below them all motion over the height of the belly.
NECK_MM = 60.0
BELLY_MM = (120.0, 250.0)

# Shares of the full descent that an organ may take part in.
_SHARES = (0.25, 0.5, 0.75, 1.0, 1.15, 1.3)
_CARRIED_SHARES = (0.25, 0.5, 0.75, 1.0)
# How far a muscle may give way, in mm.
_MUSCLE_STEPS_MM = tuple(np.arange(0.5, 15.01, 0.5).tolist())
_MUSCLE_WAYS: dict[str, tuple[Triple, ...]] = {
    "pectoral": ((0.0, -1.0, 0.0), (0.0, -0.9, 0.4358898943540673)),
    "abdominal": ((0.0, -1.0, 0.0), (0.0, -0.8, -0.6)),
    "erector": ((0.0, 1.0, 0.0),),
}


def descent(lungs: LungMotion, lowest: float, floor: float, steps: int) -> Profile:
    """Return the displacement field of what lies between and below the lungs.

    At the height of the lungs it is theirs, so that what lies between them keeps its place among them; below it dies
    out evenly down to the floor of the belly.

    Parameters
    ----------
    lungs
        How these move.
    lowest
        z down to which the lungs' own motion goes on: the lowest point of lungs and diaphragm.
    floor
        z of the lowest soft tissue that could move.
    steps
        N.
    """
    top = lungs.origin[2]
    bottom = float(np.clip(floor, lowest - BELLY_MM[1], lowest - BELLY_MM[0]))
    forward = -lungs.forward_mm
    down = -(lungs.along - 1.0) * (top - lowest)
    return Profile(
        "descent",
        even(1.0, steps),
        (bottom, lowest, top, top + NECK_MM),
        ((0.0, 0.0, 0.0), (0.0, forward, down), (0.0, forward, 0.0), (0.0, 0.0, 0.0)),
    )


def with_profile(scene: Scene, name: str, profile: Profile, share: float) -> Motion:
    """Return the motion of a tissue that the field carries along, wholly or by a share."""
    role = scene.tissues[name].role
    if share != 1.0:
        scaled = tuple((x * share, y * share, z * share) for x, y, z in profile.displacements)
        profile = Profile(f"{profile.name} {share:g}", profile.amplitude, profile.heights, scaled)
    return Motion(name, fields=(profile,), tissues=(name,), role=role.part, side=role.side)


def organ_candidates(scene: Scene, name: str, profile: Profile) -> list[Motion | None]:
    """Return what an organ may do: stay, move down, move down and be compressed, or follow the field wholly."""
    tissue = scene.tissues[name]
    ends = np.array([tissue.lower, tissue.upper])
    low, high = profile.full(ends)
    middle = profile.full(tissue.mesh.vertices).mean(axis=0)
    height = float(ends[1, 2] - ends[0, 2])
    top = (float(tissue.centre[0]), float(tissue.centre[1]), float(ends[1, 2]))
    candidates: list[Motion | None] = [None, with_profile(scene, name, profile, 1.0)]
    for share in _SHARES:
        candidates.append(_motion(scene, name, (even_move(middle * share, scene.steps),)))
        vertical = np.array([0.0, 0.0, middle[2] * share])
        candidates.append(_motion(scene, name, (even_move(vertical, scene.steps),)))
        along = 1.0 + share * float(high[2] - low[2]) / height
        if along > 0.5:
            move = np.array([0.0, middle[1], high[2]]) * share
            candidates.append(
                _motion(scene, name, (Scale(at(top), z=even(along, scene.steps, 1.0)), even_move(move, scene.steps)))
            )
    return candidates


def muscle_candidates(scene: Scene, name: str) -> list[Motion | None]:
    """Return what a muscle may do: stay, or give way outwards."""
    ways = _MUSCLE_WAYS[scene.tissues[name].role.part]
    candidates: list[Motion | None] = [None]
    for way in ways:
        candidates += [_motion(scene, name, (even_move(np.array(way) * mm, scene.steps),)) for mm in _MUSCLE_STEPS_MM]
    return candidates


def carried_candidates(scene: Scene, name: str, profile: Profile, neighbours: Sequence[str]) -> list[Motion | None]:
    """Return what any other soft tissue may do: stay, follow the field, or go with a neighbour."""
    candidates: list[Motion | None] = [None]
    candidates += [with_profile(scene, name, profile, share) for share in _CARRIED_SHARES]
    for other in neighbours:
        motion = scene.motions.get(other)
        if motion is not None and motion.operations:
            candidates.append(_motion(scene, name, motion.operations))
    return candidates


def riding(scene: Scene, name: str, parent: str) -> Motion | None:
    """Return the motion of a tissue that lies within another: the same."""
    motion = scene.motions.get(parent)
    if motion is None:
        return None
    role = scene.tissues[name].role
    return Motion(name, motion.operations, motion.fields, tissues=(name,), role=role.part, side=role.side)


def _motion(scene: Scene, name: str, operations: tuple[Operation, ...]) -> Motion:
    role = scene.tissues[name].role
    return Motion(name, operations, tissues=(name,), role=role.part, side=role.side)
