"""Defects between two tissues: one vertex or face of the first is moved to the second.

The second tissue must lie, around the place, entirely below a plane, and the rest of what is moved above it; so
it is known without any distance search that the two surfaces meet where they are meant to and nowhere else.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from vhp_cli.mesh import Mesh
from vhp_cli.phantom.sites import MAX_EDGE, Array, Numbers, Site, depth_below, faces_at, longest_edge, normal_at, stored

PairPlant = Callable[[Mesh, Mesh, int, int], Site | None]  # a, b, a face of each that are near

CLEAR = 1e-3  # mm by which points must lie on their side of the plane


def _vertices_near(mesh: Mesh, lower: Array, upper: Array) -> Numbers:
    """Vertices of all faces whose boxes meet a box."""
    corners = mesh.vertices[mesh.faces]
    meets = ((corners.min(axis=1) <= upper) & (corners.max(axis=1) >= lower)).all(axis=1)
    return np.unique(mesh.faces[meets])


def _separated(a: Mesh, moved: Numbers, target: Array, b: Mesh, spared: Numbers, origin: Array, up: Array) -> bool:
    """Tell if b lies below the plane and the faces of a that are moved above it, but for what is moved or spared."""
    fan = np.flatnonzero(np.isin(a.faces, moved).any(axis=1))
    ring = a.vertices[np.setdiff1d(a.faces[fan], moved)]
    around = np.concatenate([ring, target])
    near = np.setdiff1d(_vertices_near(b, around.min(axis=0) - 1.5, around.max(axis=0) + 1.5), spared)
    return bool(((ring - origin) @ up > 1.0).all() and ((b.vertices[near] - origin) @ up < -CLEAR).all())


def _moved(mesh: Mesh, vertices: Numbers, target: Array) -> tuple[Mesh, Array]:
    points = mesh.vertices.copy()
    points[vertices] = target
    fan = np.isin(mesh.faces, vertices).any(axis=1)
    return Mesh(points, mesh.faces), points[mesh.faces[fan]]


def _vertex_to(a: Mesh, b: Mesh, face_a: int, face_b: int, height: float, note: str) -> Site | None:
    """Move a vertex of a to `height` mm above a vertex of b."""
    for w in b.faces[face_b]:
        up, origin = normal_at(b, faces_at(b, int(w))), b.vertices[w]
        target = stored(origin + height * up)
        order = np.argsort(np.linalg.norm(a.vertices[a.faces[face_a]] - origin, axis=1))
        for v in a.faces[face_a][order]:
            vertex = np.array([v])
            if _separated(a, vertex, target[None], b, np.array([w]), origin, up):
                return Site(*_with_place(_moved(a, vertex, target[None]), 0.5 * (target + origin), note))
    return None


def _with_place(moved: tuple[Mesh, Array], place: Array, note: str) -> tuple[Mesh, Array, str, Array]:
    return moved[0], place, note, moved[1]


def touching(a: Mesh, b: Mesh, face_a: int, face_b: int) -> Site | None:
    """P002: move a vertex of the first tissue exactly onto a vertex of the second."""
    return _vertex_to(a, b, face_a, face_b, 0.0, "moved a vertex of the first onto a vertex of the second")


def narrow_gap(a: Mesh, b: Mesh, face_a: int, face_b: int) -> Site | None:
    """P005: move a vertex of the first tissue to 0.5 mm above a vertex of the second."""
    return _vertex_to(a, b, face_a, face_b, 0.5, "moved a vertex of the first to 0.5 mm from a vertex of the second")


def crossing(a: Mesh, b: Mesh, face_a: int, face_b: int) -> Site | None:
    """P001: move a vertex of the first tissue below a face of the second."""
    around = np.array([face_b])
    up, middle = normal_at(b, around), b.vertices[b.faces[face_b]].mean(axis=0)
    deep = min(0.2, 0.3 * depth_below(b, middle, -up, around))
    target = stored(middle - deep * up)
    order = np.argsort(np.linalg.norm(a.vertices[a.faces[face_a]] - middle, axis=1))
    for v in a.faces[face_a][order]:
        fan = faces_at(a, int(v))
        if ((a.vertices[np.setdiff1d(a.faces[fan], [v])] - middle) @ up > 1.0).all():
            note = f"moved a vertex of the first {deep:.2g} mm below a face of the second"
            return Site(*_with_place(_moved(a, np.array([v]), target[None]), middle, note))
    return None


def coincident_face(a: Mesh, b: Mesh, face_a: int, face_b: int) -> Site | None:
    """P003: move a face of the first tissue exactly onto a face of the second."""
    if longest_edge(b, face_b)[1] > MAX_EDGE:
        return None
    theirs, ours = b.faces[face_b], a.faces[face_a]
    origin, up = b.vertices[theirs[0]], normal_at(b, np.array([face_b]))
    turns = [np.roll(theirs[::-1], k) for k in range(3)]
    target = b.vertices[min(turns, key=lambda turn: float(np.linalg.norm(b.vertices[turn] - a.vertices[ours])))]
    if normal_at(a, np.array([face_a])) @ up > -0.5 or not _separated(a, ours, target, b, theirs, origin, up):
        return None
    note = "moved a face of the first onto a face of the second"
    return Site(*_with_place(_moved(a, ours, target), target.mean(axis=0), note))


PAIR_PLANTS: dict[str, PairPlant] = {
    "P001": crossing,
    "P002": touching,
    "P003": coincident_face,
    "P005": narrow_gap,
}
