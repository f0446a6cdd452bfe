"""A layer under a surface: how thick it shall be, and by how much points are too shallow or too deep for it."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from vhp_cli.kernels.measuring import Closest, closest
from vhp_cli.kernels.spatial import Tree
from vhp_cli.mesh import Mesh

Floats = NDArray[np.float64]
T = TypeVar("T")

# Fewer points are not worth a second thread.
_WORTH_THREADS = 20_000


class Depths(NamedTuple):
    """Depths (P,) of points under the outer surface in mm, negative outside, and the thickness (P,) wanted there."""

    found: Floats
    wanted: Floats


class Layer:
    """What lies between a surface and a shell within it.

    Parameters
    ----------
    outer
        The surface: closed, outward, free of self-intersections.
    thickness : (V,) float64
        How thick the layer shall be at each of its vertices in mm; linear in between.
    threads
        How many threads look for distances; the result is the same.
    """

    def __init__(self, outer: Mesh, thickness: Floats, threads: int = 1) -> None:
        self.outer = outer
        self.thickness = thickness
        self.tree = Tree(outer.vertices, outer.faces)
        self.threads = threads
        self.least, self.most = float(thickness.min()), float(thickness.max())

    def depths(self, points: Floats, limit_mm: float = np.inf) -> Depths:
        """Return how deep points (P, 3) lie, and how deep the layer reaches at the places of the surface next to them.

        What is farther from the surface than a limit gets the limit as its distance, and the thickest layer.
        """
        found = self.distances(points, limit_mm)
        inside = np.concatenate(in_parts(self.tree.inside, points, self.threads)) == 1
        return Depths(np.where(inside, found.found, -found.found), found.wanted)

    def distances(self, points: Floats, limit_mm: float = np.inf) -> Depths:
        """Return the same for points that are known to lie within the surface."""
        near = nearest(self.tree, points, limit_mm, self.threads)
        at = np.flatnonzero(near.faces >= 0)
        distances = np.full(len(points), min(limit_mm, np.finfo(np.float64).max))
        distances[at] = near.distances[at]
        wanted = np.full(len(points), self.most)
        if self.least < self.most:
            wanted[at] = interpolated(self.outer, self.thickness, near.points[at], near.faces[at])
        return Depths(distances, wanted)


def nearest(tree: Tree, points: Floats, limit_mm: float, threads: int) -> Closest:
    """Return the nearest points of a surface, as `closest` does, by several threads."""
    parts = in_parts(lambda part: closest(tree, part, limit_mm), points, threads)
    return parts[0] if len(parts) == 1 else Closest(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def in_parts(function: Callable[[Floats], T], points: Floats, threads: int) -> list[T]:
    """Return what a function, a kernel that releases the lock of the interpreter, makes of parts of points (P, 3)."""
    if threads < 2 or len(points) < _WORTH_THREADS:
        return [function(points)]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(function, np.array_split(points, threads)))


def interpolated(mesh: Mesh, values: Floats, points: Floats, faces: NDArray[np.int32]) -> Floats:
    """Return values (P,) at points (P, 3) of faces (P,) of a mesh, linear in between their corners."""
    a, b, c = (mesh.vertices[mesh.faces[faces, k]] for k in range(3))
    first, second, way = b - a, c - a, points - a
    ff, fs, ss = ((u * v).sum(axis=1) for u, v in ((first, first), (first, second), (second, second)))
    fw, sw = (first * way).sum(axis=1), (second * way).sum(axis=1)
    area = ff * ss - fs * fs
    flat = area <= 1e-12 * np.maximum(ff * ss, 1e-300)
    divisor = np.where(flat, 1.0, area)
    v = np.where(flat, 0.0, (ss * fw - fs * sw) / divisor)
    w = np.where(flat, 0.0, (ff * sw - fs * fw) / divisor)
    weights = np.clip(np.stack([1 - v - w, v, w], axis=1), 0.0, 1.0)
    weights /= weights.sum(axis=1, keepdims=True)
    found: Floats = (weights * values[mesh.faces[faces]]).sum(axis=1)
    return found
