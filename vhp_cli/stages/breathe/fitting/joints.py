"""The joint of a rib with the spine: as the rib turns, it glides by so little that the joint gets no tighter."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from vhp_cli.kernels.spatial import Tree, gap, overlap_volume
from vhp_cli.stages.breathe.fitting.scene import Scene
from vhp_cli.stages.breathe.sequence import Motion

Array = NDArray[np.float64]

# Bones of the spine that are so near to a rib make up its joint, in mm.
NEAR_MM = 2.0
# How far a rib may glide, in mm: less than the cartilage of these joints is thick.
MOST_MM = 1.0
# What is aimed at beyond the limits, so that it holds between the times looked at: less volume in common by this
# share, and a larger gap in mm.
_LESS, _MORE_MM = 0.02, 0.003
_ROUNDS, _SWEEPS = 8, 300
# Of which so much may be missing.
_CLOSE = 1e-5
# Step of the finite differences of the volume in common, in mm.
_STEP_MM = 0.02


def joint_of(scene: Scene, rib: str, spine: Sequence[str]) -> list[str]:
    """Return the bones of the spine that a rib is joined to: those in contact with it or near."""
    return [bone for bone in spine if scene.room(rib, bone, NEAR_MM) < NEAR_MM]


def is_unmeasured(scene: Scene, rib: str, joint: Sequence[str]) -> bool:
    """Tell if the volume that a rib has in common with a bone of its joint can't be told."""
    return any(frozenset((rib, bone)) in scene.in_contact and bool(np.isnan(scene.common(rib, bone))) for bone in joint)


def glide(scene: Scene, rib: str, joint: Sequence[str], motion: Motion) -> Array | None:
    """Return the shortest translation at t = N by which a turning rib keeps its joint as loose as at rest.

    Each bone sets a limit: the square root of the volume in common may not grow, or the gap not fall below the one that
    must be kept. The limits are linearised, the shortest translation within them is taken, and so on until they hold.

    Parameters
    ----------
    scene
        Where everything is.
    rib, joint
        The rib, and the bones of its joint, which stay.
    motion
        Of the rib, without the translation.

    Returns
    -------
    (3,) float64 or None
        In mm; None if it would have to glide too far.
    """
    places = [(t / scene.steps, motion.apply(scene.tissues[rib].mesh.vertices, t)) for t in scene.times]
    faces = scene.tissues[rib].mesh.faces
    total = np.zeros(3)
    for _ in range(_ROUNDS):
        rows: list[Array] = []
        lacks: list[float] = []
        for share, vertices in places:
            for bone in joint:
                lack, slope = _limit(scene, rib, bone, vertices + share * total, faces)
                rows.append(share * slope)
                lacks.append(lack)
        if max(lacks, default=0.0) <= _CLOSE:
            return total
        slopes = np.array(rows)
        total = shortest(slopes, np.array(lacks) + slopes @ total)
        if not np.linalg.norm(total) <= MOST_MM:
            return None
    return None


def _limit(scene: Scene, rib: str, bone: str, vertices: Array, faces: NDArray[np.int32]) -> tuple[float, Array]:
    """Return by how much a limit is missed (0 or less: it holds), and by how much that falls per mm of translation."""
    other = scene.tissues[bone].tree
    tree = Tree(vertices, faces)
    touching = frozenset((rib, bone)) in scene.in_contact
    found = gap(tree, other, NEAR_MM)
    if found is None:
        return -NEAR_MM, np.zeros(3)
    allowed = np.sqrt(scene.common(rib, bone) * (1.0 - _LESS)) if touching else 0.0
    if not found.contact_kind:
        away = (found.points[0] - found.points[1]) / found.distance
        # What touched at rest and has come apart may touch again.
        lack = -allowed if touching else scene.needed(rib, bone) + _MORE_MM
        return lack - found.distance, away
    # A pair that was apart and crosses now must be apart again, by what the gap has to be.
    lack = np.sqrt(overlap_volume(tree, other)) - allowed + (0.0 if touching else scene.needed(rib, bone))
    slope = np.zeros(3)
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = _STEP_MM
        before, after = (overlap_volume(Tree(vertices + way, faces), other) for way in (-step, step))
        slope[axis] = (np.sqrt(before) - np.sqrt(after)) / (2.0 * _STEP_MM)
    return float(lack), slope


def shortest(slopes: Array, needed: Array) -> Array:
    """Return the shortest vector g (3,) with ``slopes @ g >= needed``, by Hildreth's row action (1957).

    Where there is none, what it returns grows with the number of sweeps.
    """
    vector, multipliers = np.zeros(3), np.zeros(len(needed))
    sizes = (slopes**2).sum(axis=1)
    for _ in range(_SWEEPS):
        for row in np.flatnonzero(sizes > 0.0):
            change = max((needed[row] - slopes[row] @ vector) / sizes[row], -multipliers[row])
            multipliers[row] += change
            vector = vector + change * slopes[row]
    return vector
