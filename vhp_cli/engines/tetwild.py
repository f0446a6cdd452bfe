"""fTetWild, by pytetwild: tetrahedra along any surface, or their boundary. Runs in a child process only.

It takes whatever it is given, and crashes on what makes no sense: that is refused here.
"""

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
    pytetwild = _library()
    size = _diagonal(vertices)
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


def tetrahedralize(vertices: NDArray[np.float64], faces: NDArray[np.int32], options: Mapping[str, Any]) -> Arrays:
    """Fill a box around any triangles with tetrahedra, some faces of which follow the triangles.

    Parameters
    ----------
    vertices, faces
        Any triangles, such as the surfaces of all tissues together: they may be open, cross or touch.
    options
        ``envelope_mm``: most distance from the given triangles; ``edge_length_mm``: wanted edge length;
        ``stop_energy``: AMIPS energy at which a mesh is good enough (3 is a regular tetrahedron; below 7 the engine
        may not end); ``iterations``: most passes over the mesh; ``coarsen``: fewer tetrahedra at the same quality;
        ``threads``; ``sizing``: None, or points (n, 3), tetrahedra (m, 4) and edge lengths (n,) of a background mesh
        that says how long edges are wanted where.

    Returns
    -------
    points (N, 3), tetrahedra (M, 4)
        All of the box, positively oriented.

    Raises
    ------
    ValueError
        If there are no triangles, a coordinate is not finite, or a vertex does not exist.
    """
    if not len(faces):
        raise ValueError("there are no triangles")
    if not np.isfinite(vertices).all():
        raise ValueError("a coordinate is not finite")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise ValueError("a face refers to a vertex that does not exist")
    corners = vertices[faces]
    if not (corners.max(axis=(0, 1)) > corners.min(axis=(0, 1))).all():
        raise ValueError("the triangles all lie in one plane")
    background: dict[str, Any] = {}
    if options.get("sizing") is not None:
        points, tetrahedra, lengths = options["sizing"]
        background = {"bg_vertices": np.array(points), "bg_tets": np.array(tetrahedra), "bg_values": np.array(lengths)}
    points, tetrahedra = _library().tetrahedralize(
        np.array(vertices),
        np.array(faces),
        edge_length_abs=float(options["edge_length_mm"]),
        epsilon=float(options["envelope_mm"]) / _diagonal(vertices),
        stop_energy=float(options["stop_energy"]),
        num_opt_iter=int(options["iterations"]),
        coarsen=bool(options["coarsen"]),
        num_threads=int(options["threads"]),
        # The whole box, as what its own filter takes for outside may be a tissue that lies in no other.
        disable_filtering=True,
        vtk_ordering=True,
        quiet=False,
        loglevel=2,
        **background,
    )
    return np.asarray(points, dtype=np.float64), np.asarray(tetrahedra, dtype=np.int32)


def _library() -> Any:
    if "pyvista" not in sys.modules and importlib.util.find_spec("pyvista") is None:
        # pytetwild 0.4.2 loads pyvista only to add methods to it, but does not require it.
        sys.modules["pyvista"] = types.ModuleType("pyvista")
    return importlib.import_module("pytetwild")


def _diagonal(vertices: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(vertices.max(axis=0) - vertices.min(axis=0))) or 1.0


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
