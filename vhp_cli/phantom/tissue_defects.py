"""Defects of one tissue. Each function breaks one rule at a place it is given, or returns None if it can't there.

The faces that a defect adds lie inside the tissue or at most 0.2 mm outside, so that no other tissue is met.
All new coordinates are float32 numbers, and whatever has to lie exactly on an edge or in a plane does so in them.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from vhp_cli.mesh import Mesh
from vhp_cli.phantom.sites import (
    Array,
    Site,
    across,
    depth_below,
    faces_at,
    frame_around,
    longest_edge,
    normal_at,
    outward_solid,
    stored,
    with_part,
)

Plant = Callable[[Mesh, int], Site | None]  # mesh, face near which to plant

TETRAHEDRON = np.array([[0, 1, 2], [0, 1, 3], [1, 2, 3], [0, 2, 3]])
OCTAHEDRON = np.array([[i, 2 + j, 4 + k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])

OUTSIDE = 0.2  # mm that a part may stick out
NO_FACES = np.empty((0, 3, 3))


def hole(mesh: Mesh, face: int) -> Site:
    """T001: remove all faces around a vertex."""
    vertex = int(mesh.faces[face, 0])
    fan = faces_at(mesh, vertex)
    rim = mesh.faces[fan]
    ends = mesh.vertices[[pair for row in rim for pair in [[v for v in row if v != vertex]]]]
    kept = np.delete(mesh.faces, fan, axis=0)
    kept = np.where(kept > vertex, kept - 1, kept)
    vertices = np.delete(mesh.vertices, vertex, axis=0)
    return Site(Mesh(vertices, kept), ends.mean(axis=(0, 1)), f"removed the {len(fan)} faces around a vertex", NO_FACES)


def shared_edge(mesh: Mesh, face: int) -> Site | None:
    """T002: hang a small closed part onto an edge, where four faces then meet."""
    corner, length = longest_edge(mesh, face)
    a, b = int(mesh.faces[face, corner]), int(mesh.faces[face, (corner + 1) % 3])
    pair = np.array([face, across(mesh, face, corner)[0]])
    normal = normal_at(mesh, pair)
    ends = mesh.vertices[[a, b]]
    middle = ends.mean(axis=0)
    depth = min(0.3 * length, 0.3 * depth_below(mesh, middle, -normal, pair))
    if depth < 0.1:
        return None
    sideways = np.cross(ends[1] - ends[0], normal) / length
    new = stored(middle - depth * normal + np.outer([0.3, -0.3], depth * sideways))
    faces = outward_solid(np.concatenate([ends, new]), TETRAHEDRON)
    part = np.array([a, b, -1, -2])[faces]
    changed = np.concatenate([ends, new])[faces]
    return Site(with_part(mesh, new, part), middle, "hung a small tetrahedron onto an edge, inside the tissue", changed)


def shared_vertex(mesh: Mesh, face: int) -> Site | None:
    """T003: hang a small closed part onto a vertex, around which there are then two fans of faces."""
    vertex = int(mesh.faces[face, 0])
    fan = faces_at(mesh, vertex)
    normal, tip = normal_at(mesh, fan), mesh.vertices[vertex]
    depth = min(0.35 * longest_edge(mesh, face)[1], 0.3 * depth_below(mesh, tip, -normal, fan))
    if depth < 0.1:
        return None
    u, v = frame_around(normal)
    turn = np.radians([0.0, 120.0, 240.0])
    new = stored(tip - depth * normal + 0.3 * depth * (np.outer(np.cos(turn), u) + np.outer(np.sin(turn), v)))
    points = np.concatenate([tip[None], new])
    faces = outward_solid(points, TETRAHEDRON)
    part = np.array([vertex, -1, -2, -3])[faces]
    note = "hung a small tetrahedron onto a vertex, inside the tissue"
    return Site(with_part(mesh, new, part), tip, note, points[faces])


def flipped_face(mesh: Mesh, face: int) -> Site:
    """T004: turn one face over."""
    faces = mesh.faces.copy()
    faces[face] = faces[face, ::-1]
    middle = mesh.vertices[mesh.faces[face, :2]].mean(axis=0)
    return Site(Mesh(mesh.vertices, faces), middle, "turned one face over", NO_FACES)


def inside_out(mesh: Mesh, face: int) -> Site:
    """T005: turn all faces over."""
    place = mesh.vertices[mesh.faces[face]].mean(axis=0)
    return Site(Mesh(mesh.vertices, mesh.faces[:, ::-1]), place, "turned the whole surface inside out", NO_FACES)


def duplicate_face(mesh: Mesh, face: int) -> Site:
    """T006: store one face twice, its corners in another order."""
    faces = np.concatenate([mesh.faces, np.roll(mesh.faces[face : face + 1], 1, axis=1)])
    place = mesh.vertices[mesh.faces[face]].mean(axis=0)
    return Site(Mesh(mesh.vertices, faces), place, "stored one face twice", NO_FACES)


def spike(mesh: Mesh, face: int) -> Site | None:
    """X001: pull a vertex inwards until it comes out of the wall on the other side."""
    vertex = int(mesh.faces[face, 0])
    fan = faces_at(mesh, vertex)
    normal, start = normal_at(mesh, fan), mesh.vertices[vertex]
    # The wall that is pierced must share no vertex with the faces that are pulled.
    near = np.flatnonzero(np.isin(mesh.faces, mesh.faces[fan]).any(axis=1))
    depth = depth_below(mesh, start, -normal, near)
    if not 1.0 < depth < 30.0 or depth_below(mesh, start, -normal, fan) < depth:
        return None
    vertices = mesh.vertices.copy()
    vertices[vertex] = stored(start - (depth + OUTSIDE) * normal)
    moved = Mesh(vertices, mesh.faces)
    note = f"pulled a vertex {depth + OUTSIDE:.3g} mm inwards, through the opposite wall"
    return Site(moved, start - depth * normal, note, vertices[mesh.faces[fan]])


def blob(mesh: Mesh, face: int) -> Site | None:
    """X001: add a small octahedron that sticks out through a face."""
    corners = mesh.vertices[mesh.faces[face]]
    around = np.array([face])
    normal, middle = normal_at(mesh, around), corners.mean(axis=0)
    length = longest_edge(mesh, face)[1]
    radius = min(0.3 * length, 0.3 * depth_below(mesh, middle, -normal, around))
    if radius < 0.15:
        return None
    out = min(OUTSIDE, 0.3 * radius)
    u, v = (0.4 * radius * axis for axis in frame_around(normal))
    centre = middle - (radius - out) * normal
    points = stored(centre + np.array([radius * normal, -radius * normal, u, -u, v, -v]))
    faces = outward_solid(points, OCTAHEDRON)
    note = f"added an octahedron that sticks out {out:.2g} mm through a face"
    return Site(with_part(mesh, points, -1 - faces), middle, note, points[faces])


def _flattened(mesh: Mesh, face: int) -> tuple[Mesh, Array, int, float] | None:
    """Move the corners of a face, by at most 0.1 mm, into a plane at right angles to an axis.

    Returns the mesh, the corners, the axis, and the direction of the outer normal along it (+1 or -1): points
    with the same coordinate on that axis lie exactly in the plane of the face.
    """
    corners = mesh.vertices[mesh.faces[face]]
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    axis = int(np.argmax(np.abs(normal)))
    level = float(np.float32(corners[:, axis].mean()))
    if np.abs(corners[:, axis] - level).max() > 0.1 or np.abs(normal[axis]) < 0.9 * np.linalg.norm(normal):
        return None
    vertices = mesh.vertices.copy()
    vertices[mesh.faces[face], axis] = level
    return Mesh(vertices, mesh.faces), vertices[mesh.faces[face]], axis, float(np.sign(normal[axis]))


def _touched_faces(mesh: Mesh, face: int) -> Array:
    return mesh.vertices[mesh.faces[np.isin(mesh.faces, mesh.faces[face]).any(axis=1)]]


def _below_face(mesh: Mesh, face: int, corners: Array, axis: int, outward: float) -> tuple[float, Array] | None:
    """Room below a flattened face (mm), and the inward unit vector."""
    inward = -outward * np.eye(3)[axis]
    depth = 0.3 * min(depth_below(mesh, corners.mean(axis=0), inward, np.array([face])), longest_edge(mesh, face)[1])
    return None if depth < 0.1 else (depth, inward)


def coplanar_overlap(mesh: Mesh, face: int) -> Site | None:
    """X002: add a small tetrahedron below a face, with one of its own faces exactly in the plane of that face."""
    flat = _flattened(mesh, face)
    if flat is None or (room := _below_face(flat[0], face, *flat[1:])) is None:
        return None
    changed, corners, axis, _ = flat
    middle = corners.mean(axis=0)
    top = stored(middle + 0.4 * (corners - middle))
    top[:, axis] = corners[0, axis]
    points = np.concatenate([top, stored(middle + room[0] * room[1])[None]])
    faces = outward_solid(points, TETRAHEDRON)
    note = "added a tetrahedron inside, one face of which lies in the plane of a face of the tissue"
    return Site(with_part(changed, points, -1 - faces), middle, note, _touched_faces(changed, face))


def fold(mesh: Mesh, face: int) -> Site | None:
    """X003: fold a flap along an edge so that it lies flat on the face beside it."""
    flat = _flattened(mesh, face)
    if flat is None:
        return None
    changed, corners, axis, _ = flat
    corner, _ = longest_edge(changed, face)
    a, b = (int(v) for v in np.roll(changed.faces[face], -corner)[:2])
    other, d = across(changed, face, corner)
    middle = 0.5 * (changed.vertices[a] + changed.vertices[b])
    inner = stored(0.6 * middle + 0.4 * corners.mean(axis=0))
    inner[axis] = corners[0, axis]
    vertices = np.concatenate([changed.vertices, inner[None]])
    e = len(changed.vertices)
    faces = np.concatenate([np.delete(changed.faces, other, axis=0), [[b, a, e], [b, e, d], [e, a, d]]])
    note = "folded a flap along an edge flat onto the face beside it"
    return Site(Mesh(vertices, faces.astype(np.int32)), middle, note, _touched_faces(changed, face))


def touch(mesh: Mesh, face: int) -> Site | None:
    """X004: add a small tetrahedron inside, the tip of which touches a face."""
    flat = _flattened(mesh, face)
    if flat is None or (room := _below_face(flat[0], face, *flat[1:])) is None:
        return None
    changed, corners, axis, _ = flat
    depth, inward = room
    tip = stored(corners.mean(axis=0))
    tip[axis] = corners[0, axis]
    u, v = (0.4 * depth * side for side in frame_around(inward))
    points = np.concatenate([tip[None], stored(tip + depth * inward + np.array([u, -0.5 * u + v, -0.5 * u - v]))])
    faces = outward_solid(points, TETRAHEDRON)
    note = "added a tetrahedron inside, the tip of which touches a face of the tissue"
    return Site(with_part(changed, points, -1 - faces), tip, note, _touched_faces(changed, face))


def _split(mesh: Mesh, face: int, corner: int, point: Array) -> Mesh:
    """Put a vertex at `point` into a face: three faces instead of one."""
    a, b, c = (int(v) for v in np.roll(mesh.faces[face], -corner))
    e = len(mesh.vertices)
    faces = np.concatenate([np.delete(mesh.faces, face, axis=0), [[a, b, e], [b, c, e], [c, a, e]]])
    return Mesh(np.concatenate([mesh.vertices, stored(point)[None]]), faces.astype(np.int32))


def sliver(mesh: Mesh, face: int) -> Site | None:
    """Q001: put a vertex into a face very near to an edge: q of the triangle between is about 0.001."""
    corner, length = longest_edge(mesh, face)
    if length < 1.0:
        return None
    a, b, c = mesh.vertices[np.roll(mesh.faces[face], -corner)]
    middle = 0.5 * (a + b)
    height = np.linalg.norm(np.cross(b - a, c - a)) / length
    point = middle + 0.012 * length / height * (c - middle)
    note = f"put a vertex {0.012 * length:.2g} mm beside an edge of {length:.3g} mm"
    return Site(_split(mesh, face, corner, point), middle, note, NO_FACES)


def short_edge(mesh: Mesh, face: int) -> Site | None:
    """Q002: split an edge, and the two faces at it, 0.004 mm from its end."""
    corner, length = longest_edge(mesh, face)
    a, b, c = (int(v) for v in np.roll(mesh.faces[face], -corner))
    other, d = across(mesh, face, corner)
    start, stop = mesh.vertices[a], mesh.vertices[b]
    point = stored(start + 0.004 / length * (stop - start))
    if not 0.003 < np.linalg.norm(point - start) < 0.005:
        return None
    e = len(mesh.vertices)
    kept = np.delete(mesh.faces, [face, other], axis=0)
    faces = np.concatenate([kept, [[a, e, c], [e, b, c], [b, e, d], [e, a, d]]])
    changed = Mesh(np.concatenate([mesh.vertices, point[None]]), faces.astype(np.int32))
    return Site(changed, start, "split an edge 0.004 mm from its end", NO_FACES)


def zero_area(mesh: Mesh, face: int) -> Site | None:
    """Q003: put a vertex exactly onto the middle of an edge, but into one of the two faces only."""
    corner, length = longest_edge(mesh, face)
    if length < 0.5:
        return None
    ends = np.roll(mesh.faces[face], -corner)[:2]
    # Multiples of 2^-10 mm below 256 mm have a middle that float32 holds exactly.
    on_grid = np.round(mesh.vertices[ends] * 1024) / 1024
    if np.abs(on_grid).max() >= 256:
        return None
    vertices = mesh.vertices.copy()
    vertices[ends] = on_grid
    changed = Mesh(vertices, mesh.faces)
    middle = on_grid.mean(axis=0)
    note = "put a vertex exactly onto an edge: a face with three points in a line"
    return Site(_split(changed, face, corner, middle), middle, note, _touched_faces(changed, face))


PLANTS: dict[str, tuple[Plant, ...]] = {
    "T001": (hole,),
    "T002": (shared_edge,),
    "T003": (shared_vertex,),
    "T004": (flipped_face,),
    "T005": (inside_out,),
    "T006": (duplicate_face,),
    "X001": (spike, blob),
    "X002": (coplanar_overlap,),
    "X003": (fold,),
    "X004": (touch,),
    "Q001": (sliver,),
    "Q002": (short_edge,),
    "Q003": (zero_area,),
}
