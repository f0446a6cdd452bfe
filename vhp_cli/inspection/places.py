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


def contact_points(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a point of contact of each pair of triangles, for display: the middle of their common part.

    It is the mean of the points in which the edges of each pass through the other; where rounding loses these,
    or the triangles lie in one plane, the middle between their two nearest corners.

    Parameters
    ----------
    first, second : (N, 3, 3) float64
        Corners of the triangles, of which each pair is known to meet.

    Returns
    -------
    (N, 3) float64
    """
    points = [_edge_crossings(first, second), _edge_crossings(second, first)]
    found = np.concatenate(points, axis=1)
    hit = ~np.isnan(found[:, :, :1])
    number = hit.sum(axis=1)
    middle = np.where(hit, found, 0.0).sum(axis=1) / np.maximum(number, 1)
    for pair in np.flatnonzero(number[:, 0] == 0):
        distances = np.linalg.norm(first[pair, :, None] - second[pair, None], axis=2)
        i, j = np.unravel_index(distances.argmin(), (3, 3))
        middle[pair] = (first[pair, i] + second[pair, j]) / 2
    return middle


def _edge_crossings(edges: NDArray[np.float64], faces: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return where the three edges of each triangle (N, 3, 3) pass through its partner: (N, 3, 3), NaN where not."""
    origin, u, v = faces[:, :1], faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0]
    normal = np.cross(u, v)
    heights = np.einsum("nkd,nd->nk", edges - origin, normal)
    after = np.roll(heights, -1, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = heights / (heights - after)
        points = edges + (np.roll(edges, -1, axis=1) - edges) * share[:, :, None]
        # Barycentric coordinates in the plane of the face.
        offset = points - origin
        size = np.einsum("nd,nd->n", normal, normal)[:, None]
        s = np.einsum("nkd,nd->nk", np.cross(offset, v[:, None]), normal) / size
        t = np.einsum("nkd,nd->nk", np.cross(u[:, None], offset), normal) / size
        inside = (heights * after <= 0) & (heights != after) & (s >= -1e-9) & (t >= -1e-9) & (s + t <= 1 + 1e-9)
    return np.where(inside[:, :, None], points, np.nan)
