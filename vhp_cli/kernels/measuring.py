"""Distances to a surface: its nearest point to other points, and the first face that a ray meets."""

from __future__ import annotations

import ctypes
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vhp_cli.kernels._library import address, f64, function, i64, pointer
from vhp_cli.kernels.spatial import Tree, _TreeView

_LARGEST = 1e38  # mm; the same limit as for the vertices of a tree

_tree = ctypes.POINTER(_TreeView)
_closest = function("vhp_closest", None, [_tree, pointer, i64, f64, pointer, pointer, pointer])
_first_hits = function("vhp_first_hits", None, [_tree, pointer, pointer, pointer, i64, f64, pointer, pointer, pointer])


class Closest(NamedTuple):
    """Nearest points of a surface.

    Parameters
    ----------
    distances : (P,) float64
        In mm; ``inf`` where there is no face within the limit.
    points : (P, 3) float64
        The nearest points, in mm; NaN where there is none.
    faces : (P,) int32
        A face on which each of them lies, -1 where there is none.
    """

    distances: NDArray[np.float64]
    points: NDArray[np.float64]
    faces: NDArray[np.int32]


class FirstHits(NamedTuple):
    """First faces that rays meet.

    Parameters
    ----------
    distances : (P,) float64
        In mm; ``inf`` where the ray meets nothing.
    faces : (P,) int32
        The face that it meets, -1 for none.
    cosines : (P,) float64
        Cosine of the angle between the ray and the normal of that face: positive if the ray leaves through
        it, so that the face is the other side of the wall under the point; 0 for none.
    """

    distances: NDArray[np.float64]
    faces: NDArray[np.int32]
    cosines: NDArray[np.float64]


def closest(tree: Tree, points: ArrayLike, limit: float = np.inf) -> Closest:
    """Find the point of a surface nearest to each query point.

    Exact up to rounding, about 1e-16 times the size of the nearest triangle and of the distance. Degenerate
    faces count as the segments or points that they are. Where several faces are equally near, which one is
    named depends on the tree and the point alone. Queries in an order that follows the surface are the fastest.

    Parameters
    ----------
    tree
        The surface; it may be open, non-manifold or a heap of single triangles.
    points : (P, 3) array_like
        In mm.
    limit
        Largest distance of interest in mm; the smaller, the faster.

    Raises
    ------
    ValueError
        If a coordinate is not finite or exceeds 1e38, or the limit is not a number of at least 0.
    """
    points = _checked(points)
    if not limit >= 0:
        raise ValueError(f"the limit must be at least 0, not {limit}")
    distances, places, faces = np.empty(len(points)), np.empty((len(points), 3)), np.empty(len(points), np.int32)
    _closest(tree._view, address(points), len(points), limit, address(distances), address(places), address(faces))
    return Closest(distances, places, faces)


def thickness(tree: Tree, points: ArrayLike, directions: ArrayLike, faces_to_ignore: ArrayLike) -> FirstHits:
    """Find how far it is from points of a surface through the wall below them.

    The first face is sought that a ray meets, by the watertight test of Woop, Benthin & Wald 2013 (in double
    arithmetic): no ray slips through an edge between two faces. A face that lies at the point itself counts,
    at distance 0; faces of zero area do not.

    Parameters
    ----------
    tree
        The surface.
    points : (P, 3) array_like
        Starts of the rays in mm, such as the centres of faces.
    directions : (P, 3) array_like
        Where they go, such as against the normals; of any length. A ray without a direction meets nothing.
    faces_to_ignore : (P,) array_like of int
        The face on which each point lies; -1 for none.

    Raises
    ------
    ValueError
        If the shapes do not agree or a coordinate is not finite or exceeds 1e38.
    """
    points, directions = _checked(points), _checked(directions)
    ignored = np.ascontiguousarray(faces_to_ignore, dtype=np.int32)
    n = len(points)
    if len(directions) != n or ignored.shape != (n,):
        raise ValueError(f"{n} points need as many directions and faces, not {len(directions)} and {ignored.shape}")
    largest = np.abs(directions).max(axis=1, initial=0.0, keepdims=True)
    unit = np.divide(directions, largest, out=np.zeros_like(directions), where=largest > 0)
    unit /= np.maximum(np.linalg.norm(unit, axis=1, keepdims=True), 1.0)
    # A face through the start may seem to lie behind it by the rounding of the coordinates.
    size = max(np.abs(tree.lower).max(), np.abs(tree.upper).max()) if tree.n_faces else 0.0
    behind = 4 * float(np.finfo(np.float64).eps) * float(size)
    distances, cosines, faces = np.empty(n), np.empty(n), np.empty(n, np.int32)
    outputs = (address(distances), address(cosines), address(faces))
    _first_hits(tree._view, address(points), address(unit), address(ignored), n, behind, *outputs)
    return FirstHits(distances, faces, cosines)


def _checked(points: ArrayLike) -> NDArray[np.float64]:
    points = np.ascontiguousarray(points, dtype=np.float64)
    if points.size == 0:
        points = points.reshape(0, 3)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points must have shape (P, 3), not {points.shape}")
    if not (np.abs(points) <= _LARGEST).all():
        raise ValueError("a coordinate is not finite, or above 1e38 mm")
    return points
