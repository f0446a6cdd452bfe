"""Which tissue each tetrahedron belongs to, by winding numbers: right for sound surfaces, and robust for others."""

from __future__ import annotations

import heapq
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vhp_cli.kernels.measuring import closest
from vhp_cli.kernels.spatial import Tree
from vhp_cli.stages.tetmesh.tissues import Box, Tissue
from vhp_cli.volume import BACKGROUND, Labels, Points, Tetrahedra, volumes

# A point is inside where the absolute winding number exceeds this: surfaces may be turned inside out as a whole.
INSIDE = 0.5
# Points asked for at once by a thread.
_CHUNK = 16_384
# Cells along the longest side of a box, level by level: those far from the surface are asked for once.
_CELLS = (12, 48, 144)
# Cells that hold fewer points than this in the mean save nothing.
_POINTS_PER_CELL = 3
# Points along each side of a grid by which the volume of a surface that is not sound is estimated.
_GRID = 24


@dataclass(frozen=True, slots=True, eq=False)
class Labelling:
    """The tissue of each tetrahedron.

    Parameters
    ----------
    labels : (M,) int32
        1 + index of the tissue; 0: none.
    within : list of (k,) int32
        For each tissue the tetrahedra within its surface, whichever tissue they belong to.
    """

    labels: Labels
    within: list[NDArray[np.int32]]

    def enclosed(self, sizes_mm3: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the volume within the surface of each tissue (T,), from the volumes of all tetrahedra (M,)."""
        return np.array([sizes_mm3[inside].sum() for inside in self.within])


def precedence(
    tissues: Sequence[Tissue], sizes_mm3: Sequence[float], containers: Mapping[str, frozenset[str]]
) -> list[int]:
    """Return the indices of the tissues in the order in which they are laid over each other.

    Every tissue comes after those that it lies in. Apart from that those of lower priority come first, then larger
    ones, then by name.

    Parameters
    ----------
    tissues
        The tissues.
    sizes_mm3
        Their volumes.
    containers
        For each tissue, those that it lies in.
    """
    index = {tissue.name: number for number, tissue in enumerate(tissues)}
    around = [{index[name] for name in containers.get(tissue.name, ()) if name in index} for tissue in tissues]
    key = [(tissue.priority, -sizes_mm3[number], tissue.name, number) for number, tissue in enumerate(tissues)]
    order: list[int] = []
    ready = [key[number] for number in range(len(tissues)) if not around[number]]
    heapq.heapify(ready)
    while ready:
        number = heapq.heappop(ready)[-1]
        order.append(number)
        for inner in range(len(tissues)):
            if number in around[inner]:
                around[inner].discard(number)
                if not around[inner]:
                    heapq.heappush(ready, key[inner])
    # Tissues that lie in each other in a circle, as only a wrong statement can have it.
    return order + [item[-1] for item in sorted(key) if item[-1] not in order]


def smallest_containers(
    tissues: Sequence[Tissue], sizes_mm3: Sequence[float], containers: Mapping[str, frozenset[str]]
) -> list[int | None]:
    """Return for each tissue the index of the smallest one that it lies in; None for none."""
    index = {tissue.name: number for number, tissue in enumerate(tissues)}
    around = [[index[name] for name in containers.get(tissue.name, ()) if name in index] for tissue in tissues]
    return [min(found, key=lambda number: (sizes_mm3[number], number), default=None) for found in around]


def enclosed_volume(tissue: Tissue, tree: Tree) -> float:
    """Return the volume that a surface encloses in mm3; an estimate on a grid where that is not defined."""
    if tissue.volume_mm3 is not None:
        return abs(tissue.volume_mm3)
    if not tree.n_faces:
        return 0.0
    steps = (np.arange(_GRID) + 0.5) / _GRID
    grid = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    inside = np.abs(tree.winding(tree.lower + grid * (tree.upper - tree.lower))) > INSIDE
    return float(inside.mean() * np.prod(tree.upper - tree.lower))


def label_tetrahedra(
    points: Points,
    tetrahedra: Tetrahedra,
    trees: Sequence[Tree],
    order: Sequence[int],
    *,
    parents: Sequence[int | None] | None = None,
    regions: NDArray[np.int32] | None = None,
    solid: Sequence[bool] | None = None,
    threads: int = 1,
) -> Labelling:
    """Give each tetrahedron the last tissue, in an order, that holds its centroid.

    Parameters
    ----------
    points, tetrahedra
        The mesh.
    trees
        The surface of each tissue.
    order
        Indices of the tissues; see `precedence`.
    parents
        For each tissue one that it lies in: if that one comes before it in the order, it is looked for only there.
    regions : (M,) int32
        Tetrahedra that no surface parts, numbered from 0: all of a region are what its largest one is. None: each is
        looked at.
    solid
        Which surfaces are closed and oriented, so that points that they do not part are either inside or outside
        together. None: unknown.
    threads
        How many to use; the result does not depend on it.
    """
    centroids = points[tetrahedra].mean(axis=1)
    if regions is not None:
        order_by_size = np.lexsort((volumes(points, tetrahedra), regions))
        last = np.append(np.flatnonzero(np.diff(regions[order_by_size])), len(regions) - 1)
        centroids = centroids[order_by_size[last]]
    labels = np.full(len(tetrahedra), BACKGROUND, np.int32)
    held: dict[int, NDArray[np.int32]] = {}
    with ThreadPoolExecutor(max(threads, 1)) as executor:
        for number in order:
            parent = parents[number] if parents else None
            test = within_solid if solid and solid[number] else within
            if regions is None and parent in held:
                candidates = held[parent]
                inside = candidates[test(trees[number], centroids[candidates], executor)]
            elif regions is None:
                inside = np.flatnonzero(test(trees[number], centroids, executor)).astype(np.int32)
            else:
                inside = np.flatnonzero(within(trees[number], centroids, executor)[regions]).astype(np.int32)
            labels[inside] = number + 1
            held[number] = inside
    return Labelling(labels, [held[number] for number in range(len(trees))])


def within(tree: Tree, points: Points, executor: ThreadPoolExecutor | None = None) -> NDArray[np.bool_]:
    """Tell which points lie within a surface, by the absolute winding number."""
    inside = np.zeros(len(points), np.bool_)
    if not tree.n_faces:
        return inside
    near = np.flatnonzero(((points >= tree.lower) & (points <= tree.upper)).all(axis=1))
    chunks = [points[near[start : start + _CHUNK]] for start in range(0, len(near), _CHUNK)]
    found = list((executor.map if executor else map)(tree.winding, chunks))
    if found:
        inside[near] = np.abs(np.concatenate(found)) > INSIDE
    return inside


def within_solid(tree: Tree, points: Points, executor: ThreadPoolExecutor | None = None) -> NDArray[np.bool_]:
    """Tell the same of a closed, oriented surface; points far from it are asked for together, cell by cell."""
    inside = np.zeros(len(points), np.bool_)
    if not tree.n_faces:
        return inside
    left = np.flatnonzero(((points >= tree.lower) & (points <= tree.upper)).all(axis=1))
    longest = float((tree.upper - tree.lower).max())
    for count in _CELLS:
        edge = longest / count
        index = np.minimum(((points[left] - tree.lower) / edge).astype(np.int64), count - 1)
        keys, cell = np.unique((index[:, 0] * count + index[:, 1]) * count + index[:, 2], return_inverse=True)
        if _POINTS_PER_CELL * len(keys) > len(left):
            break
        places = np.column_stack((keys // count**2, keys // count % count, keys % count))
        centres = tree.lower + (places + 0.5) * edge
        # No point of a cell is farther from its centre than a half of its diagonal.
        reach = edge * np.sqrt(3.0) / 2 * (1 + 1e-6)
        far = np.isinf(closest(tree, centres, reach).distances)
        inner = np.zeros(len(keys), np.bool_)
        inner[far] = np.abs(tree.winding(centres[far])) > INSIDE
        decided = far[cell]
        inside[left[decided]] = inner[cell[decided]]
        left = left[~decided]
    inside[left] = within(tree, points[left], executor)
    return inside


def in_box(points: Points, tetrahedra: Tetrahedra, box: Box) -> NDArray[np.bool_]:
    """Tell which tetrahedra have their centroid in a box."""
    centroids = points[tetrahedra].mean(axis=1)
    inside: NDArray[np.bool_] = ((centroids > box[0]) & (centroids < box[1])).all(axis=1)
    return inside
