"""Exact contacts, gaps and nesting of triangle meshes, by search trees over their faces.

Whether two faces meet, and whether a point is inside, is decided exactly for the coordinates as
given; distances, winding numbers and volumes are computed in double arithmetic. Coordinates are in
mm, volumes in mm3.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vhp_cli.kernels._library import address, check_allocation, f64, function, i64, pointer

KIND_TOUCH = 1
KIND_COPLANAR = 2
KIND_CROSSING = 3
KIND_FOLD = 4
KIND_DUPLICATE = 5
_KINDS = 6

# Pairs of faces after which counting stops; mirrored from hits.h.
MOST_PAIRS = 10_000_000

# At most so many faces per leaf (and more than half as many on average): the fastest, by measurement.
_LEAF_FACES = 4
_SMALLEST = 1e-60


class _TreeView(ctypes.Structure):
    """`Tree` of tree.h."""

    _fields_ = (
        ("n_faces", i64),
        ("n_regular", i64),
        ("n_vertices", i64),
        ("n_leaves", i64),
        ("levels", i64),
        ("vertices", pointer),
        ("faces", pointer),
        ("numbers", pointer),
        ("face_boxes", pointer),
        ("boxes", pointer),
    )


_tree = ctypes.POINTER(_TreeView)
_build = function("vhp_tree_build", ctypes.c_int, [pointer, i64, pointer, i64, i64] + [pointer] * 7)
_self_hits = function("vhp_self_hits", i64, [_tree, i64, pointer, pointer, pointer])
_pair_hits = function("vhp_pair_hits", i64, [_tree, _tree, i64, pointer, pointer, pointer])
_gap = function("vhp_gap", ctypes.c_int, [_tree, _tree, f64, pointer, pointer, pointer])
_inside = function("vhp_inside", None, [_tree, pointer, i64, pointer])
_component_depths = function("vhp_component_depths", ctypes.c_int, [_tree, pointer, i64, pointer, pointer])
_winding_prepare = function("vhp_winding_prepare", None, [_tree, pointer])
_winding = function("vhp_winding", None, [_tree, pointer, pointer, i64, f64, pointer])
_contact_points = function("vhp_contact_points", None, [pointer, pointer, i64, pointer])
_overlap_volume = function("vhp_overlap_volume", ctypes.c_int, [_tree, _tree, pointer])


@dataclass(frozen=True, slots=True, eq=False)
class Hits:
    """Pairs of faces that meet.

    Parameters
    ----------
    pairs : (M, 2) int32
        Face numbers, of the first and of the second mesh; the smaller first if there is only one mesh.
        The worst kinds come first (crossing, coplanar, fold, duplicate, touch), and within a kind the
        pairs are in ascending order.
    kinds : (M,) uint8
        ``KIND_CROSSING``: the interiors of the two faces meet, in different planes;
        ``KIND_COPLANAR``: they overlap in one plane;
        ``KIND_FOLD``: the same for faces that share an edge;
        ``KIND_DUPLICATE``: faces with the same three vertices;
        ``KIND_TOUCH``: any other common point that the mesh does not join by a shared vertex.
    counts : (6,) int64
        Number of all pairs of each kind, whether listed or not; the index is the kind.
    faces_a, faces_b : int
        Number of faces of the first and second mesh that are in any pair (`faces_b` is 0 if there is
        only one mesh).
    crossing_faces, coplanar_faces : int
        Number of faces, of both meshes together, that are in a pair of that kind.
    """

    pairs: NDArray[np.int32]
    kinds: NDArray[np.uint8]
    counts: NDArray[np.int64]
    faces_a: int
    faces_b: int
    crossing_faces: int
    coplanar_faces: int

    @property
    def n_pairs(self) -> int:
        """Number of all pairs, whether listed or not; at least that many if the count is not `complete`."""
        return int(self.counts.sum())

    @property
    def complete(self) -> bool:
        """False if there are so many pairs that counting stopped at `MOST_PAIRS` or soon after."""
        return self.n_pairs < MOST_PAIRS


@dataclass(frozen=True, slots=True, eq=False)
class Gap:
    """The smallest distance of two meshes.

    Parameters
    ----------
    contact_kind : int
        Kind of the first contact that was found, not always the worst one; 0 if the meshes are apart.
    distance : float
        In mm; 0 on contact. The relative error is about 1e-16 times the size of the two nearest
        triangles over the distance.
    points : (2, 3) float64
        The nearest points on the first and the second mesh, or a point of contact, both up to rounding.
    faces : tuple of int
        The faces on which they lie.
    """

    contact_kind: int
    distance: float
    points: NDArray[np.float64]
    faces: tuple[int, int]


class Tree:
    """An immutable search tree over the faces of a mesh.

    Faces with zero area or a repeated vertex take part in gaps, not in hits or in parity.
    Any number of threads may use a tree at the same time. It holds about 100 bytes for each triangle.

    Parameters
    ----------
    vertices : (V, 3) float64
        Coordinates in mm. Those below 1e-60 are taken as 0, which keeps the predicates exact.
    faces : (F, 3) int32
        Vertex indices of each triangle.

    Raises
    ------
    ValueError
        If a face refers to a vertex that does not exist, or to one with a coordinate that is not finite
        or exceeds 1e38.
    """

    __slots__ = ("_arrays", "_moments", "_view", "lower", "n_faces", "upper")

    n_faces: int
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]

    def __init__(self, vertices: ArrayLike, faces: ArrayLike) -> None:
        vertices = np.ascontiguousarray(vertices, dtype=np.float64).reshape(-1, 3)
        faces = np.ascontiguousarray(faces, dtype=np.int32).reshape(-1, 3)
        if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
            raise ValueError(f"faces refer to vertices outside 0..{len(vertices) - 1}")
        self.n_faces = len(faces)
        levels = max(0, (self.n_faces - 1) // _LEAF_FACES).bit_length()
        tree_vertices = np.empty_like(vertices)
        tree_faces = np.empty_like(faces)
        numbers = np.empty(self.n_faces, np.int32)
        face_boxes = np.empty((self.n_faces + 1, 6), np.float32)
        boxes = np.empty((2 << levels, 6), np.float32)
        counts = np.zeros(2, np.int64)
        bounds = np.empty((2, 3))
        outputs = [address(x) for x in (tree_vertices, tree_faces, numbers, face_boxes, boxes, counts, bounds)]
        for _ in range(2):
            status = _build(address(vertices), len(vertices), address(faces), self.n_faces, levels, *outputs)
            if status != -3:
                break
            vertices = np.where(np.abs(vertices) < _SMALLEST, 0.0, vertices)
        check_allocation(status)
        if status == -2:
            raise ValueError("a coordinate is not finite, or above 1e38 mm")
        n_regular, n_used = int(counts[0]), int(counts[1])
        if n_used < len(vertices):
            tree_vertices = tree_vertices[:n_used].copy()
        self.lower, self.upper = bounds[0], bounds[1]
        self._arrays: tuple[NDArray[np.generic], ...] = (tree_vertices, tree_faces, numbers, face_boxes, boxes)
        addresses = [address(x) for x in self._arrays]
        self._view = _TreeView(self.n_faces, n_regular, n_used, 1 << levels, levels, *addresses)
        self._moments: NDArray[np.float64] | None = None
        for array in (*self._arrays, self.lower, self.upper):
            array.flags.writeable = False

    def self_hits(self, limit: int = 4096) -> Hits:
        """Find the pairs of faces that meet where the mesh does not join them.

        What two faces share by vertex index is no contact; two vertices at one place are.

        Parameters
        ----------
        limit
            Most pairs to list; all are counted.
        """
        pairs, kinds, counts = _hit_arrays(limit)
        written = _self_hits(self._view, limit, address(pairs), address(kinds), address(counts))
        return _hits(written, pairs, kinds, counts, one_mesh=True)

    def inside(self, points: ArrayLike) -> NDArray[np.int8]:
        """Tell which points lie inside a closed surface, whichever way it is oriented.

        Exact: the parity of the crossings of a ray. On an open surface the answer means nothing.

        Parameters
        ----------
        points : (P, 3) array_like
            In mm.

        Returns
        -------
        (P,) int8
            1 inside, 0 outside, -1 on the surface.
        """
        points = np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 3)
        places = np.empty(len(points), np.int8)
        _inside(self._view, address(points), len(points), address(places))
        return places

    def component_depths(self, labels: ArrayLike, n_components: int) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
        """Count for each component how many other components contain it.

        Exact, as by the first vertex of the component that lies on no other component. Meaningful for
        closed components that do not cross each other.

        Parameters
        ----------
        labels : (F,) int32
            Component of each face, or -1 to ignore it.
        n_components
            Number of components.

        Returns
        -------
        depths : (C,) int32
            Number of components around each one.
        undecided : (C,) bool
            True where every vertex lies on another component (or there is none): the depth is then 0.

        Raises
        ------
        ValueError
            If the labels don't fit the faces or the number of components.
        """
        labels = np.ascontiguousarray(labels, dtype=np.int32)
        if labels.shape != (self.n_faces,) or (len(labels) and labels.max() >= n_components):
            raise ValueError(f"expected {self.n_faces} labels below {n_components}")
        depths = np.empty(n_components, np.int32)
        undecided = np.empty(n_components, np.uint8)
        check_allocation(
            _component_depths(self._view, address(labels), n_components, address(depths), address(undecided))
        )
        return depths, undecided.astype(np.bool_)

    def winding(self, points: ArrayLike, accuracy: float = 2.0) -> NDArray[np.float64]:
        """Compute the generalized winding number of the surface about points.

        1 inside a closed outward surface, 0 outside, between for an open one. Hierarchical, with the
        first-order far field of Barill et al. 2018, Fast winding numbers for soups and clouds.

        Parameters
        ----------
        points : (P, 3) array_like
            In mm.
        accuracy
            Distance, in radii of a group of faces, from which on the group is taken as one; ``inf``
            sums up every face.
        """
        points = np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 3)
        # Threads that come here together compute the same array; one of them is kept.
        moments = self._moments
        if moments is None:
            moments = np.empty((2 * self._view.n_leaves - 1, 7))
            _winding_prepare(self._view, address(moments))
            self._moments = moments
        numbers = np.empty(len(points))
        _winding(self._view, address(moments), address(points), len(points), accuracy, address(numbers))
        return numbers


def _hit_arrays(limit: int) -> tuple[NDArray[np.int32], NDArray[np.uint8], NDArray[np.int64]]:
    if limit < 0:
        raise ValueError("limit must not be negative")
    return np.empty((limit, 2), np.int32), np.empty(limit, np.uint8), np.zeros(_KINDS + 4, np.int64)


def _hits(
    written: int, pairs: NDArray[np.int32], kinds: NDArray[np.uint8], counts: NDArray[np.int64], *, one_mesh: bool
) -> Hits:
    check_allocation(written)
    pairs, kinds = pairs[:written], kinds[:written]
    if one_mesh:
        pairs = np.sort(pairs, axis=1)
    severity = np.array([0, 5, 2, 1, 3, 4])[kinds]
    order = np.lexsort((pairs[:, 1], pairs[:, 0], severity))
    faces_a, faces_b, crossing_faces, coplanar_faces = map(int, counts[_KINDS:])
    return Hits(
        np.ascontiguousarray(pairs[order]),
        kinds[order],
        counts[:_KINDS].copy(),
        faces_a,
        faces_b,
        crossing_faces,
        coplanar_faces,
    )


def pair_hits(a: Tree, b: Tree, limit: int = 4096) -> Hits:
    """Find the pairs of faces of two meshes that meet.

    Parameters
    ----------
    a, b
        The two meshes.
    limit
        Most pairs to list; all are counted.
    """
    pairs, kinds, counts = _hit_arrays(limit)
    written = _pair_hits(a._view, b._view, limit, address(pairs), address(kinds), address(counts))
    return _hits(written, pairs, kinds, counts, one_mesh=False)


def gap(a: Tree, b: Tree, limit: float = np.inf) -> Gap | None:
    """Find the smallest distance of two meshes, or their first contact.

    Contact is decided by the same exact test as in `pair_hits`.

    Parameters
    ----------
    a, b
        The two meshes.
    limit
        Largest distance of interest in mm; the smaller, the faster.

    Returns
    -------
    Gap or None
        None if the meshes are farther apart than `limit`, or one of them has no faces.
    """
    distance = np.zeros(1)
    points = np.empty((2, 3))
    faces = np.empty(2, np.int32)
    kind = _gap(a._view, b._view, limit, address(distance), address(points), address(faces))
    if kind < 0:
        return None
    return Gap(kind, float(distance[0]), points, (int(faces[0]), int(faces[1])))


def contact_points(first: ArrayLike, second: ArrayLike) -> NDArray[np.float64]:
    """Return a point of contact of each pair of triangles that are known to meet, for display.

    It is the mean of the points in which the edges of each pass through the other; where the triangles lie in one
    plane, or rounding loses these points, the middle between their two nearest corners.

    Parameters
    ----------
    first, second : (N, 3, 3) float64
        Corners of the triangles, in mm.

    Returns
    -------
    (N, 3) float64
    """
    first = np.ascontiguousarray(first, dtype=np.float64).reshape(-1, 3, 3)
    second = np.ascontiguousarray(second, dtype=np.float64).reshape(-1, 3, 3)
    if len(first) != len(second):
        raise ValueError(f"{len(first)} triangles can't be paired with {len(second)}")
    points = np.empty((len(first), 3))
    _contact_points(address(first), address(second), len(first), address(points))
    return points


def overlap_volume(a: Tree, b: Tree) -> float:
    """Compute the volume that two closed, consistently oriented surfaces have in common.

    By the divergence theorem, from the parts of each face inside the other surface (see overlap.c). The
    second mesh is moved by 1e-11 of the largest coordinate, which rids it of all degenerate contacts
    and adds an error of that thickness over the area in contact. What a self-intersecting surface
    encloses twice counts twice.

    Parameters
    ----------
    a, b
        The two meshes, each oriented outward or inward as a whole.

    Returns
    -------
    float
        In mm3; nan if it can't be told, as for a surface that is open or not oriented consistently.
    """
    volume = np.zeros(1)
    check_allocation(_overlap_volume(a._view, b._view, address(volume)))
    return float(volume[0])
