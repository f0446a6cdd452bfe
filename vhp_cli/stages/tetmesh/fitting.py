"""Move the interfaces of a labelled mesh onto the surfaces they stand for, so that volumes come out right.

The mesher keeps its faces within an envelope about the surfaces, and flattens what is round there: convex tissues lose
volume. Here each vertex of an interface is moved by the mean distance of the triangles around it from the surface (the
L2 projection onto piecewise linear functions, with a lumped mass matrix), which makes the volume between the two vanish
to first order. No tetrahedron may become worse than a limit, or than it was.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vhp_cli.inspection.adjacency import adjacency, interfaces
from vhp_cli.inspection.tetrahedra import tetrahedron_quality
from vhp_cli.kernels.measuring import closest
from vhp_cli.kernels.spatial import Tree
from vhp_cli.stages.tetmesh.relaxing import UNUSED, Floor
from vhp_cli.volume import BACKGROUND, Points, Tetrahedra, VolumeMesh

Floats = NDArray[np.float64]

_ROUNDS = 2
# Parts of a step that are tried: all, a half, and so on down to this.
_LEAST_SHARE = 1 / 8
_CHUNK = 16_384


def fit_to_surfaces(
    mesh: VolumeMesh,
    trees: Sequence[Tree],
    limit_mm: float,
    *,
    kept: NDArray[np.bool_] | None = None,
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
    moving = np.unique(triangles)
    touched = np.zeros(len(mesh.points), np.bool_)
    touched[moving] = True
    around = np.flatnonzero(touched[mesh.tetrahedra].any(axis=1))
    tetrahedra = mesh.tetrahedra[around]
    used = np.ones(len(around), np.bool_) if kept is None else kept[around]
    least = floor or Floor()
    least_angle = np.where(used, least.min_dihedral_deg, UNUSED.min_dihedral_deg)
    least_ratio = np.where(used, least.radius_ratio, UNUSED.radius_ratio)
    start, points = mesh.points, mesh.points.copy()
    with ThreadPoolExecutor(max(threads, 1)) as executor:
        for _ in range(_ROUNDS):
            step = _mean_offsets(points, triangles, sides, trees, 2 * limit_mm, executor)
            step = _clipped(points + step - start, limit_mm) + start - points
            points = _guarded(points, step, tetrahedra, least_angle, least_ratio)
    return replace(mesh, points=points)


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


def _guarded(points: Points, step: Floats, tetrahedra: Tetrahedra, least_angle: Floats, least_ratio: Floats) -> Points:
    """Return the points moved by as much of a step as their tetrahedra allow."""
    before = tetrahedron_quality(points, tetrahedra)
    least_angle = np.minimum(before.min_dihedral_deg, least_angle)
    least_ratio = np.minimum(before.radius_ratio, least_ratio)
    share = np.ones(len(points))
    affected = np.arange(len(tetrahedra))
    while len(affected):
        moved = points + share[:, None] * step
        after = tetrahedron_quality(moved, tetrahedra[affected])
        bad = (
            (after.volume <= 0)
            | (after.min_dihedral_deg < least_angle[affected])
            | (after.radius_ratio < least_ratio[affected])
        )
        corners = np.unique(tetrahedra[affected[bad]])
        # Where none of the corners moves any more, the tetrahedron is what it was.
        corners = corners[share[corners] > 0]
        if not len(corners):
            break
        share[corners] = np.where(share[corners] > _LEAST_SHARE, share[corners] / 2, 0.0)
        changed = np.zeros(len(points), np.bool_)
        changed[corners] = True
        affected = np.flatnonzero(changed[tetrahedra].any(axis=1))
    return points + share[:, None] * step
