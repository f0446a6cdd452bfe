"""Prove that two bodies in contact at rest do not get any tighter.

Two ways lead there. Where both follow one and the same affine map at the contact, as a rib and the end of the cartilage
on it, the contact is carried along unchanged; the rest of their faces is proven apart. Else the volume in common is
bounded: it changes no faster than the parts of either surface within the other sweep through space.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from vhp_cli.kernels.measuring import closest
from vhp_cli.kernels.spatial import overlap_volume
from vhp_cli.stages.breathe.bodies import Body
from vhp_cli.stages.breathe.gap_proof import Pair, prove_apart
from vhp_cli.stages.breathe.rest import most_in_common

Array = NDArray[np.float64]

# How often faces at a contact are cut into four, to tell which part of them can be within the other body.
_CUTS = 2
# What rounding may add to areas, speeds and distances, as a share.
_SLACK = 1e-9
# What rounding may do to a volume in common, in mm3.
_ROUNDING_MM3 = 1e-6


@dataclass(frozen=True, slots=True)
class ContactProof:
    """What is proven of a pair in contact at rest.

    Parameters
    ----------
    pair
        The tissues.
    verdict
        ``"joined"``: their contact is carried along unchanged; ``"bounded"``: their volume in common never exceeds what
        a frame may have; ``"worse"``: it does at a moment that was looked at; ``"excused"``: none of these is proven.
    evaluations
        How often the volume in common was computed.
    worse_at
        When it was found to exceed that.
    """

    pair: Pair
    verdict: Literal["joined", "bounded", "worse", "excused"]
    evaluations: int = 0
    worse_at: float | None = None


def prove_contact(first: Body, second: Body, pair: Pair, common_mm3: float, depth: int) -> ContactProof:
    """Prove that a contact gets no tighter, as far as that is so.

    Parameters
    ----------
    first, second
        The bodies.
    pair
        Their names.
    common_mm3
        Volume in common at rest.
    depth
        How often an interval of one step is halved at most.
    """
    if _joined(first, second, pair, depth):
        return ContactProof(pair, "joined")
    if not (first.rigid and second.rigid) or not np.isfinite(common_mm3):
        return ContactProof(pair, "excused")
    if any(body.tree(0.0).self_hits(limit=1).n_pairs for body in (first, second)):
        # What such a surface encloses twice counts twice: the bound would not hold.
        return ContactProof(pair, "excused")
    search = _Volumes(first, second, most_in_common(common_mm3) - _ROUNDING_MM3, depth)
    if search.run():
        return ContactProof(pair, "bounded", search.evaluations)
    verdict: Literal["worse", "excused"] = "excused" if search.worse_at is None else "worse"
    return ContactProof(pair, verdict, search.evaluations, search.worse_at)


def _joined(first: Body, second: Body, pair: Pair, depth: int) -> bool:
    """Tell if the two are in contact only where both follow the same map, at every moment."""
    shared = []
    others = dict(second.carriers())
    loose = np.ones(len(first.faces), dtype=bool)
    for operations, faces in first.carriers():
        if operations in others and faces.any():
            shared.append((faces, others[operations]))
            loose &= ~faces
    if not shared:
        return False
    combinations = [(own, ~same) for own, same in shared] + [(loose, np.ones(len(second.faces), dtype=bool))]
    for own, theirs in combinations:
        if not own.any() or not theirs.any():
            continue
        one, other = first.part(own), second.part(theirs)
        if prove_apart(one, other, pair, depth).unproven:
            return False
    # What bends deep within the other would change the volume in common without any contact.
    theirs_loose = ~np.any([same for _, same in shared], axis=0)
    return not (_any_inside(first, loose, second) or _any_inside(second, theirs_loose, first))


def _any_inside(body: Body, chosen: NDArray[np.bool_], other: Body) -> bool:
    points = body.vertices[np.unique(body.faces[chosen])]
    tree = other.tree(0.0)
    possible = points[((points >= tree.lower) & (points <= tree.upper)).all(axis=1)]
    return len(possible) > 0 and bool((tree.inside(possible) == 1).any())


class _Volumes:
    """Bounds the volume that two rigid bodies have in common.

    By the transport theorem it changes by the flux of the velocity through the parts of either surface that lie within
    the other, so no faster than their area times their speed.
    """

    def __init__(self, first: Body, second: Body, most_mm3: float, depth: int) -> None:
        self.bodies = (first, second)
        self.most, self.depth = most_mm3, depth
        self.evaluations = 0
        self.worse_at: float | None = None

    def run(self) -> bool:
        """Tell if the bound holds from 0 to N."""
        times = self.bodies[0].grid.tolist()
        volumes = [self._volume(t) for t in times]
        for start, end, before, after in zip(times, times[1:], volumes, volumes[1:], strict=False):
            rate = sum(_rate(body, other, start, end) for body, other in (self.bodies, self.bodies[::-1]))
            if not self._interval(start, end, before, after, rate, 0):
                return False
        return True

    def _volume(self, t: float) -> float:
        self.evaluations += 1
        found = overlap_volume(self.bodies[0].tree(t), self.bodies[1].tree(t))
        if found > self.most and self.worse_at is None:
            self.worse_at = t
        return found

    def _interval(self, start: float, end: float, before: float, after: float, rate: float, level: int) -> bool:
        if not max(before, after) <= self.most:
            return False
        # At any moment between, the volume is at most what it can have grown to from one end and from the other.
        if 0.5 * (before + after + rate * (end - start)) <= self.most:
            return True
        if level >= self.depth:
            return False
        middle = 0.5 * (start + end)
        between = self._volume(middle)
        return self._interval(start, middle, before, between, rate, level + 1) and self._interval(
            middle, end, between, after, rate, level + 1
        )


def _rate(body: Body, other: Body, start: float, end: float) -> float:
    """Return how fast the part of a rigid body's surface within another can sweep volume, in mm3 per step.

    All pieces of its faces count that are so near to the other body at the start that they can be within it before the
    end; each counts with its area and the largest speed of its corners.
    """
    if body.motion is None:
        return 0.0
    tree, place, faces = other.tree(start), body.place(start), body.faces
    approach = other.travel(start, end)
    corners = place[faces]
    reach = body.travel(start, end) + approach
    near = ((corners.min(axis=1) <= tree.upper + reach) & (corners.max(axis=1) >= tree.lower - reach)).all(axis=1)
    if not near.any():
        return 0.0
    corners = corners[near]
    used, local = np.unique(faces[near], return_inverse=True)
    speeds = body.motion.speeds(body.vertices[used], np.array([start]), np.array([end]))[0]
    speed = speeds[local.reshape(-1, 3)].max(axis=1) * (1.0 + _SLACK)
    for _ in range(_CUTS + 1):
        centres = corners.mean(axis=1)
        sizes = np.linalg.norm(corners - centres[:, None], axis=2).max(axis=1)
        need = sizes + speed * (end - start) + approach
        distances = closest(tree, centres, float(need.max())).distances
        near = (distances <= need) | (tree.inside(centres) == 1)
        corners, speed = corners[near], speed[near]
        if not len(corners):
            return 0.0
        areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        total = float((areas * speed).sum()) * (1.0 + _SLACK)
        corners, speed = _quartered(corners), np.repeat(speed, 4)
    return total


def _quartered(corners: Array) -> Array:
    """Cut each of triangles (F, 3, 3) into four alike, (4 F, 3, 3)."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
    pieces = [np.stack(piece, axis=1) for piece in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    found: Array = np.stack(pieces, axis=1).reshape(-1, 3, 3)
    return found
