"""Find what lies opposite to the vertices of a surface, by the kernel in untangle.c."""

from __future__ import annotations

import ctypes
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vhp_cli.kernels._library import address, f64, function, i64, pointer
from vhp_cli.kernels.spatial import Tree, _TreeView

_tree = ctypes.POINTER(_TreeView)
_opposite = function(
    "vhp_opposite", None, [_tree, pointer, pointer, pointer, pointer, pointer, i64, f64, pointer, pointer]
)


class Opposite(NamedTuple):
    """Faces that lie opposite to vertices.

    Parameters
    ----------
    faces : (N,) int32
        The nearest one, -1 where there is none within reach.
    points : (N, 3) float64
        The point of it that is nearest to the vertex; undefined where there is none.
    """

    faces: NDArray[np.int32]
    points: NDArray[np.float64]


def opposite(
    tree: Tree,
    faces: NDArray[np.int32],
    vertices: ArrayLike,
    points: ArrayLike,
    normals: ArrayLike,
    sides: ArrayLike,
    reach: float,
) -> Opposite:
    """Find the nearest face that looks against a vertex, which lies behind or in front of it.

    A face looks against a vertex if their normals form an obtuse angle. Faces at the vertex do not count.

    Parameters
    ----------
    tree, faces
        The surface; `faces` (F, 3) is what the tree was made of.
    vertices : (N,) int32
        Their numbers.
    points, normals : (N, 3) float64
        Where the vertices are, in mm, and their normals.
    sides : (N,) int8
        1: the vertex is to be behind the face; -1: in front of it.
    reach
        Largest distance in mm.
    """
    faces = np.ascontiguousarray(faces, dtype=np.int32)
    numbers = np.ascontiguousarray(vertices, dtype=np.int32)
    points = np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 3)
    normals = np.ascontiguousarray(normals, dtype=np.float64).reshape(-1, 3)
    sides = np.ascontiguousarray(sides, dtype=np.int8)
    n = len(numbers)
    if faces.shape != (tree.n_faces, 3) or points.shape != (n, 3) or normals.shape != (n, 3) or sides.shape != (n,):
        raise ValueError("the shapes of the arrays do not agree")
    found, places = np.empty(n, np.int32), np.zeros((n, 3))
    inputs = [address(array) for array in (faces, numbers, points, normals, sides)]
    _opposite(tree._view, *inputs, n, reach, address(found), address(places))
    return Opposite(found, places)
