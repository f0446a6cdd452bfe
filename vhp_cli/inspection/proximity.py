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

# The volume in common is computed with one tissue moved by 1e-11 of the largest coordinate, so that it is wrong by
# that times the area of contact. It only grades contacts that cross nowhere transversally; crossing is exact.
OVERLAP_SHIFT = 4e-11

# Vertices of a tissue that are tested against an open one.
WINDING_SAMPLES = 32

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
    a_in_b, b_in_a = _parts_inside(a, b), _parts_inside(b, a)
    record["undecided"] = a_in_b is None or b_in_a is None
    if a_in_b is not None and b_in_a is not None and (a_in_b.any() or b_in_a.any()):
        if a_in_b.all() and not b_in_a.any():
            record["relation"], record["inside"] = "a_inside_b", "a"
        elif b_in_a.all() and not a_in_b.any():
            record["relation"], record["inside"] = "b_inside_a", "b"
        else:
            # Parts of one lie in the other, parts do not: common volume without any contact of the surfaces.
            record["relation"] = "crossing"
            record["overlap_mm3"] = _known(overlap_volume(a.tree, b.tree))
    if nearest is None and record["relation"] == "disjoint" and not record["undecided"]:
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
        record["overlap_mm3"] = abs(a.volume_mm3) if a.closed else 0.0
        return record
    overlap = overlap_volume(a.tree, b.tree) if a.solid and b.solid else math.nan
    if hits.counts[KIND_CROSSING] or not hits.complete:  # what was not counted may be worse than what was
        record["relation"] = "crossing"
    elif a.solid and b.solid:
        record["relation"], record["inside"] = _graded_contact(a, b, overlap)
    else:
        record["relation"] = "touching"
    record["overlap_mm3"] = _known(overlap)
    return record


def _graded_contact(a: Surface, b: Surface, overlap: float) -> tuple[Relation, Literal["a", "b", ""]]:
    """Tell touching from crossing where every contact of two solids is degenerate (vertex, edge or plane on plane)."""
    size = max(
        1.0, *(float(np.abs(corner).max()) for corner in (a.tree.lower, a.tree.upper, b.tree.lower, b.tree.upper))
    )
    tolerance = OVERLAP_SHIFT * size * min(a.area_mm2, b.area_mm2)
    a_covered, b_covered = (overlap >= solid.volume_mm3 - tolerance for solid in (a, b))
    if overlap <= tolerance and not (a_covered or b_covered):
        return "touching", ""
    if a_covered != b_covered:
        return "touching", "a" if a_covered else "b"
    # Both are the same solid, or the volume is not known (NaN): no excuse for a contact.
    return "crossing", ""


def _known(volume: float) -> float:
    return 0.0 if math.isnan(volume) else max(0.0, volume)


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


def _parts_inside(inner: Surface, outer: Surface) -> NDArray[np.bool_] | None:
    """Tell for two surfaces without contact which parts of one lie inside the other; None if that is undecided.

    A part of a surface that nothing touches lies inside as a whole or not at all, if what surrounds it is closed.
    An open one has a mouth, in which nothing can be told.
    """
    parts = inner.representatives
    nowhere = np.zeros(len(parts), dtype=bool)
    if (len(parts) < 2 or not outer.closed) and not _box_inside(inner, outer):
        return nowhere
    if outer.closed:
        inside: NDArray[np.bool_] = outer.tree.inside(inner.mesh.vertices[parts]) == 1
        return inside
    step = max(1, len(inner.mesh.vertices) // WINDING_SAMPLES)
    winding = np.abs(outer.tree.winding(inner.mesh.vertices[::step]))
    low, high = UNDECIDED_WINDING
    if (winding <= low).all():
        return nowhere
    return ~nowhere if (winding >= high).all() else None
