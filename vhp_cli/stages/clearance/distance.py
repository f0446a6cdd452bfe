"""The signed distance to a surface: negative inside."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vhp_cli.kernels import surface
from vhp_cli.kernels.measuring import closest
from vhp_cli.kernels.spatial import Tree
from vhp_cli.mesh import Mesh

Floats = NDArray[np.float64]

# Nearer than this in mm, the way to the nearest point has no direction.
_ON_SURFACE = 1e-6
# An open surface encloses the points about which it winds by more than this.
_ENCLOSING = 0.5


class Located(NamedTuple):
    """Signed distances (P,) in mm, and the directions (P, 3) in which they grow: unit vectors."""

    values: Floats
    gradients: Floats


class SignedDistance:
    """The signed distance to a surface in mm.

    Distances are exact up to rounding, and so is the sign of a closed surface (by parity, whichever way it is
    oriented). Inside an open one is where its winding number exceeds 1/2.

    Parameters
    ----------
    mesh
        The surface.
    """

    def __init__(self, mesh: Mesh) -> None:
        topology = surface.topology(mesh.vertices, mesh.faces)
        self.mesh = mesh
        self.tree = Tree(mesh.vertices, mesh.faces)
        self.closed = not len(topology.boundary_edges)
        corners = mesh.vertices[mesh.faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        self._normals = normals / np.where(lengths > 0, lengths, 1.0)

    def __call__(self, points: Floats, limit_mm: float = np.inf, inner_mm: float = np.inf) -> Floats:
        """Return the signed distances of points (P, 3).

        Those outside that are beyond a limit equal the limit; those inside that are deeper than another one equal
        minus that.
        """
        first = min(limit_mm, inner_mm)
        distances = closest(self.tree, points, first).distances
        inside = self._inside(points)
        far = np.isinf(distances)
        for side, most in ((far & inside, inner_mm), (far & ~inside, limit_mm)):
            at = np.flatnonzero(side)
            if most > first:
                distances[at] = closest(self.tree, points[at], most).distances
            distances[at] = np.minimum(distances[at], most)
        return np.where(inside, -distances, distances)

    def located(self, points: Floats, limit_mm: float = np.inf, inner_mm: float = np.inf) -> Located:
        """Return the signed distances of points (P, 3) and their gradients.

        Those beyond a limit outside, or beyond another one inside, get that limit and no gradient.
        """
        first = min(limit_mm, inner_mm)
        near = closest(self.tree, points, first)
        inside = self._inside(points)
        far = np.isinf(near.distances)
        for side, most in ((far & inside, inner_mm), (far & ~inside, limit_mm)):
            at = np.flatnonzero(side)
            if most > first:
                near.distances[at], near.points[at], near.faces[at] = closest(self.tree, points[at], most)
                at = at[np.isinf(near.distances[at])]
            near.distances[at], near.points[at] = most, points[at]
        values = np.where(inside, -near.distances, near.distances)
        on_surface = near.distances < _ON_SURFACE
        ways = (points - near.points) / np.where(on_surface, 1.0, values)[:, None]
        return Located(values, np.where(on_surface[:, None], self._normals[near.faces], ways))

    def least(self, points: Floats) -> Floats:
        """Return what the signed distance of points (P, 3) is at least, by the box around the surface."""
        outside = np.maximum(np.maximum(self.tree.lower - points, points - self.tree.upper), 0.0)
        distances: Floats = np.linalg.norm(outside, axis=1)
        return np.where(distances > 0, distances, -np.inf)

    def _inside(self, points: Floats) -> NDArray[np.bool_]:
        inside = np.zeros(len(points), dtype=np.bool_)
        at = np.flatnonzero(((points >= self.tree.lower) & (points <= self.tree.upper)).all(axis=1))
        if self.closed:
            inside[at] = self.tree.inside(points[at]) == 1
        else:
            inside[at] = np.abs(self.tree.winding(points[at])) > _ENCLOSING
        return inside
