"""What the page shows of a tissue beside its record: its surface."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from vhp_cli.measures import TissueRecord
from vhp_cli.mesh import Mesh


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """The surface of a tissue.

    Parameters
    ----------
    mesh
        In mm.
    face_number : (F,) int64
        Number in the file of each face; None if face i is face i of the file.
    is_inside_out
        Whether its volume is negative.
    """

    mesh: Mesh
    face_number: NDArray[np.int64] | None = None
    is_inside_out: bool = field(init=False)

    def __post_init__(self) -> None:
        corners = self.mesh.vertices[self.mesh.faces] - self.mesh.vertices[:1].sum(axis=0)
        volume = float(np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])))
        object.__setattr__(self, "is_inside_out", volume < 0)

    def face(self, number: int | None) -> int | None:
        """Return the face of the mesh that has this number in the file; None if the mesh does not hold it."""
        if number is None or number < 0:
            return None
        if self.face_number is None:
            return number if number < len(self.mesh.faces) else None
        found = np.flatnonzero(self.face_number == number)
        return int(found[0]) if len(found) else None


def faces_around(surface: Shown, face: int) -> NDArray[np.int64]:
    """Return the faces that share a vertex with a face, itself among them."""
    corners = np.zeros(len(surface.mesh.vertices), dtype=bool)
    corners[surface.mesh.faces[face]] = True
    return np.flatnonzero(corners[surface.mesh.faces].any(axis=1))


def edge_length_near(surface: Shown, face: int) -> float:
    """Return the mean edge in mm of the faces that share a vertex with a face, itself left out if there are others."""
    near = faces_around(surface, face)
    if len(near) > 1:
        near = near[near != face]
    triangles = surface.mesh.vertices[surface.mesh.faces[near]]
    return float(np.linalg.norm(triangles - triangles[:, [1, 2, 0]], axis=2).mean()) or 1.0


def normal_near(surface: Shown, face: int) -> NDArray[np.float64] | None:
    """Return which way is outside at a face: the mean normal around it; turned over if the surface is inside out.

    None if the surface is flat nowhere.
    """
    corners = surface.mesh.vertices[surface.mesh.faces[faces_around(surface, face)]]
    normal: NDArray[np.float64] = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).sum(axis=0)
    length = float(np.linalg.norm(normal))
    if not length > 0:
        return None
    return normal / (-length if surface.is_inside_out else length)


# The surface of a tissue of the report, or why it can't be shown.
Surfaces = Callable[[TissueRecord], Shown | str]
