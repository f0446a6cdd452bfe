"""Better the worst tetrahedra of a labelled mesh by moving their corners, those of interfaces along their surface.

The mesher stops as soon as its worst tetrahedron is good enough by its own measure. Here corners of what falls short of
a target are moved uphill: along the gradient of the worst tetrahedron around them, as far as the worst of all around
them gets better. Corners that move at the same time have no tetrahedron in common, so that each gain is what it was
computed to be, and no tetrahedron ever becomes the worst around a corner that was moved.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vhp_cli.inspection.adjacency import Interfaces, adjacency, interfaces, tetrahedra_at
from vhp_cli.inspection.tetrahedra import tetrahedron_quality
from vhp_cli.volume import Points, VolumeMesh

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

_ROUNDS = 24
# Parts of the mean edge of the worst tetrahedron by which a corner is moved, tried in turn.
_STEPS = (0.3, 0.12, 0.04)
_DIFFERENCE = 1e-4
# A gain in parts of the target that is worth a move.
_LEAST_GAIN = 2e-3
# Normals of the triangles at a corner that lie farther apart make an edge, which stays.
_SMOOTH_COSINE = np.cos(np.radians(40.0))


@dataclass(frozen=True, slots=True)
class Floor:
    """What tetrahedra should keep: the smallest dihedral angle, and the radius ratio."""

    min_dihedral_deg: float = 12.0
    radius_ratio: float = 0.35


# What is cut off afterwards only has to keep its faces apart.
UNUSED = Floor(1.0, 0.01)


def relax(mesh: VolumeMesh, kept: Mask, target: Floor, leash_mm: float) -> VolumeMesh:
    """Return a mesh whose tetrahedra meet a target, as far as moving corners can do it; all else stays.

    Parameters
    ----------
    mesh
        The mesh, with what lies around the model.
    kept : (M,) bool
        Tetrahedra that will be used.
    target
        What they should be like. The others only have to keep some volume.
    leash_mm
        How far a corner may go from where it was, where the surface has an edge or more than two labels meet.
    """
    work = _Relaxation(mesh, kept, target, leash_mm)
    for _ in range(_ROUNDS):
        if not work.step():
            break
    return replace(mesh, points=work.points)


@dataclass(frozen=True, slots=True, eq=False)
class _Star:
    """Corners and the tetrahedra around them.

    Parameters
    ----------
    corners : (K,) int
        The corners.
    owner, around : (P,) int
        All pairs of a corner, by its position in `corners`, and a tetrahedron around it.
    first : (K,) int
        Where the pairs of each corner begin.
    worst : (K,) int32
        The worst tetrahedron around each corner.
    before : (K, 2) float64
        Least shares of angle and radius ratio around each corner.
    size : (K,) float64
        Mean edge of the worst tetrahedron, in mm.
    """

    corners: NDArray[np.integer]
    owner: NDArray[np.int64]
    first: NDArray[np.int64]
    around: NDArray[np.int32]
    worst: NDArray[np.int32]
    before: Floats
    size: Floats


class _Relaxation:
    """The state between two steps."""

    def __init__(self, mesh: VolumeMesh, kept: Mask, target: Floor, leash_mm: float) -> None:
        self.points = mesh.points.copy()
        self._origin = mesh.points
        self._tetrahedra = mesh.tetrahedra
        self._angle = np.where(kept, target.min_dihedral_deg, UNUSED.min_dihedral_deg)
        self._ratio = np.where(kept, target.radius_ratio, UNUSED.radius_ratio)
        self._starts, self._holders = tetrahedra_at(mesh.tetrahedra, len(mesh.points))
        found = adjacency(mesh.tetrahedra)
        between = interfaces(found, mesh.labels)
        self._normal, on_surface, at_edge = _surface_normals(mesh.points, between)
        self._slides = on_surface & ~at_edge
        self._leash = np.where(at_edge, leash_mm, np.inf)
        self._fixed = np.zeros(len(mesh.points), np.bool_)
        self._fixed[found.hull] = True
        self._share = self._shares(np.arange(len(mesh.tetrahedra)), self.points[mesh.tetrahedra])
        # Corners that could not gain, as long as nothing around them changes.
        self._stuck = np.zeros(len(mesh.points), np.bool_)

    def step(self) -> bool:
        """Move a set of corners; return whether there were any."""
        corners = np.unique(self._tetrahedra[self._share.min(axis=1) < 1])
        corners = corners[~self._fixed[corners] & ~self._stuck[corners]]
        if not len(corners):
            return False
        star = self._star(corners)
        gain, place = self._best(star, self._uphill(star))
        self._stuck[corners[gain < _LEAST_GAIN]] = True
        chosen = _independent(gain, star, len(self._tetrahedra)) & (gain >= _LEAST_GAIN)
        if not chosen.any():
            return False
        self.points[corners[chosen]] = place[chosen]
        changed = np.unique(star.around[chosen[star.owner]])
        self._share[changed] = self._shares(changed, self.points[self._tetrahedra[changed]])
        self._stuck[self._tetrahedra[changed]] = False
        return True

    def _star(self, corners: NDArray[np.integer]) -> _Star:
        counts = self._starts[corners + 1] - self._starts[corners]
        first = np.concatenate(([0], np.cumsum(counts)[:-1]))
        owner = np.repeat(np.arange(len(corners)), counts)
        around = self._holders[np.arange(counts.sum()) - np.repeat(first - self._starts[corners], counts)]
        before = np.minimum.reduceat(self._share[around], first)
        score = self._share[around].min(axis=1)
        position = np.where(score == before.min(axis=1)[owner], np.arange(len(score)), len(score))
        worst = around[np.minimum.reduceat(position, first)]
        edges = self.points[self._tetrahedra[worst]]
        size = np.linalg.norm(edges - np.roll(edges, 1, axis=1), axis=2).mean(axis=1)
        return _Star(corners, owner, first, around, worst, before, size)

    def _best(self, star: _Star, ways: Floats) -> tuple[Floats, Points]:
        """Return what the best of some steps on the way of each corner gains (K,), and where it leads to (K, 3)."""
        gain, place = np.zeros(len(star.corners)), self.points[star.corners].copy()
        for step in _STEPS:
            moved = self._on_leash(star.corners, self.points[star.corners] + step * ways)
            shares = self._shares_with(star.around, star.corners[star.owner], moved[star.owner])
            after = np.minimum.reduceat(shares, star.first)
            gained = after.min(axis=1) - star.before.min(axis=1)
            # The smallest angle may not fall for the sake of the radius ratio, nor the other way round.
            better = (gained > gain) & (after >= np.minimum(star.before, 1.0)).all(axis=1)
            gain[better], place[better] = gained[better], moved[better]
        return gain, place

    def _on_leash(self, corners: NDArray[np.integer], places: Points) -> Points:
        """Return places (K, 3) for corners that are no farther from where these were than they may be."""
        ways = places - self._origin[corners]
        lengths = np.linalg.norm(ways, axis=1)
        far = lengths > self._leash[corners]
        places = places.copy()
        places[far] = self._origin[corners[far]] + ways[far] * (self._leash[corners[far]] / lengths[far])[:, None]
        return places

    def _shares(self, tetrahedra: NDArray[np.integer], corners: Floats) -> Floats:
        """Return angle and radius ratio (K, 2) of tetrahedra (K,) with these corners (K, 4, 3): 1 meets the target."""
        count = len(tetrahedra)
        quality = tetrahedron_quality(corners.reshape(-1, 3), np.arange(4 * count, dtype=np.int32).reshape(-1, 4))
        shares = np.column_stack(
            (
                quality.min_dihedral_deg / np.maximum(self._angle[tetrahedra], 1e-9),
                quality.radius_ratio / np.maximum(self._ratio[tetrahedra], 1e-9),
            )
        )
        return np.where(quality.volume[:, None] > 0, shares, -1.0)

    def _shares_with(self, tetrahedra: NDArray[np.int32], corner: NDArray[np.integer], place: Floats) -> Floats:
        """Return the same for tetrahedra (K,) of which one corner (K,) is somewhere else (K, 3)."""
        points = self.points[self._tetrahedra[tetrahedra]]
        points[self._tetrahedra[tetrahedra] == corner[:, None]] = place
        return self._shares(tetrahedra, points)

    def _uphill(self, star: _Star) -> Floats:
        """Return for each corner (K, 3) the way that betters the worst tetrahedron most, as long as its mean edge."""
        gradient = np.empty((len(star.corners), 3))
        for axis in range(3):
            shift = np.zeros((len(star.corners), 3))
            shift[:, axis] = _DIFFERENCE * star.size
            ahead, behind = (
                self._shares_with(star.worst, star.corners, self.points[star.corners] + sign * shift)
                for sign in (1.0, -1.0)
            )
            gradient[:, axis] = ahead.min(axis=1) - behind.min(axis=1)
        return self._allowed(star, gradient)

    def _allowed(self, star: _Star, ways: Floats) -> Floats:
        """Return ways (K, 3) along the surface for corners that are on one, as long as the mean edge."""
        normal = self._normal[star.corners]
        across = np.einsum("ij,ij->i", ways, normal)
        ways = ways - np.where(self._slides[star.corners], across, 0.0)[:, None] * normal
        length = np.linalg.norm(ways, axis=1, keepdims=True)
        allowed: Floats = np.divide(ways, length, out=np.zeros_like(ways), where=length > 0) * star.size[:, None]
        return allowed


def _independent(gain: Floats, star: _Star, count: int) -> Mask:
    """Tell which corners have the largest gain of all that share a tetrahedron with them; of equal ones the first."""
    rank = np.empty(len(gain), np.int64)
    rank[np.lexsort((-np.arange(len(gain)), gain))] = np.arange(len(gain))
    highest = np.full(count, -1, np.int64)
    np.maximum.at(highest, star.around, rank[star.owner])
    lost = highest[star.around] != rank[star.owner]
    independent: Mask = np.bincount(star.owner, lost, len(gain)) == 0
    return independent


def _surface_normals(points: Points, between: Interfaces) -> tuple[Floats, Mask, Mask]:
    """Return the unit normal at each point of an interface, which points are on one, and which of these are at edges.

    At an edge the normals of triangles differ, or more than two labels meet.
    """
    count = len(points)
    low, high = between.sides.min(axis=1), between.sides.max(axis=1)
    a, b, c = (points[between.triangles[:, corner]] for corner in range(3))
    normals = np.cross(b - a, c - a)
    normals[between.sides[:, 0] != low] *= -1
    flat = between.triangles.ravel()
    total = np.stack([np.bincount(flat, np.repeat(normals[:, axis], 3), count) for axis in range(3)], axis=1)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    total = np.divide(total, length, out=np.zeros_like(total), where=length > 0)
    on_surface = np.zeros(count, np.bool_)
    on_surface[flat] = True
    at_edge = np.zeros(count, np.bool_)
    for label, empty in ((low, -2), (high, -2)):
        smallest, largest = np.full(count, np.iinfo(np.int32).max), np.full(count, empty)
        np.minimum.at(smallest, flat, np.repeat(label, 3))
        np.maximum.at(largest, flat, np.repeat(label, 3))
        at_edge |= on_surface & (smallest != largest)
    sizes = np.linalg.norm(normals, axis=1)
    cosine = np.einsum("fi,fci->fc", normals, total[between.triangles]) / np.maximum(sizes, 1e-300)[:, None]
    at_edge[between.triangles[cosine < _SMOOTH_COSINE]] = True
    return total, on_surface, at_edge
