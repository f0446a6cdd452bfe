"""MeshLab, by pymeshlab: exact union and alpha wrapping, both by CGAL. Runs in a child process only."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Arrays = tuple[NDArray[np.float64], NDArray[np.int32]]


def _mesh_set(*meshes: Arrays) -> Any:
    pymeshlab = importlib.import_module("pymeshlab")

    found = pymeshlab.MeshSet()
    for vertices, faces in meshes:
        found.add_mesh(pymeshlab.Mesh(vertices, faces))
    return found


def _result(mesh_set: Any) -> Arrays:
    mesh = mesh_set.current_mesh()
    return mesh.vertex_matrix(), mesh.face_matrix()


def union(vertices: NDArray[np.float64], faces: NDArray[np.int32], options: Mapping[str, Any]) -> Arrays:
    """Bound the regions of positive winding number; corners that are kept keep their coordinates.

    Parameters
    ----------
    vertices, faces
        Closed and consistently oriented; may cross itself.
    options
        ``either_sign``: keep the regions of negative winding number too.

    Raises
    ------
    PyMeshLabException
        If the surface is open or not consistently oriented.
    """
    if options.get("either_sign"):
        other = vertices, np.ascontiguousarray(faces[:, ::-1])
    else:
        other = _far_tetrahedron(vertices)
    mesh_set = _mesh_set((vertices, faces), other)
    mesh_set.generate_boolean_union(first_mesh=0, second_mesh=1)
    found, found_faces = _result(mesh_set)
    # The filter needs a second mesh; a far one costs nothing and is taken off again.
    is_ours = (found <= vertices.max(axis=0)).all(axis=1)
    return _in_order(found, found_faces[is_ours[found_faces].all(axis=1)])


def _in_order(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> Arrays:
    """Weld equal vertices and sort everything: the order of the faces depends on addresses in memory."""
    corners, index = np.unique(vertices[faces].reshape(-1, 3), axis=0, return_inverse=True)
    faces = index.reshape(-1, 3).astype(np.int32)
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    first = faces.argmin(axis=1)[:, None]
    faces = np.take_along_axis(faces, (first + np.arange(3)) % 3, axis=1)
    return corners, np.ascontiguousarray(faces[np.lexsort(faces.T[::-1])])


def _far_tetrahedron(vertices: NDArray[np.float64]) -> Arrays:
    lower, upper = vertices.min(axis=0), vertices.max(axis=0)
    size = float(np.linalg.norm(upper - lower)) or 1.0
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
    return upper + size * (1 + corners), np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], dtype=np.int32)


def alpha_wrap(vertices: NDArray[np.float64], faces: NDArray[np.int32], options: Mapping[str, Any]) -> Arrays:
    """Wrap any triangles from outside by a closed manifold (Portaneri et al. 2022, Alpha wrapping with an offset).

    Parameters
    ----------
    vertices, faces
        Any triangles.
    options
        ``alpha_mm``: smallest opening that the wrap gets through; ``offset_mm``: distance of the wrap.
    """
    pymeshlab = importlib.import_module("pymeshlab")

    size = float(np.linalg.norm(vertices.max(axis=0) - vertices.min(axis=0))) or 1.0
    mesh_set = _mesh_set((vertices, faces))
    mesh_set.generate_alpha_wrap(
        alpha=pymeshlab.PercentageValue(100 * options["alpha_mm"] / size),
        offset=pymeshlab.PercentageValue(100 * options["offset_mm"] / size),
    )
    return _result(mesh_set)
