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


def contact_point(first: NDArray[np.float64], second: NDArray[np.float64]) -> Point:
    """Return a point at which two triangles (3, 3) meet, for display: the middle of their common part.

    The mean of the crossings of each triangle's edges with the other; where these are lost to rounding
    or the triangles overlap in one plane, the mean of the corners of each that are nearest to the other.
    """
    found = [*_edge_crossings(first, second), *_edge_crossings(second, first)]
    if not found:
        gaps = np.linalg.norm(first[:, None] - second[None], axis=2)
        found = [first[gaps.min(axis=1).argmin()], second[gaps.min(axis=0).argmin()]]
    return point(np.mean(found, axis=0))


def _edge_crossings(edges: NDArray[np.float64], face: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    origin, u, v = face[0], face[1] - face[0], face[2] - face[0]
    normal = np.cross(u, v)
    heights = (edges - origin) @ normal
    crossings = []
    for i, j in ((0, 1), (1, 2), (2, 0)):
        if heights[i] * heights[j] > 0 or heights[i] == heights[j]:
            continue
        xyz = edges[i] + (edges[j] - edges[i]) * (heights[i] / (heights[i] - heights[j]))
        # Barycentric coordinates in the plane of the face.
        s, t = np.linalg.lstsq(np.column_stack((u, v)), xyz - origin, rcond=None)[0]
        if s >= -1e-9 and t >= -1e-9 and s + t <= 1 + 1e-9:
            crossings.append(xyz)
    return crossings
