"""Closedness, manifoldness and orientation of one surface (thesis 1.4, 2.3.8)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vhp_cli.inspection.places import MAX_PLACES, at_edges, at_faces, at_vertices, point
from vhp_cli.kernels.spatial import Tree
from vhp_cli.kernels.surface import Quality, Topology
from vhp_cli.measures import Defect, Defects, Place
from vhp_cli.mesh import Mesh


def topology_defects(mesh: Mesh, topology: Topology) -> Defects:
    """Return what keeps a surface from being a closed, consistently oriented 2-manifold, by rule code."""
    defects: Defects = {}
    if len(topology.boundary_edges):
        defects["T001"] = _holes(mesh, topology)
    for code, edges, faces in (
        ("T002", topology.nonmanifold_edges, topology.nonmanifold_edge_faces),
        ("T004", topology.inconsistent_edges, topology.inconsistent_faces),
    ):
        if len(edges):
            places = at_edges(mesh, edges[:MAX_PLACES], faces[:MAX_PLACES])
            defects[code] = {"count": len(edges), "places": places}
    if len(topology.nonmanifold_vertices):
        chosen = slice(0, MAX_PLACES)
        places = at_vertices(mesh, topology.nonmanifold_vertices[chosen], topology.nonmanifold_vertex_faces[chosen])
        defects["T003"] = {"count": len(topology.nonmanifold_vertices), "places": places}
    if len(topology.duplicate_faces):
        places = at_faces(mesh, topology.duplicate_faces[:MAX_PLACES])
        defects["T006"] = {"count": len(topology.duplicate_faces), "places": places}
    return defects


def _holes(mesh: Mesh, topology: Topology) -> Defect:
    """One place for each hole, the longest first."""
    edges, loops = topology.boundary_edges, topology.boundary_loop
    ends = mesh.vertices[edges]
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    around = np.bincount(loops, lengths, topology.n_boundary_loops)
    sums = np.column_stack([np.bincount(loops, ends[:, :, axis].mean(axis=1), len(around)) for axis in range(3)])
    edge_counts = np.bincount(loops, minlength=len(around))
    _, first_edge = np.unique(loops, return_index=True)
    places: list[Place] = [
        {
            "xyz_mm": point(sums[loop] / edge_counts[loop]),
            "face": int(topology.boundary_faces[first_edge[loop]]),
            "value": float(around[loop]),
        }
        for loop in np.argsort(-around, kind="stable")[:MAX_PLACES]
    ]
    number = topology.n_boundary_loops
    holes = f"{number} holes, the longest" if number > 1 else "one hole,"
    return {"count": len(edges), "places": places, "detail": f"{holes} {around.max():.4g} mm around"}


def inward_defect(
    mesh: Mesh, topology: Topology, quality: Quality, tree: Tree, meeting: NDArray[np.int32]
) -> Defect | None:
    """Return the closed parts that are turned inside out, None if there are none.

    A part inside an even number of other parts of the same tissue bounds it from outside and must have
    positive volume; inside an odd number it bounds a cavity and must have negative volume. Parts with
    holes, without a consistent orientation, or that meet other parts (`meeting`, pairs of faces) have no
    clear outside and are left to the rules on these.
    """
    n_parts = topology.n_components
    if n_parts == 0:
        return None
    sound = np.ones(n_parts, dtype=bool)
    for faces in (topology.boundary_faces, topology.inconsistent_faces, topology.nonmanifold_edge_faces):
        labels = topology.component[faces]
        sound[labels[labels >= 0]] = False
    ends = topology.component[meeting]
    sound[ends[ends[:, 0] != ends[:, 1]]] = False
    volumes = quality.component_volume
    depths, undecided = np.zeros(n_parts, dtype=np.int32), np.zeros(n_parts, dtype=bool)
    if n_parts > 1:
        bounding = (topology.component >= 0) & sound[np.maximum(topology.component, 0)]
        labels = np.where(bounding, topology.component, np.int32(-1))
        depths, undecided = tree.component_depths(labels, n_parts)
    # The sign of a volume within rounding of zero tells nothing: a part so flat has no outside, and counts as wrong.
    flat = np.abs(volumes) <= 1e-12 * quality.component_area**1.5
    wrong = np.flatnonzero(sound & ~undecided & (flat | ((volumes > 0) == (depths % 2 == 1))))
    if not len(wrong):
        return None
    wrong = wrong[np.argsort(-np.abs(volumes[wrong]), kind="stable")]
    cavities = int((depths[wrong] % 2).sum())
    detail = f"{len(wrong)} of {n_parts} parts" if n_parts > 1 else "the whole surface"
    if cavities:
        detail += f", {cavities} of them walls of cavities or parts inside other parts"
    worst = wrong[:MAX_PLACES]
    return {
        "count": len(wrong),
        "places": at_faces(mesh, first_faces(topology)[worst], np.abs(volumes[worst])),
        "detail": detail,
    }


def first_faces(topology: Topology) -> NDArray[np.int64]:
    """Return the first face of each component (C,)."""
    labels, first = np.unique(topology.component, return_index=True)
    return first[labels >= 0]


def has_odd_edge(mesh: Mesh, topology: Topology) -> bool:
    """Tell if three, five, ... faces meet at some edge: then parity does not separate inside from outside."""
    if not len(topology.nonmanifold_edges):
        return False
    faces = mesh.faces[topology.component >= 0]
    edges = np.sort(np.concatenate((faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]])), axis=1).astype(np.int64)
    _, uses = np.unique(edges[:, 0] * len(mesh.vertices) + edges[:, 1], return_counts=True)
    return bool((uses % 2).any())
