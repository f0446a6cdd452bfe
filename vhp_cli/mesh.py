"""The triangle mesh value that every floor of the package passes around."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Vertices = NDArray[np.float64]
Faces = NDArray[np.int32]


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """An immutable indexed triangle mesh (thesis eq. 2.2: the arrays ``P`` and ``t``, 0-based).

    Parameters
    ----------
    vertices : (V, 3) float64
        Coordinates in mm.
    faces : (F, 3) int32
        Vertex indices of each triangle, counter-clockwise seen from outside.

    Raises
    ------
    ValueError
        If a shape is wrong or a face refers to a vertex that does not exist.
    """

    vertices: Vertices
    faces: Faces

    def __post_init__(self) -> None:
        vertices = np.ascontiguousarray(self.vertices, dtype=np.float64)
        faces = np.ascontiguousarray(self.faces, dtype=np.int32)
        if vertices.ndim != 2 or vertices.shape[1] != 3:
            raise ValueError(f"vertices must have shape (V, 3), not {vertices.shape}")
        if faces.ndim != 2 or faces.shape[1] != 3:
            raise ValueError(f"faces must have shape (F, 3), not {faces.shape}")
        if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
            raise ValueError(f"faces refer to vertices outside 0..{len(vertices) - 1}")
        # A view, so that read-only here does not freeze the caller's array.
        vertices, faces = vertices.view(), faces.view()
        vertices.flags.writeable = False
        faces.flags.writeable = False
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces)


def vertex_normals(mesh: Mesh) -> Vertices:
    """Return the unit normals of the vertices, weighted by area (V, 3); 0 where there is none."""
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    at = mesh.faces.ravel()
    sums = np.stack([np.bincount(at, np.repeat(normals[:, axis], 3), len(mesh.vertices)) for axis in range(3)], axis=1)
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    unit: Vertices = sums / np.where(lengths > 0, lengths, 1.0)
    return unit
