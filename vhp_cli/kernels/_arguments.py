"""What every kernel asks of a mesh before C sees it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

# Half-edges are counted in 32 bits.
MAX_FACES = (2**31 - 1) // 3


def checked_mesh(vertices: ArrayLike, faces: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return a mesh as contiguous arrays.

    Parameters
    ----------
    vertices : (V, 3)
        Coordinates in mm.
    faces : (F, 3)
        Vertex indices.

    Returns
    -------
    vertices : (V, 3) float64
    faces : (F, 3) int32

    Raises
    ------
    ValueError
        If the shapes are others, there are more than `MAX_FACES` faces, or an index refers to no vertex.
    """
    vertices = np.ascontiguousarray(vertices, dtype=np.float64)
    faces = np.ascontiguousarray(faces, dtype=np.int32)
    if vertices.ndim != 2 or vertices.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
        raise ValueError(f"vertices and faces must have shapes (V, 3) and (F, 3), not {vertices.shape}, {faces.shape}")
    if len(faces) > MAX_FACES:
        raise ValueError(f"a mesh can't have more than {MAX_FACES} faces, this one has {len(faces)}")
    if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
        raise ValueError(f"faces refer to vertices outside 0..{len(vertices) - 1}")
    return vertices, faces
