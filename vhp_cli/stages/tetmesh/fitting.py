"""Move the interfaces of a labelled mesh onto the surfaces they stand for, so that volumes come out right.

The mesher keeps its faces within an envelope about the surfaces, and flattens what is round there: convex tissues lose
volume. Here each vertex of an interface is moved by the mean distance of the triangles around it from the surface (the
L2 projection onto piecewise linear functions, with a lumped mass matrix), which makes the volume between the two vanish
to first order. No tetrahedron may become worse than a limit, or than it was.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vhp_cli.inspection.adjacency import Interfaces, adjacency, interfaces
from vhp_cli.kernels.measuring import closest
from vhp_cli.kernels.spatial import Tree
from vhp_cli.kernels.tetrahedra import advance
from vhp_cli.stages.tetmesh.relaxing import UNUSED, Floor
from vhp_cli.volume import BACKGROUND, Points, Tetrahedra, VolumeMesh, volumes

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

_ROUNDS = 2
_VOLUME_ROUNDS = 6
# Of its volume, what a tissue may be off before anything is done about it.
_VOLUME_TOLERANCE = 1e-4
_CHUNK = 16_384


def fit_to_surfaces(
    mesh: VolumeMesh,
    trees: Sequence[Tree],
    limit_mm: float,
    *,
    kept: Mask | None = None,
    floor: Floor | None = None,
    threads: int = 1,
) -> VolumeMesh:
    """Return a mesh whose interfaces lie on the surfaces in the mean; labels and connections stay.

    Parameters
    ----------
    mesh
        Label ``k`` is the tissue of surface ``trees[k - 1]``.
    trees
        The surfaces.
    limit_mm
        How far a vertex may move in all, and half of how far a surface is looked for.
    kept : (M,) bool
        Tetrahedra that will be used; the others only have to keep some volume. None: all.
    floor
        What tetrahedra have to keep.
    threads
        How many to use; the result does not depend on it.
    """
    between = interfaces(adjacency(mesh.tetrahedra), mesh.labels)
    # Not the faces of a box of air.
    chosen = (between.sides > BACKGROUND).any(axis=1)
    triangles, sides = between.triangles[chosen], between.sides[chosen]
    if not len(triangles) or limit_mm <= 0:
        return mesh
    guard = _Guard(mesh.tetrahedra, np.unique(triangles), kept, floor or Floor())
    start, points = mesh.points, mesh.points
    with ThreadPoolExecutor(max(threads, 1)) as executor:
        for _ in range(_ROUNDS):
            step = _mean_offsets(points, triangles, sides, trees, 2 * limit_mm, executor)
            step = _clipped(points + step - start, limit_mm) + start - points
            points, _ = guard.advance(points, step[guard.moving])
    return replace(mesh, points=points)


def match_volumes(
    mesh: VolumeMesh,
    goals_mm3: Mapping[frozenset[int], float],
    limit_mm: float,
    *,
    kept: Mask | None = None,
    floor: Floor | None = None,
) -> VolumeMesh:
    """Return a mesh whose tissues have the volumes of their surfaces, as far as the shape of tetrahedra allows.

    Where some vertices could not follow the surface, the others of it make up for them: the boundary of a tissue moves
    along its normals, by the same distance everywhere. Where it is that of a neighbour, too, it stays.

    Parameters
    ----------
    mesh
        The mesh.
    goals_mm3
        The volume within each surface, by the labels that lie there.
    limit_mm
        How far a vertex may move.
    kept, floor
        As of `fit_to_surfaces`.
    """
    between = interfaces(adjacency(mesh.tetrahedra), mesh.labels)
    goals = sorted(goals_mm3.items(), key=lambda goal: sorted(goal[0]))
    owner, outward = _owners(mesh, between, [labels for labels, _ in goals])
    moving = np.flatnonzero(owner >= 0).astype(np.int32)
    if not len(moving) or limit_mm <= 0:
        return mesh
    member = np.zeros((len(goals), int(mesh.labels.max()) + 1))
    for number, (labels, _) in enumerate(goals):
        member[number, [label for label in labels if label < member.shape[1]]] = 1
    guard = _Guard(mesh.tetrahedra, moving, kept, floor or Floor())
    own, wanted = owner[moving], np.array([volume for _, volume in goals])
    points, free = mesh.points, np.ones(len(moving), np.bool_)
    for _ in range(_VOLUME_ROUNDS):
        sizes = np.bincount(mesh.labels, volumes(points, mesh.tetrahedra), member.shape[1])
        lacking = wanted - member @ sizes
        lacking[np.abs(lacking) <= _VOLUME_TOLERANCE * wanted] = 0.0
        if not lacking.any():
            break
        gradient = _volume_gradient(points, outward, moving)
        slope = np.linalg.norm(gradient, axis=1)
        room = np.bincount(own[free], slope[free], len(goals))
        distance = np.divide(lacking, room, out=np.zeros_like(lacking), where=room > 0)
        normals = gradient / np.maximum(slope, 1e-300)[:, None]
        ways = np.where(free, distance[own], 0.0)[:, None] * normals
        ways = _clipped(points[moving] + ways - mesh.points[moving], limit_mm) + mesh.points[moving] - points[moving]
        points, parts = guard.advance(points, ways)
        free &= parts == 1
    return replace(mesh, points=points)


def _owners(
    mesh: VolumeMesh, between: Interfaces, goals: Sequence[frozenset[int]]
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return whose boundary each point lies on (N,), and the triangles of boundaries, seen from outside of them.

    -1 for points on no boundary, on that of several tissues, or where more than two labels meet.
    """
    labels = int(between.sides.max(initial=0)) + 2
    inside = np.zeros((len(goals), labels), np.bool_)
    for number, goal in enumerate(goals):
        inside[number, [label for label in goal if label < labels]] = True
    # The last column stands for what is outside of the mesh.
    first, second = between.sides.T
    owner = np.full(len(between.sides), -1, np.int32)
    count = np.zeros(len(between.sides), np.int32)
    turned = np.zeros(len(between.sides), np.bool_)
    for number in range(len(goals)):
        in_first, in_second = inside[number, first], inside[number, second]
        bounds = in_first != in_second
        owner[bounds], turned[bounds] = number, in_second[bounds]
        count += bounds
    owner[count != 1] = -1
    triangles = np.where(turned[:, None], between.triangles[:, ::-1], between.triangles)
    low, high = np.full(len(mesh.points), len(goals)), np.full(len(mesh.points), -2)
    np.minimum.at(low, triangles.ravel(), np.repeat(owner, 3))
    np.maximum.at(high, triangles.ravel(), np.repeat(owner, 3))
    return np.where(low == high, high, -1).astype(np.int32), triangles[owner >= 0]


def _volume_gradient(points: Points, triangles: NDArray[np.int32], moving: NDArray[np.int32]) -> Floats:
    """Return by how much the volume within triangles grows per mm that some points (K,) move, as vectors (K, 3)."""
    a, b, c = (points[triangles[:, corner]] for corner in range(3))
    shares = np.cross(b - a, c - a) / 6
    flat = triangles.ravel()
    total = [np.bincount(flat, np.repeat(shares[:, axis], 3), len(points))[moving] for axis in range(3)]
    return np.stack(total, axis=1)


class _Guard:
    """Moves points as far as the tetrahedra around them allow."""

    def __init__(self, tetrahedra: Tetrahedra, moving: NDArray[np.integer], kept: Mask | None, floor: Floor) -> None:
        self.moving = moving.astype(np.int32)
        touched = np.zeros(int(tetrahedra.max(initial=-1)) + 1, np.bool_)
        touched[moving] = True
        around = touched[tetrahedra].any(axis=1)
        self._tetrahedra = tetrahedra[around]
        self._used = np.ones(len(self._tetrahedra), np.bool_) if kept is None else kept[around]
        self._floor = floor

    def advance(self, points: Points, ways: Floats) -> tuple[Points, Floats]:
        """Return all points, with those that move on their ways (K, 3), and how much of these they went (K,)."""
        return advance(
            points,
            self._tetrahedra,
            self._used,
            target=self._floor.target,
            unused=UNUSED.target,
            moving=self.moving,
            ways=ways,
        )


def _mean_offsets(
    points: Points,
    triangles: NDArray[np.int32],
    sides: NDArray[np.int32],
    trees: Sequence[Tree],
    reach_mm: float,
    executor: ThreadPoolExecutor,
) -> Floats:
    """Return for each point (N, 3) the way to the surfaces in the mean of the triangles around it.

    The middles of edges are looked at, which integrates quadratic functions over a triangle exactly. Of the surfaces
    of the two tissues beside a triangle the nearer one counts.
    """
    corners = points[triangles]
    middles = (corners + np.roll(corners, -1, axis=1)) / 2
    nearest = np.full(middles.shape[:2], np.inf)
    offsets = np.zeros_like(middles)
    for label, tree in enumerate(trees, start=1):
        rows = np.flatnonzero((sides == label).any(axis=1))
        if not len(rows) or not tree.n_faces:
            continue
        queries = middles[rows].reshape(-1, 3)
        chunks = [queries[start : start + _CHUNK] for start in range(0, len(queries), _CHUNK)]
        found = list(executor.map(lambda chunk, tree=tree: closest(tree, chunk, reach_mm), chunks))
        distances = np.concatenate([part.distances for part in found]).reshape(-1, 3)
        ways = (np.concatenate([part.points for part in found]) - queries).reshape(-1, 3, 3)
        better = distances < nearest[rows]
        nearest[rows] = np.where(better, distances, nearest[rows])
        offsets[rows] = np.where(better[:, :, None], ways, offsets[rows])
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    weights = np.where(np.isfinite(nearest), areas[:, None], 0.0)
    total, weight = np.zeros_like(points), np.zeros(len(points))
    for corner in range(3):
        # The two edges that end in this corner.
        for edge in (corner, (corner + 2) % 3):
            weight += np.bincount(triangles[:, corner], weights[:, edge], len(points))
            for axis in range(3):
                moment = weights[:, edge] * offsets[:, edge, axis]
                total[:, axis] += np.bincount(triangles[:, corner], moment, len(points))
    return np.divide(total, weight[:, None], out=np.zeros_like(total), where=weight[:, None] > 0)


def _clipped(ways: Floats, limit_mm: float) -> Floats:
    lengths = np.linalg.norm(ways, axis=1, keepdims=True)
    scaled: Floats = ways * np.minimum(1.0, limit_mm / np.maximum(lengths, limit_mm))
    return scaled
