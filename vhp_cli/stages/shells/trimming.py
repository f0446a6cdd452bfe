"""Cut from a surface what is too shallow for a layer."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vhp_cli import engines
from vhp_cli.kernels.spatial import Tree
from vhp_cli.mesh import Mesh
from vhp_cli.stages.clearance.zero_surface import zero_surface
from vhp_cli.stages.shells.layer import Layer, nearest
from vhp_cli.stages.shells.parts import quartered
from vhp_cli.stages.shells.thickness import STEEPEST

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

# The cutter reaches so many cells out of the surface.
_BEYOND = 1.5
# Size of the parts of faces that are told apart, in thicknesses.
_PART_SIZE, _MOST_SPLITS = 1.5, 6
# The cutter is simplified by this part of a cell.
_SIMPLIFY = 0.1
# Triangles of the cutter by area of the surface in square cells, by measurement, and most of them.
_FACES_PER_CELL, _MOST_FACES = 17.0, 450_000


class Shallow(NamedTuple):
    """The parts (T, 3, 3) of a surface that are too shallow, and the largest thickness that is wanted there."""

    corners: Floats
    thickness_mm: float


def shallow_parts(mesh: Mesh, layer: Layer, places: Mask, share: float) -> Shallow:
    """Return the parts of faces (F,) of a surface that are less than a share of the thickness deeper than asked."""
    corners = mesh.vertices[mesh.faces[places]]
    thickness = layer.distances(corners.reshape(-1, 3)).wanted.reshape(-1, 3).max(axis=1)
    for _ in range(_MOST_SPLITS):
        longest = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2).max(axis=1)
        split = longest > _PART_SIZE * thickness
        if not split.any():
            break
        parts = quartered(corners[split])
        thickness = np.concatenate([thickness[~split], np.repeat(thickness[split], 4)])
        corners = np.concatenate([corners[~split], parts])
    points = np.concatenate([corners, corners.mean(axis=1, keepdims=True)], axis=1)
    found, wanted = layer.depths(points.reshape(-1, 3))
    shallow = (found < (1 + share) * wanted).reshape(-1, 4).any(axis=1)
    return Shallow(corners[shallow], float(thickness[shallow].max(initial=0.0)))


def cell_size(shallow: Shallow, share: float) -> float:
    """Return the edge in mm of the cells in which it is cut: a share of the thickness, or more if they are many."""
    first, second = (shallow.corners[:, k] - shallow.corners[:, 0] for k in (1, 2))
    area = float(np.linalg.norm(np.cross(first, second), axis=1).sum()) / 2
    return max(share * shallow.thickness_mm, float(np.sqrt(_FACES_PER_CELL * area / _MOST_FACES)))


def trimmed(
    mesh: Mesh, layer: Layer, shallow: Shallow, *, share: float, cell_mm: float, memory_gb: float | None = None
) -> Mesh:
    """Return a surface without what is too shallow.

    Parameters
    ----------
    mesh
        The surface within the layer's outer one, closed and free of self-intersections.
    layer
        The layer.
    shallow
        Where it is too shallow.
    share
        Share of the thickness by which it is cut deeper than asked.
    cell_mm
        Edge of the cells in which this is worked out.
    memory_gb
        Limit of the engine.

    Raises
    ------
    CallFailed
        If the engine came to no result.
    TooFineError
        If there are too many cells.
    """
    patch = Tree(shallow.corners.reshape(-1, 3), np.arange(3 * len(shallow.corners)).reshape(-1, 3))
    deepest = (1 + share) * shallow.thickness_mm
    # What is too shallow within the surface is no farther from where that is so on it than the layer is thick.
    around, beyond = deepest + cell_mm, _BEYOND * cell_mm
    steepest = 1 + STEEPEST * (1 + share)

    def cutter(points: Floats, reach_mm: float) -> Floats:
        reach = steepest * reach_mm
        values = np.full(len(points), 2 * reach)
        away = nearest(patch, points, around + 2 * reach, layer.threads).distances
        at = np.flatnonzero(np.isfinite(away))
        found, wanted = layer.depths(points[at], around + 2 * reach)
        values[at] = np.maximum.reduce([found - (1 + share) * wanted, -beyond - found, away[at] - around])
        return values / steepest

    pad = around + 2 * cell_mm
    made = zero_surface(cutter, patch.lower - pad, patch.upper + pad, cell_mm)
    both = Mesh(
        np.concatenate([mesh.vertices, made.vertices]),
        np.concatenate([mesh.faces, made.faces + np.int32(len(mesh.vertices))]),
    )
    return engines.call(
        "difference", both, memory_gb=memory_gb, first_faces=len(mesh.faces), simplify_mm=_SIMPLIFY * cell_mm
    )
