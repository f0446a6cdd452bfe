"""Manifold, by manifold3d: an engine for unions and differences of solids. Runs in a child process only."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vhp_cli.kernels import surface

Arrays = tuple[NDArray[np.float64], NDArray[np.int32]]


def component_union(vertices: NDArray[np.float64], faces: NDArray[np.int32], options: Mapping[str, Any]) -> Arrays:
    """Unite the components of positive volume and take the others, as cavities, out of the whole.

    Each must be closed, 2-manifold and free of self-intersections.

    Raises
    ------
    ValueError
        If a component is no 2-manifold.
    """
    manifold3d = importlib.import_module("manifold3d")

    topology = surface.topology(vertices, faces)
    solids: list[Any] = []
    cavities: list[Any] = []
    for component in range(topology.n_components):
        own = faces[topology.component == component]
        inward = surface.quality(vertices, own, np.zeros(len(own), np.int32), 1).component_volume[0] < 0
        used, index = np.unique(own[:, ::-1] if inward else own, return_inverse=True)
        part = manifold3d.Manifold(
            manifold3d.Mesh64(vert_properties=vertices[used], tri_verts=index.reshape(-1, 3).astype(np.uint64))
        )
        if part.status() != manifold3d.Error.NoError:
            raise ValueError(f"component {component} is no 2-manifold: {part.status()}")
        (cavities if inward else solids).append(part)
    whole = manifold3d.Manifold.batch_boolean(solids, manifold3d.OpType.Add)
    if cavities:
        whole -= manifold3d.Manifold.batch_boolean(cavities, manifold3d.OpType.Add)
    found = whole.to_mesh64()
    return np.array(found.vert_properties[:, :3]), np.array(found.tri_verts, dtype=np.int32)


def difference(vertices: NDArray[np.float64], faces: NDArray[np.int32], options: Mapping[str, Any]) -> Arrays:
    """Take a solid out of another one; see `_boolean`."""
    return _boolean(vertices, faces, options, "Subtract")


def merge(vertices: NDArray[np.float64], faces: NDArray[np.int32], options: Mapping[str, Any]) -> Arrays:
    """Unite two solids; see `_boolean`."""
    return _boolean(vertices, faces, options, "Add")


def _boolean(
    vertices: NDArray[np.float64], faces: NDArray[np.int32], options: Mapping[str, Any], operation: str
) -> Arrays:
    """Combine two solids that come as one mesh.

    Parameters
    ----------
    vertices, faces
        Both solids, each closed and 2-manifold.
    options
        ``first_faces``: number of faces of the first one; ``simplify_mm``: by how much the second may be simplified.
    operation
        Name of the operation in manifold3d.

    Raises
    ------
    ValueError
        If one of them is no 2-manifold, or the operation fails.
    """
    manifold3d = importlib.import_module("manifold3d")
    split = int(options["first_faces"])
    solids = []
    for name, own in (("first", faces[:split]), ("second", faces[split:])):
        used, index = np.unique(own, return_inverse=True)
        solid = manifold3d.Manifold(
            manifold3d.Mesh64(vert_properties=vertices[used], tri_verts=index.reshape(-1, 3).astype(np.uint64))
        )
        if solid.status() != manifold3d.Error.NoError:
            raise ValueError(f"the {name} solid is no 2-manifold: {solid.status()}")
        solids.append(solid)
    second = solids[1].as_original().simplify(float(options["simplify_mm"]))
    made = manifold3d.Manifold.batch_boolean([solids[0], second], getattr(manifold3d.OpType, operation))
    if made.status() != manifold3d.Error.NoError:
        raise ValueError(f"the boolean operation failed: {made.status()}")
    found = made.to_mesh64()
    return np.array(found.vert_properties[:, :3]), np.array(found.tri_verts, dtype=np.int32)
