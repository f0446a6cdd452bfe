"""Join rings of points by triangles, and improve the triangles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Faces = NDArray[np.int32]

FLIP_BELOW = 0.45  # q below which a triangle is worth a flip
FLIP_ROUNDS = 8
FLAT = 0.9  # cosine between the normals of two triangles whose common edge may be flipped


def sew(counts: NDArray[np.int64], stagger: Array) -> Faces:
    """Triangulate between neighbouring rings.

    Each edge of a ring becomes the base of a triangle with its tip on the other ring; walking around
    both rings at once, the edge whose middle comes first is taken first.

    Parameters
    ----------
    counts : (R,) int64
        Points per ring; the first and last ring are poles with one point.
    stagger : (R,) float64
        Offset of the first point of each ring, in steps of that ring.
    """
    start = np.concatenate([[0], np.cumsum(counts)])
    edges = np.where(counts > 1, counts, 0)
    # One event for every ring edge, once in the strip above its ring and once in the strip below.
    ring = np.repeat(np.arange(len(counts)), edges)
    index = np.arange(len(ring)) - np.repeat(np.concatenate([[0], np.cumsum(edges)])[:-1], edges)
    middle = (index + 0.5 + stagger[ring]) / counts[ring]
    strip = np.concatenate([ring, ring - 1])
    upper = np.concatenate([np.zeros(len(ring), bool), np.ones(len(ring), bool)])
    index, middle = np.tile(index, 2), np.tile(middle, 2)
    order = np.lexsort((upper, middle, strip))
    strip, upper, index = strip[order], upper[order], index[order]
    # How far the walk has come on the other ring when an event takes place.
    first = np.searchsorted(strip, strip)
    passed_upper = np.cumsum(upper) - upper
    passed_upper -= passed_upper[first]
    passed_lower = np.arange(len(strip)) - first - passed_upper
    low, high = strip, strip + 1
    a = start[np.where(upper, high, low)] + index
    b = start[np.where(upper, high, low)] + (index + 1) % counts[np.where(upper, high, low)]
    tip = np.where(upper, start[low] + passed_lower % counts[low], start[high] + passed_upper % counts[high])
    faces = np.stack([np.where(upper, b, a), np.where(upper, a, b), tip], axis=1)
    return np.ascontiguousarray(faces, dtype=np.int32)


def neighbour_mean(vertices: Array, faces: Faces) -> Array:
    """Mean of the neighbours of each vertex of a closed surface."""
    first, second = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    number = np.bincount(first, minlength=len(vertices))
    sums = [np.bincount(first, vertices[second, k], len(vertices)) for k in range(3)]
    return np.stack(sums, axis=1) / number[:, None]


def triangle_quality(corners: Array) -> Array:
    """Quality q = 2 r_in / r_out (thesis eq. 2.4) of triangles (F, 3, 3)."""
    sides = np.roll(corners, -1, axis=1) - corners
    a, b, c = np.linalg.norm(sides, axis=2).T
    double_area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    quality: Array = 4 * double_area**2 / ((a + b + c) * a * b * c)
    return quality


def flip_edges(vertices: Array, faces: Faces) -> Faces:
    """Flip the longest edge of badly shaped triangles where the worse of the two triangles gains by it.

    Only edges between nearly coplanar triangles are flipped, and never so that two vertices are joined twice.
    """
    faces = faces.copy()
    n = np.int64(len(vertices))
    for _ in range(FLIP_ROUNDS):
        quality = triangle_quality(vertices[faces])
        bad = np.flatnonzero(quality < FLIP_BELOW)
        if not len(bad):
            break
        directed = (faces.astype(np.int64) * n + np.roll(faces, -1, axis=1)).ravel()
        order = np.argsort(directed)
        ordered = directed[order]
        touched: set[int] = set()
        joined: set[int] = set()
        for face in bad[np.argsort(quality[bad], kind="stable")].tolist():
            sides = np.linalg.norm(vertices[np.roll(faces[face], -1)] - vertices[faces[face]], axis=1)
            a, b, c = (int(v) for v in np.roll(faces[face], -int(np.argmax(sides))))
            other, corner = divmod(int(order[np.searchsorted(ordered, b * n + a)]), 3)
            if touched & {face, other}:
                continue
            d = int(faces[other, (corner + 2) % 3])
            link = min(c, d) * int(n) + max(c, d)
            if link in joined or ordered[min(int(np.searchsorted(ordered, link)), len(ordered) - 1)] == link:
                continue
            # Both have the same outline; only the diagonal changes.
            before, after = np.array([[a, b, c], [b, a, d]]), np.array([[c, a, d], [d, b, c]])
            pair = vertices[np.concatenate([before, after])]
            normals = np.cross(pair[:, 1] - pair[:, 0], pair[:, 2] - pair[:, 0])
            normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]
            q = triangle_quality(pair)
            if q[2:].min() <= q[:2].min() or (normals @ normals.T).min() < FLAT:
                continue
            faces[[face, other]] = after
            touched |= {face, other}
            joined.add(link)
        if not touched:
            break
    return faces
