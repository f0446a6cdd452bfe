"""The connected parts of all surfaces, how they lie in each other, and what regions they divide space into."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vhp_cli.kernels import surface
from vhp_cli.kernels.spatial import Tree
from vhp_cli.stages.tetmesh.labelling import within
from vhp_cli.stages.tetmesh.tissues import Tissue, without_flat_faces
from vhp_cli.volume import Points

NOWHERE = -1


@dataclass(frozen=True, slots=True, eq=False)
class Component:
    """A connected part of the surface of a tissue.

    Parameters
    ----------
    tissue
        Index of the tissue.
    tree
        The part.
    volume_mm3
        Signed; positive if it faces outward.
    vertex : (3,) float64
        A point on it, in mm.
    """

    tissue: int
    tree: Tree
    volume_mm3: float
    vertex: NDArray[np.float64]


def components_of(tissues: Sequence[Tissue]) -> list[Component]:
    """Return the parts of all surfaces, those of each tissue together and in the order of their first faces."""
    found = []
    for index, tissue in enumerate(tissues):
        mesh = without_flat_faces(tissue.mesh)
        topology = surface.topology(mesh.vertices, mesh.faces)
        quality = surface.quality(mesh.vertices, mesh.faces, topology.component, topology.n_components)
        for number in range(topology.n_components):
            faces = mesh.faces[topology.component == number]
            tree = Tree(mesh.vertices, faces)
            found.append(Component(index, tree, float(quality.component_volume[number]), mesh.vertices[faces[0, 0]]))
    return found


@dataclass(frozen=True, slots=True, eq=False)
class Located:
    """Where points lie among the parts of all surfaces.

    Parameters
    ----------
    innermost : (P,) int32
        The smallest part that each point lies within, -1 for none.
    tissues : (T, P) bool
        Whether each point lies in each tissue: within more parts that face outward than inward, or the other way
        round.
    """

    innermost: NDArray[np.int32]
    tissues: NDArray[np.bool_]


def locate(components: Sequence[Component], points: Points) -> Located:
    """Find out within which parts of surfaces points lie."""
    innermost = np.full(len(points), NOWHERE, np.int32)
    count = 1 + max((part.tissue for part in components), default=-1)
    winding = np.zeros((count, len(points)), np.int32)
    # From the largest to the smallest, so that the smallest is written last.
    for index in sorted(range(len(components)), key=lambda index: (-abs(components[index].volume_mm3), -index)):
        part = components[index]
        inside = within(part.tree, points)
        innermost[inside] = index
        winding[part.tissue, inside] += 1 if part.volume_mm3 > 0 else -1
    return Located(innermost, winding != 0)


def expected_parts(
    tissues: Sequence[Tissue], components: Sequence[Component], order: Sequence[int]
) -> list[int | None]:
    """Return in how many connected parts each tissue has to come out, told from the surfaces alone.

    Surfaces that do not meet divide space into regions, each bounded from outside by one part of a surface. The
    winding numbers of a region are sums over the parts around it, and neighbouring regions of one tissue are one.

    Parameters
    ----------
    tissues
        The tissues.
    components
        Their parts, from `components_of`.
    order
        How they are laid over each other; see `vhp_cli.stages.tetmesh.labelling.precedence`.

    Returns
    -------
    list
        None for a tissue that is not clean, or near one that is not: nothing can be told exactly.
    """
    chosen = [index for index, part in enumerate(components) if tissues[part.tissue].clean]
    around = {index: [] for index in chosen}  # type: dict[int, list[int]]
    starts = np.array([components[index].vertex for index in chosen]).reshape(-1, 3)
    for outer in chosen:
        # On its own surface a point is neither inside nor outside.
        for inner in np.asarray(chosen)[components[outer].tree.inside(starts) == 1]:
            around[int(inner)].append(outer)
    region_label = {}
    for index in chosen:
        winding = dict.fromkeys(range(len(tissues)), 0)
        for part in (index, *around[index]):
            winding[components[part].tissue] += 1 if components[part].volume_mm3 > 0 else -1
        region_label[index] = next((tissue for tissue in reversed(order) if winding[tissue]), NOWHERE)
    counts = [0] * len(tissues)
    for index in chosen:
        label = region_label[index]
        # The part directly around it is the one with the most parts around itself.
        parent = max(around[index], key=lambda part: len(around[part]), default=None)
        outside = NOWHERE if parent is None else region_label[parent]
        if label != NOWHERE and label != outside:
            counts[label] += 1
    unclear = [part.tree for part in components if not tissues[part.tissue].clean]
    return [
        count if tissue.clean and not any(_boxes_meet(tissue, tree) for tree in unclear) else None
        for tissue, count in zip(tissues, counts, strict=True)
    ]


def _boxes_meet(tissue: Tissue, tree: Tree) -> bool:
    if not len(tissue.mesh.faces):
        return False
    corners = tissue.mesh.vertices[np.unique(tissue.mesh.faces)]
    return bool((corners.min(axis=0) <= tree.upper).all() and (corners.max(axis=0) >= tree.lower).all())
