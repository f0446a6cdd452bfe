"""The tissues of a mesh back as surfaces."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from vhp_cli.inspection.adjacency import adjacency, interfaces
from vhp_cli.mesh import Mesh
from vhp_cli.volume import VolumeMesh


def tissue_surfaces(mesh: VolumeMesh, containers: Mapping[str, frozenset[str]]) -> dict[str, Mesh]:
    """Return the boundary of each tissue that has tetrahedra, oriented outward, by its name.

    As in the model that was meshed, a tissue is what it is together with the tissues that lie in it.

    Parameters
    ----------
    mesh
        The mesh.
    containers
        For each tissue, all tissues that it lies in.
    """
    between = interfaces(adjacency(mesh.tetrahedra), mesh.labels)
    present = np.bincount(mesh.labels, minlength=len(mesh.names) + 1)
    found = {}
    for label, name in enumerate(mesh.names, start=1):
        if not present[label]:
            continue
        within = [other for other, inner in enumerate(mesh.names, start=1) if name in containers.get(inner, ())]
        triangles = between.boundary(label, *within)
        if len(triangles):
            used, index = np.unique(triangles, return_inverse=True)
            found[name] = Mesh(mesh.points[used], index.reshape(-1, 3).astype(np.int32))
    return found
