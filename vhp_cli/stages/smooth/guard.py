"""Take new positions of vertices only as far as the surface stays as sound as it was.

Proposed positions are rounded to float32 and judged as such. Where something is wrong, the vertices around go part of
the way back, in the end to where they were; nobody goes forward again. With all of them back the surface is the one
from before, so that this ends, and ends with a surface that breaks no guard.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vhp_cli.kernels import surface
from vhp_cli.kernels.measuring import closest
from vhp_cli.kernels.spatial import Tree
from vhp_cli.mesh import Mesh, vertex_normals
from vhp_cli.rounding import rounded

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]

# Parts of the way that a vertex tries, one after the other.
_PARTS = np.array([1.0, 0.5, 0.2, 0.0])
# No face turns by more than 60 degrees at once; one below this q has no normal to speak of.
_LEAST_TURN_COSINE = 0.5
_FLAT_QUALITY = 0.02
# A triangle below this q has next to no area.
_NO_AREA = 1e-9
# Edges are never folded more sharply than this.
_SHARPEST_TURN_DEG = 179.5
# The surface is looked at in points only, and between them it is a little farther away.
_MARGIN = 0.9
# Targets are drawn so near, as a part of the deviation, that the faces between them have a chance to keep it too.
_REACH = 0.6
# Contacts to list besides those that were there before; more are found in the next round.
_LISTED_CONTACTS = 4096
# Rounds of offsets, and the share of the tolerance that is left alone.
_VOLUME_ROUNDS = 6
_VOLUME_LEFT = 0.1
# An offset is taken to gain at least this part of the area times its length.
_LEAST_GAIN = 0.2


@dataclass(frozen=True, slots=True)
class Limits:
    """What has to hold after every change.

    Parameters
    ----------
    deviation_mm
        Largest distance between the surface and the given one, either way.
    quality
        q that a triangle may sink to; one that is below may not sink.
    min_edge_mm
        Length that an edge may shrink to; one that is below may not shrink.
    turn_deg
        Angle by which the surface may turn at an edge; beyond it, no edge may turn by more than those around it did.
    """

    deviation_mm: float
    quality: float
    min_edge_mm: float
    turn_deg: float = _SHARPEST_TURN_DEG


class Settled(NamedTuple):
    """What became of a proposal: the mesh, vertices that moved, and those that went back all or part of the way."""

    mesh: Mesh
    moved: int
    held: int


class Volumes(NamedTuple):
    """Volume of each closed component in mm3, 0 for an open one; component and area by face number and component."""

    volumes: Floats
    areas: Floats
    closed: Mask
    component: NDArray[np.int32]


def volumes_of(mesh: Mesh) -> Volumes:
    """Return the volumes that the components of a surface enclose."""
    joined = surface.topology(mesh.vertices, mesh.faces)
    measured = surface.quality(mesh.vertices, mesh.faces, joined.component, joined.n_components)
    closed = np.ones(joined.n_components, dtype=np.bool_)
    for faces in (joined.boundary_faces, joined.nonmanifold_edge_faces, joined.inconsistent_faces):
        labels = joined.component[faces]
        closed[labels[labels >= 0]] = False
    volumes = np.where(closed, measured.component_volume, 0.0)
    return Volumes(volumes, measured.component_area, closed, joined.component)


class Guard:
    """The guards about one surface.

    Boundaries, places that are not manifold and faces in contact with others are frozen: they stay as they are.

    Parameters
    ----------
    given
        The surface to stay at, float32 values as coordinates, every vertex in a face, no face with equal vertices.
    limits
        What has to hold.
    fixed : (V,) bool
        Further vertices that stay.

    Attributes
    ----------
    fixed : (V,) bool
        All vertices that stay.
    complete
        False if the surface is in contact with itself in so many places that they can't be told from new ones.
    """

    def __init__(self, given: Mesh, limits: Limits, fixed: Mask | None = None) -> None:
        self.given = given
        self.limits = limits
        self.tree = Tree(given.vertices, given.faces)
        hits = self.tree.self_hits(0)
        self.complete = hits.complete
        pairs = self.tree.self_hits(hits.n_pairs if hits.complete else 0).pairs
        self.contacts = np.sort(_pair_keys(pairs, len(given.faces)))
        self.fixed = _immovable(given, pairs)
        if fixed is not None:
            self.fixed |= fixed
        middles = given.vertices[surface.topology(given.vertices, given.faces).inner_edges].mean(axis=1)
        self.samples = np.concatenate([given.vertices, middles, given.vertices[given.faces].mean(axis=1)])
        self._covered: tuple[Mesh, Ints] | None = None
        self._wanted = volumes_of(given)

    def narrowed(self, share: float) -> Guard:
        """Return the same guards with a share of the deviation."""
        other = copy.copy(self)
        other.limits = replace(self.limits, deviation_mm=share * self.limits.deviation_mm)
        return other

    def turning_by(self, angle_deg: float) -> Guard:
        """Return the same guards with another limit on the angle by which the surface may turn at an edge."""
        other = copy.copy(self)
        other.limits = replace(self.limits, turn_deg=min(angle_deg, _SHARPEST_TURN_DEG))
        return other

    def settle(self, mesh: Mesh, targets: Floats) -> Settled:
        """Move vertices towards their targets as far as the guards allow.

        Parameters
        ----------
        mesh
            A state of the given surface that keeps the limits, with its vertex numbers; edges may be flipped.
        targets : (V, 3) float64
            Where its vertices would go; from farther away than allowed they are drawn near the given surface first.
        """
        ways = _Ways(mesh, self._within_reach(targets), self.fixed)
        if not ways.n_moving:
            return Settled(mesh, 0, 0)
        check = _Check(self, mesh, ways)
        while True:
            faces = check.offenders()
            if not len(faces):
                moved = Mesh(ways.vertices, mesh.faces)
                self._covered = moved, check.cover
                return Settled(moved, ways.n_moving, ways.n_held)
            check.changed(ways.back(mesh.faces[faces].ravel()))
            if not ways.n_moving:
                return Settled(mesh, 0, ways.n_held)

    def _within_reach(self, targets: Floats) -> Floats:
        """Return the targets, those that are too far away moved towards the given surface."""
        near = closest(self.tree, targets)
        reach = _REACH * self.limits.deviation_mm
        part = reach / np.maximum(near.distances, reach)
        return np.where((part < 1)[:, None], near.points + part[:, None] * (targets - near.points), targets)

    def cover_of(self, mesh: Mesh) -> Ints:
        """Return the face of a mesh that each sample of the given surface has near it."""
        if self._covered is None or self._covered[0] is not mesh:
            tree = Tree(mesh.vertices, mesh.faces)
            near = closest(tree, self.samples, self.limits.deviation_mm)
            faces, off = near.faces.astype(np.int64), np.flatnonzero(near.faces < 0)
            faces[off] = closest(tree, self.samples[off]).faces
            self._covered = mesh, faces
        return self._covered[1]

    def volume_error(self, mesh: Mesh) -> float:
        """Return the change of volume, summed over the closed components, as a share of the volume at first."""
        total = abs(self._wanted.volumes.sum())
        if not total:
            return 0.0
        return float(np.abs(volumes_of(mesh).volumes - self._wanted.volumes).sum() / total)

    def restore_volume(self, mesh: Mesh, tolerance: float) -> Mesh:
        """Offset the closed components along their normals until they have the volume that they had at first.

        Parameters
        ----------
        mesh
            As for `settle`.
        tolerance
            Share of the volume; the aim is a fraction of it.
        """
        wanted = self._wanted
        component = np.zeros(len(mesh.vertices), dtype=np.int64)
        component[mesh.faces.ravel()] = np.repeat(wanted.component, 3)
        # What an offset gains in volume by its length: the area, or less where vertices are held.
        gain = areas = np.maximum(wanted.areas, np.finfo(np.float64).tiny)
        most = 0.5 * self.limits.deviation_mm
        for _ in range(_VOLUME_ROUNDS):
            error = self.volume_error(mesh)
            if error <= _VOLUME_LEFT * tolerance:
                break
            volumes = volumes_of(mesh).volumes
            step = np.where(wanted.closed, np.clip((wanted.volumes - volumes) / gain, -most, most), 0.0)
            offset = self.settle(mesh, mesh.vertices + step[component][:, None] * vertex_normals(mesh)).mesh
            if not self.volume_error(offset) < error:
                break
            gained = np.divide(volumes_of(offset).volumes - volumes, step, out=gain.copy(), where=step != 0)
            gain = np.maximum(gained, _LEAST_GAIN * areas)
            mesh = offset
        return mesh


class _Ways:
    """How far each vertex goes of its way."""

    def __init__(self, mesh: Mesh, targets: Floats, fixed: Mask) -> None:
        self._faces = mesh.faces
        self._start = mesh.vertices
        self._way = targets - mesh.vertices
        self._part = np.where(fixed, len(_PARTS) - 1, 0)
        self._held = np.zeros(len(mesh.vertices), dtype=np.bool_)
        self._place()

    def _place(self) -> None:
        exact = self._start + _PARTS[self._part][:, None] * self._way
        there = rounded(exact)
        self.vertices = np.where((self._part < len(_PARTS) - 1)[:, None], there, self._start)
        moving = (self.vertices != self._start).any(axis=1)
        self.touched: Mask = moving[self._faces].any(axis=1)
        self.n_moving = int(moving.sum())
        self._moving = moving

    @property
    def n_held(self) -> int:
        """Number of vertices that went back all or part of the way."""
        return int(self._held.sum())

    def back(self, vertices: NDArray[np.integer]) -> Mask:
        """Take vertices back, and tell which; if none of them has moved, all that have."""
        chosen = np.zeros(len(self._part), dtype=np.bool_)
        chosen[vertices] = True
        chosen &= self._moving
        if not chosen.any():
            chosen = self._moving
        self._held |= chosen
        self._part[chosen] += 1
        self._place()
        return chosen


class _Check:
    """Judges the faces that have changed since they were judged last."""

    def __init__(self, guard: Guard, mesh: Mesh, ways: _Ways) -> None:
        self._guard, self._mesh, self._ways = guard, mesh, ways
        corners = mesh.vertices[mesh.faces]
        self._quality, self._normals = _shapes(corners)
        self._sides = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
        joined = surface.topology(mesh.vertices, mesh.faces)
        self._edges, self._edge_faces = joined.inner_edges, joined.inner_edge_faces
        turns = _turns(mesh.vertices, mesh.faces, self._edges, self._edge_faces)
        # The largest turn at a side of each face; NaN, where a face has no area, is none.
        sharpest = np.zeros(len(mesh.faces))
        for side in range(2):
            np.fmax.at(sharpest, self._edge_faces[:, side], turns)
        self._most_turns = sharpest[self._edge_faces].max(axis=1, initial=guard.limits.turn_deg)
        self._first_cover = guard.cover_of(mesh)
        self.cover = self._first_cover.copy()
        self._unjudged = {name: ways.touched.copy() for name in ("shape", "place", "cover")}

    def changed(self, vertices: Mask) -> None:
        """Take note that vertices have gone back."""
        faces = vertices[self._mesh.faces].any(axis=1)
        for unjudged in self._unjudged.values():
            unjudged |= faces

    def offenders(self) -> Ints:
        """Return faces that break a guard, the cheapest guard first; none if all is well."""
        for name, judge in (("shape", self._misshapen), ("place", self._strayed), ("cover", self._uncovering)):
            faces = judge(self._unjudged[name])
            if len(faces):
                return faces
            self._unjudged[name][:] = False
        return self._in_contact()

    def _misshapen(self, unjudged: Mask) -> Ints:
        """Return the faces that lost their shape, turned over, or are folded onto a neighbour."""
        limits, vertices = self._guard.limits, self._ways.vertices
        faces = np.flatnonzero(unjudged & self._ways.touched)
        corners = vertices[self._mesh.faces[faces]]
        q, normals = _shapes(corners)
        old_q = self._quality[faces]
        bad = (q < np.minimum(old_q, limits.quality)) | ((q < _NO_AREA) & (q < old_q))
        turned = np.einsum("ij,ij->i", normals, self._normals[faces]) < _LEAST_TURN_COSINE
        bad |= turned & (old_q > _FLAT_QUALITY)
        sides = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
        bad |= (sides < np.minimum(self._sides[faces], limits.min_edge_mm)).any(axis=1)
        if bad.any():
            return faces[bad]
        edges = np.flatnonzero(unjudged[self._edge_faces].any(axis=1))
        turns = _turns(vertices, self._mesh.faces, self._edges[edges], self._edge_faces[edges])
        folded = turns > self._most_turns[edges]
        return _unique(self._edge_faces[edges[folded]])

    def _strayed(self, unjudged: Mask) -> Ints:
        """Return the faces of which a vertex, the middle of an edge or the centre is too far from the given surface."""
        mesh, now = self._mesh, self._ways.vertices
        touched = unjudged & self._ways.touched
        edges = np.flatnonzero(touched[self._edge_faces].any(axis=1))
        faces = np.flatnonzero(touched)
        far = np.zeros(len(mesh.vertices), dtype=np.bool_)
        corners = np.unique(mesh.faces[faces])
        far[corners] = self._is_far(mesh.vertices[corners], now[corners])
        middles = (points[self._edges[edges]].mean(axis=1) for points in (mesh.vertices, now))
        far_edges = self._is_far(*middles)
        centres = (points[mesh.faces[faces]].mean(axis=1) for points in (mesh.vertices, now))
        far_faces = faces[self._is_far(*centres)]
        at_vertices = faces[far[mesh.faces[faces]].any(axis=1)]
        return _unique(np.concatenate([at_vertices, far_faces, self._edge_faces[edges[far_edges]].ravel()]))

    def _is_far(self, before: Floats, now: Floats) -> Mask:
        """Tell which points are too far from the given surface; what was too far before may be as far."""
        limit, tree = _MARGIN * self._guard.limits.deviation_mm, self._guard.tree
        far = np.isinf(closest(tree, now, limit).distances)
        at = np.flatnonzero(far)
        # Most were near enough before: the others are looked at closely.
        at = at[np.isinf(closest(tree, before[at], limit).distances)]
        far[at] = closest(tree, now[at]).distances > closest(tree, before[at]).distances
        return far

    def _uncovering(self, unjudged: Mask) -> Ints:
        """Return the faces that left a point of the given surface too far from any face."""
        limit = _MARGIN * self._guard.limits.deviation_mm
        at = np.flatnonzero(unjudged[self.cover])
        samples = self._guard.samples
        now = Tree(self._ways.vertices, self._mesh.faces)
        found = closest(now, samples[at], limit)
        near = found.faces >= 0
        self.cover[at[near]] = found.faces[near]
        lost = at[~near]
        if len(lost):
            # What was too far before may be as far.
            before = Tree(self._mesh.vertices, self._mesh.faces)
            worse = closest(now, samples[lost]).distances > closest(before, samples[lost]).distances
            lost = lost[worse]
        # The face that was near at first has moved, or the distance could not have grown.
        return _unique(np.concatenate([self.cover[lost], self._first_cover[lost]]))

    def _in_contact(self) -> Ints:
        """Return the faces that meet others and did not before."""
        known, n_faces = self._guard.contacts, len(self._mesh.faces)
        pairs = Tree(self._ways.vertices, self._mesh.faces).self_hits(len(known) + _LISTED_CONTACTS).pairs
        return _unique(pairs[~np.isin(_pair_keys(pairs, n_faces), known)])


def _unique(faces: NDArray[np.integer]) -> Ints:
    return np.unique(faces).astype(np.int64)


def _immovable(mesh: Mesh, contacts: NDArray[np.int32]) -> Mask:
    """Return the vertices on boundaries, where the surface is not manifold, and of faces in contact."""
    joined = surface.topology(mesh.vertices, mesh.faces)
    fixed = np.zeros(len(mesh.vertices), dtype=np.bool_)
    for vertices in (
        joined.boundary_edges,
        joined.nonmanifold_edges,
        joined.inconsistent_edges,
        joined.nonmanifold_vertices,
        mesh.faces[joined.duplicate_faces],
        mesh.faces[contacts.ravel()],
    ):
        fixed[vertices.ravel()] = True
    return fixed


def _pair_keys(pairs: NDArray[np.int32], n_faces: int) -> Ints:
    return pairs[:, 0].astype(np.int64) * n_faces + pairs[:, 1]


def _shapes(corners: Floats) -> tuple[Floats, Floats]:
    """Return q = 2 r_in / r_out and unit normal of triangles (F, 3, 3)."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normals = np.cross(first, second)
    double_area = np.linalg.norm(normals, axis=1)
    sides = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
    divisor = sides.prod(axis=1) * sides.sum(axis=1)
    q = np.divide(4 * double_area**2, divisor, out=np.zeros_like(divisor), where=divisor > 0)
    return q, normals / np.where(double_area > 0, double_area, 1.0)[:, None]


def _turns(
    vertices: Floats, faces: NDArray[np.int32], edges: NDArray[np.int32], edge_faces: NDArray[np.int32]
) -> Floats:
    """Return the angle in degrees by which the surface turns at each edge: 0 flat, 180 folded back."""
    return 180.0 - surface.dihedral_angles(vertices, faces, edges, edge_faces)
