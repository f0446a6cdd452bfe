"""TetGen, by tetgen: an optional engine under the AGPL that keeps every triangle. Runs in a child process only."""

from __future__ import annotations

import importlib
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Arrays = tuple[NDArray[np.float64], NDArray[np.int32]]

# Asked for where the triangles allow it. Much more, and the refinement goes on without an end.
_MIN_DIHEDRAL_DEG = 15.0
_RADIUS_EDGE_RATIO = 1.3
# Flips and moves after it go on while there are larger angles than this.
_MAX_DIHEDRAL_DEG = 165.0
_OPTIMIZATION_PASSES = 10


def tetrahedralize(vertices: NDArray[np.float64], faces: NDArray[np.int32], options: Mapping[str, Any]) -> Arrays:
    """Fill all that is enclosed with tetrahedra, the faces of which all triangles are (Si 2015, TetGen).

    Parameters
    ----------
    vertices, faces
        Closed surfaces that do not cross: disjoint, nested, or joined at whole triangles, which are given once.
    options
        ``edge_length_mm``: length that edges away from the triangles should not exceed; None: as the triangles ask.

    Returns
    -------
    points (N, 3), tetrahedra (M, 4)
        The first points are the vertices; the tetrahedra are all oriented the same way.

    Raises
    ------
    RuntimeError
        If the surfaces cross or touch elsewhere, or TetGen fails.
    """
    tetgen = importlib.import_module("tetgen")

    engine = tetgen.TetGen(np.array(vertices), np.array(faces))
    edge_length = options.get("edge_length_mm")
    size: dict[str, Any] = {}
    most_new = 20 * len(vertices) + 1000
    if edge_length:
        # Of the regular tetrahedron.
        largest = edge_length**3 / (6 * math.sqrt(2))
        size = {"fixedvolume": True, "maxvolume": largest}
        box = float(np.prod(vertices.max(axis=0) - vertices.min(axis=0)))
        most_new += math.ceil(box / largest)
    points, tetrahedra, _, _ = engine.tetrahedralize(
        nobisect=True,  # no new points on the triangles
        quality=True,
        mindihedral=_MIN_DIHEDRAL_DEG,
        minratio=_RADIUS_EDGE_RATIO,
        optmaxdihedral=_MAX_DIHEDRAL_DEG,
        opt_iterations=_OPTIMIZATION_PASSES,
        steinerleft=most_new,
        quiet=True,
        **size,
    )
    return np.array(points, dtype=np.float64), np.array(tetrahedra, dtype=np.int32)
