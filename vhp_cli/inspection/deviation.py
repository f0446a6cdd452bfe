"""How far two surfaces lie apart, both ways, and which parts of the first the second has lost.

Either surface may be open, non-manifold or a heap of single triangles: nothing but distances is asked of it.

Distances are taken at sample points: all vertices; points along every edge longer than the spacing s; and at
least one point in every face, so many that each stands for at most s squared. The spacing is 1/200 of the
diagonal of the surface's box, or less where its area calls for less than 20 000 points; it grows where points
along edges, or in faces, would exceed 100 000 and 200 000. Every point of the surface is within 1.7 s of a
sample (measured on random triangles), and no distance changes by more than the way between two points: a
maximum is too small by at most 1.7 s, and never too large. Between surfaces that lie nearly parallel, as
before and after remeshing, it is too small by far less: about the change of the distance from one sample to the
next. Means and areas are weighted by the area that a point stands for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vhp_cli.inspection.places import MAX_PLACES, point
from vhp_cli.kernels.measuring import closest
from vhp_cli.kernels.reading import weld
from vhp_cli.kernels.spatial import Tree
from vhp_cli.kernels.surface import topology
from vhp_cli.measures import Deviation, Distance, Place, Point
from vhp_cli.mesh import Mesh

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_SPACINGS_ON_DIAGONAL = 200
_FEWEST_POINTS = 20_000
_MOST_FACE_POINTS = 200_000  # besides one in every face
_MOST_EDGE_POINTS = 100_000

# The R2 sequence of Roberts 2018, The unreasonable effectiveness of quasirandom sequences: multiples of the
# powers of 1/g, where g**3 = g + 1, fill the unit square evenly.
_R2 = (0.7548776662466927, 0.5698402909980532)


@dataclass(frozen=True, slots=True)
class LostPart:
    """One connected part of a surface that lies far from another surface.

    Parameters
    ----------
    area_mm2
        Of the part.
    distance_mm
        Of its farthest sample from the other surface.
    xyz_mm
        Where that is, on the part.
    face
        The face there.
    faces
        Number of faces of which at least a sample is lost.
    share_outside
        Share of its area that lies outside the other surface (winding number below 1/2), 0 to 1: material that
        is gone. The rest lies within: an inner wall that was dissolved, or a cavity that was filled.
    """

    area_mm2: float
    distance_mm: float
    xyz_mm: Point
    face: int
    faces: int
    share_outside: float


@dataclass(frozen=True, slots=True, eq=False)
class _Samples:
    """Points on a surface (P, 3), the face of each, and the area in mm2 that it stands for (0: vertices, edges).

    The first points are the vertices of these numbers.
    """

    points: Floats
    faces: Ints
    areas: Floats
    vertices: Ints


def deviation(before: Mesh, after: Mesh, *, lost_limit_mm: float) -> Deviation:
    """Measure how far input and output of a stage lie apart, at samples (see above).

    Parameters
    ----------
    before, after
        The two surfaces.
    lost_limit_mm
        What of `before` lies farther than this from `after` counts as lost.

    Raises
    ------
    ValueError
        If a surface has no faces or a coordinate that is not finite, or the limit is negative.
    """
    _require_faces(before, after)
    before_tree, after_tree = (Tree(mesh.vertices, mesh.faces) for mesh in (before, after))
    kept_before, kept_after = _common_faces(before, after)
    samples = _sample(before)
    distances = _distances(samples, after_tree, kept_before)
    to_output = _distance(samples, distances)
    parts = _lost_parts(before, samples, distances, lost_limit_mm, after_tree)
    back = _sample(after)
    to_input = _distance(back, _distances(back, before_tree, kept_after))
    places: list[Place] = [
        {"xyz_mm": part.xyz_mm, "face": part.face, "value": part.distance_mm} for part in parts[:MAX_PLACES]
    ]
    return {
        "max": max(to_output["max"], to_input["max"]),
        "mean": (to_output["mean"] + to_input["mean"]) / 2,
        "to_output": to_output,
        "to_input": to_input,
        "lost_area_mm2": float(sum(part.area_mm2 for part in parts)),
        "lost_outside_mm2": float(sum(part.area_mm2 * part.share_outside for part in parts)),
        "lost_limit_mm": float(lost_limit_mm),
        "lost_places": places,
    }


def lost_parts(before: Mesh, after: Mesh, *, limit_mm: float) -> list[LostPart]:
    """Find the connected parts of a surface that lie farther than a limit from another, the farthest first.

    Faces are in one part if they share an edge and both have lost samples.

    Parameters
    ----------
    before, after
        The two surfaces; whether a part is outside means something only if `after` is closed and outward.
    limit_mm
        The largest distance at which a point still counts as kept.

    Raises
    ------
    ValueError
        If a surface has no faces or a coordinate that is not finite, or the limit is negative.
    """
    _require_faces(before, after)
    tree = Tree(after.vertices, after.faces)
    samples = _sample(before)
    distances = _distances(samples, tree, _common_faces(before, after)[0])
    return _lost_parts(before, samples, distances, limit_mm, tree)


def _common_faces(first: Mesh, second: Mesh) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Tell which faces of either mesh the other has too, by the coordinates of their corners."""
    _, index = weld(np.concatenate([first.vertices, second.vertices]))
    second_faces = index[len(first.vertices) :][second.faces]
    corners = np.sort(np.concatenate([index[: len(first.vertices)][first.faces], second_faces]), axis=1).astype(
        np.int64
    )
    order = np.lexsort(corners.T)
    fresh = np.ones(len(order), np.bool_)
    fresh[1:] = (corners[order[1:]] != corners[order[:-1]]).any(axis=1)
    face = np.empty(len(order), np.int64)
    face[order] = np.cumsum(fresh)
    own, other = face[: len(first.faces)], face[len(first.faces) :]
    return np.isin(own, other), np.isin(other, own)


def _distances(samples: _Samples, tree: Tree, kept: NDArray[np.bool_]) -> Floats:
    """Return the distance of each sample from a surface that has the kept faces too."""
    distances = np.zeros(len(samples.points))
    moved = ~kept[samples.faces]
    distances[moved] = closest(tree, samples.points[moved]).distances
    return distances


def _require_faces(*meshes: Mesh) -> None:
    if not all(len(mesh.faces) for mesh in meshes):
        raise ValueError("a surface without faces has no distance from another")


def _sample(mesh: Mesh) -> _Samples:
    corners = mesh.vertices[mesh.faces]
    sides = np.roll(corners, -1, axis=1) - corners
    face_areas = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) / 2
    extent = corners.reshape(-1, 3).max(axis=0) - corners.reshape(-1, 3).min(axis=0)
    area = float(face_areas.sum())
    spacing = min(float(np.linalg.norm(extent)) / _SPACINGS_ON_DIAGONAL, (area / _FEWEST_POINTS) ** 0.5)

    vertices, first_use = np.unique(mesh.faces, return_index=True)
    edge_points, edge_faces = _edge_samples(mesh, np.linalg.norm(sides, axis=2), spacing)
    inner_points, inner_faces, areas = _face_samples(corners, face_areas, max(spacing**2, area / _MOST_FACE_POINTS))
    return _Samples(
        points=np.concatenate((mesh.vertices[vertices], edge_points, inner_points)),
        faces=np.concatenate((first_use // 3, edge_faces, inner_faces)),
        areas=np.concatenate((np.zeros(len(vertices) + len(edge_points)), areas)),
        vertices=vertices.astype(np.int64),
    )


def _edge_samples(mesh: Mesh, lengths: Floats, spacing: float) -> tuple[Floats, Ints]:
    """Points that cut every edge longer than the spacing into equal pieces."""
    spacing = max(spacing, float(lengths.sum()) / (2 * _MOST_EDGE_POINTS))
    if spacing <= 0:
        return np.empty((0, 3)), np.empty(0, np.int64)
    long = np.flatnonzero(lengths.reshape(-1) > spacing)
    faces = long // 3
    ends = np.column_stack((mesh.faces[faces, long % 3], mesh.faces[faces, (long + 1) % 3])).astype(np.int64)
    ends.sort(axis=1)
    # Once for all faces at an edge.
    _, first = np.unique(ends[:, 0] * len(mesh.vertices) + ends[:, 1], return_index=True)
    long, faces, ends = long[first], faces[first], ends[first]
    pieces = np.ceil(lengths.reshape(-1)[long] / spacing).astype(np.int64)
    edges, number = _repeat(pieces - 1)
    share = ((number + 1) / pieces[edges])[:, None]
    points = (1 - share) * mesh.vertices[ends[edges, 0]] + share * mesh.vertices[ends[edges, 1]]
    return points, faces[edges]


def _face_samples(corners: Floats, areas: Floats, area_per_point: float) -> tuple[Floats, Ints, Floats]:
    """Points spread evenly over every face: its centre if it has only one, else a low-discrepancy sequence."""
    counts = np.ones(len(areas), dtype=np.int64)
    if area_per_point > 0:
        counts = np.maximum(np.ceil(areas / area_per_point), 1).astype(np.int64)
    faces, number = _repeat(counts)
    u, v = ((0.5 + (number + 1) * step) % 1.0 for step in _R2)
    # What lies beyond the diagonal of the unit square is turned back by half a turn.
    beyond = u + v > 1
    u, v = np.where(beyond, 1 - u, u), np.where(beyond, 1 - v, v)
    alone = counts[faces] == 1
    u[alone] = v[alone] = 1 / 3
    a, b, c = (corners[faces, k] for k in range(3))
    points = a + u[:, None] * (b - a) + v[:, None] * (c - a)
    return points, faces, (areas / counts)[faces]


def _repeat(counts: Ints) -> tuple[Ints, Ints]:
    """Index i as often as counts[i] says, and the running number within each."""
    indices = np.repeat(np.arange(len(counts)), counts)
    return indices, np.arange(len(indices)) - np.repeat(np.cumsum(counts) - counts, counts)


def _distance(samples: _Samples, distances: Floats) -> Distance:
    farthest = int(distances.argmax())
    total = float(samples.areas.sum())
    # A surface of zero area has no weights.
    mean = float(samples.areas @ distances) / total if total > 0 else float(distances.mean())
    return {"max": float(distances[farthest]), "mean": mean, "xyz_mm": point(samples.points[farthest])}


def _lost_parts(mesh: Mesh, samples: _Samples, distances: Floats, limit: float, tree: Tree | None) -> list[LostPart]:
    """Return the lost parts; without the tree of the other surface their share outside is left at 0."""
    if not limit >= 0:
        raise ValueError(f"the limit must be at least 0, not {limit}")
    lost = np.flatnonzero(distances > limit)
    if not len(lost):
        return []
    points, areas, distances = samples.points[lost], samples.areas[lost], distances[lost]
    # All faces at a lost vertex, though it was taken from the first of them.
    is_corner = np.zeros(len(mesh.vertices), dtype=np.bool_)
    is_corner[samples.vertices[lost[lost < len(samples.vertices)]]] = True
    is_lost: NDArray[np.bool_] = np.asarray(is_corner[mesh.faces].any(axis=1))
    is_lost[samples.faces[lost]] = True
    faces = np.flatnonzero(is_lost)
    component = topology(mesh.vertices, mesh.faces[faces]).component
    # A face with equal vertices has no edges to share: a part of its own.
    alone = component < 0
    component[alone] = component.max() + 1 + np.arange(np.count_nonzero(alone))
    face_of = np.searchsorted(faces, samples.faces[lost])
    # Faces that meet others at one vertex alone may have no sample of their own: no part.
    labels, part_of = np.unique(component[face_of], return_inverse=True)
    n_parts = len(labels)

    # Each part in one run, its farthest sample first.
    order = np.lexsort((-distances, part_of))
    farthest = order[np.searchsorted(part_of[order], np.arange(n_parts))]
    area = np.bincount(part_of, areas, n_parts)
    n_faces = np.bincount(component)[labels]
    share = np.zeros(n_parts)
    if tree is not None:
        outside = tree.winding(points) < 0.5
        # A part of which no point with an area is lost: its vertices decide.
        weights = np.where(area[part_of] > 0, areas, 1.0)
        share = np.bincount(part_of, weights * outside, n_parts) / np.bincount(part_of, weights, n_parts)
    return [
        LostPart(
            area_mm2=float(area[part]),
            distance_mm=float(distances[farthest[part]]),
            xyz_mm=point(points[farthest[part]]),
            face=int(faces[face_of[farthest[part]]]),
            faces=int(n_faces[part]),
            share_outside=float(share[part]),
        )
        for part in np.argsort(-distances[farthest], kind="stable")
    ]
