"""A tissue as breathing needs it, and what can be told of its shape."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from vhp_cli.kernels import surface
from vhp_cli.kernels.spatial import Tree
from vhp_cli.mesh import Mesh, Vertices
from vhp_cli.stages.breathe.roles import Role

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Tissue:
    """One tissue at rest, in the frame LPS and in mm.

    Parameters
    ----------
    name
        Unique in the model.
    mesh
        The surface at rest.
    role
        Its part in breathing.
    tree
        Search tree of the mesh.
    closed
        No open edge, so that an inside is defined.
    representatives : (C,) int
        One vertex of each component.
    volume_mm3
        Enclosed by the surface.
    """

    name: str
    mesh: Mesh
    role: Role
    tree: Tree = field(repr=False)
    closed: bool
    representatives: NDArray[np.int64] = field(repr=False)
    volume_mm3: float

    @classmethod
    def from_mesh(cls, name: str, mesh: Mesh, role: Role) -> Tissue:
        """Measure a mesh."""
        joined = surface.topology(mesh.vertices, mesh.faces)
        first = np.unique(joined.component, return_index=True)
        parts = mesh.faces[first[1][first[0] >= 0], 0].astype(np.int64)
        closed = not len(joined.boundary_edges) and not len(joined.nonmanifold_edges) % 2 and len(mesh.faces) > 0
        tree = Tree(mesh.vertices, mesh.faces)
        return cls(name, mesh, role, tree, closed, parts, abs(volume(mesh.vertices, mesh.faces)))

    @property
    def lower(self) -> Array:
        """Low corner of the box around it."""
        return self.tree.lower

    @property
    def upper(self) -> Array:
        """High corner of the box around it."""
        return self.tree.upper

    @property
    def centre(self) -> Array:
        """Middle of the box around it."""
        middle: Array = 0.5 * (self.tree.lower + self.tree.upper)
        return middle


def volume(vertices: Vertices, faces: NDArray[np.int32]) -> float:
    """Return the signed volume that a closed surface encloses, by tetrahedra about its mean vertex, in mm3."""
    if not len(faces):
        return 0.0
    corners = (vertices - vertices.mean(axis=0))[faces]
    return float(np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))) / 6.0


def of_part(tissues: Sequence[Tissue], *names: str) -> list[Tissue]:
    """Return the tissues that play one of these parts."""
    return [tissue for tissue in tissues if tissue.role.part in names]


def box(tissues: Sequence[Tissue]) -> tuple[Array, Array]:
    """Return the corners of the box around all of them."""
    return np.min([tissue.lower for tissue in tissues], axis=0), np.max([tissue.upper for tissue in tissues], axis=0)
