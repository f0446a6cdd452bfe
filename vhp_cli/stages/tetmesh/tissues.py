"""The tissues of a model as the mesher takes them: surfaces, how they lie to each other, and all of them as one."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from vhp_cli.errors import VhpError
from vhp_cli.kernels import surface
from vhp_cli.kernels.spatial import Tree
from vhp_cli.mesh import Mesh

Box = tuple[NDArray[np.float64], NDArray[np.float64]]
# Names of two tissues.
Pair = tuple[str, str]


@dataclass(frozen=True, slots=True, eq=False)
class Tissue:
    """One tissue.

    Parameters
    ----------
    name
        Unique in the model.
    mesh
        Its surface, in mm; it may be defective.
    volume_mm3
        What it encloses; None if that is not defined, as the surface is open or not oriented consistently.
    clean
        Whether the surface is closed, 2-manifold, oriented and free of self-intersections, and meets no other tissue:
        what its parts are can then be told exactly.
    defects
        Codes of the rules of T and X that its surface breaks as errors.
    priority
        Where tissues overlap that do not lie in each other, the higher one gets the common volume.
    edge_length
        Edge length wanted in this tissue, in mm or as a part of the model's diagonal; None: that of the model.
    """

    name: str
    mesh: Mesh
    volume_mm3: float | None
    clean: bool = True
    defects: tuple[str, ...] = ()
    priority: float = 0.0
    edge_length: str | None = None


@dataclass(frozen=True, slots=True)
class Relations:
    """How the tissues of a model lie to each other.

    Parameters
    ----------
    containers
        For each tissue, all tissues that it lies in.
    overlaps_mm3
        Common volume of the pairs of tissues that overlap without one lying in the other; 0 where it is not known.
    gaps_mm
        Gaps between a tissue and one that lies in it, by pair, as far as they were looked for.
    distances_mm
        Distances of tissues that lie apart, by pair, as far as they were looked for.
    contacts
        Pairs of tissues that touch, or of which it can't be told how they lie to each other.
    """

    containers: Mapping[str, frozenset[str]] = field(default_factory=dict)
    overlaps_mm3: Mapping[Pair, float] = field(default_factory=dict)
    gaps_mm: Mapping[Pair, float] = field(default_factory=dict)
    distances_mm: Mapping[Pair, float] = field(default_factory=dict)
    contacts: frozenset[Pair] = frozenset()

    @property
    def smallest_gap_mm(self) -> float | None:
        """The smallest gap between a tissue and one that lies in it; None: none was found."""
        return min(self.gaps_mm.values(), default=None)

    @property
    def smallest_distance_mm(self) -> float | None:
        """The smallest distance of two tissues that lie apart; None: none was found."""
        return min(self.distances_mm.values(), default=None)

    def among(self, names: Collection[str]) -> Relations:
        """Return how some of the tissues lie to each other."""

        def within(values: Mapping[Pair, float]) -> dict[Pair, float]:
            return {pair: value for pair, value in values.items() if pair[0] in names and pair[1] in names}

        return Relations(
            {name: around.intersection(names) for name, around in self.containers.items() if name in names},
            within(self.overlaps_mm3),
            within(self.gaps_mm),
            within(self.distances_mm),
            frozenset(pair for pair in self.contacts if pair[0] in names and pair[1] in names),
        )


def without_flat_faces(mesh: Mesh) -> Mesh:
    """Return a mesh without faces that have no area."""
    topology = surface.topology(mesh.vertices, mesh.faces)
    quality = surface.quality(mesh.vertices, mesh.faces, topology.component, topology.n_components)
    return Mesh(mesh.vertices, np.delete(mesh.faces, quality.degenerate, axis=0))


def soup(tissues: Sequence[Tissue], box: Box | None = None) -> Mesh:
    """Return all surfaces as one, not joined, without faces that have no area.

    Parameters
    ----------
    tissues
        The tissues.
    box
        Lower and upper corner of a box of air, which is added as a surface.

    Raises
    ------
    VhpError
        If nothing is left.
    """
    meshes = [without_flat_faces(tissue.mesh) for tissue in tissues]
    if box is not None:
        meshes.append(box_surface(*box))
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = np.concatenate([mesh.faces + offset for mesh, offset in zip(meshes, offsets[:-1], strict=True)])
    if not len(faces):
        raise VhpError("there is no triangle with an area to mesh from")
    used, index = np.unique(faces, return_inverse=True)
    return Mesh(np.concatenate([mesh.vertices for mesh in meshes])[used], index.reshape(-1, 3).astype(np.int32))


def box_surface(lower: NDArray[np.float64], upper: NDArray[np.float64]) -> Mesh:
    """Return the surface of a box, 12 triangles."""
    corners = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], dtype=np.float64)
    faces = [
        (0, 2, 3), (0, 3, 1), (4, 5, 7), (4, 7, 6), (0, 1, 5), (0, 5, 4),
        (2, 6, 7), (2, 7, 3), (0, 4, 6), (0, 6, 2), (1, 3, 7), (1, 7, 5),
    ]  # fmt: skip
    return Mesh(lower + corners * (upper - lower), np.array(faces, dtype=np.int32))


def bounds(tissues: Sequence[Tissue]) -> Box:
    """Return the lower and upper corner of the box around all faces of tissues."""
    corners = [tissue.mesh.vertices[np.unique(tissue.mesh.faces)] for tissue in tissues if len(tissue.mesh.faces)]
    if not corners:
        raise VhpError("there is no triangle to mesh from")
    points = np.concatenate(corners)
    return points.min(axis=0), points.max(axis=0)


def diagonal(tissues: Sequence[Tissue]) -> float:
    """Return the diagonal of the box around all tissues, in mm."""
    lower, upper = bounds(tissues)
    return float(np.linalg.norm(upper - lower))


def trees(tissues: Sequence[Tissue]) -> list[Tree]:
    """Return a search tree for each tissue, its faces turned to one side.

    Where faces are turned against each other, winding numbers say little; `vhp heal` turns them in the same way.
    """
    from vhp_cli.stages.heal.orientation import orient

    found = []
    for tissue in tissues:
        mesh = without_flat_faces(tissue.mesh)
        if "T004" in tissue.defects or "T005" in tissue.defects:
            mesh, _ = orient(mesh)
        found.append(Tree(mesh.vertices, mesh.faces))
    return found
