"""Inner loops of topological repair: gluing of half-edges, orientation, fans, and triangulation of holes.

Half-edge 3 f + k of a mesh runs from corner k of face f to its next corner. In the arrays of this module it is
element [f, k].
"""

from __future__ import annotations

from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from vhp_cli.kernels._library import address, check_allocation, function, i32, i64, pointer

Int = NDArray[np.int32]
Float = NDArray[np.float64]
Index = NDArray[np.int64]

BOUNDARY = -1  # a half-edge without a second one at its edge
CROWDED = -2  # one of more than two at its edge

_orient_patches = function("vhp_orient_patches", i32, [pointer, i64, *[pointer] * 4])
_split_fans = function("vhp_split_fans", i64, [pointer, i64, pointer, i64, pointer, pointer])
_radial_order = function("vhp_radial_order", i32, [pointer, pointer, i64, *[pointer] * 4])
_fill_loop = function("vhp_fill_loop", i64, [pointer, i64, pointer, pointer, i64, i32, pointer])
_fill_band = function("vhp_fill_band", i32, [pointer, i64, pointer, i64, pointer, i64, i32, pointer])

FillMethod = Literal["angle", "area", "plane"]
_FILL_METHODS: dict[FillMethod, int] = {"angle": 0, "area": 1, "plane": 2}
BandMethod = Literal["length", "area"]
_BAND_METHODS: dict[BandMethod, int] = {"length": 0, "area": 1}


def edge_keys(faces: Int, n_vertices: int) -> Index:
    """Return a number for the undirected edge of each half-edge: lower vertex times `n_vertices` + upper vertex.

    Parameters
    ----------
    faces : (F, 3) int32
        Vertex indices.
    n_vertices
        Number of vertices.

    Returns
    -------
    (F, 3) int64
    """
    start = faces.astype(np.int64)
    end = np.roll(start, -1, axis=1)
    return np.minimum(start, end) * n_vertices + np.maximum(start, end)


def mates(faces: Int, n_vertices: int) -> tuple[Int, list[Index]]:
    """Pair the half-edges of each edge that has two.

    Parameters
    ----------
    faces : (F, 3) int32
        Vertex indices; no face may use a vertex twice.
    n_vertices
        Number of vertices.

    Returns
    -------
    mates : (F, 3) int32
        For each half-edge the other one at its edge; `BOUNDARY` if there is none, `CROWDED` if there are several.
    crowds : list of (k,) int64
        The half-edges of each edge that has more than two, in ascending order.
    """
    keys = edge_keys(faces, n_vertices).ravel()
    order = np.argsort(keys, kind="stable")
    first = np.flatnonzero(np.diff(keys[order], prepend=-1))
    count = np.diff(first, append=len(keys))
    found = np.full(len(keys), BOUNDARY, np.int32)
    pairs = first[count == 2]
    found[order[pairs]] = order[pairs + 1]
    found[order[pairs + 1]] = order[pairs]
    crowds = [order[begin : begin + size] for begin, size in zip(first[count > 2], count[count > 2], strict=True)]
    for crowd in crowds:
        found[crowd] = CROWDED
    return found.reshape(-1, 3), crowds


def orient_patches(faces: Int, glued: Int) -> tuple[NDArray[np.bool_], Int, NDArray[np.bool_]]:
    """Tell which faces have to be reversed so that each patch of glued faces is oriented coherently.

    Parameters
    ----------
    faces : (F, 3) int32
        Vertex indices.
    glued : (F, 3) int32
        As of `mates`: the half-edge that each one is glued to, or a negative number.

    Returns
    -------
    turned : (F,) bool
        True for the faces to be reversed, seen from the first face of the patch.
    patch : (F,) int32
        Patch of each face, numbered by their first faces.
    twisted : (P,) bool
        True for each patch that can't be oriented.

    Raises
    ------
    KernelError
        If memory runs out.
    """
    faces, glued = _checked(faces, glued)
    n = len(faces)
    turned, twisted, patch = np.zeros(n, np.uint8), np.zeros(n, np.uint8), np.empty(n, np.int32)
    n_patches = _orient_patches(address(faces), n, address(glued), address(turned), address(patch), address(twisted))
    check_allocation(n_patches)
    return turned.astype(np.bool_), patch, twisted[:n_patches].astype(np.bool_)


def split_fans(faces: Int, glued: Int, n_vertices: int) -> tuple[Int, Int]:
    """Give each fan of glued faces its own vertex.

    Parameters
    ----------
    faces : (F, 3) int32
        Vertex indices.
    glued : (F, 3) int32
        As of `mates`.
    n_vertices
        Number of vertices.

    Returns
    -------
    faces : (F, 3) int32
        With the new vertex indices; the first fan of each vertex keeps its index.
    origin : (k,) int32
        The vertex that each new one, `n_vertices`, `n_vertices` + 1, ..., was before.

    Raises
    ------
    KernelError
        If memory runs out.
    """
    faces, glued = _checked(faces, glued)
    if len(faces) and faces.max() >= n_vertices:
        raise ValueError(f"faces refer to vertices outside 0..{n_vertices - 1}")
    split, origin = np.empty_like(faces), np.empty(faces.size, np.int32)
    n_new = _split_fans(address(faces), len(faces), address(glued), n_vertices, address(split), address(origin))
    check_allocation(n_new)
    return split, origin[:n_new].copy()


def _checked(faces: Int, glued: Int) -> tuple[Int, Int]:
    faces = np.ascontiguousarray(faces, dtype=np.int32)
    glued = np.ascontiguousarray(glued, dtype=np.int32)
    if faces.ndim != 2 or faces.shape[1] != 3 or glued.shape != faces.shape:
        raise ValueError(f"faces and mates must have the same shape (F, 3), not {faces.shape}, {glued.shape}")
    if len(faces) and (glued.max() >= faces.size or faces.min() < 0):
        raise ValueError("mates refer to half-edges that do not exist, or a vertex index is negative")
    return faces, glued


def radial_order(vertices: Float, axes: Int, points: list[Int]) -> list[tuple[Int, Int]]:
    """Order points around axes, counter-clockwise as seen against the direction of the axis. Exact.

    Parameters
    ----------
    vertices : (V, 3) float64
        Coordinates in mm.
    axes : (m, 2) int32
        The two vertices of each axis, in its direction.
    points : list of m (k,) int32
        The vertices around each axis.

    Returns
    -------
    list of m (order, angle)
        ``order``: places in `points`, sorted, from the first point that is not on the axis; those on the axis come
        last. ``angle``: 0, 1, 2, ... in this order, the same for points at the same angle; -1 for those on the axis.

    Raises
    ------
    ValueError
        If an index is wrong.
    KernelError
        If memory runs out.
    """
    vertices = np.ascontiguousarray(vertices, dtype=np.float64)
    axes = np.ascontiguousarray(axes, dtype=np.int32).reshape(-1, 2)
    starts = np.concatenate(([0], np.cumsum([len(own) for own in points]))).astype(np.int64)
    around = np.concatenate([*points, np.empty(0, np.int32)]).astype(np.int32)
    if len(points) != len(axes):
        raise ValueError(f"{len(points)} groups of points for {len(axes)} axes")
    for indices in (axes, around):
        if indices.size and (indices.min() < 0 or indices.max() >= len(vertices)):
            raise ValueError(f"there are no vertices outside 0..{len(vertices) - 1}")
    order, angle = np.empty_like(around), np.empty_like(around)
    check_allocation(
        _radial_order(
            address(vertices),
            address(axes),
            len(axes),
            address(starts),
            address(around),
            address(order),
            address(angle),
        )
    )
    return [(order[begin:end], angle[begin:end]) for begin, end in pairwise(starts)]


def fill_loop(points: Float, rims: Float, banned: Int, method: FillMethod) -> Int | None:
    """Triangulate the polygon of a hole without new vertices.

    Parameters
    ----------
    points : (n, 3) float64
        Corners in mm, in the direction in which the faces of the cap run along them.
    rims : (n, 3) float64
        Normal of the face beyond the edge from corner i to i + 1, of any length; NaN where there is none.
    banned : (k, 2) int32
        Pairs of corners that must not be joined, as the surface joins them already.
    method
        ``angle``: smallest largest angle to neighbouring faces, then least area (Liepa 2003, Filling holes in meshes);
        ``area``: least area; ``plane``: constrained Delaunay triangulation of the projection along the area vector.
        The first two cut off the best ears of loops with more than 220 corners first.

    Returns
    -------
    (n - 2, 3) int32 or None
        Corners of each face; None if the method finds no triangulation.

    Raises
    ------
    ValueError
        If a shape or an index is wrong, or a coordinate is not finite.
    KernelError
        If memory runs out.
    """
    points = np.ascontiguousarray(points, dtype=np.float64)
    rims = np.ascontiguousarray(rims, dtype=np.float64)
    n = len(points)
    if n < 3 or points.shape != (n, 3) or rims.shape != (n, 3) or not np.isfinite(points).all():
        raise ValueError(f"expected at least three finite points and their rims, not {points.shape}, {rims.shape}")
    pairs = np.sort(np.asarray(banned, np.int64).reshape(-1, 2), axis=1)
    if pairs.size and (pairs.min() < 0 or pairs.max() >= n):
        raise ValueError(f"banned pairs refer to corners outside 0..{n - 1}")
    keys = np.unique(pairs[:, 0] * n + pairs[:, 1])
    faces = np.empty((n - 2, 3), np.int32)
    written = _fill_loop(
        address(points), n, address(rims), address(keys), len(keys), _FILL_METHODS[method], address(faces)
    )
    check_allocation(written)
    return faces if written == n - 2 else None


def fill_band(outer: Float, inner: Float, starts: Int, method: BandMethod) -> Int:
    """Triangulate the band between two loops that run the same way round.

    Parameters
    ----------
    outer, inner : (n, 3), (m, 3) float64
        Their corners in mm.
    starts : (k,) int32
        Corners of the inner loop, one of which is joined to the first corner of the outer loop: the best one.
    method
        ``length``: least sum of the squared lengths of the edges across; ``area``: least area (Fuchs, Kedem and
        Uselton 1977, Optimal surface reconstruction from planar contours).

    Returns
    -------
    (n + m, 3) int32
        Corners of each face, those of the inner loop counted from n. The faces run along the outer loop, and against
        the inner one.

    Raises
    ------
    ValueError
        If a shape or an index is wrong.
    KernelError
        If memory runs out.
    """
    outer = np.ascontiguousarray(outer, dtype=np.float64)
    inner = np.ascontiguousarray(inner, dtype=np.float64)
    starts = np.ascontiguousarray(starts, dtype=np.int32)
    n, m = len(outer), len(inner)
    if n < 3 or m < 3 or outer.shape != (n, 3) or inner.shape != (m, 3):
        raise ValueError(f"expected two loops of three points or more, not {outer.shape}, {inner.shape}")
    if not len(starts) or starts.min() < 0 or starts.max() >= m:
        raise ValueError(f"expected at least one start in 0..{m - 1}")
    faces = np.empty((n + m, 3), np.int32)
    check_allocation(
        _fill_band(
            address(outer), n, address(inner), m, address(starts), len(starts), _BAND_METHODS[method], address(faces)
        )
    )
    return faces
