"""fTetWild, by pytetwild: the boundary of a tetrahedral mesh near a surface. Runs in a child process only."""

from __future__ import annotations

import importlib
import importlib.util
import sys
import types
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Arrays = tuple[NDArray[np.float64], NDArray[np.int32]]


def envelope(vertices: NDArray[np.float64], faces: NDArray[np.int32], options: Mapping[str, Any]) -> Arrays:
    """Tetrahedralize what any triangles enclose, and return the boundary of the tetrahedra, oriented outward.

    The boundary is closed and consistently oriented, but not always 2-manifold.

    Parameters
    ----------
    vertices, faces
        Any triangles.
    options
        ``envelope_mm``: most distance from the given triangles; ``edge_length_mm``: wanted edge length.
    """
    if "pyvista" not in sys.modules and importlib.util.find_spec("pyvista") is None:
        # pytetwild 0.4.2 loads pyvista only to add methods to it, but does not require it.
        sys.modules["pyvista"] = types.ModuleType("pyvista")
    pytetwild = importlib.import_module("pytetwild")

    size = float(np.linalg.norm(vertices.max(axis=0) - vertices.min(axis=0))) or 1.0
    points, tetrahedra = pytetwild.tetrahedralize(
        # It refuses arrays that can't be written to.
        np.array(vertices),
        np.array(faces),
        edge_length_abs=float(options["edge_length_mm"]),
        epsilon=options["envelope_mm"] / size,
        num_threads=1,
        quiet=True,
    )
    return _boundary(np.asarray(points, dtype=np.float64), np.asarray(tetrahedra, dtype=np.int64))


def _boundary(points: NDArray[np.float64], tetrahedra: NDArray[np.int64]) -> Arrays:
    edges = points[tetrahedra[:, 1:]] - points[tetrahedra[:, :1]]
    inverted = np.linalg.det(edges) < 0
    tetrahedra = np.where(inverted[:, None], tetrahedra[:, [0, 2, 1, 3]], tetrahedra)
    # Each side of a positive tetrahedron, counter-clockwise seen from outside.
    sides = np.concatenate([tetrahedra[:, list(side)] for side in ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))])
    _, first, count = np.unique(np.sort(sides, axis=1), axis=0, return_index=True, return_counts=True)
    faces = sides[np.sort(first[count == 1])]
    used, index = np.unique(faces, return_inverse=True)
    return points[used], index.reshape(-1, 3).astype(np.int32)
