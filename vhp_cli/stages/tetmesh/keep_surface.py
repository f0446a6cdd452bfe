"""Tetrahedra between surfaces whose triangles stay as they are: for clean models, by TetGen or Gmsh.

What comes back from an engine is believed only after every input triangle was found in it.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from vhp_cli import engines
from vhp_cli.errors import UsageError
from vhp_cli.inspection.adjacency import adjacency, connected_parts
from vhp_cli.inspection.tetrahedra import FACES, tetrahedron_quality
from vhp_cli.kernels.reading import weld
from vhp_cli.mesh import Mesh
from vhp_cli.processes import CallFailed
from vhp_cli.stages.tetmesh.relaxing import Floor, Parted, relax
from vhp_cli.volume import Points, Tetrahedra, VolumeMesh, volumes

ExactEngine = Literal["tetgen", "gmsh"]

# Three vertex numbers of so many bits fit into one integer.
_BITS = 21


@dataclass(frozen=True, slots=True, eq=False)
class ExactMesh:
    """Tetrahedra among whose faces all given triangles are.

    Parameters
    ----------
    points : (N, 3) float64
        In mm; the vertices of the triangles come with the very same coordinates.
    tetrahedra : (M, 4) int32
        Of all that the triangles enclose, hollow spaces included; positively oriented as a whole.
    regions : (M,) int32
        A number from 0 for all that the triangles part from each other: a region lies within a tissue as a whole, or
        not at all.
    notes
        What was done after the engine, in words.
    """

    points: Points
    tetrahedra: Tetrahedra
    regions: NDArray[np.int32]
    notes: tuple[str, ...]


def installed_engine(wanted: ExactEngine | None = None) -> ExactEngine:
    """Return the engine to use: the wanted one, or the first that is installed.

    Raises
    ------
    UsageError
        If it is not installed, or none is.
    """
    choices: tuple[ExactEngine, ...] = ("tetgen", "gmsh") if wanted is None else (wanted,)
    for name in choices:
        if engines.ENGINES[name].available:
            return name
    listed = " or ".join(f"{name} ({engines.ENGINES[name].licence})" for name in choices)
    raise UsageError(
        f"keeping the surface triangles needs {listed}, which is not installed",
        hint=f"pip install 'vhp-cli[{choices[0]}]', if its licence suits you",
    )


def keep_surface(
    surfaces: Sequence[Mesh],
    *,
    engine: ExactEngine,
    edge_length_mm: float | None = None,
    improve: bool = True,
    timeout_s: float | None = None,
    memory_gb: float | None = None,
) -> ExactMesh:
    """Fill all that surfaces enclose with tetrahedra that keep their triangles.

    Parameters
    ----------
    surfaces
        Closed, free of self-intersections, and disjoint, nested or (TetGen only) joined at whole triangles.
    engine
        Which to use.
    edge_length_mm
        Length that edges away from the surfaces should not exceed; None: as the triangles ask.
    improve
        Better the shapes between the triangles, by swaps and moves, and then by MMG, where it is installed and does
        better still.
    timeout_s, memory_gb
        Limits of all calls together, and of each.

    Raises
    ------
    CallFailed
        If the engine failed, or an input triangle is missing from its mesh.
    """
    deadline = None if timeout_s is None else time.monotonic() + timeout_s
    triangles = united(surfaces)
    points, tetrahedra = engines.call_volume(
        engine, triangles, timeout_s=timeout_s, memory_gb=memory_gb, edge_length_mm=edge_length_mm
    )
    tetrahedra = _turned(points, tetrahedra)
    lost = missing_triangles(triangles, points, tetrahedra)
    if len(lost):
        place = ", ".join(f"{value:g}" for value in triangles.vertices[triangles.faces[lost[0]]].mean(axis=0))
        raise CallFailed(
            "error",
            f"{engine} ({engines.ENGINES[engine].distribution}): {len(lost)} of {len(triangles.faces)} triangles are "
            f"not in its mesh, the first at ({place}) mm",
        )
    made = ExactMesh(points, tetrahedra, regions_between(triangles, points, tetrahedra), ())
    if not improve:
        return made
    made = relaxed(made, triangles)
    if not engines.ENGINES["mmg"].available:
        return made
    left = None if deadline is None else max(deadline - time.monotonic(), 0.001)
    return improved(made, triangles, timeout_s=left, memory_gb=memory_gb)


def relaxed(mesh: ExactMesh, triangles: Mesh) -> ExactMesh:
    """Return a mesh with better tetrahedra between the triangles, or as it was where a triangle would be lost.

    Parameters
    ----------
    mesh
        What the engine made.
    triangles
        Those that stay, from `united`.
    """
    count = int(mesh.regions.max(initial=-1)) + 1
    names = tuple(str(number) for number in range(count))
    whole = VolumeMesh(mesh.points, mesh.tetrahedra, mesh.regions + 1, names)
    kept = np.ones(len(mesh.tetrahedra), np.bool_)
    better = relax(Parted(whole, kept, mesh.regions), Floor(), 0.0, inner_only=True)
    points, tetrahedra = better.mesh.points, better.mesh.tetrahedra
    if len(missing_triangles(triangles, points, tetrahedra)):
        return mesh
    return ExactMesh(points, tetrahedra, better.regions, mesh.notes)


def improved(
    mesh: ExactMesh, triangles: Mesh, *, timeout_s: float | None = None, memory_gb: float | None = None
) -> ExactMesh:
    """Return what MMG makes of a mesh, or the mesh as it was where that is not better or not whole.

    Parameters
    ----------
    mesh
        What the engine made.
    triangles
        Those that stay, from `united`.
    timeout_s, memory_gb
        Limits of the call.
    """

    def unchanged(why: str) -> ExactMesh:
        return ExactMesh(mesh.points, mesh.tetrahedra, mesh.regions, (*mesh.notes, f"not improved by mmg: {why}"))

    _, place = _places(triangles, mesh.points)
    point_at = np.empty(int(place.max()) + 1, dtype=np.int32)
    point_at[place] = np.arange(len(mesh.points), dtype=np.int32)
    faces = point_at[triangles.faces]
    try:
        points, tetrahedra = engines.call_volume(
            "mmg",
            Mesh(mesh.points, faces),
            timeout_s=timeout_s,
            memory_gb=memory_gb,
            tetrahedra=mesh.tetrahedra,
            regions=mesh.regions + 1,
        )
    except CallFailed as failed:
        return unchanged(failed.detail)
    if len(missing_triangles(triangles, points, tetrahedra)):
        return unchanged("it lost triangles")
    before, after = tetrahedron_quality(mesh.points, mesh.tetrahedra), tetrahedron_quality(points, tetrahedra)
    change = f"{before.min_dihedral_deg.min():.2f} to {after.min_dihedral_deg.min():.2f} degrees"
    if not after.volume.min() > 0 or after.min_dihedral_deg.min() <= before.min_dihedral_deg.min():
        return unchanged(f"the smallest dihedral angle would go from {change}")
    regions = regions_between(triangles, points, tetrahedra)
    if not np.isclose(after.volume.sum(), before.volume.sum(), rtol=1e-9) or regions.max() != mesh.regions.max():
        return unchanged("it changed the regions between the triangles")
    return ExactMesh(
        points, tetrahedra, regions, (*mesh.notes, f"improved by mmg: smallest dihedral angle from {change}")
    )


def united(surfaces: Sequence[Mesh]) -> Mesh:
    """Return the triangles of several surfaces as one mesh: each place one vertex, each triangle once."""
    points = np.concatenate([surface.vertices[surface.faces].reshape(-1, 3) for surface in surfaces])
    vertices, index = weld(points)
    faces = index.reshape(-1, 3)
    _, first = np.unique(_face_keys(faces, Mesh(vertices, faces)), return_index=True)
    return Mesh(vertices, faces[np.sort(first)])


def missing_triangles(triangles: Mesh, points: Points, tetrahedra: Tetrahedra) -> NDArray[np.int64]:
    """Return the indices of the triangles whose three points are not those of a face of a tetrahedron.

    Parameters
    ----------
    triangles
        From `united`.
    points, tetrahedra
        The mesh; its points count by their coordinates, which must be the same to the last bit.
    """
    wanted, place = _places(triangles, points)
    corners = place[tetrahedra]
    # A face that counts has three corners of triangles.
    near = corners[(corners < len(triangles.vertices)).sum(axis=1) >= 3]
    return np.flatnonzero(~np.isin(wanted, _face_keys(near[:, FACES].reshape(-1, 3), triangles)))


def regions_between(triangles: Mesh, points: Points, tetrahedra: Tetrahedra) -> NDArray[np.int32]:
    """Return for each tetrahedron (M,) the number of its region, of those that the triangles part from each other."""
    joined = adjacency(tetrahedra)
    walls, place = _places(triangles, points)
    is_wall = np.isin(_face_keys(place[joined.inner], triangles), walls)
    return connected_parts(len(tetrahedra), joined.pairs[~is_wall])


def _turned(points: Points, tetrahedra: Tetrahedra) -> Tetrahedra:
    """Return tetrahedra of positive volume in all; one that is turned against the others stays so, to be seen."""
    if volumes(points, tetrahedra).sum() >= 0:
        return tetrahedra
    return np.ascontiguousarray(tetrahedra[:, [0, 2, 1, 3]])


def _places(triangles: Mesh, points: Points) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Return keys of the triangles, and for each point the vertex at its place, or a number beyond the vertices."""
    count = len(triangles.vertices)
    _, place = weld(np.concatenate((triangles.vertices, points)))
    return _face_keys(triangles.faces, triangles), place[count:]


def _face_keys(faces: NDArray[np.int32], triangles: Mesh) -> NDArray[np.int64]:
    """Return a number for each face, the same for those with the same vertices; -1 for one with other points."""
    count = len(triangles.vertices)
    if count >= 1 << _BITS:
        raise CallFailed("error", f"{count} vertices are too many to keep the surface")
    low, middle, high = np.sort(faces, axis=1).astype(np.int64).T
    return np.where(high < count, (low << 2 * _BITS) | (middle << _BITS) | high, -1)
