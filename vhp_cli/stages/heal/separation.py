"""Part vertices that are different by their indices but would be one point in the file."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vhp_cli.inspection.places import MAX_PLACES, point
from vhp_cli.kernels.reading import weld
from vhp_cli.kernels.spatial import Tree
from vhp_cli.measures import Action, Place
from vhp_cli.mesh import Mesh
from vhp_cli.rounding import rounded, spacing
from vhp_cli.stages.heal.candidate import diagonal

# How far touching vertices are moved apart: this share of the diagonal, at most so many mm, at most this share of the
# shortest edge there; and never less than this many spacings of float32.
_APART_SHARE = 2e-4
_APART_MOST = 0.02
_APART_EDGE_SHARE = 0.2
_APART_ULPS = 8
# Pairs of faces listed when the moves are checked.
_MOST_PAIRS = 100_000
# How the vertices at a spot are moved, in the order in which it is tried: factor of the distance, inward if positive.
_MOVES = (1.0, 0.5, -1.0, -0.5, 0.25, -0.25, 2.0, -2.0)


def separate(mesh: Mesh) -> tuple[Mesh, list[Action]]:
    """Move vertices apart that are different but would be the same in the file.

    Readers of an STL file weld equal points, so two fans at one point would be a non-manifold vertex again. They
    are moved along their normals, inward or, where that does not part the surface, outward, by the least of 0.02 mm,
    0.02 % of the diagonal and a fifth of the shortest edge there.

    Parameters
    ----------
    mesh
        Oriented, and manifold by its indices.
    """
    written = rounded(mesh.vertices)
    _, spot = weld(written)
    members = np.bincount(spot)
    moving = np.flatnonzero(members[spot] > 1)
    used = np.zeros(len(mesh.vertices), np.bool_)
    used[mesh.faces] = True
    moving = moving[used[moving]]
    if not len(moving):
        return mesh, []
    parting = _Parting(mesh, moving, spot)
    vertices, still = parting.best()
    moved = np.linalg.norm(vertices[moving] - mesh.vertices[moving], axis=1)
    message = f"{len(moving)} vertices that lay on others moved, by {moved.max():.2g} mm at most"
    if still:
        message += f"; {still} of them still touch"
    places: list[Place] = [
        {"xyz_mm": point(mesh.vertices[vertex]), "face": None, "value": float(distance)}
        for vertex, distance in list(zip(moving, moved, strict=True))[:MAX_PLACES]
    ]
    action: Action = {"step": "separate", "message": message, "count": len(moving), "places": places}
    return Mesh(vertices, mesh.faces), [action]


class _Parting:
    """Search of moves that part the vertices at each spot.

    Parameters
    ----------
    mesh
        The mesh.
    moving
        Vertices that share their spot with others.
    spot : (V,) int32
        Number of the spot of every vertex.
    """

    def __init__(self, mesh: Mesh, moving: NDArray[np.int64], spot: NDArray[np.int32]) -> None:
        self.mesh = mesh
        self.moving = moving
        self.spots, self.group = np.unique(spot[moving], return_inverse=True)
        is_moving = np.zeros(len(mesh.vertices), np.bool_)
        is_moving[moving] = True
        beside = np.flatnonzero(is_moving[mesh.faces].any(axis=1))
        corners = mesh.vertices[mesh.faces[beside]]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]
        inward = np.zeros_like(mesh.vertices)
        shortest = np.full(len(mesh.vertices), np.inf)
        for k in range(3):
            to_next, to_last = corners[:, k - 2] - corners[:, k], corners[:, k - 1] - corners[:, k]
            lengths = np.linalg.norm(to_next, axis=1), np.linalg.norm(to_last, axis=1)
            cosine = np.einsum("ij,ij->i", to_next, to_last) / np.maximum(lengths[0] * lengths[1], 1e-300)
            # Weighted by the angle at the vertex: independent of the triangulation.
            np.add.at(inward, mesh.faces[beside, k], -np.arccos(np.clip(cosine, -1, 1))[:, None] * normals)
            np.minimum.at(shortest, mesh.faces[beside, k], np.minimum(*lengths))
        size = np.maximum(np.linalg.norm(inward[moving], axis=1), 1e-300)
        self.direction = inward[moving] / size[:, None]
        least = _APART_ULPS * spacing(mesh.vertices)
        largest = min(_APART_MOST, _APART_SHARE * diagonal(mesh))
        self.distance = np.maximum(np.minimum(largest, _APART_EDGE_SHARE * shortest[moving]), least)
        # Everything that a vertex could touch on its way.
        reach = max(_MOVES) * float(self.distance.max())
        faces = mesh.vertices[mesh.faces]
        lower, upper = faces.min(axis=1) - reach, faces.max(axis=1) + reach
        box = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
        self.near = np.flatnonzero(((lower <= box[1]) & (upper >= box[0])).all(axis=1))
        self.group_of = np.full(len(mesh.vertices), -1)
        self.group_of[moving] = self.group

    def moved(self, factors: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the vertices, those of each spot moved by its factor, as they would be written."""
        vertices = mesh_vertices = self.mesh.vertices.copy()
        step = (factors[self.group] * self.distance)[:, None] * self.direction
        vertices[self.moving] = rounded(mesh_vertices[self.moving] + step)
        return vertices

    def hits(self, vertices: NDArray[np.float64]) -> NDArray[np.int64]:
        """Count for each spot the pairs of faces that meet there."""
        faces = self.mesh.faces[self.near]
        found = Tree(vertices, faces).self_hits(_MOST_PAIRS)
        counts = np.zeros(len(self.spots), np.int64)
        groups = self.group_of[faces[found.pairs].reshape(-1, 6)]
        for k in range(6):
            # Each pair counts once for a spot.
            fresh = (groups[:, k] >= 0) & (groups[:, k, None] != groups[:, :k]).all(axis=1)
            np.add.at(counts, groups[fresh, k], 1)
        return counts

    def best(self) -> tuple[NDArray[np.float64], int]:
        """Return the moved vertices, and how many of the moving ones are in faces that still meet others."""
        chosen = np.full(len(self.spots), _MOVES[0])
        vertices = self.moved(chosen)
        hits = self.hits(vertices)
        for factor in _MOVES[1:]:
            if not hits.any():
                break
            trial = np.where(hits > 0, factor, chosen)
            found = self.hits(self.moved(trial))
            better = found < hits
            chosen = np.where(better, trial, chosen)
            vertices = self.moved(chosen)
            hits = self.hits(vertices)
        return vertices, int((hits[self.group] > 0).sum())
