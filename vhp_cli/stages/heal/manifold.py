"""Cut a mesh into manifold surfaces: at edges with more than two faces, and at vertices with more than one fan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vhp_cli.inspection.places import MAX_PLACES, at_faces, point
from vhp_cli.kernels.repairing import BOUNDARY, CROWDED, mates, orient_patches, radial_order, split_fans
from vhp_cli.kernels.spatial import Tree
from vhp_cli.kernels.surface import quality, topology
from vhp_cli.measures import Action, Place
from vhp_cli.mesh import Mesh
from vhp_cli.rounding import rounded
from vhp_cli.stages.heal.candidate import face_areas
from vhp_cli.stages.heal.orientation import patch_volumes

# A wall or fin that hangs on edges with more than two faces is dropped only up to this share of the area.
_FIN_SHARE = 0.5
# Walls and fins are sheets: the square of the length of their border is at least this multiple of their area (a disc:
# 12.6, a hemisphere: 6.3). Less is a part or a cavity with a small hole.
_SHEET_BORDER = 2.0
# A fin is flat: its volume with the borders closed, over area^1.5, is below this; else it is a part with a hole.
_FIN_VOLUME = 0.01
_SAMPLES = 15
_MOST_ROUNDS = 8


def make_manifold(mesh: Mesh) -> tuple[Mesh, list[Action]]:
    """Separate the surfaces that meet in non-manifold edges and vertices.

    At an edge with 2 k faces that agree in orientation, those are joined that bound solid between them, in the order
    of their angles (exact); else the neighbours that continue each other most smoothly, the same ones all along a
    seam of the same patches. A face left over is cut off. Then each fan of a vertex gets a vertex of its own; only
    open fans stay together, as closing their holes may join them. What was cut off with no open edge left behind, a
    wall within or a fin, is dropped.

    The result is manifold by its indices; where vertices still lie on each other, see `separation.separate`.

    Parameters
    ----------
    mesh
        Any mesh without collapsed faces.
    """
    actions: list[Action] = []
    apart = np.zeros(len(mesh.vertices), np.bool_)
    glued, crowds = mates(mesh.faces, len(mesh.vertices))
    if crowds:
        mesh, glued, done = _cut_seams(mesh)
        actions += done
        apart = np.zeros(len(mesh.vertices), np.bool_)
        crowded = mates(mesh.faces, len(mesh.vertices))[0] == CROWDED
        apart[mesh.faces[crowded]] = apart[np.roll(mesh.faces, -1, axis=1)[crowded]] = True
    fresh = _split_vertices(mesh, glued, apart)
    if crowds:
        fresh = _split_edges(fresh, glued)
    extra = fresh.vertices[len(mesh.vertices) :]
    if len(extra):
        message = f"{len(extra)} vertices added where parts of the surface met in a point or an edge"
        places: list[Place] = [{"xyz_mm": point(xyz), "face": None} for xyz in extra[:MAX_PLACES]]
        actions.append({"step": "manifold", "message": message, "count": len(extra), "places": places})
        mesh = fresh
    return mesh, actions


def _split_vertices(mesh: Mesh, glued: NDArray[np.int32], apart: NDArray[np.bool_]) -> Mesh:
    """Split vertices by fans; the open fans of a vertex stay one, unless it is marked in `apart`."""
    faces, origin = split_fans(mesh.faces, glued, len(mesh.vertices))
    if not len(origin):
        return mesh
    old = np.concatenate([np.arange(len(mesh.vertices)), origin])
    together = np.zeros(len(old), np.bool_)
    together[faces[glued < 0]] = together[np.roll(faces, -1, axis=1)[glued < 0]] = True
    fans = np.flatnonzero(together & ~apart[old])
    # The first open fan of each vertex stands for all of them.
    first = np.full(len(mesh.vertices), len(old))
    np.minimum.at(first, old[fans], fans)
    stand_in = np.arange(len(old))
    stand_in[fans] = first[old[fans]]
    chosen = stand_in[faces]
    new = np.unique(chosen[chosen >= len(mesh.vertices)])
    chosen = np.where(chosen >= len(mesh.vertices), len(mesh.vertices) + np.searchsorted(new, chosen), chosen)
    return Mesh(mesh.vertices[np.concatenate([np.arange(len(mesh.vertices)), old[new]])], chosen.astype(np.int32))


def _split_edges(mesh: Mesh, glued: NDArray[np.int32]) -> Mesh:
    """Cut the edges that still have more than two faces in their middle, with a new vertex for each joined pair.

    The two ends of such an edge can't be split, as its faces are joined round them by other faces.
    """
    _, crowds = mates(mesh.faces, len(mesh.vertices))
    if not crowds:
        return mesh
    pairs = glued.ravel()
    middle: dict[int, int] = {}
    points: list[NDArray[np.float64]] = []
    for half_edge in map(int, np.concatenate(crowds)):
        if half_edge in middle:
            continue
        face, k = divmod(half_edge, 3)
        ends = mesh.vertices[mesh.faces[face, [k, (k + 1) % 3]]]
        middle[half_edge] = len(mesh.vertices) + len(points)
        if pairs[half_edge] >= 0:
            middle[int(pairs[half_edge])] = middle[half_edge]
        # What is written is float32.
        points.append(rounded(ends.mean(axis=0)))
    cut = sorted({half_edge // 3 for half_edge in middle})
    pieces: list[tuple[int, int, int]] = []
    for face in cut:
        pieces += _cut_face(mesh.faces[face].tolist(), [middle.get(3 * face + k) for k in range(3)])
    whole = np.ones(len(mesh.faces), np.bool_)
    whole[cut] = False
    return Mesh(np.concatenate([mesh.vertices, points]), np.concatenate([mesh.faces[whole], pieces]))


def _cut_face(corners: list[int], middles: list[int | None]) -> list[tuple[int, int, int]]:
    """Return the pieces of a face with new vertices in the middle of some of its edges."""
    rim = [vertex for pair in zip(corners, middles, strict=True) for vertex in pair if vertex is not None]
    pieces = []
    # Cut off the corners between two middles, then what is left at a middle.
    for k, corner in enumerate(corners):
        before, after = middles[k - 1], middles[k]
        if before is not None and after is not None:
            pieces.append((before, corner, after))
            rim.remove(corner)
    start = next(i for i, vertex in enumerate(rim) if vertex not in corners)
    rim = rim[start:] + rim[:start]
    return pieces + [(rim[0], rim[i], rim[i + 1]) for i in range(1, len(rim) - 1)]


@dataclass(frozen=True, slots=True, eq=False)
class _Seam:
    """An edge with more than two faces.

    Parameters
    ----------
    half_edges : (k,) int64
        By angle about the edge, counter-clockwise seen against its direction from the lower to the upper vertex.
    angles : (k,) int32
        Rank of the angle; the same for faces that lie on each other.
    forward : (k,) bool
        Whether the face runs from the lower to the upper vertex.
    directions : (k, 3) float64
        Unit vectors into the faces, perpendicular to the edge; zero for a face without area.
    """

    half_edges: NDArray[np.int64]
    angles: NDArray[np.int32]
    forward: NDArray[np.bool_]
    directions: NDArray[np.float64]


def _seams(mesh: Mesh, crowds: list[NDArray[np.int64]]) -> list[_Seam]:
    start = mesh.faces.ravel()
    end = np.roll(mesh.faces, -1, axis=1).ravel()
    opposite = np.roll(mesh.faces, -2, axis=1).ravel()
    axes = np.array([sorted((start[crowd[0]], end[crowd[0]])) for crowd in crowds], np.int32)
    around = radial_order(mesh.vertices, axes, [opposite[crowd] for crowd in crowds])
    seams = []
    for crowd, axis, (order, angles) in zip(crowds, axes, around, strict=True):
        half_edges = crowd[order]
        origin, along = mesh.vertices[axis[0]], mesh.vertices[axis[1]] - mesh.vertices[axis[0]]
        arms = mesh.vertices[opposite[half_edges]] - origin
        arms -= np.outer(arms @ along, along) / max(float(along @ along), 1e-300)
        arms /= np.maximum(np.linalg.norm(arms, axis=1), 1e-300)[:, None]
        seams.append(_Seam(half_edges, angles, start[half_edges] == axis[0], arms))
    return seams


def _cut_seams(mesh: Mesh) -> tuple[Mesh, NDArray[np.int32], list[Action]]:
    """Decide which faces stay joined at the edges with more than two, and drop walls and fins."""
    actions: list[Action] = []
    count = 0
    for _ in range(_MOST_ROUNDS):
        glued, crowds = mates(mesh.faces, len(mesh.vertices))
        if not crowds:
            break
        count = max(count, len(crowds))
        glued = _glue_seams(mesh, glued, _seams(mesh, crowds))
        fins = _fins(mesh, glued, crowds)
        if not fins.any():
            break
        dropped = np.flatnonzero(fins)
        areas = face_areas(mesh)[dropped]
        largest = np.argsort(-areas, kind="stable")[:MAX_PLACES]
        actions.append(
            {
                "step": "manifold",
                "message": f"{len(dropped)} faces of walls within or of fins dropped, {areas.sum():.3g} mm2",
                "count": len(dropped),
                "places": at_faces(mesh, dropped[largest], np.sqrt(areas[largest])),
                "area_mm2": float(areas.sum()),
            }
        )
        mesh = Mesh(mesh.vertices, mesh.faces[~fins])
    else:
        glued, crowds = mates(mesh.faces, len(mesh.vertices))
        if crowds:
            glued = _glue_seams(mesh, glued, _seams(mesh, crowds))
    message = f"{count} edges with more than two faces cut"
    actions.append({"step": "manifold", "message": message, "count": count, "places": []})
    return mesh, glued, actions


def _glue_seams(mesh: Mesh, glued: NDArray[np.int32], seams: list[_Seam]) -> NDArray[np.int32]:
    """Return the mates with the half-edges of the seams glued in pairs, as far as they go."""
    turned, patch, twisted = orient_patches(mesh.faces, glued)
    component = topology(mesh.vertices, mesh.faces).component
    volume = quality(mesh.vertices, mesh.faces, component, int(component.max()) + 1).component_volume
    result = glued.ravel().copy()
    unclear: dict[tuple[int, ...], list[_Seam]] = {}
    for seam in seams:
        face = seam.half_edges // 3
        if turned[face].any() or 2 * seam.forward.sum() != len(face) or not seam.directions.any(axis=1).all():
            # The same patches meet along a seam: decide for all of it at once.
            unclear.setdefault(tuple(sorted(patch[face].tolist())), []).append(seam)
            continue
        # About the edge, solid begins behind a face that runs backward and ends at one that runs forward.
        ends = seam.forward if volume[component[face[0]]] >= 0 else ~seam.forward
        # Of faces on each other the ends come first: between two solids that touch there is nothing, not a solid.
        order = np.lexsort((~ends, seam.angles))
        for i, j in order[_brackets(ends[order].tolist())].tolist():
            result[seam.half_edges[i]], result[seam.half_edges[j]] = seam.half_edges[j], seam.half_edges[i]
    n_patches = len(twisted)
    areas = np.bincount(patch, face_areas(mesh), minlength=n_patches)
    is_free = np.bincount(patch, (glued == BOUNDARY).any(axis=1), minlength=n_patches) > 0
    for group in unclear.values():
        smoothness = _smoothness(group, patch)
        own = patch[group[0].half_edges // 3]
        smallest = int(own[np.argmin(areas[own])])
        # A small patch with a border of its own, on an odd number of faces, is a fin: the others close without it.
        fin = smallest if len(own) % 2 and is_free[smallest] else -1
        for seam in group:
            # Faces that agree in orientation all along must agree across the edge too, or the surface gets one-sided.
            agreeing = None if turned.any() else seam.forward
            for i, j in _smooth_pairs(seam, patch, smoothness, fin, agreeing):
                result[seam.half_edges[i]], result[seam.half_edges[j]] = seam.half_edges[j], seam.half_edges[i]
    return result.reshape(-1, 3)


def _brackets(ends: list[bool]) -> list[tuple[int, int]]:
    """Match the places round a circle that open (False) with those that close (True), like brackets."""
    pairs = []
    waiting: list[int] = []
    # Twice round: what opens before the start closes after it.
    matched: set[int] = set()
    for place in [*range(len(ends)), *range(len(ends))]:
        if place in matched:
            continue
        if not ends[place]:
            if place not in waiting:
                waiting.append(place)
        elif waiting:
            start = waiting.pop()
            pairs.append((start, place))
            matched |= {start, place}
    return pairs


def _smoothness(group: list[_Seam], patch: NDArray[np.int32]) -> dict[tuple[int, int], float]:
    """Return the sum over a seam of -cos of the angle between pairs of patches: large if they go straight on."""
    total: dict[tuple[int, int], float] = {}
    for seam in group:
        own = patch[seam.half_edges // 3].tolist()
        for i in range(len(own)):
            for j in range(i):
                pair = (min(own[i], own[j]), max(own[i], own[j]))
                total[pair] = total.get(pair, 0.0) - float(seam.directions[i] @ seam.directions[j])
    return total


def _smooth_pairs(
    seam: _Seam,
    patch: NDArray[np.int32],
    smoothness: dict[tuple[int, int], float],
    fin: int,
    forward: NDArray[np.bool_] | None,
) -> list[tuple[int, int]]:
    """Pair neighbours about the seam, the smoothest first; pairs never cross each other. One face of `fin` is left.

    If `forward` is given, only faces that run opposite ways along the edge are joined.
    """
    own = patch[seam.half_edges // 3].tolist()
    left = list(range(len(own)))
    if fin in own:
        left.remove(own.index(fin))
    pairs = []
    while len(left) > 1:
        rated = []
        for place in range(len(left)):
            i, j = left[place - 1], left[place]
            if forward is None or forward[i] != forward[j]:
                along = smoothness[min(own[i], own[j]), max(own[i], own[j])]
                rated.append((along, -float(seam.directions[i] @ seam.directions[j]), -place))
        if not rated:
            break
        place = -max(rated)[2]
        pairs.append((left[place - 1], left[place]))
        left = [other for other in left if other not in pairs[-1]]
    return pairs


def _fins(mesh: Mesh, glued: NDArray[np.int32], crowds: list[NDArray[np.int64]]) -> NDArray[np.bool_]:
    """Mark what was cut off: faces of their own, and patches of a closed surface that are walls within it or fins."""
    flat = glued.ravel()
    drop = np.zeros(len(mesh.faces), np.bool_)
    cut = [crowd[flat[crowd] < 0] for crowd in crowds]
    if not any(len(own) for own in cut):
        return drop
    turned, patch, _ = orient_patches(mesh.faces, glued)
    n_patches = int(patch.max()) + 1
    half_edge_patch = np.repeat(patch, 3)
    at_seam = np.zeros(len(flat), np.bool_)
    at_seam[np.concatenate(cut)] = True
    # A face that is joined to nothing any more.
    lone = (np.bincount(patch) == 1)[patch] & at_seam.reshape(-1, 3).any(axis=1)
    if lone.any():
        return np.asarray(lone, np.bool_)
    hangs = np.zeros(n_patches, np.bool_)
    hangs[half_edge_patch[at_seam]] = True
    is_free = np.zeros(n_patches, np.bool_)
    is_free[half_edge_patch[(flat < 0) & ~at_seam]] = True
    areas = face_areas(mesh)
    share = np.bincount(patch, areas) / max(float(areas.sum()), 1e-300)
    closed = ~hangs & ~is_free
    if not closed.any():
        return drop
    tree = Tree(mesh.vertices, mesh.faces[closed[patch]])
    oriented = np.where(turned[:, None], mesh.faces[:, ::-1], mesh.faces)
    volumes = patch_volumes(mesh.vertices, oriented, patch, n_patches)
    flatness = np.abs(volumes) / np.maximum(np.bincount(patch, areas), 1e-300) ** 1.5
    ends = mesh.vertices[np.stack([mesh.faces, np.roll(mesh.faces, -1, axis=1)])]
    sides = np.where(glued < 0, np.linalg.norm(ends[1] - ends[0], axis=2), 0.0).sum(axis=1)
    is_sheet = np.bincount(patch, sides) ** 2 >= _SHEET_BORDER * np.bincount(patch, areas)
    for fin in np.flatnonzero(hangs & is_sheet & (share <= _FIN_SHARE)):
        own = patch == fin
        # All that it hung on must be closed without it.
        beside = [flat_patch for crowd in crowds if own[crowd // 3].any() for flat_patch in patch[crowd // 3].tolist()]
        if not all(closed[other] or other == fin for other in beside):
            continue
        members = np.flatnonzero(own)
        widest = members[np.argsort(-areas[members], kind="stable")[:_SAMPLES]]
        inside = tree.inside(mesh.vertices[mesh.faces[widest]].mean(axis=1)) == 1
        if 2 * inside.sum() > len(inside) or (is_free[fin] and flatness[fin] < _FIN_VOLUME):
            drop |= own
    return drop
