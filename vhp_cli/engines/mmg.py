"""MMG, by mmgpy: an optional engine under the LGPL that betters tetrahedra. Runs in a child process only."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Arrays = tuple[NDArray[np.float64], NDArray[np.int32]]


def improve(points: NDArray[np.float64], triangles: NDArray[np.int32], options: Mapping[str, Any]) -> Arrays:
    """Better the shape of tetrahedra at their size, without touching some triangles (Dapogny et al. 2014, MMG3D).

    Parameters
    ----------
    points, triangles
        Points of the tetrahedra, and the faces of theirs that stay as they are.
    options
        ``tetrahedra`` (M, 4); ``regions`` (M,) from 1: a number for all that the triangles part from each other.

    Returns
    -------
    points (N, 3), tetrahedra (M', 4)
        The corners of the triangles are among the points, with the very same coordinates.

    Raises
    ------
    RuntimeError
        If MMG fails, or loses a corner of a triangle.
    """
    mmgpy = importlib.import_module("mmgpy")

    tetrahedra, regions = options["tetrahedra"], options["regions"]
    mesh = mmgpy.MmgMesh3D()
    mesh.set_mesh_size(vertices=len(points), tetrahedra=len(tetrahedra), triangles=len(triangles))
    kept = np.unique(triangles)
    numbers = np.zeros(len(points), dtype=np.int64)
    numbers[kept] = kept + 1
    mesh.set_vertices(np.array(points), refs=numbers)
    mesh.set_tetrahedra(np.array(tetrahedra, dtype=np.int32), refs=np.asarray(regions, dtype=np.int64))
    mesh.set_triangles(np.array(triangles, dtype=np.int32))
    mesh.set_required_triangles(np.arange(len(triangles), dtype=np.int32))
    mesh.remesh(optim=True, nosurf=True, verbose=-1)
    made, found = mesh.get_vertices_with_refs()
    made = np.array(made, dtype=np.float64)
    corner = np.flatnonzero(found)
    if not np.array_equal(np.sort(found[corner]), kept + 1):
        raise RuntimeError("a corner of a triangle is lost")
    # MMG scales the mesh and back, which rounds the last digits off.
    made[corner] = points[found[corner] - 1]
    return made, np.array(mesh.get_tetrahedra(), dtype=np.int32)
