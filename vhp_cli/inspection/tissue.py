"""Everything that can be measured on one tissue by itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vhp_cli.inspection.intersections import self_intersections
from vhp_cli.inspection.places import point
from vhp_cli.inspection.quality import fold_measures, quality_record, shape_defects
from vhp_cli.inspection.topology import first_faces, has_odd_edge, inward_defect, topology_defects
from vhp_cli.kernels import surface
from vhp_cli.kernels.spatial import Tree
from vhp_cli.measures import Defects, TissueMeasures
from vhp_cli.mesh import Mesh


@dataclass(frozen=True, slots=True)
class ShapeLimits:
    """Limits below which triangles, edges and folds are counted and located."""

    quality: float
    edge_mm: float
    fold_deg: float


@dataclass(frozen=True, slots=True)
class Surface:
    """A tissue as the pair checks need it.

    Parameters
    ----------
    mesh, tree
        The surface and its search tree.
    closed
        No open edge: inside and outside are defined by parity.
    solid
        Closed, 2-manifold and outward: enclosed volumes are defined.
    representatives : (C,) int32
        One vertex of each component.
    volume_mm3, area_mm2
        As in the measures.
    """

    mesh: Mesh
    tree: Tree
    closed: bool
    solid: bool
    representatives: np.ndarray
    volume_mm3: float
    area_mm2: float


def inspect_tissue(
    mesh: Mesh, limits: ShapeLimits, *, unreferenced: int = 0
) -> tuple[TissueMeasures, Defects, Surface]:
    """Measure one surface completely.

    Parameters
    ----------
    mesh
        The surface in mm.
    limits
        What counts as badly shaped.
    unreferenced
        Vertices of the file that belong to no face (welding has dropped them).

    Returns
    -------
    measures, defects, surface
        What was measured, what is wrong, and the surface ready for the checks against other tissues.
    """
    topology = surface.topology(mesh.vertices, mesh.faces)
    quality = surface.quality(mesh.vertices, mesh.faces, topology.component, topology.n_components)
    tree = Tree(mesh.vertices, mesh.faces)
    hits = tree.self_hits()
    intersections, intersection_defects = self_intersections(mesh, hits)
    smallest_fold, fold_defect = fold_measures(mesh, topology, limits.fold_deg)
    inward = inward_defect(mesh, topology, quality, tree, hits.pairs)

    defects: Defects = {
        **topology_defects(mesh, topology),
        **({"T005": inward} if inward else {}),
        **intersection_defects,
        **({"X005": fold_defect} if fold_defect else {}),
        **shape_defects(mesh, topology, quality, min_quality=limits.quality, min_edge_mm=limits.edge_mm),
    }
    sound = topology.n_components > 0
    closed = sound and not len(topology.boundary_edges) and not has_odd_edge(mesh, topology)
    manifold = sound and not len(topology.nonmanifold_edges) and not len(topology.nonmanifold_vertices)
    oriented = sound and not len(topology.inconsistent_edges)
    # A face and its duplicate enclose nothing: closed by count, but no solid.
    simple = manifold and oriented and not len(topology.duplicate_faces)
    outward = closed and simple and inward is None and quality.volume > 0
    measures: TissueMeasures = {
        "triangles": len(mesh.faces),
        "vertices": len(mesh.vertices),
        "components": topology.n_components,
        "euler": topology.euler,
        "genus": topology.n_components - topology.euler // 2 if closed and manifold and oriented else None,
        "closed": closed,
        "manifold": manifold,
        "oriented": oriented,
        "outward": outward,
        "volume_mm3": quality.volume,
        "area_mm2": quality.area,
        "bounds_mm": {"min": point(tree.lower), "max": point(tree.upper)} if sound else None,
        "centroid_mm": point(quality.volume_centroid if outward else quality.area_centroid) if sound else None,
        "topology": {
            "boundary_edges": len(topology.boundary_edges),
            "boundary_loops": topology.n_boundary_loops,
            "nonmanifold_edges": len(topology.nonmanifold_edges),
            "nonmanifold_vertices": len(topology.nonmanifold_vertices),
            "inconsistent_edges": len(topology.inconsistent_edges),
            "inward_components": inward["count"] if inward else 0,
            "duplicate_faces": len(topology.duplicate_faces),
            "degenerate_faces": len(quality.degenerate),
            "collapsed_faces": len(topology.collapsed_faces),
            "unreferenced_vertices": unreferenced,
        },
        "quality": quality_record(quality.q),
        "size_mm": {"min": quality.r_out_min, "mean": quality.r_out_mean, "max": quality.r_out_max} if sound else None,
        "edge_mm": {
            "min": topology.edge_length_min,
            "mean": topology.edge_length_mean,
            "max": topology.edge_length_max,
        }
        if topology.n_edges
        else None,
        "min_dihedral_deg": smallest_fold,
        "self_intersections": intersections,
    }
    solid = outward and not intersections["pairs"]
    representatives = mesh.faces[first_faces(topology), 0]
    return measures, defects, Surface(mesh, tree, closed, solid, representatives, quality.volume, quality.area)


def restore_surface(mesh: Mesh, measures: TissueMeasures) -> Surface:
    """Return the surface of a mesh whose measures are known."""
    representatives = mesh.faces[:1, 0]
    if measures["components"] != 1 or measures["topology"]["collapsed_faces"]:
        topology = surface.topology(mesh.vertices, mesh.faces)
        representatives = mesh.faces[first_faces(topology), 0]
    solid = measures["outward"] and not measures["self_intersections"]["pairs"]
    return Surface(
        mesh,
        Tree(mesh.vertices, mesh.faces),
        measures["closed"],
        solid,
        representatives,
        measures["volume_mm3"],
        measures["area_mm2"],
    )


def inspect_nothing() -> TissueMeasures:
    """Return the measures of a tissue of which nothing could be read."""
    return {
        "triangles": 0,
        "vertices": 0,
        "components": 0,
        "euler": 0,
        "genus": None,
        "closed": False,
        "manifold": False,
        "oriented": False,
        "outward": False,
        "volume_mm3": 0.0,
        "area_mm2": 0.0,
        "bounds_mm": None,
        "centroid_mm": None,
        "topology": {
            "boundary_edges": 0,
            "boundary_loops": 0,
            "nonmanifold_edges": 0,
            "nonmanifold_vertices": 0,
            "inconsistent_edges": 0,
            "inward_components": 0,
            "duplicate_faces": 0,
            "degenerate_faces": 0,
            "collapsed_faces": 0,
            "unreferenced_vertices": 0,
        },
        "quality": None,
        "size_mm": None,
        "edge_mm": None,
        "min_dihedral_deg": None,
        "self_intersections": {
            "faces": 0,
            "pairs": 0,
            "crossing": 0,
            "coplanar": 0,
            "folded": 0,
            "duplicate": 0,
            "touching": 0,
            "complete": True,
        },
    }
