"""How two triangles meet, in exact integer arithmetic: the slow reference of the spatial kernels.

Works on whole arrays of integers: int64 for coordinates of at most 8 (see `pair_kinds`), Python's own
integers (dtype object) for any. It shares no method with the kernels: where those compare the order
of four points on a line by determinants, this computes the points as fractions; where those look for
a separating edge, this looks for vertices inside and edges that meet.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np

APART, TOUCH, COPLANAR, CROSSING, FOLD, DUPLICATE = range(6)

# How far triangles are shrunk to see whether their interiors overlap: more than enough for
# doubles, as two overlapping triangles of integer coordinates up to k share a disc
# of radius 1 / (100 k^6) or more.
SHRINK = 10**200


def integers(*arrays):
    """Return float arrays as integers, all scaled by one power of two, dtype object."""
    fractions = [[Fraction(float(x)) for x in np.ravel(array)] for array in arrays]
    scale = max((f.denominator for row in fractions for f in row), default=1)
    return [
        np.array([int(f * scale) for f in row], dtype=object).reshape(np.shape(array))
        for row, array in zip(fractions, arrays, strict=True)
    ]


def sign(x):
    return (x > 0).astype(np.int8) - (x < 0).astype(np.int8)


def dot(a, b):
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]


def cross(a, b):
    parts = [a[..., i] * b[..., j] - a[..., j] * b[..., i] for i, j in ((1, 2), (2, 0), (0, 1))]
    return np.stack(parts, axis=-1)


def normal(triangles):
    return cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])


def degenerate(triangles):
    return (normal(triangles) == 0).all(axis=-1)


def _heights(triangles, others):
    """Heights (n, 3) of the corners of others over the planes of triangles, times the normals' length."""
    n = normal(triangles)
    return np.stack([dot(n, others[:, k] - triangles[:, 0]) for k in range(3)], axis=1)


def _interval(triangles, heights, direction):
    """Ends of the segment in which each triangle meets a plane, as fractions along `direction`.

    Returns (exists, low, low_divisor, high, high_divisor).
    """
    place = np.stack([dot(triangles[:, k], direction) for k in range(3)], axis=1)
    one = np.ones_like(place[:, 0])
    candidates = [(heights[:, k] == 0, place[:, k], one) for k in range(3)]
    for k in range(3):
        u, w = k, (k + 1) % 3
        divisor = heights[:, w] - heights[:, u]
        turn = np.where(divisor < 0, -one, one)
        numerator = heights[:, w] * place[:, u] - heights[:, u] * place[:, w]
        candidates.append((heights[:, u] * heights[:, w] < 0, turn * numerator, turn * divisor))
    exists = np.zeros(len(place), bool)
    low, low_divisor, high, high_divisor = one.copy(), one.copy(), one.copy(), one.copy()
    for valid, numerator, divisor in candidates:
        below = valid & (~exists | (numerator * low_divisor < low * divisor))
        above = valid & (~exists | (numerator * high_divisor > high * divisor))
        low, low_divisor = np.where(below, numerator, low), np.where(below, divisor, low_divisor)
        high, high_divisor = np.where(above, numerator, high), np.where(above, divisor, high_divisor)
        exists |= valid
    return exists, low, low_divisor, high, high_divisor


def _transversal(a, b, heights_a, heights_b, shared):
    """Kinds for triangles in different planes (garbage for others)."""
    direction = cross(normal(a), normal(b))
    exists_a, low_a, low_a_divisor, high_a, high_a_divisor = _interval(a, heights_a, direction)
    exists_b, low_b, low_b_divisor, high_b, high_b_divisor = _interval(b, heights_b, direction)
    first = sign(high_b * low_a_divisor - low_a * high_b_divisor)  # end of b after begin of a
    second = sign(high_a * low_b_divisor - low_b * high_a_divisor)
    meet = exists_a & exists_b & (first >= 0) & (second >= 0)
    # A segment in common, not only a point; each interval must have a length of its own too.
    length_a = sign(high_a * low_a_divisor - low_a * high_a_divisor) > 0
    length_b = sign(high_b * low_b_divisor - low_b * high_b_divisor) > 0
    segment = meet & (first > 0) & (second > 0) & length_a & length_b

    def straddle(heights):
        return (heights > 0).any(axis=1) & (heights < 0).any(axis=1)

    crossing = segment & straddle(heights_a) & straddle(heights_b)
    # Triangles with a common vertex always meet there, those with a common edge along all of it.
    contact = np.where(shared == 0, meet, (shared == 1) & segment)
    return np.where(crossing, CROSSING, np.where(contact, TOUCH, APART))


def _area2(a, b, c):
    return (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])


def _point_in_triangle(point, triangles):
    signs = np.stack([sign(_area2(triangles[:, k], triangles[:, (k + 1) % 3], point)) for k in range(3)], axis=1)
    return ~((signs > 0).any(axis=1) & (signs < 0).any(axis=1))


def _segments_meet(p, q, r, s):
    def within(a, b, x):
        return ((np.minimum(a, b) <= x) & (x <= np.maximum(a, b))).all(axis=1)

    side_r, side_s, side_p, side_q = (sign(_area2(*points)) for points in ((p, q, r), (p, q, s), (r, s, p), (r, s, q)))
    return (
        ((side_r * side_s < 0) & (side_p * side_q < 0))
        | ((side_r == 0) & within(p, q, r))
        | ((side_s == 0) & within(p, q, s))
        | ((side_p == 0) & within(r, s, p))
        | ((side_q == 0) & within(r, s, q))
    )


def _segment_meets_triangle(p, q, triangles):
    found = _point_in_triangle(p, triangles) | _point_in_triangle(q, triangles)
    for k in range(3):
        found |= _segments_meet(p, q, triangles[:, k], triangles[:, (k + 1) % 3])
    return found


def _triangles_meet_2d(a, b):
    found = _point_in_triangle(b[:, 0], a)
    for k in range(3):
        found |= _segment_meets_triangle(a[:, k], a[:, (k + 1) % 3], b)
    return found


def _shrunk(triangles):
    """Shrink integer triangles towards their centroids by a factor 1 - 1 / SHRINK, scaled by 3 SHRINK."""
    triangles = triangles.astype(object)
    return triangles * (3 * (SHRINK - 1)) + triangles.sum(axis=1, keepdims=True)


def _coplanar(a, b, shared):
    """Kinds for triangles in one plane; shared corners are numbered alike in both and come first."""
    n = normal(a)
    axis = np.argmax(n != 0, axis=1)
    keep = np.array([[1, 2], [0, 2], [0, 1]])[axis]
    rows = np.arange(len(a))[:, None, None]
    a, b = (t[rows, np.arange(3)[None, :, None], keep[:, None, :]].astype(object) for t in (a, b))
    overlap = _triangles_meet_2d(_shrunk(a), _shrunk(b))
    contact = np.where(shared == 0, _triangles_meet_2d(a, b), False)
    one = shared == 1
    contact[one] = _segment_meets_triangle(a[one, 1], a[one, 2], b[one]) | _segment_meets_triangle(
        b[one, 1], b[one, 2], a[one]
    )
    full = np.where(shared == 2, FOLD, COPLANAR)
    return np.where(overlap, full, np.where(contact, TOUCH, APART))


def pair_kinds(a, b, shared=None):
    """How triangles a[i] and b[i] meet apart from what they share.

    Parameters
    ----------
    a, b : (n, 3, 3) integers
        Corners; int64 is exact up to |x| <= 8, as the largest product has degree 11: the differences
        are at most 16, and 4000 * 16^11 = 7e16.
    shared : (n,) int, optional
        Number of corners (the first ones, in the same order) that both have in common by number; 0 if
        not given.
    """
    if a.dtype != object:
        assert max(np.abs(a).max(initial=0), np.abs(b).max(initial=0)) <= 8
    shared = np.zeros(len(a), int) if shared is None else np.asarray(shared)
    # Differences from one corner: smaller numbers, the same answer.
    a, b = a - a[:, :1], b - a[:, :1]
    heights_b, heights_a = _heights(a, b), _heights(b, a)
    kinds = _transversal(a, b, heights_a, heights_b, shared)
    flat = (heights_b == 0).all(axis=1)
    kinds[flat] = _coplanar(a[flat], b[flat], shared[flat])
    kinds[shared == 3] = DUPLICATE
    kinds[degenerate(a) | degenerate(b)] = APART
    return kinds


def _box_pairs(a, b):
    """Indices of triangles a and b (integers) whose boxes overlap."""
    low_a, high_a, low_b, high_b = a.min(axis=1), a.max(axis=1), b.min(axis=1), b.max(axis=1)
    near = np.ones((len(a), len(b)), bool)
    for d in range(3):
        near &= (low_a[:, None, d] <= high_b[None, :, d]) & (low_b[None, :, d] <= high_a[:, None, d])
    return np.nonzero(near)


def mesh_pairs(mesh_a, mesh_b):
    """Return {(face of a, face of b): kind} of two meshes (vertices, faces) with float vertices."""
    vertices_a, vertices_b = integers(mesh_a[0], mesh_b[0])
    a, b = vertices_a[mesh_a[1]], vertices_b[mesh_b[1]]
    i, j = _box_pairs(a, b)
    kinds = pair_kinds(a[i], b[j])
    return {(int(i[k]), int(j[k])): int(kinds[k]) for k in np.nonzero(kinds)[0]}


def _box_pairs_of_one(triangles):
    """Indices (i < j) of float triangles whose boxes overlap, by a sweep along x."""
    low, high = triangles.min(axis=1), triangles.max(axis=1)
    order = np.argsort(low[:, 0], kind="stable")
    begins = low[order, 0]
    pairs = [np.empty((0, 2), int)]
    for place, i in enumerate(order):
        later = order[place + 1 : np.searchsorted(begins, high[i, 0], "right")]
        later = later[((low[later] <= high[i]) & (high[later] >= low[i])).all(axis=1)]
        pairs.append(np.stack([np.minimum(later, i), np.maximum(later, i)], axis=1))
    return np.concatenate(pairs).T


def _shared_first(faces, others):
    """Faces with the corners that both have in common moved to the front, in one order, and their number."""
    same = faces[:, :, None] == others[:, None, :]
    faces = np.take_along_axis(faces, np.argsort(~same.any(axis=2), axis=1, kind="stable"), axis=1)
    place = np.argmax(others[:, :, None] == faces[:, None, :], axis=2)
    rank = np.where(same.any(axis=1), place, 3)
    return (
        faces,
        np.take_along_axis(others, np.argsort(rank, axis=1, kind="stable"), axis=1),
        same.any(axis=2).sum(axis=1),
    )


def self_pairs(vertices, faces):
    """Return {(face, higher face): kind} of one mesh with float vertices."""
    faces = np.asarray(faces)
    (exact,) = integers(vertices)
    repeated = (faces == np.roll(faces, 1, axis=1)).any(axis=1)
    i, j = _box_pairs_of_one(np.asarray(vertices)[faces])
    keep = ~repeated[i] & ~repeated[j]
    i, j = i[keep], j[keep]
    found = {}
    for start in range(0, len(i), 50_000):  # objects take much memory
        some = slice(start, start + 50_000)
        first, second, shared = _shared_first(faces[i[some]], faces[j[some]])
        kinds = pair_kinds(exact[first], exact[second], shared)
        found |= {(int(i[start + k]), int(j[start + k])): int(kinds[k]) for k in np.nonzero(kinds)[0]}
    return found
