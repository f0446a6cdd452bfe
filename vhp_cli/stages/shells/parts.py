"""Cut triangles into four."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# The corners of the four parts of a triangle, by those of the whole.
_QUARTERS = np.array(
    [
        [[2, 0, 0], [1, 1, 0], [1, 0, 1]],
        [[1, 1, 0], [0, 2, 0], [0, 1, 1]],
        [[1, 0, 1], [0, 1, 1], [0, 0, 2]],
        [[1, 1, 0], [0, 1, 1], [1, 0, 1]],
    ]
) / 2.0  # fmt: skip


def quartered(corners: Floats) -> Floats:
    """Return the four parts of each triangle (T, 3, 3), one after the other, halved along all edges (4 T, 3, 3)."""
    parts: Floats = (_QUARTERS @ corners[:, None]).reshape(-1, 3, 3)
    return parts
