"""Fewer triangles for viewing, by clustering of vertices: fast, and for any surface, however broken.

It serves the eye alone. Whatever is measured, is measured on the surface itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vhp_cli.mesh import Mesh

Float = NDArray[np.float64]
Int = NDArray[np.int32]

_ROUNDS = 4  # of the search for the size of the cells
_LEAST = 2000  # triangles of a tissue that the larger ones leave to it
_CELLS = 2**19  # along an axis


@dataclass(frozen=True, slots=True, eq=False)
class Thinned:
    """A surface for viewing.

    Parameters
    ----------
    vertices : (V, 3) float64
        In mm.
    faces : (F, 3) int32
    q : (F,) float64
        Quality of each face: its own, or the worst of the original faces that went into its corners.
    is_whole
        Whether it is the surface itself.
    """

    vertices: Float
    faces: Int
    q: Float
    is_whole: bool


def shares(counts: Sequence[int], budget: int) -> list[int]:
    """Return how many triangles of each tissue are shown: all of them, or in proportion above a least number.

    Parameters
    ----------
    counts
        Triangles of each tissue.
    budget
        Triangles of all.
    """
    if sum(counts) <= budget:
        return list(counts)
    floor = min(_LEAST, budget // len(counts))
    least = [min(count, floor) for count in counts]
    spare = [count - low for count, low in zip(counts, least, strict=True)]
    share = (budget - sum(least)) / sum(spare)
    return [low + int(share * more) for low, more in zip(least, spare, strict=True)]


def qualities(vertices: Float, faces: Int) -> Float:
    """Return q = 2 r_in / r_out of each face (thesis eq. 2.4), 0 for degenerate ones: (F,)."""
    corners = vertices[faces]
    sides = np.linalg.norm(corners - corners[:, [1, 2, 0]], axis=2)
    # 2 r_in / r_out = (b + c - a)(c + a - b)(a + b - c) / (a b c)
    total = sides.sum(axis=1)
    product = sides.prod(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        q = np.prod(total[:, None] - 2.0 * sides, axis=1) / product
    return np.clip(np.where(product > 0, q, 0.0), 0.0, 1.0)


def thin(mesh: Mesh, target: int, kept: NDArray[np.int64]) -> Thinned:
    """Return a surface of about so many triangles.

    Vertices within a cell of a grid become one, in their middle (Rossignac & Borrel 1993); those near the faces that
    are kept stay themselves.

    Parameters
    ----------
    mesh
        The surface.
    target
        Triangles wanted; if there are no more, the surface is returned whole.
    kept : (K,) int64
        Faces that stay as they are, with all faces that share a vertex with them.
    """
    q = qualities(mesh.vertices, mesh.faces)
    if len(mesh.faces) <= target:
        return Thinned(mesh.vertices, mesh.faces, q, True)
    alone = _near(mesh, kept)
    cluster = _clusters(mesh, max(target // 2, 4), alone)
    n = int(cluster.max()) + 1
    members = np.bincount(cluster, minlength=n)
    middle = np.stack([np.bincount(cluster, mesh.vertices[:, axis], n) / members for axis in range(3)], axis=1)
    # The middle of one is itself, without a division.
    middle[cluster[alone]] = mesh.vertices[alone]
    faces = cluster[mesh.faces].astype(np.int32)
    gone = (faces == faces[:, [1, 2, 0]]).any(axis=1)
    worst = np.ones(n)
    np.minimum.at(worst, faces[gone].ravel(), np.repeat(q[gone], 3))
    left = np.flatnonzero(~gone)
    ordered = np.sort(faces[left], axis=1)
    _, first = np.unique(ordered, axis=0, return_index=True) if len(left) else (None, left)
    left = left[np.sort(first)]
    faces = faces[left]
    return Thinned(middle, faces, np.minimum(q[left], worst[faces].min(axis=1, initial=1.0)), False)


def _near(mesh: Mesh, kept: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the vertices of the faces that share a vertex with one of these."""
    touched = np.zeros(len(mesh.vertices), dtype=bool)
    touched[mesh.faces[kept].ravel()] = True
    near = touched[mesh.faces].any(axis=1)
    return np.unique(mesh.faces[near]).astype(np.int64)


def _clusters(mesh: Mesh, wanted: int, alone: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the cluster of each vertex, numbered in the order of the cells: about so many."""
    corners = mesh.vertices[mesh.faces]
    area = 0.5 * float(
        np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    )
    low, size = mesh.vertices.min(axis=0), float(np.ptp(mesh.vertices, axis=0).max())
    least = size / _CELLS or 1.0
    # A surface passes through 1.5 cells for each area of a cell's side, on the average over its directions.
    side = max(float(np.sqrt(1.5 * area / wanted)), least)
    facing = _facing(mesh)
    for _ in range(_ROUNDS):
        cell = ((mesh.vertices - low) / side).astype(np.int64)
        key = ((cell[:, 0] * (_CELLS + 1) + cell[:, 1]) * (_CELLS + 1) + cell[:, 2]) * 6 + facing
        key[alone] = -1 - np.arange(len(alone))
        found, cluster = np.unique(key, return_inverse=True)
        if 0.8 * wanted <= len(found) <= wanted or side == least or len(found) <= len(alone) + 8:
            break
        side = max(side * float(np.sqrt(len(found) / (0.9 * wanted))), least)
    clusters: NDArray[np.int64] = cluster.reshape(-1)
    return clusters


def _facing(mesh: Mesh) -> NDArray[np.int64]:
    """Return which way each vertex faces, as one of six: the two sides of a thin wall must not become one."""
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    n = len(mesh.vertices)
    summed = np.stack([np.bincount(mesh.faces.ravel(), np.repeat(normals[:, axis], 3), n) for axis in range(3)], axis=1)
    axis = np.abs(summed).argmax(axis=1)
    facing: NDArray[np.int64] = 2 * axis + (summed[np.arange(n), axis] > 0)
    return facing
