"""How tetrahedra are joined: shared faces, hull, connected parts, and the boundary surface of each label."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vhp_cli.inspection.tetrahedra import FACES
from vhp_cli.kernels.tetrahedra import equal_faces
from vhp_cli.volume import Labels, Tetrahedra

Ints = NDArray[np.int32]
Indices = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Adjacency:
    """The faces of a tetrahedral mesh.

    Parameters
    ----------
    pairs : (K, 2) int32
        The two tetrahedra at each inner face.
    inner : (K, 3) int32
        Corners of these faces, counter-clockwise seen from outside of the first tetrahedron.
    owners : (H,) int32
        The tetrahedron at each face of the hull, which belongs to one only.
    hull : (H, 3) int32
        Corners of these faces, counter-clockwise seen from outside.
    overfull
        Number of faces that belong to three or more tetrahedra.
    folded : (F,) int32
        Inner faces, by their rows in `inner`, whose two tetrahedra lie on the same side.
    """

    pairs: Ints
    inner: Ints
    owners: Ints
    hull: Ints
    overfull: int
    folded: Ints


def adjacency(tetrahedra: Tetrahedra) -> Adjacency:
    """Find the faces that tetrahedra share.

    Parameters
    ----------
    tetrahedra : (M, 4) int32
        Point indices, positively oriented.
    """
    faces = tetrahedra[:, FACES].reshape(-1, 3)
    order, same = equal_faces(tetrahedra)
    # Position of each face's group of equal faces, and the size of the group.
    starts = np.flatnonzero(~same)
    sizes = np.diff(np.append(starts, len(faces)))
    single, double = starts[sizes == 1], starts[sizes == 2]
    first, second = order[double], order[double + 1]
    hull = np.sort(order[single])
    # Two tetrahedra on either side see the corners of their common face in opposite order.
    folded = _turn(faces[first]) == _turn(faces[second])
    return Adjacency(
        np.column_stack((first // 4, second // 4)).astype(np.int32),
        faces[first],
        (hull // 4).astype(np.int32),
        faces[hull],
        int((sizes > 2).sum()),
        np.flatnonzero(folded).astype(np.int32),
    )


def _turn(faces: Ints) -> NDArray[np.bool_]:
    """Tell which triples (n, 3) are even permutations of their sorted order."""
    a, b, c = faces.T
    even: NDArray[np.bool_] = ((a < b).astype(np.int8) + (b < c) + (c < a)) == 2
    return even


def connected_parts(count: int, pairs: NDArray[np.integer]) -> Ints:
    """Return the connected parts of a graph, numbered in the order of their first members.

    Parameters
    ----------
    count
        Number of nodes.
    pairs : (K, 2) int
        Nodes that are joined.

    Returns
    -------
    (count,) int32
        Part of each node.
    """
    root = np.arange(count, dtype=np.int32)
    a, b = (np.asarray(column, dtype=np.int32) for column in pairs.T)
    while True:
        low, high = np.minimum(root[a], root[b]), np.maximum(root[a], root[b])
        apart = low != high
        if not apart.any():
            break
        a, b = a[apart], b[apart]
        np.minimum.at(root, high[apart], low[apart])
        while True:
            further = root[root]
            if np.array_equal(further, root):
                break
            root = further
    return np.unique(root, return_inverse=True)[1].astype(np.int32)


@dataclass(frozen=True, slots=True, eq=False)
class Interfaces:
    """The faces between labels, and those of the hull.

    Parameters
    ----------
    triangles : (F, 3) int32
        Corners, counter-clockwise seen from the second side.
    sides : (F, 2) int32
        Labels of the tetrahedra on both sides; `OUTSIDE` on the second side of a face of the hull.
    owners : (F,) int32
        The tetrahedron on the first side.
    """

    triangles: Ints
    sides: Ints
    owners: Ints

    def boundary(self, *labels: int) -> Ints:
        """Return the triangles (F, 3) that bound some labels together, counter-clockwise seen from outside of them."""
        first, second = (np.isin(self.sides[:, side], labels) for side in (0, 1))
        return np.concatenate((self.triangles[first & ~second], self.triangles[second & ~first][:, ::-1]))


OUTSIDE = -1


def interfaces(found: Adjacency, labels: Labels) -> Interfaces:
    """Return the faces between tetrahedra of different labels, and those of the hull."""
    sides = labels[found.pairs]
    between = np.flatnonzero(sides[:, 0] != sides[:, 1])
    outer = np.column_stack((labels[found.owners], np.full(len(found.owners), OUTSIDE)))
    return Interfaces(
        np.concatenate((found.inner[between], found.hull)),
        np.concatenate((sides[between], outer)).astype(np.int32),
        np.concatenate((found.pairs[between, 0], found.owners)),
    )


def tetrahedra_at(tetrahedra: Tetrahedra, count: int) -> tuple[Indices, Ints]:
    """Return the tetrahedra at each of so many points: those of point p are ``holders[starts[p] : starts[p + 1]]``."""
    corners = tetrahedra.ravel()
    order = np.argsort(corners, kind="stable")
    starts = np.concatenate(([0], np.cumsum(np.bincount(corners, minlength=count))))
    return starts, (order // 4).astype(np.int32)
