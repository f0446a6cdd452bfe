"""How two tissues lie to each other: contact, crossing, gap, enclosure (thesis 5.1.4)."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from vhp_cli.inspection.intersections import middle_contact
from vhp_cli.inspection.places import point
from vhp_cli.inspection.tissue import Surface
from vhp_cli.kernels.spatial import KIND_CROSSING, gap, overlap_volume, pair_hits
from vhp_cli.measures import PairMeasures, Relation
from vhp_cli.mesh import Mesh

# Overlaps below this share of the smaller tissue are rounding of the volume, not overlap: the crossing
# itself is decided exactly, the volume only grades contacts that cross nowhere transversally.
OVERLAP_ROUNDING = 1e-6

# Among so many of the worst contacts the one in the middle is shown.
LISTED_CONTACTS = 512

# Winding numbers between these can't be called inside or outside of an open surface.
UNDECIDED_WINDING = (0.2, 0.8)


def near_pairs(lower: NDArray[np.float64], upper: NDArray[np.float64], margin_mm: float) -> NDArray[np.int64]:
    """Return the pairs (i < j) of boxes (N, 3) that are nowhere farther apart than a margin, (P, 2)."""
    near = np.ones((len(lower), len(lower)), dtype=bool)
    for axis in range(3):
        near &= lower[:, None, axis] - margin_mm <= upper[None, :, axis]
    near &= near.T
    return np.argwhere(np.triu(near, 1))


def inspect_pair(a: Surface, b: Surface, gap_search_mm: float) -> PairMeasures | None:
    """Measure one pair of tissues.

    Parameters
    ----------
    a, b
        The tissues.
    gap_search_mm
        Gaps above this are not measured.

    Returns
    -------
    PairMeasures or None
        None if the two lie apart by more than the search limit and neither contains the other.
    """
    record: PairMeasures = {
        "relation": "disjoint",
        "inside": "",
        "min_gap_mm": None,
        "points_mm": None,
        "faces": None,
        "crossing_faces": 0,
        "contact_faces": 0,
        "coplanar_faces": 0,
        "overlap_mm3": 0.0,
        "undecided": False,
    }
    nearest = gap(a.tree, b.tree, gap_search_mm)
    if nearest is not None and nearest.contact_kind:
        return _contact(a, b, record)
    if nearest is not None:
        record["min_gap_mm"] = nearest.distance
        record["points_mm"] = [point(xyz) for xyz in nearest.points]
        record["faces"] = [int(face) for face in nearest.faces]
    for inner, outer, side in ((a, b, "a"), (b, a, "b")):
        if not _box_inside(inner, outer):
            continue
        enclosed, record["undecided"] = _enclosed(inner, outer)
        if enclosed:
            record["inside"] = side  # type: ignore[typeddict-item]
            record["relation"] = "a_inside_b" if side == "a" else "b_inside_a"
    if nearest is None and not record["inside"] and not record["undecided"]:
        return None
    return record


def _contact(a: Surface, b: Surface, record: PairMeasures) -> PairMeasures:
    hits = pair_hits(a.tree, b.tree, limit=LISTED_CONTACTS)
    where, faces = middle_contact(a.mesh, b.mesh, hits)
    record["min_gap_mm"] = 0.0
    record["points_mm"] = [where, where]
    record["faces"] = faces
    record["crossing_faces"] = hits.crossing_faces
    record["contact_faces"] = hits.faces_a + hits.faces_b
    record["coplanar_faces"] = hits.coplanar_faces
    if _same_surface(a.mesh, b.mesh):
        record["relation"] = "identical"
        record["overlap_mm3"] = abs(_volume(a)) if a.closed else 0.0
        return record
    overlap = overlap_volume(a.tree, b.tree) if a.solid and b.solid else math.nan
    if hits.counts[KIND_CROSSING] or not hits.complete:  # what was not counted may be worse than what was
        record["relation"] = "crossing"
    else:
        record["relation"], record["inside"] = _graded_contact(a, b, overlap)
    # Volumes are good to rounding only: what lies below it is contact without overlap.
    record["overlap_mm3"] = 0.0 if math.isnan(overlap) else max(0.0, overlap)
    return record


def _graded_contact(a: Surface, b: Surface, overlap: float) -> tuple[Relation, Literal["a", "b", ""]]:
    """Tell touching from crossing where every contact is degenerate (vertex, edge or plane on plane)."""
    if math.isnan(overlap):
        return "touching", ""
    volumes = _volume(a), _volume(b)
    tolerance = OVERLAP_ROUNDING * min(volumes)
    if overlap <= tolerance:
        return "touching", ""
    if overlap >= min(volumes) - tolerance:
        return "touching", "a" if volumes[0] < volumes[1] else "b"
    return "crossing", ""


def _volume(a: Surface) -> float:
    corners = a.mesh.vertices[a.mesh.faces] - a.tree.lower
    return float(np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6)


def _same_surface(a: Mesh, b: Mesh) -> bool:
    if a.faces.shape != b.faces.shape or a.vertices.shape != b.vertices.shape:
        return False
    return bool(np.array_equal(_canonical(a), _canonical(b)))


def _canonical(mesh: Mesh) -> NDArray[np.float64]:
    """Return the triangles as rows of nine numbers in an order that only the set of triangles decides."""
    rank = np.lexsort(mesh.vertices.T[::-1])
    order = np.empty(len(rank), dtype=np.int64)
    order[rank] = np.arange(len(rank))
    faces = np.sort(order[mesh.faces], axis=1)
    faces = faces[np.lexsort(faces.T[::-1])]
    return mesh.vertices[rank][faces].reshape(-1, 9)


def _box_inside(inner: Surface, outer: Surface) -> bool:
    return bool((inner.tree.lower >= outer.tree.lower).all() and (inner.tree.upper <= outer.tree.upper).all())


def _enclosed(inner: Surface, outer: Surface) -> tuple[bool, bool]:
    """Tell for two surfaces without contact if every part of one lies inside the other, and if that is undecided."""
    points = inner.mesh.vertices[inner.representatives]
    if not len(points):
        return False, False
    if outer.closed:
        return bool((outer.tree.inside(points) == 1).all()), False
    winding = np.abs(outer.tree.winding(points))
    low, high = UNDECIDED_WINDING
    return bool((winding >= high).all()), bool(((winding > low) & (winding < high)).any())
