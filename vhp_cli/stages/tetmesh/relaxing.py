"""Better the worst tetrahedra of a labelled mesh by moving corners and swapping tetrahedra.

The mesher stops as soon as its worst tetrahedron is good enough by its own measure. Here every tetrahedron that falls
short of a target is swapped away together with those around one of its edges or faces (Freitag & Ollivier-Gooch 1997,
Tetrahedral mesh improvement using swapping and smoothing), or its corners are moved uphill: whatever makes the worst of
all tetrahedra concerned better. Corners on interfaces slide along them. No change makes a worst tetrahedron worse.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vhp_cli.inspection.adjacency import Interfaces, adjacency, interfaces
from vhp_cli.kernels import tetrahedra as kernels
from vhp_cli.volume import Labels, Points, VolumeMesh

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

_ROUNDS = 40
# Normals of the triangles at a corner that lie farther apart make an edge, which stays.
_SMOOTH_COSINE = np.cos(np.radians(40.0))


@dataclass(frozen=True, slots=True)
class Floor:
    """What tetrahedra should keep: the smallest dihedral angle, and the radius ratio."""

    min_dihedral_deg: float = 12.0
    radius_ratio: float = 0.35

    @property
    def target(self) -> kernels.Target:
        """The same for the kernels."""
        return kernels.Target(self.min_dihedral_deg, self.radius_ratio)


# What is cut off afterwards only has to keep its faces apart.
UNUSED = Floor(1.0, 0.01)


@dataclass(frozen=True, slots=True, eq=False)
class Parted:
    """A mesh with what is to be known of each tetrahedron while it is changed.

    Parameters
    ----------
    mesh
        The mesh, with what lies around the model.
    kept : (M,) bool
        Tetrahedra that will be used. The same for all of a region.
    regions : (M,) int32
        Tetrahedra of a region have the same label; they are never swapped across a region's border.
    """

    mesh: VolumeMesh
    kept: Mask
    regions: NDArray[np.int32]


def relax(parted: Parted, target: Floor, leash_mm: float, *, inner_only: bool = False) -> Parted:
    """Return a mesh whose tetrahedra meet a target, as far as moves and swaps can do it; all else stays.

    Parameters
    ----------
    parted
        The mesh.
    target
        What the tetrahedra that are kept should be like. The others only have to have some volume.
    leash_mm
        How far a corner may leave the surface on which it was, or its place where the surface has an edge or more
        than two labels meet.
    inner_only
        Whether interfaces stay exactly as they are.
    """
    mesh = parted.mesh
    found = adjacency(mesh.tetrahedra)
    normals, border, at_edge = _surface_normals(mesh.points, interfaces(found, mesh.labels))
    normals[at_edge] = 0.0
    fixed = np.zeros(len(mesh.points), np.bool_)
    fixed[found.hull] = True
    if inner_only:
        fixed |= border
    label_of = np.zeros(int(parted.regions.max(initial=0)) + 1, np.int32)
    label_of[parted.regions] = mesh.labels
    made = kernels.relax(
        mesh.points,
        mesh.tetrahedra,
        parted.regions,
        parted.kept,
        target=target.target,
        unused=UNUSED.target,
        fixed=fixed,
        border=border,
        normals=normals,
        # The border of a region within a label is no interface, and has no shape to keep by changing its edges.
        leash_mm=np.where(border, leash_mm, -1.0),
        rounds=_ROUNDS,
    )
    better = VolumeMesh(made.points, made.tetrahedra, label_of[made.labels], mesh.names)
    return Parted(better, made.used, made.labels)


def regions_of(labels: Labels, within: list[NDArray[np.int32]]) -> NDArray[np.int32]:
    """Return regions (M,) that no surface parts: of one label, and within the same surfaces.

    Parameters
    ----------
    labels : (M,) int32
        Of tetrahedra.
    within : list of (k,) int32
        The tetrahedra within each surface.
    """
    # Each surface has a number of its own, and the sum says within which ones a tetrahedron lies.
    numbers = np.random.default_rng(0).integers(0, 2**63, len(within) + 1, dtype=np.uint64)
    total = labels.astype(np.uint64) * numbers[-1]
    for inside, number in zip(within, numbers[:-1], strict=True):
        total[inside] += number
    return np.unique(total, return_inverse=True)[1].astype(np.int32)


def _surface_normals(points: Points, between: Interfaces) -> tuple[Floats, Mask, Mask]:
    """Return the unit normal at each point of an interface, which points are on one, and which of these are at edges.

    At an edge the normals of triangles differ, or more than two labels meet.
    """
    count = len(points)
    low, high = between.sides.min(axis=1), between.sides.max(axis=1)
    a, b, c = (points[between.triangles[:, corner]] for corner in range(3))
    normals = np.cross(b - a, c - a)
    normals[between.sides[:, 0] != low] *= -1
    flat = between.triangles.ravel()
    total = np.stack([np.bincount(flat, np.repeat(normals[:, axis], 3), count) for axis in range(3)], axis=1)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    total = np.divide(total, length, out=np.zeros_like(total), where=length > 0)
    on_surface = np.zeros(count, np.bool_)
    on_surface[flat] = True
    at_edge = np.zeros(count, np.bool_)
    for label, empty in ((low, -2), (high, -2)):
        smallest, largest = np.full(count, np.iinfo(np.int32).max), np.full(count, empty)
        np.minimum.at(smallest, flat, np.repeat(label, 3))
        np.maximum.at(largest, flat, np.repeat(label, 3))
        at_edge |= on_surface & (smallest != largest)
    sizes = np.linalg.norm(normals, axis=1)
    cosine = np.einsum("fi,fci->fc", normals, total[between.triangles]) / np.maximum(sizes, 1e-300)[:, None]
    at_edge[between.triangles[cosine < _SMOOTH_COSINE]] = True
    return total, on_surface, at_edge
