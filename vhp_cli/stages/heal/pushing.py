"""Clear zones of a surface that meets itself by moving vertices: smooth tangles, push sheets apart."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vhp_cli.kernels.spatial import KIND_CROSSING, Hits, Tree
from vhp_cli.kernels.untangling import opposite
from vhp_cli.rounding import rounded
from vhp_cli.stages.heal.zones import (
    Floats,
    Ints,
    Mask,
    all_hits,
    edges_of,
    grown,
    mean_edge_lengths,
    normals_at,
    winding_ahead,
    zones_hit,
)

_SMOOTHING_RINGS = (0, 1, 2, 3)
_SMOOTHING_STEPS = (1, 2, 4, 8, 16, 32)
_MOST_PUSHES = 60
# So many pushes without fewer faces that meet, and a zone is given up.
_PATIENCE = 12
# Share of the way to the other side of a wrong region that a vertex goes in one push; the other side comes to meet it.
_PUSH = 0.6


class Moved(NamedTuple):
    """What moving vertices came to.

    Parameters
    ----------
    vertices : (V, 3) float64
        Where they are now; float32 values if they were moved.
    distances : (zones,) float64
        Farthest way of a vertex of each zone in mm; ``inf`` where the zone was not cleared.
    """

    vertices: Floats
    distances: Floats


def _farthest(start: Floats, vertices: Floats, labels: Ints, count: int) -> Floats:
    ways = np.linalg.norm(vertices - start, axis=1)
    farthest = np.zeros(count + 1)
    np.maximum.at(farthest, labels, ways)
    return farthest[:count]


def _pairs_of_zones(labels: Ints, faces: Ints, pairs: Ints, count: int) -> NDArray[np.int64]:
    """Return the number of pairs of faces that meet in each zone (zones,)."""
    zone = labels[faces[pairs]].reshape(len(pairs), 6).max(axis=1)
    return np.bincount(zone[zone >= 0], minlength=count)


def smooth(vertices: Floats, faces: Ints, labels: Ints, count: int, core: Mask) -> Moved:
    """Move the vertices around each zone towards the mean of their neighbours, by the least amount that clears it.

    Suits tangles of a few triangles. Tries so many rings of neighbours and steps of smoothing for all zones at once.
    """
    edges = edges_of(faces)
    best, distances = vertices.copy(), np.full(count, np.inf)
    for rings in _SMOOTHING_RINGS:
        free = grown(core, edges, rings) & (labels >= 0)
        trial, done = vertices, 0
        for steps in _SMOOTHING_STEPS:
            trial = _averaged(trial, edges, free, steps - done)
            done = steps
            placed = np.where(free[:, None], rounded(trial), vertices)
            farthest = _farthest(vertices, placed, labels, count)
            farthest[zones_hit(labels, faces, all_hits(Tree(placed, faces)).pairs, count)] = np.inf
            better = farthest < distances
            if better.any():
                distances[better] = farthest[better]
                taken = (labels >= 0) & np.append(better, False)[labels]
                best[taken] = placed[taken]
    return Moved(best, distances)


def _averaged(vertices: Floats, edges: Ints, free: Mask, steps: int) -> Floats:
    inner = edges[free[edges].any(axis=1)]
    chosen = np.flatnonzero(free)
    degree = np.bincount(inner.ravel(), minlength=len(vertices))[chosen][:, None]
    found = vertices.copy()
    for _ in range(steps):
        total = np.zeros_like(found)
        for d in range(3):
            total[:, d] = np.bincount(inner[:, 0], found[inner[:, 1], d], minlength=len(found))
            total[:, d] += np.bincount(inner[:, 1], found[inner[:, 0], d], minlength=len(found))
        found[chosen] = total[chosen] / degree
    return found


def push(
    vertices: Floats,
    faces: Ints,
    labels: Ints,
    active: Mask,
    core: Mask,
    *,
    gap: float,
    reach: float,
    spread: int,
    by_winding: bool,
    smoothing: float,
) -> Moved:
    """Move vertices little by little until edges no longer pass through faces.

    Parameters
    ----------
    vertices, faces, labels
        The mesh, closed and consistently oriented, and the zone of each vertex.
    active : (zones,) bool
        The zones to clear; nothing else is moved.
    core : (V,) bool
        Vertices on the wrong side, or of faces that meet others.
    gap
        Least distance in mm between what is pushed apart.
    reach
        Farthest way that a vertex may go in mm.
    spread
        Rings of neighbours that are taken along, ever less.
    by_winding
        Whether the winding number in front of a vertex tells where it has to go: if it is 1, the vertex is within
        material that it overlaps, and has to go back; if it is -1, the two sides of a wall have passed through
        each other, and it has to go forward; the nearest opposite face tells how far. Else, and for edges with
        both ends on the right side, the shortest way out counts.
    smoothing
        Share of the way to the mean of its neighbours that each vertex of a face that meets others goes besides.
    """
    count = len(active)
    start = vertices
    near = _near(vertices, faces, labels, active, reach)
    far_tree, faces = Tree(vertices, faces[~near]), np.ascontiguousarray(faces[near])
    edges = edges_of(faces)
    fewest, since = np.full(count, np.iinfo(np.int64).max), np.zeros(count, np.int64)
    for _ in range(_MOST_PUSHES):
        tree = Tree(vertices, faces)
        hits = all_hits(tree)
        found = _pairs_of_zones(labels, faces, hits.pairs, count)
        since = np.where(found < fewest, 0, since + 1)
        fewest = np.minimum(found, fewest)
        still = active & (found > 0) & (since < _PATIENCE) & (_farthest(start, vertices, labels, count) <= reach)
        if not still.any():
            break
        free = np.append(still, False)[labels]
        touched = np.zeros(len(vertices), np.bool_)
        touched[faces[hits.pairs]] = True
        chosen = np.flatnonzero((core | touched) & free)
        normals = normals_at(vertices, faces)
        ahead = np.zeros(len(chosen), np.int32)
        if by_winding:
            lengths = mean_edge_lengths(vertices, edges)
            ahead = winding_ahead((tree, far_tree), vertices, normals, lengths, chosen)
        wrong = np.zeros(len(vertices), np.bool_)
        wrong[chosen] = ahead != 0
        move = _contact_ways(vertices, faces, hits, wrong, free, gap)
        move[chosen] += _opposite_ways(tree, faces, vertices, normals, chosen, ahead, gap, reach)
        if smoothing:
            caught = touched & free
            move[caught] += smoothing * (_averaged(vertices, edges, caught, 1) - vertices)[caught]
        if spread:
            move = _spread(move, edges, free, spread)
        stirred = free & move.any(axis=1)
        vertices = np.where(stirred[:, None], rounded(vertices + move), vertices)
    else:
        hits = all_hits(Tree(vertices, faces))
    distances = _farthest(start, vertices, labels, count)
    distances[zones_hit(labels, faces, hits.pairs, count) | (distances > reach) | ~active] = np.inf
    return Moved(vertices, distances)


def _near(vertices: Floats, faces: Ints, labels: Ints, active: Mask, reach: float) -> Mask:
    """Tell which faces something in an active zone can run into."""
    corners = vertices[faces]
    lower, upper = corners.min(axis=1), corners.max(axis=1)
    near = np.zeros(len(faces), np.bool_)
    for zone in np.flatnonzero(active):
        own = vertices[labels == zone]
        near |= ((lower <= own.max(axis=0) + 2 * reach) & (upper >= own.min(axis=0) - 2 * reach)).all(axis=1)
    return near


def _opposite_ways(
    tree: Tree,
    faces: Ints,
    vertices: Floats,
    normals: Floats,
    chosen: NDArray[np.intp],
    ahead: Ints,
    gap: float,
    reach: float,
) -> Floats:
    """Return how each chosen vertex has to move (N, 3)."""
    points, normal = vertices[chosen], normals[chosen]
    ways = np.zeros_like(points)

    def found(where: Mask, side: int, within: float) -> tuple[NDArray[np.intp], Floats, Floats]:
        """Return places in `chosen`, the way to the opposite face, and that face's unit normal."""
        places = np.flatnonzero(where)
        sides = np.full(len(places), side, np.int8)
        other = opposite(tree, faces, chosen[places], points[places], normal[places], sides, within)
        there = other.faces >= 0
        places, near = places[there], other.points[there]
        a, b, c = (vertices[faces[other.faces[there], k]] for k in range(3))
        across = np.cross(b - a, c - a)
        across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)
        return places, near - points[places], across

    # Behind a face whose material it overlaps: out of it. In front of the other side of its wall: back behind it.
    for side in (1, -1):
        places, way, across = found(ahead * side > 0, side, reach)
        ways[places] = _PUSH * (way + side * gap * across)
    # On the right side but too near.
    for side in (-1, 1):
        places, way, across = found(np.equal(ahead, 0), side, gap)
        ways[places] -= side * (gap - np.linalg.norm(way, axis=1, keepdims=True)) / 2 * across
    return ways


def _spread(move: Floats, edges: Ints, free: Mask, rings: int) -> Floats:
    """Let the neighbours follow, each ring by a smaller share."""
    fixed = np.logical_or.reduce(move != 0, axis=1)
    for ring in range(rings):
        share = 1 - (ring + 1) / (rings + 1)
        total, number = np.zeros_like(move), np.zeros(len(move))
        for a, b in ((0, 1), (1, 0)):
            leads = edges[fixed[edges[:, a]] & ~fixed[edges[:, b]] & free[edges[:, b]]]
            source, target = leads[:, a], leads[:, b]
            for d in range(3):
                total[:, d] += np.bincount(target, move[source, d], minlength=len(move))
            number += np.bincount(target, minlength=len(move))
        reached = number > 0
        move[reached] = share * total[reached] / number[reached][:, None]
        fixed |= reached
    return move


def _between(vertices: Floats, ends: NDArray[np.int64], share: Floats) -> Floats:
    return (1 - share) * vertices[ends[:, 0]] + share * vertices[ends[:, 1]]


def _contact_ways(vertices: Floats, faces: Ints, hits: Hits, wrong: Mask, free: Mask, gap: float) -> Floats:
    """Return how vertices have to move so that edges no longer pass through faces (V, 3).

    Of the ways to part an edge and a face - one end back through the face, or the whole edge out over a border of the
    face - the shortest is taken and shared out to the vertices of both. Edges with an end on the wrong side are left
    to what moves that end.
    """
    pairs = hits.pairs[hits.kinds == KIND_CROSSING]
    pairs = np.concatenate([pairs, pairs[:, ::-1]])
    ends = np.concatenate([faces[pairs[:, 0]][:, [k, (k + 1) % 3]] for k in range(3)])
    across = faces[np.tile(pairs[:, 1], 3)]
    keep = ~wrong[ends].any(axis=1) & (free[ends].any(axis=1) | free[across].any(axis=1))
    _, first = np.unique(np.column_stack([np.sort(ends, axis=1), across])[keep], axis=0, return_index=True)
    ends, across = np.sort(ends, axis=1)[keep][first], across[keep][first]
    segment, triangle = vertices[ends], vertices[across]
    share, place = _crossing(segment, triangle)
    inside = np.isfinite(share)
    ends, across, segment, triangle, place = (x[inside] for x in (ends, across, segment, triangle, place))
    if not len(ends):
        return np.zeros_like(vertices)

    normal = np.cross(triangle[:, 1] - triangle[:, 0], triangle[:, 2] - triangle[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    # Rows of weights: of the two ends of the edge and the three corners of the face.
    ways, weights, lengths = [], [], []
    for end in range(2):
        height = np.einsum("ij,ij->i", segment[:, end] - triangle[:, 0], normal)
        ways.append(-np.sign(height)[:, None] * normal)
        lengths.append(np.abs(height))
        row = np.zeros((len(ends), 5))
        row[:, end] = 1
        row[:, 2:] = -place
        weights.append(row)
    for k in range(3):
        s, t, way = _nearest_on_lines(segment, triangle[:, [k, (k + 1) % 3]])
        length = np.linalg.norm(way, axis=1)
        ways.append(way / np.maximum(length, 1e-300)[:, None])
        lengths.append(np.where(length > 0, length, np.inf))
        row = np.zeros((len(ends), 5))
        row[:, 0], row[:, 1] = 1 - s, s
        row[:, 2 + k], row[:, 2 + (k + 1) % 3] = t - 1, -t
        weights.append(row)
    best = np.argmin(lengths, axis=0)
    rows = np.arange(len(ends))
    way, weight, length = (np.array(values)[best, rows] for values in (ways, weights, lengths))
    step = (length + gap) / np.einsum("ij,ij->i", weight, weight)
    moves = (weight * step[:, None])[:, :, None] * way[:, None, :]

    corners = np.column_stack([ends, across]).ravel()
    total = np.stack([np.bincount(corners, moves[:, :, d].ravel(), len(vertices)) for d in range(3)], axis=1)
    number = np.bincount(corners, weight.ravel() != 0, len(vertices))
    return total / np.maximum(number, 1)[:, None]


def _nearest_on_lines(first: Floats, second: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the places (N,) where segments (N, 2, 3) are nearest to others, and the ways between (N, 3)."""
    u, v, offset = first[:, 1] - first[:, 0], second[:, 1] - second[:, 0], first[:, 0] - second[:, 0]
    uu, uv, vv = (np.einsum("ij,ij->i", a, b) for a, b in ((u, u), (u, v), (v, v)))
    uo, vo = np.einsum("ij,ij->i", u, offset), np.einsum("ij,ij->i", v, offset)
    determinant = uu * vv - uv * uv
    s = np.divide(uv * vo - vv * uo, determinant, out=np.full_like(uu, 0.5), where=determinant > 1e-12 * uu * vv)
    s = np.clip(s, 0, 1)
    t = np.clip(np.divide(uv * s + vo, vv, out=np.zeros_like(vv), where=vv > 0), 0, 1)
    s = np.clip(np.divide(uv * t - uo, uu, out=np.zeros_like(uu), where=uu > 0), 0, 1)
    return s, t, second[:, 0] + t[:, None] * v - first[:, 0] - s[:, None] * u


def _crossing(segments: Floats, triangles: Floats) -> tuple[Floats, Floats]:
    """Return where segments pass through triangles: the share of the segment, NaN if nowhere, and of the corners."""
    origin = triangles[:, 0]
    u, v, way = triangles[:, 1] - origin, triangles[:, 2] - origin, segments[:, 1] - segments[:, 0]
    # Moeller & Trumbore 1997, Fast, minimum storage ray/triangle intersection.
    # Segments in the plane of their triangle divide by zero, and pass through nothing.
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        p = np.cross(way, v)
        inverse = 1 / np.einsum("ij,ij->i", u, p)
        offset = segments[:, 0] - origin
        first = np.einsum("ij,ij->i", offset, p) * inverse
        q = np.cross(offset, u)
        second = np.einsum("ij,ij->i", way, q) * inverse
        share = np.einsum("ij,ij->i", v, q) * inverse
        meets = (first >= 0) & (second >= 0) & (first + second <= 1) & (share >= 0) & (share <= 1)
        place = np.stack([1 - first - second, first, second], axis=1)
    return np.where(meets, share, np.nan), place
