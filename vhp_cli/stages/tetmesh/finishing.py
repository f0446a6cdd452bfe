"""From what a mesher made to the mesh that is handed out: tidy labels, good tetrahedra, volumes of the surfaces."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vhp_cli.kernels.spatial import Tree
from vhp_cli.stages.tetmesh.components import Component
from vhp_cli.stages.tetmesh.fitting import fit_to_surfaces, match_volumes
from vhp_cli.stages.tetmesh.labelling import Labelling, in_box
from vhp_cli.stages.tetmesh.relaxing import Floor, Parted, regions_of, relax
from vhp_cli.stages.tetmesh.tidying import tidy
from vhp_cli.stages.tetmesh.tissues import Box, box_surface
from vhp_cli.volume import BACKGROUND, VolumeMesh, volumes

# Around a box of air; no tissue can be called so, as a name is part of a path.
_AROUND = "\0"


@dataclass(frozen=True, slots=True, eq=False)
class Finish:
    """How a mesh is finished.

    Parameters
    ----------
    trees
        The surface of each tissue.
    components
        Their connected parts.
    goals_mm3
        The volume within surfaces, by the labels that lie there, where that is well defined.
    box
        Of air; None: none.
    floor
        What tetrahedra are to keep.
    epsilon_mm
        How far faces may lie from the surfaces.
    smallest_region
        Regions of fewer tetrahedra are crumbs.
    fit
        Whether interfaces are moved onto the surfaces.
    threads
        How many to use; the result does not depend on it.
    """

    trees: Sequence[Tree]
    components: Sequence[Component]
    goals_mm3: Mapping[frozenset[int], float]
    box: Box | None
    floor: Floor
    epsilon_mm: float
    smallest_region: int
    fit: bool
    threads: int


@dataclass(frozen=True, slots=True, eq=False)
class Finished:
    """A finished mesh.

    Parameters
    ----------
    mesh
        Only what is used.
    enclosed_mm3 : (T,) float64
        Volume within the surface of each tissue, whichever label it has.
    relabelled
        Number of tetrahedra given to each label when they were tidied.
    """

    mesh: VolumeMesh
    enclosed_mm3: NDArray[np.float64]
    relabelled: dict[int, int]


def finish(raw: VolumeMesh, found: Labelling, how: Finish, lap: Callable[[str, float], None]) -> Finished:
    """Finish a mesh.

    Parameters
    ----------
    raw
        With the labels that were found, and all that lies around the model.
    found
        Labels, and what lies within which surface.
    how
        How to do it.
    lap
        Called with each step and when it began.
    """
    started = time.perf_counter()
    mesh = tidy(raw, how.components, how.smallest_region).mesh
    moved = np.bincount(mesh.labels[mesh.labels != found.labels], minlength=len(mesh.names) + 1)
    lap("tidy", started)
    started = time.perf_counter()
    surfaces, kept = list(how.trees), mesh.labels != BACKGROUND
    names = mesh.names
    if how.box is not None:
        # What is around the box is no air: an interface as any other.
        kept |= in_box(mesh.points, mesh.tetrahedra, how.box)
        labels = np.where(kept, mesh.labels, len(names) + 1).astype(np.int32)
        mesh = VolumeMesh(mesh.points, mesh.tetrahedra, labels, (*names, _AROUND))
        wall = box_surface(*how.box)
        surfaces.append(Tree(wall.vertices, wall.faces))
    regions = regions_of(mesh.labels, found.within)
    within = [np.unique(regions[inside]) for inside in found.within]
    parted = relax(Parted(mesh, kept, regions), how.floor, how.epsilon_mm / 2)
    lap("relax", started)
    if how.fit:
        started = time.perf_counter()
        mesh = fit_to_surfaces(
            parted.mesh, surfaces, how.epsilon_mm, kept=parted.kept, floor=how.floor, threads=how.threads
        )
        mesh = match_volumes(mesh, how.goals_mm3, how.epsilon_mm / 2, kept=parted.kept, floor=how.floor)
        parted = relax(Parted(mesh, parted.kept, parted.regions), how.floor, 0.0, inner_only=True)
        lap("fit", started)
    mesh, kept = parted.mesh, parted.kept
    by_region = np.bincount(parted.regions, volumes(mesh.points, mesh.tetrahedra), int(regions.max(initial=0)) + 1)
    enclosed = np.array([by_region[inside].sum() for inside in within])
    labels = np.where(kept, mesh.labels, BACKGROUND)
    mesh = without_rest(VolumeMesh(mesh.points, mesh.tetrahedra, labels, names), kept)
    return Finished(mesh, enclosed, {label: int(count) for label, count in enumerate(moved)})


def without_rest(mesh: VolumeMesh, kept: NDArray[np.bool_]) -> VolumeMesh:
    """Return a mesh of some tetrahedra only, without the points that are left over."""
    used, index = np.unique(mesh.tetrahedra[kept], return_inverse=True)
    return VolumeMesh(mesh.points[used], index.reshape(-1, 4).astype(np.int32), mesh.labels[kept], mesh.names)
