"""Self-intersections of one surface, told apart by kind; exact on the coordinates as stored."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vhp_cli.inspection.places import MAX_PLACES, point
from vhp_cli.kernels.spatial import (
    KIND_COPLANAR,
    KIND_CROSSING,
    KIND_DUPLICATE,
    KIND_FOLD,
    KIND_TOUCH,
    Hits,
    contact_points,
)
from vhp_cli.measures import Defects, Place, Point, SelfIntersections
from vhp_cli.mesh import Mesh

# Duplicate faces are counted among the pairs but have a topology rule of their own.
_RULE_OF_KIND = {KIND_CROSSING: "X001", KIND_COPLANAR: "X002", KIND_FOLD: "X003", KIND_TOUCH: "X004"}


def self_intersections(mesh: Mesh, hits: Hits) -> tuple[SelfIntersections, Defects]:
    """Return how many faces of a mesh meet where it does not join them, and the defects by rule code.

    `hits` are those of the mesh with itself.
    """
    record: SelfIntersections = {
        "faces": hits.faces_a,
        "pairs": hits.n_pairs,
        "crossing": int(hits.counts[KIND_CROSSING]),
        "coplanar": int(hits.counts[KIND_COPLANAR]),
        "folded": int(hits.counts[KIND_FOLD]),
        "duplicate": int(hits.counts[KIND_DUPLICATE]),
        "touching": int(hits.counts[KIND_TOUCH]),
        "complete": hits.complete,
    }
    defects: Defects = {}
    for kind, code in _RULE_OF_KIND.items():
        if hits.counts[kind]:
            listed = hits.pairs[hits.kinds == kind]
            places = _places(mesh, listed[:MAX_PLACES])
            defects[code] = {"count": int(hits.counts[kind]), "places": places}
    if not hits.complete:
        # What was not counted may be worse than what was.
        worst = defects.setdefault("X001", {"count": hits.n_pairs, "places": _places(mesh, hits.pairs[:MAX_PLACES])})
        worst["detail"] = f"counting stopped after {hits.n_pairs:,} pairs of any kind"
    return record, defects


def _places(mesh: Mesh, pairs: NDArray[np.int32]) -> list[Place]:
    corners = mesh.vertices[mesh.faces[pairs]]
    points = contact_points(corners[:, 0], corners[:, 1])
    return [{"xyz_mm": point(xyz), "face": int(face)} for xyz, face in zip(points, pairs[:, 0], strict=True)]


def middle_contact(a: Mesh, b: Mesh, hits: Hits) -> tuple[Point, list[int]]:
    """Return a point of contact of two meshes and the two faces (of a, of b) that meet there.

    Among the contacts of the worst kind the one in the middle, which is most likely to show what is wrong.
    """
    pairs = hits.pairs[hits.kinds == hits.kinds[0]]
    centres = (a.vertices[a.faces[pairs[:, 0]]] + b.vertices[b.faces[pairs[:, 1]]]).mean(axis=1)
    middle = np.linalg.norm(centres - centres.mean(axis=0), axis=1).argmin()
    first, second = (int(face) for face in pairs[middle])
    where = contact_points(a.vertices[a.faces[[first]]], b.vertices[b.faces[[second]]])
    return point(where[0]), [first, second]
