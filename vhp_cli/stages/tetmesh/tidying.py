"""Tidy the labels of a mesh: crumbs go to a neighbour, and label boundaries become 2-manifold where they can.

Points and tetrahedra stay as they are; a tetrahedron that changes its label goes to a tissue, or to the air, beside it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vhp_cli.inspection.adjacency import Adjacency, Interfaces, adjacency, connected_parts, interfaces, tetrahedra_at
from vhp_cli.kernels import surface
from vhp_cli.stages.tetmesh.components import Component, locate
from vhp_cli.volume import BACKGROUND, Labels, VolumeMesh, volumes

Ints = NDArray[np.int32]

_ROUNDS = 8
# Tetrahedra that a fan at an edge may have to be given away: more are a piece of the tissue, not an accident.
_LARGEST_FAN = 12
# In place of a part of the input.
_ANYWHERE = -2


@dataclass(frozen=True, slots=True, eq=False)
class Tidied:
    """A tidied mesh, and how many tetrahedra changed their label: as crumbs, and at non-manifold edges."""

    mesh: VolumeMesh
    crumbs: int
    fans: int


def tidy(mesh: VolumeMesh, components: Sequence[Component], smallest: int) -> Tidied:
    """Tidy the labels of a mesh.

    Parameters
    ----------
    mesh
        The mesh, air included where it is kept.
    components
        The parts of the input surfaces, which tell a crumb from a small part that the input has.
    smallest
        Connected regions of a label with fewer tetrahedra go to the neighbour with the largest common area, unless
        they are all that there is of the label in a part of the input.
    """
    found = adjacency(mesh.tetrahedra)
    labels = _without_crumbs(mesh, found, mesh.labels, components, smallest)
    crumbs = int((labels != mesh.labels).sum())
    mended = _without_fans(mesh, found, labels)
    fans = int((mended != labels).sum())
    if fans:
        again = _without_crumbs(mesh, found, mended, components, smallest)
        if len(_faults(mesh, found, again)) <= len(_faults(mesh, found, mended)):
            mended = again
    return Tidied(replace(mesh, labels=mended), crumbs, fans)


def _without_crumbs(
    mesh: VolumeMesh, found: Adjacency, labels: Labels, components: Sequence[Component], smallest: int
) -> Labels:
    areas = face_areas(mesh, found.inner)
    labels = labels.copy()
    # A crumb within crumbs is reached only after those around it have gone.
    for _ in range(_ROUNDS):
        sides = labels[found.pairs]
        same = sides[:, 0] == sides[:, 1]
        region = connected_parts(len(labels), found.pairs[same])
        counts = np.bincount(region)
        small = counts < smallest
        small[_protected(mesh, labels, region, counts, components)] = False
        if not small.any():
            break
        ends = region[found.pairs[~same]]
        goes_to = _largest_neighbour(ends, areas[~same], small)
        chosen = np.flatnonzero(goes_to >= 0)
        if not len(chosen):
            break
        label_of = np.zeros(len(counts), np.int32)
        label_of[region] = labels
        label_of[chosen] = label_of[goes_to[chosen]]
        labels = label_of[region]
    return labels


def _protected(
    mesh: VolumeMesh, labels: Labels, region: Ints, counts: NDArray[np.int64], components: Sequence[Component]
) -> Ints:
    """Return the regions that stay: of each label the largest one, and the largest in each part of the input.

    A region lies in the part of the input that holds the centroid of its largest tetrahedron.
    """
    sizes = volumes(mesh.points, mesh.tetrahedra)
    # The last of each region in ascending order of size is its largest tetrahedron.
    order = np.lexsort((sizes, region))
    last = order[np.append(np.flatnonzero(np.diff(region[order])), len(order) - 1)]
    label_of = labels[last]
    found = locate(components, mesh.points[mesh.tetrahedra[last]].mean(axis=1))
    in_tissue = np.zeros((len(mesh.names) + 1, len(last)), np.bool_)
    in_tissue[1 : 1 + len(found.tissues)] = found.tissues
    in_tissue[BACKGROUND] = ~found.tissues.any(axis=0)
    largest: dict[tuple[int, int], int] = {}
    for number in np.lexsort((np.arange(len(counts)), -counts)):
        label = int(label_of[number])
        if label != BACKGROUND:
            largest.setdefault((label, _ANYWHERE), int(number))
        if in_tissue[label, number]:
            # Air within a part of the input is a cavity; outside of all, the largest region is the air around.
            largest.setdefault((label, int(found.innermost[number])), int(number))
    return np.array(sorted(set(largest.values())), np.int32)


def _largest_neighbour(ends: Ints, areas: NDArray[np.float64], small: NDArray[np.bool_]) -> Ints:
    """Return for each small region the larger one beside it with the largest common area; -1 where there is none."""
    count = len(small)
    both = np.concatenate((ends, ends[:, ::-1]))
    wide = np.concatenate((areas, areas))
    wanted = small[both[:, 0]] & ~small[both[:, 1]]
    key = both[wanted, 0].astype(np.int64) * count + both[wanted, 1]
    keys, inverse = np.unique(key, return_inverse=True)
    total = np.bincount(inverse, wide[wanted], len(keys))
    goes_to = np.full(count, -1, np.int32)
    # Ascending, so that the largest is written last; of equal ones the first.
    for index in np.lexsort((-keys, total)):
        goes_to[keys[index] // count] = keys[index] % count
    return goes_to


def _without_fans(mesh: VolumeMesh, found: Adjacency, labels: Labels) -> Labels:
    """Give the smaller fan of a label at each non-manifold edge to the label that has most beside it."""
    best, faults = labels, _faults(mesh, found, labels)
    fewest = len(faults)
    if not fewest:
        return labels
    labels = labels.copy()
    left = np.bincount(labels, minlength=len(mesh.names) + 1)
    starts, holders = tetrahedra_at(mesh.tetrahedra, len(mesh.points))
    for _ in range(_ROUNDS):
        changed = 0
        for label, a, b in faults:
            at_a, at_b = (holders[starts[point] : starts[point + 1]] for point in (a, b))
            changed += _mend_edge(mesh, labels, left, label, np.intersect1d(at_a, at_b, assume_unique=True))
        faults = _faults(mesh, found, labels)
        if len(faults) < fewest:
            best, fewest = labels.copy(), len(faults)
        if not changed or not faults:
            break
    return best


def _mend_edge(mesh: VolumeMesh, labels: Labels, left: NDArray[np.int64], label: int, here: Ints) -> int:
    """Relabel the smaller fans of a label among the tetrahedra around an edge; return how many were changed."""
    own = here[labels[here] == label]
    others = here[labels[here] != label]
    if len(own) < 2 or not len(others):
        return 0
    corners = [set(mesh.tetrahedra[tetrahedron].tolist()) for tetrahedron in own]
    joined = [(i, j) for i in range(len(own)) for j in range(i + 1, len(own)) if len(corners[i] & corners[j]) == 3]
    fan = connected_parts(len(own), np.array(joined, np.int32).reshape(-1, 2))
    sizes = np.bincount(fan)
    if len(sizes) < 2:
        return 0
    counts = Counter(labels[others].tolist())
    target = min(counts, key=lambda other: (-counts[other], other))
    changed = 0
    for number in np.argsort(-sizes, kind="stable")[1:]:
        given = own[fan == number]
        # A tissue is never given away as a whole.
        if len(given) > _LARGEST_FAN or left[label] <= len(given):
            continue
        labels[given] = target
        left[label] -= len(given)
        left[target] += len(given)
        changed += len(given)
    return changed


def _faults(mesh: VolumeMesh, found: Adjacency, labels: Labels) -> list[tuple[int, int, int]]:
    """Return the non-manifold edges of the boundaries of all tissues: label and both ends."""
    between: Interfaces = interfaces(found, labels)
    faults = []
    for label in range(1, len(mesh.names) + 1):
        boundary = between.boundary(label)
        if len(boundary):
            edges = surface.topology(mesh.points, boundary).nonmanifold_edges
            faults += [(label, int(a), int(b)) for a, b in edges]
    return faults


def face_areas(mesh: VolumeMesh, faces: Ints) -> NDArray[np.float64]:
    """Return the areas of faces (F, 3) in mm2."""
    a, b, c = (mesh.points[faces[:, corner]] for corner in range(3))
    areas: NDArray[np.float64] = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    return areas
