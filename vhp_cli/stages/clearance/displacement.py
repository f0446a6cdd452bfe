"""Move the vertices of a tissue into its room: for shallow overlaps, and gaps that are too small.

The triangulation stays. Vertices go along the gradient of the excess until they are inside; the surface around them
follows, the less the farther away, and so does the other side of a thin wall. What breaks a guard is held back, and
then the room is exceeded still: whoever asked has to look.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vhp_cli.kernels import surface
from vhp_cli.kernels.measuring import thickness
from vhp_cli.kernels.remeshing import Remesher
from vhp_cli.mesh import Mesh, vertex_normals
from vhp_cli.stages.clearance.attempt import spacing_mm
from vhp_cli.stages.clearance.cell import Cell
from vhp_cli.stages.clearance.sampling import Samples, excess_of, samples_of
from vhp_cli.stages.smooth.guard import Guard, Limits

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_ITERATIONS = 40
_SPREADS = 4
# The surface around follows by exp(-distance / length); the length in mm, or in mean edges if that is more.
_FALLOFF_MM, _FALLOFF_EDGES = 5.0, 2.5
# A vertex that would move by less than this part of the farthest one stays where it is.
_LEAST_MOVE = 0.01
# Edges longer than so many split lengths, which are so many gaps, are split.
_LONG_EDGES, _SPLIT_GAPS = 1.6, 2.5
_SPLIT_DEVIATION_MM = 1e-3
_MOST_GROWTH = 4
# Without less than this part of the largest need in so many iterations, it is given up.
_PROGRESS, _PATIENCE = 0.95, 8
# What is inside by this part of the margin at the points that are looked at, is inside between them.
_INSIDE = 0.3
# A gradient shorter than this leads nowhere.
_LEAST_SLOPE = 0.3
# Cosine from which on the face across is the other side of a wall.
_PARALLEL = 0.5
# q that a triangle may sink to; the second one if the first holds too much back.
_LEAST_QUALITIES = (0.15, 0.02)
_LEAST_EDGE_MM = 0.01
# How far inside of its room points are known to be, at least, in mm: they are not looked at until they may be out.
_BAND_MM = 1.0


class Displaced(NamedTuple):
    """A surface with moved vertices; by how much it exceeds its room in mm; how far the farthest vertex moved."""

    mesh: Mesh
    excess_mm: float
    moved_mm: float


def displaced(mesh: Mesh, cell: Cell, *, margin_mm: float, max_move_mm: float, thin_mm: float) -> Displaced:
    """Move the vertices of a tissue into its room as far as that goes.

    Parameters
    ----------
    mesh
        The given surface, with float32 values as coordinates.
    cell
        Its room.
    margin_mm
        How far inside of it vertices are brought.
    max_move_mm
        How far vertices may go.
    thin_mm
        Both sides of walls thinner than this go together.
    """
    spacing = spacing_mm(cell.gap_mm)
    active = cell.without_idle()
    given, start = mesh, excess_of(mesh, active, spacing_mm=spacing)
    samples = samples_of(mesh, active, spacing_mm=spacing, margin_mm=margin_mm)
    mesh = _refined(mesh, active, samples, margin_mm)
    if mesh is not given:
        samples = samples_of(mesh, active, spacing_mm=spacing, margin_mm=margin_mm)
    topology = surface.topology(mesh.vertices, mesh.faces)
    edges = np.concatenate([topology.inner_edges, topology.boundary_edges]).astype(np.int64)
    spread = _Spread(mesh, edges, cell, thin_mm)
    ways = np.zeros_like(mesh.vertices)
    pushed = np.zeros(len(mesh.vertices), dtype=np.bool_)
    # Above what the excess can be: points are looked at only when they may have got outside.
    most = np.full(len(samples.corners), np.inf)
    before = samples.points(mesh.vertices)
    least, idle = np.inf, 0
    for _ in range(_ITERATIONS):
        now = samples.points(mesh.vertices + ways)
        most += np.linalg.norm(now - before, axis=1)
        before = now
        at = np.flatnonzero(most > -margin_mm)
        found = cell.located(now[at], _BAND_MM)
        most[at] = found.values
        need = found.values + margin_mm
        if need.max(initial=0.0) < _PROGRESS * least:
            least, idle = float(need.max(initial=0.0)), 0
        elif (idle := idle + 1) > _PATIENCE:
            break
        steep = np.einsum("ij,ij->i", found.gradients, found.gradients)
        out = (need > 1e-4) & (steep > _LEAST_SLOPE**2)
        if not out.any():
            break
        steps = -found.gradients[out] * (need[out] / steep[out])[:, None]
        step = _largest(samples.corners[at[out]], need[out], steps, len(ways))
        pushed |= (step != 0).any(axis=1)
        ways = spread.followed(_capped(ways + step, max_move_mm), pushed)
    lengths = np.linalg.norm(ways, axis=1)
    ways[(lengths < _LEAST_MOVE * lengths.max(initial=0.0)) & ~pushed] = 0.0
    farthest = float(lengths.max(initial=0.0))
    if not farthest:
        return Displaced(given, start, 0.0)
    if excess_of(Mesh(mesh.vertices + ways, mesh.faces), cell, spacing_mm=spacing, outside_mm=farthest) > 0.5 * start:
        return Displaced(given, start, 0.0)
    best: Displaced | None = None
    for quality in _LEAST_QUALITIES:
        # The guard lets a surface go part of its deviation from the given one.
        guard = Guard(mesh, Limits(2 * farthest + 0.01, quality, _LEAST_EDGE_MM))
        if not guard.complete:
            break
        settled = guard.settle(mesh, mesh.vertices + ways).mesh
        least = -_INSIDE * margin_mm
        excess = excess_of(settled, cell, spacing_mm=spacing, least_mm=least, outside_mm=farthest) - least
        if best is None or excess < best.excess_mm:
            moved = float(np.linalg.norm(settled.vertices - mesh.vertices, axis=1).max())
            best = Displaced(settled, excess, moved)
        if excess <= 0:
            break
    return best or Displaced(given, start, 0.0)


def _refined(mesh: Mesh, cell: Cell, samples: Samples, margin_mm: float) -> Mesh:
    """Return a surface with long edges split where it exceeds its room; its shape stays, up to rounding."""
    length = _SPLIT_GAPS * cell.gap_mm
    corners = mesh.vertices[mesh.faces]
    sides = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
    if not (sides > _LONG_EDGES * length).any():
        return mesh
    out = cell.excess(samples.points(mesh.vertices), _BAND_MM) > -margin_mm
    coarse = np.unique(samples.faces[out])
    coarse = coarse[sides[coarse].max(axis=1, initial=0.0) > _LONG_EDGES * length]
    if not len(coarse):
        return mesh
    sizes = np.full(len(mesh.vertices), 1e3 * float(sides.max()))
    sizes[mesh.faces[coarse].ravel()] = length
    remesher = Remesher(
        mesh.vertices,
        mesh.faces,
        sizes=sizes,
        deviation=_SPLIT_DEVIATION_MM,
        max_triangles=_MOST_GROWTH * len(mesh.faces) + 10_000,
    )
    remesher.split(settling=False)
    return Mesh(*remesher.result())


def _largest(corners: Ints, need: Floats, steps: Floats, n_vertices: int) -> Floats:
    """Return for each vertex the step of the sample with the largest need of all that it is a corner of (V, 3)."""
    vertex = corners.ravel()
    sample = np.repeat(np.arange(len(corners)), 3)
    order = np.lexsort((sample, -need[sample], vertex))
    vertex, sample = vertex[order], sample[order]
    first = np.ones(len(vertex), dtype=np.bool_)
    first[1:] = vertex[1:] != vertex[:-1]
    found = np.zeros((n_vertices, 3))
    found[vertex[first]] = steps[sample[first]]
    return found


def _capped(ways: Floats, most: float) -> Floats:
    lengths = np.linalg.norm(ways, axis=1, keepdims=True)
    capped: Floats = ways * np.minimum(1.0, most / np.maximum(lengths, 1e-300))
    return capped


class _Spread:
    """How the surface follows the vertices that were pushed."""

    def __init__(self, mesh: Mesh, edges: Ints, cell: Cell, thin_mm: float) -> None:
        lengths = np.linalg.norm(mesh.vertices[edges[:, 0]] - mesh.vertices[edges[:, 1]], axis=1)
        falloff = max(_FALLOFF_MM, _FALLOFF_EDGES * float(lengths.mean()))
        self._from, self._to = edges.T
        self._weight = np.exp(-lengths / falloff)
        self._number = np.maximum(np.bincount(edges.ravel(), minlength=len(mesh.vertices)), 1)
        self._opposite, self._coupling = _walls(mesh, cell, thin_mm)

    def followed(self, ways: Floats, pushed: NDArray[np.bool_]) -> Floats:
        """Return the ways (V, 3) of all vertices, those of the pushed ones not shortened."""
        first, second = self._from, self._to
        for _ in range(_SPREADS):
            around = np.empty_like(ways)
            for axis in range(3):
                sums = np.bincount(first, self._weight * ways[second, axis], len(ways))
                sums += np.bincount(second, self._weight * ways[first, axis], len(ways))
                around[:, axis] = sums / self._number
            across = ways[self._opposite].mean(axis=1)
            # The side across leads where it goes farther; else both follow what is around them.
            leads = (across**2).sum(axis=1) > (around**2).sum(axis=1)
            around += np.where(leads, self._coupling, 0.0)[:, None] * (across - around)
            # What was pushed goes no less far than that, but farther with what is around it.
            stays = pushed & ((ways**2).sum(axis=1) >= (around**2).sum(axis=1))
            ways = np.where(stays[:, None], ways, around)
        return ways


def _walls(mesh: Mesh, cell: Cell, thin_mm: float) -> tuple[NDArray[np.int32], Floats]:
    """Return the corners (V, 3) of the face across the wall at each vertex, and how much the vertex goes with them."""
    normals = vertex_normals(mesh)
    start = mesh.vertices - 1e-4 * normals
    hits = thickness(cell.own.tree, start, -normals, np.full(len(start), -1, np.int32))
    found = (hits.faces >= 0) & (hits.cosines > _PARALLEL) & (hits.distances < thin_mm)
    corners = mesh.faces[np.where(found, hits.faces, 0)]
    # All of the way below two thirds of the limit, none of it at the limit.
    part = np.clip(3 * (1 - np.where(found, hits.distances, thin_mm) / max(thin_mm, 1e-300)), 0.0, 1.0)
    return corners, np.where(found, part, 0.0)
