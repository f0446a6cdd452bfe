"""Points of a surface, dense where it may exceed its room."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vhp_cli.mesh import Mesh
from vhp_cli.stages.clearance.cell import Cell

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_MOST = 400_000
_DEEPEST = 12
# Parts whose centres are inside by less than this part of the spacing are looked at on so much smaller ones.
_CLOSE, _FINER = 0.25, 6.0
# The corners of the four parts of a triangle, by those of the whole.
_QUARTERS = np.array(
    [
        [[2, 0, 0], [1, 1, 0], [1, 0, 1]],
        [[1, 1, 0], [0, 2, 0], [0, 1, 1]],
        [[1, 0, 1], [0, 1, 1], [0, 0, 2]],
        [[1, 1, 0], [0, 1, 1], [1, 0, 1]],
    ]
) / 2.0  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Points of a surface that move with it.

    Parameters
    ----------
    corners : (S, 3) int64
        Vertices of the face on which each point lies.
    weights : (S, 3) float64
        Its barycentric coordinates.
    faces : (S,) int64
        The face.
    """

    corners: Ints
    weights: Floats
    faces: Ints

    def points(self, vertices: Floats) -> Floats:
        """Return where the points are (S, 3), by the positions of all vertices."""
        found: Floats = (self.weights[:, None] @ vertices[self.corners])[:, 0]
        return found


def samples_of(mesh: Mesh, cell: Cell, *, spacing_mm: float, margin_mm: float) -> Samples:
    """Return all vertices and centres of faces, and points that lie dense where the surface may exceed its room.

    As the excess changes by at most the way between two points, whole parts of triangles are known to be inside.

    Parameters
    ----------
    mesh
        The surface.
    cell
        Its room.
    spacing_mm
        Largest size of a part that a point stands for.
    margin_mm
        How far inside of its room the surface should be.
    """
    _used, first = np.unique(mesh.faces, return_index=True)
    at_vertex = np.eye(3)[first % 3]
    centres = np.full((len(mesh.faces), 3), 1 / 3)
    dense_faces, dense_weights = _dense(mesh, cell, spacing_mm, margin_mm)
    faces = np.concatenate([first // 3, np.arange(len(mesh.faces)), dense_faces]).astype(np.int64)
    weights = np.concatenate([at_vertex, centres, dense_weights])
    return Samples(mesh.faces[faces].astype(np.int64), weights, faces)


def excess_of(
    mesh: Mesh,
    cell: Cell,
    *,
    spacing_mm: float,
    least_mm: float = 0.0,
    enough_mm: float = np.inf,
    outside_mm: float = np.inf,
) -> float:
    """Return by how much a surface exceeds its room in mm; negative if it is inside.

    Only parts of triangles are looked at that may exceed it by more than what was found so far, and than `least_mm`:
    a result below that says no more than that it is not above, and one above `enough_mm` no more than that it is not
    below. `outside_mm` is how far the surface may lie outside of the given one. Where the surface is about at the
    border of its room, the spacing is smaller than asked for.
    """
    at = np.unique(mesh.faces)
    own = np.zeros(len(at)) if mesh is cell.own.mesh else None
    found = float(cell.excess(mesh.vertices[at], 1.0, own=own, own_at_most=outside_mm).max(initial=-np.inf))
    # Towards neighbours that keep away from the given surface themselves, vertices say enough.
    cell = cell.without_idle()
    faces, parts = np.arange(len(mesh.faces)), np.broadcast_to(np.eye(3), (len(mesh.faces), 3, 3))
    for _ in range(_DEEPEST):
        if found > enough_mm:
            break
        excess, radius = _looked_at(mesh, cell, faces, parts, 0.0, outside_mm)
        found = max(found, float(excess.max(initial=-np.inf)))
        wanted = np.where(np.abs(excess) < _CLOSE * spacing_mm, spacing_mm / _FINER, spacing_mm)
        more = (excess + radius > max(found, least_mm)) & (radius > wanted)
        if not more.any() or 4 * int(more.sum()) > _MOST:
            break
        faces, parts = _quartered(faces[more], parts[more])
    return found


def _looked_at(
    mesh: Mesh, cell: Cell, faces: Ints, parts: Floats, margin_mm: float, outside_mm: float = np.inf
) -> tuple[Floats, Floats]:
    """Return the excess at the centres of parts of triangles, and how far their corners are from there (P,)."""
    corners = parts @ mesh.vertices[mesh.faces[faces]]
    centres = corners.mean(axis=1)
    away = corners - centres[:, None]
    radius = np.sqrt((away**2).sum(axis=2).max(axis=1, initial=0.0))
    own = np.zeros(len(centres)) if mesh is cell.own.mesh else None
    band = margin_mm + float(radius.max(initial=0.0))
    return cell.excess(centres, band, own=own, own_at_most=outside_mm), radius


def _quartered(faces: Ints, parts: Floats) -> tuple[Ints, Floats]:
    return np.repeat(faces, 4), (_QUARTERS @ parts[:, None]).reshape(-1, 3, 3)


def _dense(mesh: Mesh, cell: Cell, spacing_mm: float, margin_mm: float) -> tuple[Ints, Floats]:
    faces = np.arange(len(mesh.faces))
    parts = np.broadcast_to(np.eye(3), (len(faces), 3, 3))
    found_faces, found_weights = [np.empty(0, np.int64)], [np.empty((0, 3))]
    for _ in range(_DEEPEST):
        excess, radius = _looked_at(mesh, cell, faces, parts, margin_mm)
        near = excess + radius > -margin_mm
        fine = near & (radius <= spacing_mm)
        found_faces.append(faces[fine])
        found_weights.append(parts[fine].mean(axis=1))
        coarse = near & ~fine
        if not coarse.any():
            break
        if 4 * int(coarse.sum()) > _MOST:
            found_faces.append(faces[coarse])
            found_weights.append(parts[coarse].mean(axis=1))
            break
        faces, parts = _quartered(faces[coarse], parts[coarse])
    return np.concatenate(found_faces), np.concatenate(found_weights)
