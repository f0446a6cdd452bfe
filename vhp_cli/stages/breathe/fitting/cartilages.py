"""Costal cartilages that are joined to what they hold: they bend between ribs and sternum, and no joint is torn."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vhp_cli.kernels.measuring import closest
from vhp_cli.kernels.spatial import gap, pair_hits
from vhp_cli.stages.breathe.blend import Ball, Blend, Holder, balls_around
from vhp_cli.stages.breathe.fitting.curves import even_move
from vhp_cli.stages.breathe.fitting.scene import Scene
from vhp_cli.stages.breathe.operations import Operation
from vhp_cli.stages.breathe.sequence import Motion

Array = NDArray[np.float64]

_MOST_HITS = 1_000_000
# Between the names of two cartilages that are joined to each other.
_JOINT_OF = " + "


@dataclass(frozen=True, slots=True)
class _Size:
    """How large joints are made.

    Parameters
    ----------
    around_mm
        What of a cartilage is so near to a body beyond the gap between them belongs to the joint.
    faces
        Whether whole faces do.
    ball_mm
        Radius of the balls that make up a joint, and what they reach beyond it.
    """

    around_mm: float
    faces: bool
    ball_mm: tuple[float, float]


# The largest joints are taken between which a cartilage has so much room to bend, in mm, or those that leave most.
_ENOUGH_MM = 10.0
_SIZES = (
    _Size(1.5, True, (4.0, 1.0)),
    _Size(1.5, True, (2.5, 0.7)),
    _Size(1.5, False, (2.5, 0.7)),
    _Size(1.0, False, (1.5, 0.5)),
    _Size(0.5, False, (0.8, 0.3)),
)


@dataclass(frozen=True, slots=True)
class Joint:
    """Where a cartilage is joined to a body that moves as a whole.

    Parameters
    ----------
    body
        A rib, a part of the sternum, or, of two cartilages joined to each other, both names.
    balls
        What lies in them goes with the body.
    """

    body: str
    balls: tuple[Ball, ...]


@dataclass(frozen=True, slots=True)
class Joined:
    """A cartilage and its joints."""

    name: str
    joints: tuple[Joint, ...]


def find_joined(
    scene: Scene,
    cartilages: Iterable[str],
    ribs: Sequence[str],
    sternum: Sequence[str],
    ends: Mapping[str, Sequence[str]],
) -> dict[str, Joined]:
    """Return the joints of the cartilages that are nearer to a rib, the sternum or each other than the gap to keep.

    Parameters
    ----------
    scene
        The model at rest.
    cartilages, ribs, sternum
        Names.
    ends
        For cartilages that span from a body to another, these two: they hold the cartilage however far they are.
    """
    places = _places(scene, list(cartilages), ribs, sternum, ends)
    joined: dict[str, Joined] = {}
    for group in _groups(places):
        best, most = None, 0.0
        for size in _SIZES:
            balls = {
                name: {
                    key: balls_around(np.concatenate([_zone(scene, *pair, size) for pair in pairs]), *size.ball_mm)
                    for key, pairs in places[name].items()
                }
                for name in group
            }
            _merge(balls)
            between = min(_ENOUGH_MM, *(_between(own) for own in balls.values()))
            if between > most:
                best, most = balls, between
            if most == _ENOUGH_MM:
                break
        for name, own in (best or {}).items():
            joined[name] = Joined(name, tuple(Joint(key, found) for key, found in own.items()))
    return joined


def _places(
    scene: Scene,
    names: Sequence[str],
    ribs: Sequence[str],
    sternum: Sequence[str],
    ends: Mapping[str, Sequence[str]],
) -> dict[str, dict[str, list[tuple[str, str]]]]:
    """Return for each cartilage and each body that it is joined to the pairs of tissues that are near there."""
    places: dict[str, dict[str, list[tuple[str, str]]]] = {}
    for name in names:
        tight = [body for body in (*ribs, *sternum) if scene.room(name, body, scene.gap_mm) < scene.gap_mm]
        beside = [other for other in names if other != name and scene.room(name, other, scene.gap_mm) < scene.gap_mm]
        if not tight and not beside:
            continue
        own: dict[str, list[tuple[str, str]]] = {}
        for body in dict.fromkeys([*tight, *(end for end in ends.get(name, ()) if end not in names)]):
            own.setdefault(sternum[0] if body in sternum else body, []).append((name, body))
        for other in beside:
            own[_JOINT_OF.join(sorted((name, other)))] = [(name, other), (other, name)]
        places[name] = own
    return places


def _groups(places: Mapping[str, Mapping[str, object]]) -> list[list[str]]:
    """Return the cartilages that are joined to each other, directly or through others, together."""
    groups: list[list[str]] = []
    for name, own in places.items():
        near = [
            group for group in groups if any(key in places[other] for other in group for key in own if _JOINT_OF in key)
        ]
        groups = [group for group in groups if group not in near]
        groups.append([*(other for group in near for other in group), name])
    return groups


def place_joined(scene: Scene, joined: Mapping[str, Joined]) -> None:
    """Give the cartilages their motions, between those of the bodies that they are joined to."""
    at_full = float(scene.steps)
    shared: dict[str, tuple[Operation, ...]] = {}
    # Where two cartilages are joined, both go with the mean of what each would do alone.
    ways: dict[str, list[Array]] = {}
    for cartilage in joined.values():
        own = [_holder(scene, joint) for joint in cartilage.joints if joint.body in scene.tissues]
        for joint in cartilage.joints:
            if joint.body not in scene.tissues and own:
                centre = np.mean([ball[:3] for ball in joint.balls], axis=0)[None]
                ways.setdefault(joint.body, []).append(Blend("", tuple(own)).displacement(centre, at_full)[0])
    for body, steps in ways.items():
        way = np.mean(steps, axis=0)
        shared[body] = (even_move(way, scene.steps),) if way.any() else ()
    for cartilage in joined.values():
        holders = tuple(
            Holder(joint.body, shared.get(joint.body, ()), joint.balls)
            if joint.body not in scene.tissues
            else _holder(scene, joint)
            for joint in cartilage.joints
        )
        role = scene.tissues[cartilage.name].role
        motion = Motion(cartilage.name, tissues=(cartilage.name,), role=role.part, side=role.side, number=role.number)
        if all(holder.operations == holders[0].operations for holder in holders):
            motion = replace(motion, operations=holders[0].operations)
        else:
            motion = replace(motion, fields=(Blend(cartilage.name, holders),))
        scene.set(cartilage.name, motion)


def _holder(scene: Scene, joint: Joint) -> Holder:
    motion = scene.motions.get(joint.body)
    return Holder(joint.body, () if motion is None else motion.operations, joint.balls)


def _zone(scene: Scene, name: str, body: str, size: _Size) -> Array:
    """Return the vertices of a tissue at its joint with a body, (P, 3)."""
    tissue, other = scene.tissues[name], scene.tissues[body]
    vertices, faces = tissue.mesh.vertices, tissue.mesh.faces
    found = gap(tissue.tree, other.tree)
    assert found is not None
    reach = found.distance + size.around_mm
    near = closest(other.tree, vertices, reach).distances <= reach
    # A large face may be near, or in contact, though its corners are far.
    near[faces[found.faces[0]]] = True
    if frozenset((name, body)) in scene.in_contact:
        inside = ((vertices >= other.lower) & (vertices <= other.upper)).all(axis=1)
        if other.closed and inside.any():
            near[np.flatnonzero(inside)[other.tree.inside(vertices[inside]) == 1]] = True
        hits = pair_hits(tissue.tree, other.tree, limit=_MOST_HITS).pairs[:, 0]
        near[faces[hits].reshape(-1)] = True
    if size.faces:
        near[faces[near[faces].any(axis=1)].reshape(-1)] = True
    points: Array = vertices[near]
    return points


def _merge(found: dict[str, dict[str, tuple[Ball, ...]]]) -> None:
    """Let two cartilages that are joined to each other right at a rib or the sternum both go with that."""
    pairs = sorted({key for own in found.values() for key in own if key not in found and _JOINT_OF in key})
    for key in pairs:
        members = [name for name, own in found.items() if key in own]
        bodies = {
            other
            for name in members
            for other, balls in found[name].items()
            if other != key and _balls_between(balls, found[name][key]) <= 0.0
        }
        if len(bodies) == 1:
            body = bodies.pop()
            for name in members:
                found[name][body] = (*found[name].get(body, ()), *found[name].pop(key))


def _between(own: Mapping[str, tuple[Ball, ...]]) -> float:
    """Return the smallest distance between two joints of a cartilage in mm; 0 or less where they meet."""
    keys = list(own)
    return min((_balls_between(own[a], own[b]) for i, a in enumerate(keys) for b in keys[:i]), default=np.inf)


def _balls_between(first: Sequence[Ball], second: Sequence[Ball]) -> float:
    a, b = np.array(first), np.array(second)
    distances = np.linalg.norm(a[:, None, :3] - b[None, :, :3], axis=2)
    return float((distances - a[:, None, 3] - b[None, :, 3]).min())
