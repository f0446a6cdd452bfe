"""A surface with a name, and several of them as one mesh."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vhp_cli.mesh import Faces, Mesh, Vertices

# How headers call the units of coordinates.
UNIT_WORDS = {"um": "micrometres", "mm": "millimetres", "cm": "centimetres", "in": "inches", "m": "metres"}


@dataclass(frozen=True, slots=True, eq=False)
class NamedSurface:
    """A tissue as it is written: its name in the file, and its mesh in the unit of the file."""

    name: str
    mesh: Mesh


@dataclass(frozen=True, slots=True, eq=False)
class Combined:
    """Several meshes as one (thesis eq. 2.16: ``P = [P1; P2]``, ``t = [t1; t2 + n1]``).

    Parameters
    ----------
    vertices : (V, 3) float64
        Of all meshes, one after the other.
    faces : (F, 3) int32
        Into `vertices`, 0-based.
    tissue : (F,) int32
        Number of the mesh that each face is of, from 1.
    """

    vertices: Vertices
    faces: Faces
    tissue: NDArray[np.int32]


def combined(surfaces: Sequence[NamedSurface]) -> Combined:
    """Return all surfaces as one mesh."""
    meshes = [surface.mesh for surface in surfaces]
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return Combined(
        np.concatenate([np.empty((0, 3)), *(mesh.vertices for mesh in meshes)]),
        np.concatenate(
            [
                np.empty((0, 3), np.int32),
                *(mesh.faces + np.int32(offset) for mesh, offset in zip(meshes, offsets[:-1], strict=True)),
            ]
        ),
        np.repeat(np.arange(1, len(meshes) + 1, dtype=np.int32), [len(mesh.faces) for mesh in meshes]),
    )
