"""Clear the slivers along cuts by guarded remeshing; the rest of the surface stays as it is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vhp_cli.kernels import surface
from vhp_cli.kernels.measuring import closest
from vhp_cli.kernels.remeshing import Remesher
from vhp_cli.kernels.spatial import Tree
from vhp_cli.mesh import Mesh
from vhp_cli.stages.clearance.carving import known_vertices
from vhp_cli.stages.heal.candidate import Candidate, face_quality, judge
from vhp_cli.stages.heal.cascade import heal
from vhp_cli.stages.heal.options import HealOptions

Floats = NDArray[np.float64]

_ITERATIONS = 4
# Rings of triangles around a cut that are remeshed with it.
_RINGS = 2
# Edges at a cut are not shorter than this part of a cell of the grid, nor longer than so many of them.
_SHORTEST_CELLS, _LONGEST_CELLS = 1.0, 8.0
_MOST_WORK = 300_000_000
# What is still bad is worked on again, with more of its surroundings, and in the end with more of the deviation.
_RESCUES, _RESCUE_ROUNDS, _BAD = ((2, 1.0), (4, 1.0), (2, 1.0), (4, 1.0), (3, 3.0), (5, 8.0)), 20, 0.15


def finished(
    mesh: Mesh, given: Mesh, *, grid_mm: float, deviation_mm: float, target_quality: float, min_edge_mm: float
) -> Candidate:
    """Return a cut tissue with well shaped triangles along the cuts.

    Parameters
    ----------
    mesh
        The tissue after it was cut.
    given
        Before.
    grid_mm
        Cells in which the cut was worked out.
    deviation_mm
        How far the surface may move.
    target_quality
        q that is worked for.
    min_edge_mm
        Shortest edge that is left.
    """
    candidate = judge(mesh)
    written = candidate.mesh
    if not len(written.faces):
        return candidate
    frozen = _far_from_cuts(written, known_vertices(written, given))
    if frozen.all():
        return candidate
    remesher = Remesher(
        written.vertices,
        written.faces,
        sizes=_sizes(written, given, grid_mm),
        deviation=deviation_mm,
        target_quality=target_quality,
        floor=target_quality,
        min_edge=0.2 * grid_mm,
        edge_floor=min_edge_mm,
        max_triangles=2 * len(written.faces) + 1000,
        max_work=_MOST_WORK,
        frozen=frozen,
    )
    remesher.run(_ITERATIONS)
    made = judge(Mesh(*remesher.result()))
    made = rescued(made, deviation_mm=deviation_mm, target_quality=target_quality, min_edge_mm=min_edge_mm)
    if not made.sound and not candidate.sound:
        # Slivers that cross each other once they are rounded.
        healed = heal(made.mesh, HealOptions(only_topology=True)).mesh
        if healed is not None:
            made = rescued(
                judge(healed), deviation_mm=deviation_mm, target_quality=target_quality, min_edge_mm=min_edge_mm
            )
    return made if made.sound or not candidate.sound else candidate


def rescued(candidate: Candidate, *, deviation_mm: float, target_quality: float, min_edge_mm: float) -> Candidate:
    """Return a surface with better triangles around those that are really bad; parameters as of `finished`."""
    for rings, share in _RESCUES:
        candidate = _rescued(candidate, rings, share * deviation_mm, target_quality, min_edge_mm)
    return candidate


def _rescued(
    candidate: Candidate, rings: int, deviation_mm: float, target_quality: float, min_edge_mm: float
) -> Candidate:
    mesh = candidate.mesh
    sides = np.linalg.norm(mesh.vertices[mesh.faces] - mesh.vertices[np.roll(mesh.faces, -1, axis=1)], axis=2)
    bad = (face_quality(mesh) < min(_BAD, target_quality)) | (sides.min(axis=1, initial=np.inf) < min_edge_mm)
    if not bad.any():
        return candidate
    near = np.zeros(len(mesh.vertices), dtype=np.bool_)
    near[mesh.faces[bad]] = True
    for _ in range(rings):
        near[mesh.faces[near[mesh.faces].any(axis=1)]] = True
    remesher = Remesher(
        mesh.vertices,
        mesh.faces,
        sizes=np.maximum(sides.mean(), min_edge_mm),
        deviation=deviation_mm,
        target_quality=target_quality,
        floor=_BAD,
        min_edge=2 * min_edge_mm,
        edge_floor=min_edge_mm,
        max_work=_MOST_WORK,
        frozen=~near,
    )
    remesher.improve(rounds=_RESCUE_ROUNDS)
    found = judge(Mesh(*remesher.result()))
    better = (found.min_edge >= min_edge_mm, found.min_quality) > (
        candidate.min_edge >= min_edge_mm,
        candidate.min_quality,
    )
    return found if better and (found.sound or not candidate.sound) else candidate


def _far_from_cuts(mesh: Mesh, known: NDArray[np.bool_]) -> NDArray[np.bool_]:
    near = ~known
    # Slivers along a cut belong to it, even if all their corners were there before.
    near[mesh.faces[(face_quality(mesh) < 0.05) & near[mesh.faces].any(axis=1)]] = True
    for _ in range(_RINGS):
        near[mesh.faces[near[mesh.faces].any(axis=1)]] = True
    return ~near


def _sizes(mesh: Mesh, given: Mesh, grid_mm: float) -> Floats:
    """Return the edge length that the given surface has near each vertex."""
    corners = given.vertices[given.faces]
    lengths = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2).mean(axis=1)
    joined = surface.topology(given.vertices, given.faces)
    mean = max(joined.edge_length_mean, 1e-6)
    near = closest(Tree(given.vertices, given.faces), mesh.vertices).faces
    sizes: Floats = np.clip(lengths[near], 0.5 * mean, 2 * mean)
    return np.clip(sizes, _SHORTEST_CELLS * grid_mm, max(_LONGEST_CELLS * grid_mm, 0.5 * mean))
