"""Gmsh, by gmsh: an optional engine under the GPL that keeps every triangle. Runs in a child process only."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vhp_cli.kernels import surface
from vhp_cli.kernels.spatial import Tree

Arrays = tuple[NDArray[np.float64], NDArray[np.int32]]

_TRIANGLE, _TETRAHEDRON = 2, 4
_DELAUNAY = 1


def tetrahedralize(vertices: NDArray[np.float64], faces: NDArray[np.int32], options: Mapping[str, Any]) -> Arrays:
    """Fill all that is enclosed with tetrahedra, the faces of which all triangles are (Geuzaine & Remacle 2009, Gmsh).

    Delaunay refinement, then Netgen's optimization. Each closed component bounds one volume, less the components
    directly inside of it.

    Parameters
    ----------
    vertices, faces
        Closed 2-manifold surfaces that neither cross nor touch: disjoint or nested.
    options
        ``edge_length_mm``: length that edges away from the triangles should not exceed; None: as the triangles ask.

    Returns
    -------
    points (N, 3), tetrahedra (M, 4)
        The first points are the vertices; the tetrahedra are all oriented the same way.

    Raises
    ------
    ValueError
        If components are open, or touch each other.
    """
    gmsh = importlib.import_module("gmsh")

    topology = surface.topology(vertices, faces)
    if len(topology.boundary_edges):
        raise ValueError("a surface is open")
    if len(topology.nonmanifold_edges) or len(topology.nonmanifold_vertices):
        raise ValueError("surfaces touch each other or themselves; tetgen takes those that share whole triangles")
    component = np.asarray(topology.component)
    inside = children(vertices, faces, component, topology.n_components)
    gmsh.initialize(interruptible=False)
    for name, value in (
        ("General.Terminal", 0),
        ("General.NumThreads", 1),
        ("Mesh.Algorithm3D", _DELAUNAY),
        ("Mesh.OptimizeNetgen", 1),
    ):
        gmsh.option.setNumber(name, value)
    if options.get("edge_length_mm"):
        gmsh.option.setNumber("Mesh.MeshSizeMax", float(options["edge_length_mm"]))
    gmsh.model.add("vhp")
    mesh, geometry = gmsh.model.mesh, gmsh.model.geo
    loops = []
    for index in range(topology.n_components):
        own = faces[component == index]
        used = np.unique(own)
        tag = gmsh.model.addDiscreteEntity(2)
        mesh.addNodes(2, tag, used + 1, vertices[used].ravel())
        mesh.addElementsByType(tag, _TRIANGLE, [], own.astype(np.int64).ravel() + 1)
        loops.append(geometry.addSurfaceLoop([tag]))
    for index, within in enumerate(inside):
        geometry.addVolume([loops[index], *(loops[other] for other in within)])
    geometry.synchronize()
    mesh.generate(3)
    tags, coordinates, _ = mesh.getNodes()
    order = np.argsort(tags)
    place = np.zeros(int(tags.max()) + 1, np.int32)
    place[tags[order]] = np.arange(len(tags))
    _, corners = mesh.getElementsByType(_TETRAHEDRON)
    points = np.array(coordinates).reshape(-1, 3)[order]
    tetrahedra = place[corners].reshape(-1, 4)
    gmsh.finalize()
    return points, tetrahedra


def children(
    vertices: NDArray[np.float64], faces: NDArray[np.int32], component: NDArray[np.int32], count: int
) -> list[list[int]]:
    """Return the components directly inside of each closed component; none of them touch."""
    trees = [Tree(vertices, faces[component == index]) for index in range(count)]
    first = np.array([vertices[faces[np.argmax(component == index), 0]] for index in range(count)])
    contains = np.array([tree.inside(first) == 1 for tree in trees]).reshape(count, count)
    np.fill_diagonal(contains, False)
    depth = contains.sum(axis=0)
    return [np.flatnonzero(contains[index] & (depth == depth[index] + 1)).tolist() for index in range(count)]
