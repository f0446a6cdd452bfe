"""Shape of the triangles: q, size, edges and folds (thesis 2.1, eq. 2.4)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vhp_cli.inspection.places import MAX_PLACES, at_edges, at_faces
from vhp_cli.kernels import surface
from vhp_cli.measures import Defect, Defects
from vhp_cli.measures import Quality as QualityRecord
from vhp_cli.mesh import Mesh

HISTOGRAM_BINS = 20


def quality_record(q: NDArray[np.float64]) -> QualityRecord | None:
    """Return the distribution of q (F,), None without faces.

    Quantiles are the order statistics at ``floor(p (F - 1))``: values that some triangle has.
    """
    if not len(q):
        return None
    ranks = [int(p * (len(q) - 1)) for p in (0.01, 0.05, 0.50)]
    ordered = np.partition(q, ranks)
    bins = np.minimum((q * HISTOGRAM_BINS).astype(np.int64), HISTOGRAM_BINS - 1)
    return {
        "min": float(q.min()),
        "p01": float(ordered[ranks[0]]),
        "p05": float(ordered[ranks[1]]),
        "p50": float(ordered[ranks[2]]),
        "mean": float(q.mean()),
        "histogram": np.bincount(bins, minlength=HISTOGRAM_BINS).tolist(),
    }


def shape_defects(
    mesh: Mesh, topology: surface.Topology, quality: surface.Quality, *, min_quality: float, min_edge_mm: float
) -> Defects:
    """Return degenerate and badly shaped triangles and short edges, by rule code."""
    defects: Defects = {}
    degenerate = quality.degenerate
    if len(degenerate):
        defects["Q003"] = {"count": len(degenerate), "places": at_faces(mesh, degenerate[:MAX_PLACES])}
    low = np.flatnonzero(quality.q < min_quality)
    low = low[~np.isin(low, degenerate)]
    if len(low):
        worst = low[np.argsort(quality.q[low], kind="stable")[:MAX_PLACES]]
        defects["Q001"] = {
            "count": len(low),
            "places": at_faces(mesh, worst, quality.q[worst]),
            "value": float(quality.q[worst[0]]),
            "detail": _shapes([_is_needle(mesh.vertices[mesh.faces[face]]) for face in worst]),
        }
    if topology.edge_length_min < min_edge_mm:
        defects["Q002"] = _short_edges(mesh, min_edge_mm)
    return defects


def fold_measures(mesh: Mesh, topology: surface.Topology, limit_deg: float) -> tuple[float | None, Defect | None]:
    """Return the smallest angle between two joined faces in degrees, and the edges below the limit.

    Faces that lie flat on each other (0 degrees exactly) are self-intersections and left to these rules.
    """
    if not len(topology.inner_edges):
        return None, None
    angles = surface.dihedral_angles(mesh.vertices, mesh.faces, topology.inner_edges, topology.inner_edge_faces)
    smallest = float(np.fmin.reduce(angles))
    sharp = np.flatnonzero((angles < limit_deg) & (angles > 0)) if smallest < limit_deg else np.empty(0, dtype=np.int64)
    if not len(sharp):
        return (smallest if np.isfinite(smallest) else None), None
    worst = sharp[np.argsort(angles[sharp], kind="stable")[:MAX_PLACES]]
    places = at_edges(mesh, topology.inner_edges[worst], topology.inner_edge_faces[worst, 0])
    for place, angle in zip(places, angles[worst], strict=True):
        place["value"] = float(angle)
    return smallest, {"count": len(sharp), "places": places, "value": float(angles[worst[0]])}


def _shapes(needles: list[bool]) -> str:
    """Say what the worst triangles look like: needles have one short edge, caps one angle near 180 degrees."""
    number = sum(needles)
    if number in (0, len(needles)):
        shape = "needle" if number else "cap"
        return f"a {shape}" if len(needles) == 1 else f"the worst are {shape}s"
    return f"{number} needles and {len(needles) - number} caps among the worst {len(needles)}"


def _is_needle(triangle: NDArray[np.float64]) -> bool:
    lengths = np.sort(np.linalg.norm(triangle - np.roll(triangle, 1, axis=0), axis=1))
    return bool(lengths[0] < 0.1 * lengths[1])


def _short_edges(mesh: Mesh, limit_mm: float) -> Defect:
    corners = mesh.vertices[mesh.faces]
    lengths = np.linalg.norm(corners - corners[:, [1, 2, 0]], axis=2)
    collapsed = (mesh.faces == mesh.faces[:, [1, 2, 0]]).any(axis=1)
    faces, starts = np.nonzero((lengths < limit_mm) & ~collapsed[:, None])
    edges = np.sort(np.column_stack((mesh.faces[faces, starts], mesh.faces[faces, (starts + 1) % 3])), axis=1)
    _, first = np.unique(edges[:, 0].astype(np.int64) * len(mesh.vertices) + edges[:, 1], return_index=True)
    edges = edges[first]
    faces, lengths = faces[first], lengths[faces[first], starts[first]]
    worst = np.argsort(lengths, kind="stable")[:MAX_PLACES]
    places = at_edges(mesh, edges[worst], faces[worst])
    for place, length in zip(places, lengths[worst], strict=True):
        place["value"] = float(length)
    return {"count": len(edges), "places": places, "value": float(lengths[worst[0]])}
