"""Which tissues have to be meshed together, and which may be meshed by themselves.

Tissues that stand apart share no face. The mesh of a model is then the union of the meshes of its clusters, provided
that no envelope reaches across the gap between two of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from vhp_cli.inspection.adjacency import adjacency, connected_parts
from vhp_cli.kernels import surface
from vhp_cli.kernels.spatial import Tree, pair_hits
from vhp_cli.stages.tetmesh.sizing import SHARE_OF_GAP, Envelope, envelope
from vhp_cli.stages.tetmesh.tissues import Relations, Tissue, bounds, diagonal
from vhp_cli.volume import VolumeMesh

Group = tuple[int, ...]

# To keep clusters apart, their envelopes become so many times as thin at most; any nearer, they are one cluster.
_LEAST_FOR_APART = 0.25
# An envelope of this part of a distance may close it, but seldom does, and a thinner one takes the engine much longer.
_SHARE_AT_FIRST = 0.8


@dataclass(frozen=True, slots=True)
class Cluster:
    """Tissues that are meshed together.

    Parameters
    ----------
    tissues
        Their indices, ascending.
    envelope
        How far their mesh may lie from the surfaces.
    """

    tissues: Group
    envelope: Envelope


def clusters_of(
    tissues: Sequence[Tissue],
    relations: Relations,
    walls_mm: Sequence[float | None],
    *,
    asked_mm: float | None = None,
    careful: Sequence[Group] = (),
    together: Sequence[Group] = (),
) -> list[Cluster]:
    """Part the tissues of a model into clusters, in the order of their first tissues.

    Tissues that meet, overlap, or lie in each other belong together, and those with a gap that envelopes could close.

    Parameters
    ----------
    tissues
        The tissues; all have faces.
    relations
        How they lie to each other; pairs of which nothing is said lie far apart.
    walls_mm
        How thick they are where they are thin; see `vhp_cli.stages.tetmesh.sizing.wall_thickness`.
    asked_mm
        The widest envelope; None: it is chosen for each cluster.
    careful
        Tissues of clusters that met each other: their envelopes must not be able to close the gaps between them.
    together
        Tissues that belong together for another reason.
    """
    size = diagonal(tissues)
    number = {tissue.name: index for index, tissue in enumerate(tissues)}
    distances = [(number[a], number[b], value) for (a, b), value in relations.distances_mm.items()]
    links = [(first, other) for first, *others in together for other in others]
    links += [(number[a], number[b]) for a, b in _related(relations) if a in number and b in number]
    links += _around_unsound(tissues)
    while True:
        groups, group_of = _linked(len(tissues), links)
        own = [
            Envelope(asked_mm, "as asked") if asked_mm else _own_envelope(group, tissues, relations, walls_mm, size)
            for group in groups
        ]
        apart = [(a, b, value) for a, b, value in distances if group_of[a] != group_of[b]]
        close = [
            (a, b)
            for a, b, value in apart
            if SHARE_OF_GAP * value < _LEAST_FOR_APART * max(own[group_of[a]].mm, own[group_of[b]].mm)
        ]
        if not close:
            break
        links += close
    for a, b, value in apart:
        share = SHARE_OF_GAP if any(a in group and b in group for group in careful) else _SHARE_AT_FIRST
        for index in (group_of[a], group_of[b]):
            if share * value < own[index].mm:
                reason = f"{share:g} of the distance of {tissues[a].name} and {tissues[b].name}, {value:.3g} mm"
                own[index] = Envelope(share * value, reason)
    return [Cluster(group, chosen) for group, chosen in zip(groups, own, strict=True)]


def _own_envelope(
    group: Group,
    tissues: Sequence[Tissue],
    relations: Relations,
    walls_mm: Sequence[float | None],
    diagonal_mm: float,
) -> Envelope:
    chosen = [tissues[index] for index in group]
    among = relations.among({tissue.name for tissue in chosen})
    return envelope(
        chosen,
        [walls_mm[index] for index in group],
        among.smallest_gap_mm,
        diagonal_mm,
        among.smallest_distance_mm,
        diagonal(chosen),
    )


def _related(relations: Relations) -> Iterable[tuple[str, str]]:
    yield from ((inner, outer) for inner, around in relations.containers.items() for outer in around)
    yield from relations.overlaps_mm3
    yield from relations.gaps_mm
    yield from relations.contacts


def _around_unsound(tissues: Sequence[Tissue]) -> list[tuple[int, int]]:
    """Return the pairs of tissues of which one has no inside that could be told exactly, and whose boxes meet."""
    corners = [bounds([tissue]) for tissue in tissues]
    lower, upper = (np.array([corner[side] for corner in corners]) for side in (0, 1))
    found = []
    for index, tissue in enumerate(tissues):
        if tissue.volume_mm3 is None:
            near = ((lower <= upper[index]) & (upper >= lower[index])).all(axis=1)
            found += [(index, int(other)) for other in np.flatnonzero(near) if other != index]
    return found


def _linked(count: int, links: Sequence[tuple[int, int]]) -> tuple[list[Group], list[int]]:
    """Return groups of what links connect, in the order of their first members, and the group of each."""
    group_of = connected_parts(count, np.array(links, np.int32).reshape(-1, 2)).tolist()
    groups: list[list[int]] = [[] for _ in range(max(group_of) + 1)]
    for index, group in enumerate(group_of):
        groups[group].append(index)
    return [tuple(group) for group in groups], group_of


def meeting(meshes: Sequence[VolumeMesh]) -> list[tuple[int, int]]:
    """Return the pairs of meshes that touch, cross or contain one another; exact for the coordinates as given.

    Where no face of one hull meets one of the other, each part of a hull lies in the other mesh as a whole or not at
    all, and one of its vertices tells which.
    """
    hulls, starts = [], []
    for mesh in meshes:
        faces = adjacency(mesh.tetrahedra).hull
        parts = surface.topology(mesh.points, faces)
        _, first = np.unique(parts.component, return_index=True)
        hulls.append(Tree(mesh.points, faces))
        starts.append(mesh.points[faces[first, 0]])
    found = []
    for a in range(len(meshes)):
        for b in range(a + 1, len(meshes)):
            if (hulls[a].lower > hulls[b].upper).any() or (hulls[b].lower > hulls[a].upper).any():
                continue
            if (
                pair_hits(hulls[a], hulls[b], limit=0).n_pairs
                or (hulls[a].inside(starts[b]) == 1).any()
                or (hulls[b].inside(starts[a]) == 1).any()
            ):
                found.append((a, b))
    return found


def union(meshes: Sequence[VolumeMesh], labels_of: Sequence[Sequence[int]], names: tuple[str, ...]) -> VolumeMesh:
    """Return meshes that share no points as one.

    Parameters
    ----------
    meshes
        Of the clusters, without air.
    labels_of
        For each mesh the label in the union of each of its names.
    names
        Of the union.
    """
    offsets = np.cumsum([0, *(len(mesh.points) for mesh in meshes)])
    return VolumeMesh(
        np.concatenate([mesh.points for mesh in meshes]),
        np.concatenate([mesh.tetrahedra + offset for mesh, offset in zip(meshes, offsets[:-1], strict=True)]),
        np.concatenate([np.array([0, *own])[mesh.labels] for mesh, own in zip(meshes, labels_of, strict=True)]),
        names,
    )
