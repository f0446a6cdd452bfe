"""Where a defect is: points in mm for the reports."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vhp_cli.measures import Place, Point
from vhp_cli.mesh import Mesh

MAX_PLACES = 10


def point(xyz: ArrayLike) -> Point:
    """Return a point as JSON, to a nanometre: below the spacing of float32 at body size."""
    return [round(float(value), 6) for value in np.asarray(xyz)]


def at_faces(mesh: Mesh, faces: Iterable[int], values: Iterable[float] | None = None) -> list[Place]:
    """Return the centroids of faces as places, with one measured value each if given."""
    chosen = [int(face) for face in faces]
    centroids = mesh.vertices[mesh.faces[chosen]].mean(axis=1) if chosen else np.empty((0, 3))
    places: list[Place] = [{"xyz_mm": point(xyz), "face": face} for xyz, face in zip(centroids, chosen, strict=True)]
    if values is not None:
        for place, value in zip(places, values, strict=True):
            place["value"] = float(value)
    return places


def at_vertices(mesh: Mesh, vertices: Iterable[int], faces: Iterable[int]) -> list[Place]:
    """Return vertices as places, each with one of its faces."""
    return [
        {"xyz_mm": point(mesh.vertices[vertex]), "face": int(face)}
        for vertex, face in zip(vertices, faces, strict=True)
    ]


def at_edges(mesh: Mesh, edges: NDArray[np.int32], faces: Iterable[int]) -> list[Place]:
    """Return the midpoints of edges (k, 2) as places, each with one of its faces."""
    midpoints = mesh.vertices[edges].mean(axis=1)
    return [{"xyz_mm": point(xyz), "face": int(face)} for xyz, face in zip(midpoints, faces, strict=True)]
