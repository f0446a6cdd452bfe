"""How long edges are to be, and how closely the surfaces are to be followed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vhp_cli.kernels.measuring import closest, thickness
from vhp_cli.kernels.spatial import Tree
from vhp_cli.stages.tetmesh.labelling import within
from vhp_cli.stages.tetmesh.tissues import Tissue, without_flat_faces

# A background mesh: points, tetrahedra, and the edge length at each point.
SizingField = tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.float64]]

# The envelope, unless something is thinner: in mm, and in parts of the diagonal.
_MOST_ENVELOPE_MM = 0.25
_MOST_ENVELOPE = 1e-3
_LEAST_ENVELOPE = 2e-5
# The same in parts of the diagonal of tissues that are meshed by themselves.
_MOST_OWN_ENVELOPE = 5e-3
# Two surfaces that each move by less than half of the gap between them stay apart.
SHARE_OF_GAP = 0.4
# To keep tissues apart that lie beside each other, the envelope becomes so many times as thin at most.
_LEAST_FOR_DISTANCE = 0.5
# Of each surface so many faces are sampled, and so many of the walls below them may be thinner than assumed.
_WALL_SAMPLES = 2000
_THIN_WALLS = 0.05
# Cells along the longest side of the background mesh.
_CELLS = 32


class Envelope(NamedTuple):
    """How far a mesh may lie from the surfaces, in mm, and what decided on that."""

    mm: float
    reason: str


def envelope(
    tissues: Sequence[Tissue],
    walls_mm: Sequence[float | None],
    gap_mm: float | None,
    diagonal_mm: float,
    distance_mm: float | None = None,
    own_diagonal_mm: float | None = None,
) -> Envelope:
    """Choose how far the mesh may lie from the surfaces: below half of what keeps them apart.

    Parameters
    ----------
    tissues
        The tissues.
    walls_mm
        How thick they are where they are thin; see `wall_thickness`.
    gap_mm
        The smallest gap between a tissue and one that lies in it: a layer of tissue. None: there is none.
    diagonal_mm
        Of the model.
    distance_mm
        The smallest distance of tissues that lie apart; None: there is none. Where it is very small, they may touch in
        the mesh, which does less harm than a mesh as fine as that would.
    own_diagonal_mm
        Of these tissues, if they are a part of the model.
    """
    own = diagonal_mm if own_diagonal_mm is None else own_diagonal_mm
    choices = [
        (_MOST_ENVELOPE_MM, f"{_MOST_ENVELOPE_MM:g} mm, as nothing is thinner"),
        (_MOST_ENVELOPE * diagonal_mm, f"{_MOST_ENVELOPE:.1%} of the model's diagonal"),
        (_MOST_OWN_ENVELOPE * own, f"{_MOST_OWN_ENVELOPE:.1%} of the diagonal of these tissues"),
    ]
    if gap_mm:
        choices.append((SHARE_OF_GAP * gap_mm, f"{SHARE_OF_GAP:g} of the smallest gap, {gap_mm:.3g} mm"))
    choices += [
        (SHARE_OF_GAP * wall, f"{SHARE_OF_GAP:g} of the walls of {tissue.name}, {wall:.3g} mm")
        for tissue, wall in zip(tissues, walls_mm, strict=True)
        if wall
    ]
    chosen, reason = min(choices, key=lambda choice: choice[0])
    least = _LEAST_ENVELOPE * own
    if chosen < least:
        return Envelope(least, f"{_LEAST_ENVELOPE:g} of the diagonal, the least; {reason} would be {chosen:.3g} mm")
    if distance_mm and SHARE_OF_GAP * distance_mm < chosen:
        apart = SHARE_OF_GAP * distance_mm
        if apart < _LEAST_FOR_DISTANCE * chosen:
            return Envelope(chosen, f"{reason}; tissues only {distance_mm:.3g} mm apart may touch")
        return Envelope(apart, f"{SHARE_OF_GAP:g} of the smallest distance of tissues, {distance_mm:.3g} mm")
    return Envelope(chosen, reason)


def wall_thickness(tissue: Tissue) -> float | None:
    """Return how thick a tissue is where it is thin, in mm: 5 % of its area have less below them; None: unknown."""
    mesh = without_flat_faces(tissue.mesh)
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(normals, axis=1)
    if not len(areas) or not areas.sum():
        return None
    # Evenly over the area, from the first face to the last.
    total = np.cumsum(areas)
    count = min(_WALL_SAMPLES, len(areas))
    chosen = np.searchsorted(total, (np.arange(count) + 0.5) / count * total[-1])
    own = Tree(mesh.vertices, mesh.faces)
    inward = -np.sign(np.einsum("ij,ij->", corners[:, 0] - corners[0, 0], normals)) or -1.0
    hits = thickness(own, corners[chosen].mean(axis=1), inward * normals[chosen], chosen)
    # A ray that meets a face from outside has left through a defect, or met a part inside.
    known = hits.distances[np.isfinite(hits.distances) & (-inward * hits.cosines > 0)]
    return float(np.quantile(known, _THIN_WALLS)) if len(known) else None


def sizing_field(
    trees: Sequence[Tree],
    order: Sequence[int],
    lower: NDArray[np.float64],
    upper: NDArray[np.float64],
    lengths_mm: Sequence[float | None],
    edge_length_mm: float,
) -> SizingField | None:
    """Return a background mesh with the edge length wanted at each point; None if it is the same everywhere.

    The points of a grid have the edge length of the tissue in which they lie, or a shorter one of a tissue that comes
    nearer to them than the next point, so that none slips through.

    Parameters
    ----------
    trees
        The surfaces of the tissues.
    order
        How they are laid over each other.
    lower, upper
        Corners of the box to fill.
    lengths_mm
        What is wanted in each tissue; None: nothing of its own.
    edge_length_mm
        Where a tissue has no length of its own, and outside of all.
    """
    wanted = [edge_length_mm if length is None else length for length in lengths_mm]
    if all(length == edge_length_mm for length in wanted):
        return None
    cell = float((upper - lower).max()) / _CELLS
    counts = np.maximum(np.ceil((upper - lower) / cell).astype(np.int64), 1) + 3
    middle = (lower + upper) / 2
    axes = [middle[axis] + cell * (np.arange(counts[axis]) - (counts[axis] - 1) / 2) for axis in range(3)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    lengths = np.full(len(points), edge_length_mm)
    for index in order:
        lengths[within(trees[index], points)] = wanted[index]
    reach = cell * np.sqrt(3.0)
    for index in order:
        if wanted[index] < max(edge_length_mm, *wanted) and trees[index].n_faces:
            near = np.isfinite(closest(trees[index], points, reach).distances)
            lengths[near] = np.minimum(lengths[near], wanted[index])
    return points, _cut_cells(counts), lengths


def _cut_cells(counts: NDArray[np.int64]) -> NDArray[np.int32]:
    """Return the tetrahedra of a grid, six in each cell around its diagonal (Kuhn)."""
    number = np.arange(np.prod(counts)).reshape(counts)
    first = number[:-1, :-1, :-1].ravel()
    step = np.array([counts[1] * counts[2], counts[2], 1])
    tetrahedra = []
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1), (0, 2, 1), (1, 0, 2), (2, 1, 0)):
        path = np.column_stack((first, first + step[i], first + step[i] + step[j], first + step.sum()))
        odd = (i, j, k) in ((0, 2, 1), (1, 0, 2), (2, 1, 0))
        tetrahedra.append(path[:, [0, 2, 1, 3]] if odd else path)
    return np.concatenate(tetrahedra).astype(np.int32)
