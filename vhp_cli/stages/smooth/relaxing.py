"""The guarded method: vertices relax along the surface and edges flip, as long as triangles get better."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from vhp_cli.kernels import surface
from vhp_cli.kernels.remeshing import Remesher
from vhp_cli.kernels.smoothing import Smoothing, smoothing_steps
from vhp_cli.mesh import Mesh
from vhp_cli.stages.smooth.guard import Guard
from vhp_cli.stages.smooth.history import State, measured

# Means over neighbours that make the wanted edge lengths vary gently.
_GRADING_ROUNDS = 3
# Iterations that also even out the number of faces at vertices; later ones would undo what was gained.
_BALANCING = 6
# Parts of the way that rounding off tries, and the sum of the angles that has to be left of it at most.
_ROUNDING_PARTS = (0.5, 0.2)
_LEAST_ROUNDING = 0.999
# Bound on the time of one run: boxes and triangles looked at, some 1e8 in 5 to 10 seconds.
_MOST_WORK = 2_000_000_000
# q that no operation takes a triangle below, unless it lifts the worst one around.
FLOOR = 0.3


def quality_floor(mesh: Mesh) -> float:
    """Return the q below which no triangle may be taken: 0.3, or the worst of the mesh if that is better."""
    return max(FLOOR, measured(mesh, "", 0).min_quality)


def remesher_of(mesh: Mesh, guard: Guard) -> Remesher:
    """Return a remesher that keeps a state of the guard's surface within its limits."""
    given = guard.given
    sizes = _local_lengths(given)
    same = mesh is given
    return Remesher(
        mesh.vertices,
        mesh.faces,
        sizes=sizes if same else _local_lengths(mesh),
        reference=None if same else (given.vertices, given.faces),
        reference_sizes=None if same else sizes,
        deviation=guard.limits.deviation_mm,
        floor=guard.limits.quality,
        min_edge=0.0,
        max_work=_MOST_WORK,
        frozen=guard.fixed,
    )


def relaxed(guard: Guard, *, flips: bool) -> Iterator[State]:
    """Yield the given surface after each iteration of relaxation and flips, as long as anything changes.

    Parameters
    ----------
    guard
        The surface and its limits.
    flips
        Whether edges are flipped.
    """
    remesher = remesher_of(guard.given, guard)
    iteration = 0
    while True:
        iteration += 1
        flipped = 0
        if flips:
            flipped = remesher.flip()
            if iteration <= _BALANCING:
                flipped += remesher.flip(balance=True)
        moved = remesher.relax()
        if not flipped and not moved:
            return
        yield measured(Mesh(*remesher.result()), "relax", iteration, flips=flipped, moves=moved)


def rounded_off(guard: Guard, start: State, sharp_deg: float, tolerance: float) -> Iterator[State]:
    """Yield the surface after each iteration that takes the ends of sharp edges towards their neighbours' mean.

    Parameters
    ----------
    guard
        The surface and its limits.
    start
        The state to start from.
    sharp_deg
        Angle beyond which an edge is sharp.
    tolerance
        Of the volume, which is restored each time.
    """
    state = measured(start.mesh, start.entry["step"], start.entry["iteration"], sharp_deg=sharp_deg)
    while state.excess > 0:
        found = (_less_sharp(guard, state, sharp_deg, tolerance, part) for part in _ROUNDING_PARTS)
        better = next((less for less in found if less is not None), None)
        if better is None:
            return
        state = better
        yield state


def _less_sharp(guard: Guard, state: State, sharp_deg: float, tolerance: float, part: float) -> State | None:
    """Return a state with the ends of sharp edges a part of the way to their neighbours' mean; None if no better."""
    mesh = state.mesh
    joined = surface.topology(mesh.vertices, mesh.faces)
    turns = 180.0 - surface.dihedral_angles(mesh.vertices, mesh.faces, joined.inner_edges, joined.inner_edge_faces)
    ends = np.unique(joined.inner_edges[turns > sharp_deg])
    moved = next(smoothing_steps(mesh.vertices, mesh.faces, Smoothing(step=part), fixed=guard.fixed)).vertices
    targets = mesh.vertices.copy()
    targets[ends] = moved[ends]
    # Single edges may get sharper on the way, but none more than the sharpest.
    settled = guard.turning_by(float(np.nanmax(turns))).settle(mesh, targets)
    found = measured(
        guard.restore_volume(settled.mesh, tolerance),
        "round off",
        state.entry["iteration"] + 1,
        moves=settled.moved,
        held=settled.held,
        sharp_deg=sharp_deg,
    )
    better = found.excess < _LEAST_ROUNDING * state.excess and guard.volume_error(found.mesh) <= tolerance
    return found if better else None


def _local_lengths(mesh: Mesh) -> NDArray[np.float64]:
    """Return the mean length of the edges around each vertex in mm, evened out over its neighbours."""
    corners = mesh.faces.astype(np.int64)
    ends = np.sort(np.concatenate([corners[:, [k, (k + 1) % 3]] for k in range(3)]), axis=1)
    edges = np.unique(ends, axis=0)
    lengths = np.linalg.norm(mesh.vertices[edges[:, 1]] - mesh.vertices[edges[:, 0]], axis=1)
    counts = np.bincount(edges.ravel(), minlength=len(mesh.vertices))
    for _ in range(_GRADING_ROUNDS + 1):
        sums = np.bincount(edges.ravel(), np.repeat(lengths, 2), len(mesh.vertices))
        at_vertices: NDArray[np.float64] = sums / np.maximum(counts, 1)
        lengths = at_vertices[edges].mean(axis=1)
    # Where all edges have length 0 there is nothing to scale.
    return np.where(at_vertices > 0, at_vertices, 1.0)
