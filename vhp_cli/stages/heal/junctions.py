"""Close cracks: borders that lie along each other within a small tolerance, but do not share their vertices."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from vhp_cli.inspection.places import MAX_PLACES, point
from vhp_cli.kernels.reading import weld
from vhp_cli.kernels.repairing import CROWDED, mates
from vhp_cli.measures import Action, Place
from vhp_cli.mesh import Mesh
from vhp_cli.stages.heal.candidate import diagonal

# Widest crack, as a share of the diagonal and in mm.
_WIDTH_SHARE = 5e-4
_WIDTH_MOST = 0.05
# A vertex is taken into an edge only if its distance is at most this share of that to either end, and two vertices are
# joined only within this share of the shortest border edge there: no face is bent or collapsed noticeably.
_SLANT = 0.05
_EDGE_SHARE = 0.25
_MOST_ROUNDS = 10
# Edges compared with the vertices near them at a time.
_BLOCK = 64


def join_cracks(mesh: Mesh, width: float | None = None) -> tuple[Mesh, list[Action]]:
    """Close cracks along the borders of a mesh.

    Border vertices that nearly coincide are merged, and a border edge on which other border vertices lie (T-junctions)
    is cut there. Either is undone if it makes edges with more than two faces.

    Parameters
    ----------
    mesh
        Any mesh without collapsed faces.
    width
        Widest crack in mm; None: 0.05 % of the diagonal, at most 0.05 mm.
    """
    glued, _ = mates(mesh.faces, len(mesh.vertices))
    if not (glued < 0).any():
        return mesh, []
    if width is None:
        width = min(_WIDTH_SHARE * diagonal(mesh), _WIDTH_MOST)
    merged = cut = 0
    places: list[NDArray[np.float64]] = []
    for _ in range(_MOST_ROUNDS):
        mesh, joined = _merge(mesh, width)
        mesh, met = _cut(mesh, width)
        merged += len(joined)
        cut += len(met)
        places += [joined, met]
        if not len(met):
            break
    actions: list[Action] = []
    if merged or cut:
        spots: list[Place] = [{"xyz_mm": point(xyz), "face": None} for xyz in np.concatenate(places)[:MAX_PLACES]]
        message = (
            f"cracks closed: {merged} border vertices merged, {cut} border edges cut at a vertex within {width:.2g} mm"
        )
        actions.append({"step": "junctions", "message": message, "count": merged + cut, "places": spots})
    return mesh, actions


def _open_edges(mesh: Mesh) -> tuple[NDArray[np.int64], NDArray[np.int64], int]:
    """Return face and side of the border half-edges, and the number of half-edges at crowded edges."""
    glued, _ = mates(mesh.faces, len(mesh.vertices))
    face, k = np.nonzero((glued < 0) & (glued != CROWDED))
    return face, k, int((glued == CROWDED).sum())


def _merge(mesh: Mesh, width: float) -> tuple[Mesh, NDArray[np.float64]]:
    """Merge border vertices that lie within a share of the border edges there; returns where."""
    nothing = np.empty((0, 3))
    face, k, crowded = _open_edges(mesh)
    if not len(face):
        return mesh, nothing
    start, end = mesh.faces[face, k], mesh.faces[face, (k + 1) % 3]
    border, index = np.unique(np.stack([start, end]), return_inverse=True)
    index = index.reshape(2, -1)
    shortest = np.full(len(border), np.inf)
    sides = np.linalg.norm(mesh.vertices[start] - mesh.vertices[end], axis=1)
    for row in index:
        np.minimum.at(shortest, row, sides)
    _, group = weld(mesh.vertices[border], width)
    count = np.bincount(group)
    # Of a group that is too long for its edges, nobody is merged.
    first = np.unique(group, return_index=True)[1]
    reach = np.linalg.norm(mesh.vertices[border] - mesh.vertices[border[first[group]]], axis=1)
    too_far = np.zeros(len(count), np.bool_)
    too_far[group[reach > np.minimum(2 * width, _EDGE_SHARE * shortest)]] = True
    chosen = (count[group] > 1) & ~too_far[group]
    if not chosen.any():
        return mesh, nothing
    target = np.arange(len(mesh.vertices))
    target[border[chosen]] = border[first[group[chosen]]]
    faces = target[mesh.faces]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    trial = Mesh(mesh.vertices, faces)
    left, _, crowded_now = _open_edges(trial)
    if crowded_now > crowded or len(left) >= len(face):
        return mesh, nothing
    return trial, mesh.vertices[np.flatnonzero(target != np.arange(len(target)))]


def _cut(mesh: Mesh, width: float) -> tuple[Mesh, NDArray[np.float64]]:
    """Cut border edges at border vertices that lie on them; returns where."""
    face, k, crowded = _open_edges(mesh)
    start, end = mesh.faces[face, k], mesh.faces[face, (k + 1) % 3]
    edge, vertex, along = _on_edges(mesh.vertices, start, end, width)
    # A vertex of the face itself can't be taken into its edge.
    outside = (mesh.faces[face[edge]] != vertex[:, None]).all(axis=1)
    edge, vertex, along = edge[outside], vertex[outside], along[outside]
    # One edge of a face in a round: its other edges move to other faces.
    own = np.full(len(mesh.faces), len(face))
    np.minimum.at(own, face[edge], edge)
    first = own[face[edge]] == edge
    edge, vertex, along = edge[first], vertex[first], along[first]
    if not len(edge):
        return mesh, np.empty((0, 3))
    order = np.lexsort((vertex, along, edge))
    edge, vertex = edge[order], vertex[order]
    fresh = []
    for one in np.unique(edge):
        tip = mesh.faces[face[one], (k[one] + 2) % 3]
        chain = [start[one], *dict.fromkeys(vertex[edge == one].tolist()), end[one]]
        fresh += [(a, b, tip) for a, b in pairwise(chain)]
    whole = np.ones(len(mesh.faces), np.bool_)
    whole[face[edge]] = False
    trial = Mesh(mesh.vertices, np.concatenate([mesh.faces[whole], np.array(fresh, np.int32)]))
    left, _, crowded_now = _open_edges(trial)
    if crowded_now > crowded or len(left) >= len(face):
        return mesh, np.empty((0, 3))
    return trial, mesh.vertices[vertex]


def _on_edges(
    vertices: NDArray[np.float64], start: NDArray[np.int32], end: NDArray[np.int32], width: float
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Return number of the edge, vertex, and place along the edge, for the ends of edges that lie on other edges."""
    ends = np.unique(np.concatenate([start, end])).astype(np.int64)
    found: list[tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]] = [
        (np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0))
    ]
    ends = ends[np.argsort(vertices[ends, 0], kind="stable")]
    points = vertices[ends]
    # Along x, only the vertices between the two ends of an edge can lie on it.
    low = np.minimum(vertices[start, 0], vertices[end, 0]) - width
    high = np.maximum(vertices[start, 0], vertices[end, 0]) + width
    order = np.argsort(low, kind="stable")
    for chosen in np.array_split(order, max(1, len(order) // _BLOCK)):
        if not len(chosen):
            continue
        begin, stop = np.searchsorted(points[:, 0], [low[chosen].min(), high[chosen].max()])
        a = vertices[start[chosen]][:, None]
        side = vertices[end[chosen]][:, None] - a
        length = np.maximum(np.linalg.norm(side, axis=2), 1e-300)
        along = np.einsum("eij,evj->ev", side, points[None, begin:stop] - a) / length
        away = np.linalg.norm(points[None, begin:stop] - a - (along / length)[:, :, None] * side, axis=2)
        from_ends = np.minimum(along, length - along)
        edge, place = np.nonzero((away <= width) & (away <= _SLANT * from_ends) & (from_ends > 0))
        found.append((chosen[edge], ends[begin + place], along[edge, place]))
    edges, on, along_edges = zip(*found, strict=True)
    return np.concatenate(edges), np.concatenate(on), np.concatenate(along_edges)
