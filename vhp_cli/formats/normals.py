"""Normals of faces, as files store them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def unit_normals(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the outward unit normal of each face with these corners, (F, 3, 3) to (F, 3); 0 for one without area."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    # Scaled first: the squares of very small or large components would leave the range of a double.
    largest = np.abs(normals).max(axis=1, initial=0.0, keepdims=True)
    np.divide(normals, largest, out=normals, where=largest > 0)
    lengths = np.sqrt((normals * normals).sum(axis=1, keepdims=True))
    np.divide(normals, lengths, out=normals, where=lengths > 0)
    return np.asarray(normals)
