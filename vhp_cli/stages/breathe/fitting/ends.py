"""Where a rib begins and ends."""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vhp_cli.kernels import surface
from vhp_cli.kernels.measuring import closest
from vhp_cli.mesh import Mesh
from vhp_cli.stages.breathe.tissue import Tissue

Array = NDArray[np.float64]

# The end of a rib is the mean of what lies so near to its outermost vertex, along the surface.
END_MM = 8.0


@dataclass(frozen=True, slots=True, eq=False)
class RibEnds:
    """The two ends of a rib, (3,) each, in mm."""

    head: Array
    tip: Array


def rib_ends(rib: Tissue, spine: Sequence[Tissue]) -> RibEnds:
    """Find head and tip of a rib: the two ends along its surface, the head nearer to the spine.

    The vertex nearest to the spine is no good sign of the head: it jumps between head and tubercle, and tilts the axis
    of a pair by up to 28 degrees (measured on 24 ribs), the end along the surface by 4.

    Parameters
    ----------
    rib
        The rib.
    spine
        Vertebrae; without any, the head is the end further back.
    """
    neighbours = _neighbours(rib.mesh)
    start = int(np.argmax(np.linalg.norm(rib.mesh.vertices - rib.centre, axis=1)))
    first = _farthest(_distances(neighbours, start))
    from_first = _distances(neighbours, first)
    from_last = _distances(neighbours, _farthest(from_first))
    ends = [rib.mesh.vertices[distance < END_MM].mean(axis=0) for distance in (from_first, from_last)]
    if spine:
        depth = [min(float(closest(v.tree, end[None]).distances[0]) for v in spine) for end in ends]
    else:
        depth = [-float(end[1]) for end in ends]
    head = int(np.argmin(depth))
    return RibEnds(ends[head], ends[1 - head])


def _neighbours(mesh: Mesh) -> list[list[tuple[int, float]]]:
    """Return for each vertex those it has an edge to, with lengths; parts of a surface stay apart."""
    edges = surface.topology(mesh.vertices, mesh.faces).inner_edges
    lengths = np.linalg.norm(mesh.vertices[edges[:, 0]] - mesh.vertices[edges[:, 1]], axis=1)
    found: list[list[tuple[int, float]]] = [[] for _ in range(len(mesh.vertices))]
    for (a, b), length in zip(edges.tolist(), lengths.tolist(), strict=True):
        found[a].append((b, length))
        found[b].append((a, length))
    return found


def _distances(neighbours: list[list[tuple[int, float]]], start: int) -> Array:
    """Return the distance of every vertex from one, along edges (Dijkstra 1959); infinite in other parts."""
    distances = np.full(len(neighbours), np.inf)
    distances[start] = 0.0
    queue = [(0.0, start)]
    while queue:
        distance, vertex = heapq.heappop(queue)
        if distance > distances[vertex]:
            continue
        for other, length in neighbours[vertex]:
            if distance + length < distances[other]:
                distances[other] = distance + length
                heapq.heappush(queue, (distance + length, other))
    return distances


def _farthest(distances: Array) -> int:
    return int(np.argmax(np.where(np.isfinite(distances), distances, -1.0)))
