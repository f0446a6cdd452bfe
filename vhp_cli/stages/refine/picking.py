"""Which triangles to refine: those with the largest errors, or the largest ones."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from vhp_cli.mesh import Mesh


def worst(values: NDArray[np.float64], percent: float) -> NDArray[np.bool_]:
    """Pick the faces with the largest values.

    Parameters
    ----------
    values : (F,) float64
        One for each face.
    percent
        How many of the faces, to the nearest whole number (halves up), but at least one.

    Returns
    -------
    (F,) bool
        The picked faces; of equal values those of lower number.
    """
    count = min(max(math.floor(len(values) * percent / 100 + 0.5), 1), len(values))
    picked = np.zeros(len(values), dtype=np.bool_)
    picked[np.argsort(-values, kind="stable")[:count]] = True
    return picked


def sizes(mesh: Mesh) -> NDArray[np.float64]:
    """Return the size of each face in mm (F,): the radius of the smallest circle around it.

    That is r_out, the triangle size of thesis 2.1.4, but half of the longest edge for an obtuse triangle: its r_out
    says little, as it grows without bound while the triangle gets flat.
    """
    corners = mesh.vertices[mesh.faces]
    squares = np.sort(((corners - np.roll(corners, -1, axis=1)) ** 2).sum(axis=2), axis=1)
    double_area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    half_longest = np.sqrt(squares[:, 2]) / 2
    is_acute = (squares[:, 2] < squares[:, 0] + squares[:, 1]) & (double_area > 0)
    r_out = np.divide(np.sqrt(squares.prod(axis=1)), 2 * double_area, out=np.zeros(len(corners)), where=is_acute)
    radii: NDArray[np.float64] = np.where(is_acute, np.maximum(r_out, half_longest), half_longest)
    return radii


def with_neighbours(mesh: Mesh, picked: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the picked faces and those that have a vertex in common with them (F,)."""
    reached = np.zeros(len(mesh.vertices), dtype=np.bool_)
    reached[mesh.faces[picked]] = True
    of_corners: NDArray[np.bool_] = reached[mesh.faces]
    return np.asarray(of_corners.any(axis=1))
