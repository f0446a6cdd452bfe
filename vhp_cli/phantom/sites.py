"""What the planting of defects has in common: the record of a defect, and looking around on a surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vhp_cli.mesh import Mesh

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]

# Longest edge in mm of a face at which a defect is planted, so that "at this face" is one place.
MAX_EDGE = 9.0


@dataclass(frozen=True, slots=True)
class Planted:
    """One defect that was made on purpose.

    Parameters
    ----------
    rule
        Code of the rule that it breaks; others may follow from it in the same tissue or pair.
    tissues
        The tissue, or the two tissues, it concerns.
    xyz_mm
        Where it is; None if it concerns a file as a whole.
    note
        What was done.
    """

    rule: str
    tissues: tuple[str, ...]
    xyz_mm: tuple[float, float, float] | None
    note: str


class Site(NamedTuple):
    """A defect made in one mesh: the new mesh, the place, what was done, and the faces that are new or moved."""

    mesh: Mesh
    xyz: Array
    note: str
    changed: Array  # corners (k, 3, 3)


def stored(points: Array) -> Array:
    """Round coordinates to float32, as a binary STL stores them."""
    return np.asarray(points, dtype=np.float32).astype(np.float64)


def faces_at(mesh: Mesh, vertex: int) -> Numbers:
    """Return the faces around a vertex."""
    return np.flatnonzero((mesh.faces == vertex).any(axis=1))


def normal_at(mesh: Mesh, faces: Numbers) -> Array:
    """Return the unit normal of a few faces together, weighted by their area."""
    corners = mesh.vertices[mesh.faces[faces]]
    total = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).sum(axis=0)
    unit: Array = total / np.linalg.norm(total)
    return unit


def across(mesh: Mesh, face: int, corner: int) -> tuple[int, int]:
    """Return the face beyond the edge that starts at `corner` of a face, and its third vertex."""
    a, b = mesh.faces[face, corner], mesh.faces[face, (corner + 1) % 3]
    beyond = np.flatnonzero((mesh.faces == a).any(axis=1) & (mesh.faces == b).any(axis=1))
    other = int(beyond[beyond != face][0])
    third = next(int(v) for v in mesh.faces[other] if v not in (a, b))
    return other, third


def longest_edge(mesh: Mesh, face: int) -> tuple[int, float]:
    """Return the corner at which the longest edge of a face starts, and its length in mm."""
    corners = mesh.vertices[mesh.faces[face]]
    lengths = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    corner = int(np.argmax(lengths))
    return corner, float(lengths[corner])


def depth_below(mesh: Mesh, start: Array, inward: Array, leave_out: Numbers) -> float:
    """Return how far a ray from a surface goes before it meets the surface again, in mm (inf: never).

    The faces `leave_out`, from which the ray starts, don't count (Moeller and Trumbore 1997).
    """
    corners = np.delete(mesh.vertices[mesh.faces], leave_out, axis=0)
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(inward, second)
    determinant = (first * p).sum(axis=1)
    scale = np.where(np.abs(determinant) > 1e-12, determinant, np.inf)
    offset = start - corners[:, 0]
    u = (offset * p).sum(axis=1) / scale
    q = np.cross(offset, first)
    v = (q @ inward) / scale
    t = (second * q).sum(axis=1) / scale
    met = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 1e-6) & np.isfinite(scale)
    return float(t[met].min()) if met.any() else float("inf")


def frame_around(direction: Array) -> tuple[Array, Array]:
    """Return two unit vectors at right angles to a direction and to each other."""
    first = np.cross(direction, np.eye(3)[int(np.argmin(np.abs(direction)))])
    first /= np.linalg.norm(first)
    return first, np.cross(direction, first)


def with_part(mesh: Mesh, points: Array, faces: Numbers) -> Mesh:
    """Add vertices and faces; in `faces`, -1 - i stands for the new vertex i."""
    vertices = np.concatenate([mesh.vertices, stored(points)])
    numbers = np.where(faces < 0, len(mesh.vertices) - 1 - faces, faces)
    return Mesh(vertices, np.concatenate([mesh.faces, numbers]).astype(np.int32))


def outward_solid(points: Array, faces: Numbers) -> Numbers:
    """Orient the faces of a small convex solid so that they face away from its middle."""
    corners = points[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = ((corners.mean(axis=1) - points.mean(axis=0)) * normals).sum(axis=1) < 0
    return np.where(inward[:, None], faces[:, ::-1], faces)
