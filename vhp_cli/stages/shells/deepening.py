"""Push a shell inward where it is a bit too shallow, under the guards of smoothing."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vhp_cli.kernels import surface
from vhp_cli.kernels.measuring import closest
from vhp_cli.kernels.spatial import Tree, gap
from vhp_cli.mesh import Mesh
from vhp_cli.stages.shells.layer import Layer
from vhp_cli.stages.shells.parts import quartered
from vhp_cli.stages.shells.projections import projected
from vhp_cli.stages.smooth.guard import Guard, Limits

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_ROUNDS = 16
# Without less than this part of all that is lacking in so many rounds, it is given up.
_PROGRESS, _PATIENCE = 0.9, 2
# Faces that are deep enough by less than this part of the thickness, or of what depth differs between their points, are
# looked at in parts of such a size.
_NEARLY, _BENT, _PART_SIZE, _MOST_SPLITS = 0.03, 0.5, 0.4, 2
# Points of edges that are looked at where the outer surface bulges inward.
_ALONG = (0.2, 0.4, 0.6, 0.8)
# The gap is widened where it is the smallest, again and again, if it lacks no more than this part of the thickness.
_GAP_ROUNDS, _MOST_MISSING, _LITTLE = 40, 0.05, 0.01
# Where thickness varies, so little may be lacking, as a share of the least.
_NEGLIGIBLE = 0.005
# What a shell lacks in depth it moves so many times over.
_MORE = 1.1
_DEVIATION, _LEAST_QUALITY, _LEAST_EDGE = 1.0, 0.05, 0.01


class Deepened(NamedTuple):
    """A shell, its gap from the surface around it in mm, and the numbers of faces that are too shallow still."""

    mesh: Mesh
    gap_mm: float
    shallow: Ints


def deepened(mesh: Mesh, layer: Layer, faces: Ints, *, share: float) -> Deepened:
    """Push faces inward that are too shallow: at first by points of them, then by the exact gap.

    Parameters
    ----------
    mesh
        The shell, sound, with float32 values as coordinates.
    layer
        Its layer.
    faces : (N,) int64
        Numbers of the faces that may be too shallow.
    share
        Share of the thickness by which they shall be deeper than asked.
    """
    pushed = _Pushed(mesh, layer)
    progress = _Progress()
    for _ in range(_ROUNDS):
        faces, points, need = _shallow_points(pushed.mesh, layer, share, faces)
        if not len(need) or not progress.goes_on(float(need.sum())):
            break
        near = closest(layer.tree, points)
        moved = pushed.push(faces, (points - near.points) / np.maximum(near.distances, 1e-12)[:, None], _MORE * need)
        if not len(moved):
            break
        # Faces that could not be moved stay in view, as those around may make room.
        faces = np.union1d(faces, moved)
    seen, stuck = faces, np.empty(0, np.int64)
    ridges, progress = _ridges(layer), _Progress()
    for _ in range(_ROUNDS):
        faces, directions, need = _below_ridges(pushed.mesh, layer, share, ridges)
        if not len(need) or not progress.goes_on(float(need.sum())):
            break
        if not len(pushed.push(faces, directions, _MORE * need)):
            break
    reached, progress = 0.0, _Progress()
    for _ in range(_GAP_ROUNDS):
        nearest = gap(layer.tree, Tree(pushed.mesh.vertices, pushed.mesh.faces))
        reached = 0.0 if nearest is None or nearest.contact_kind else nearest.distance
        missing = layer.least - reached
        if nearest is None or missing <= 0:
            break
        face = np.array(nearest.faces[1:], dtype=np.int64)
        if missing > _MOST_MISSING * layer.least or not progress.goes_on(missing):
            stuck = face
            break
        way = (nearest.points[1] - nearest.points[0]) / max(nearest.distance, 1e-12)
        if not len(pushed.push(face, way[None], _MORE * missing + _LITTLE * layer.least)):
            stuck = face
            break
    shallow, _, need = _shallow_points(pushed.mesh, layer, 0.0, seen)
    return Deepened(pushed.mesh, reached, np.union1d(shallow[need > _NEGLIGIBLE * layer.least], stuck))


class _Progress:
    """Tells whether something that should vanish still gets less."""

    def __init__(self) -> None:
        self._least = np.inf
        self._idle = 0

    def goes_on(self, value: float) -> bool:
        """Take note of a value, and return False if it has not got less by much for a while."""
        if value < _PROGRESS * self._least:
            self._least, self._idle = value, 0
        else:
            self._idle += 1
        return self._idle <= _PATIENCE


class _Pushed:
    """A shell of which faces are pushed under guard."""

    def __init__(self, mesh: Mesh, layer: Layer) -> None:
        self.mesh = mesh
        self._limits = Limits(_DEVIATION * layer.most, _LEAST_QUALITY, _LEAST_EDGE * layer.least)
        self._guard: Guard | None = None

    def push(self, faces: Ints, directions: Floats, lengths: Floats | float) -> Ints:
        """Move the corners of faces (N,) in directions (N, 3); return the numbers of all faces that changed."""
        if self._guard is None:
            self._guard = Guard(self.mesh, self._limits)
        own = self.mesh.faces[faces].ravel().astype(np.int64)
        order = np.argsort(own, kind="stable")
        demands = np.broadcast_to(lengths, len(faces))[order // 3]
        ways = projected(np.zeros_like(self.mesh.vertices), own[order], directions[order // 3], demands)
        before = self.mesh
        if not self._guard.complete:
            return np.empty(0, np.int64)
        self.mesh = self._guard.settle(before, before.vertices + ways).mesh
        changed = (self.mesh.vertices != before.vertices).any(axis=1)
        return np.flatnonzero(changed[self.mesh.faces].any(axis=1))


def _ridges(layer: Layer) -> Floats:
    """Return points (P, 3) of the outer surface near to what is within: vertices, and edges that bulge inward."""
    outer = layer.outer
    joined = surface.topology(outer.vertices, outer.faces)
    first, second = (outer.faces[joined.inner_edge_faces[:, side]] for side in range(2))
    a, b, c = (outer.vertices[first[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    across = outer.vertices[second].sum(axis=1) - 3 * a
    inward = joined.inner_edges[(normals * across).sum(axis=1) > 0]
    start, end = outer.vertices[inward[:, 0]], outer.vertices[inward[:, 1]]
    return np.concatenate([outer.vertices, *((1 - part) * start + part * end for part in _ALONG)])


def _below_ridges(mesh: Mesh, layer: Layer, share: float, ridges: Floats) -> tuple[Ints, Floats, Floats]:
    """Return faces that are too near to such points, in which direction they have to go, and how far in mm."""
    near = closest(Tree(mesh.vertices, mesh.faces), ridges, (1 + share) * layer.most)
    at = np.flatnonzero(near.faces >= 0)
    points = near.points[at]
    depth, wanted = layer.distances(points, 2 * layer.most)
    need = (1 + share) * wanted - depth
    keep = (need > share * wanted) & (near.distances[at] > 0)
    at, points = at[keep], points[keep]
    directions = (points - ridges[at]) / near.distances[at, None]
    return near.faces[at].astype(np.int64), directions, need[keep]


def _shallow_points(mesh: Mesh, layer: Layer, share: float, faces: Ints) -> tuple[Ints, Floats, Floats]:
    """Return points of some faces (their numbers, and where) that are too shallow, and by how much in mm.

    Corners, middles of sides and centres are looked at, and the same of parts of faces that are nearly too shallow.
    """
    corners = mesh.vertices[mesh.faces[faces]]
    found_faces, found_points, found_need = [], [], []
    for level in range(_MOST_SPLITS + 1):
        middles = (corners + np.roll(corners, -1, axis=1)) / 2
        points = np.concatenate([corners, middles, corners.mean(axis=1, keepdims=True)], axis=1)
        depth, wanted = layer.distances(points.reshape(-1, 3), 2 * layer.most)
        need = ((1 + share) * wanted - depth).reshape(-1, 7)
        worst, most = need.argmax(axis=1), need.max(axis=1)
        at = np.flatnonzero(most > 0)
        found_faces.append(faces[at])
        found_points.append(points[at, worst[at]])
        found_need.append(most[at])
        longest = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2).max(axis=1)
        thickness = wanted.reshape(-1, 7)[:, 6]
        nearly = np.maximum(_NEARLY * thickness, _BENT * (most - need.min(axis=1)))
        more = (most <= 0) & (most > -nearly) & (longest > _PART_SIZE * thickness)
        if level == _MOST_SPLITS or not more.any():
            break
        faces, corners = np.repeat(faces[more], 4), quartered(corners[more])
    return np.concatenate(found_faces), np.concatenate(found_points), np.concatenate(found_need)
