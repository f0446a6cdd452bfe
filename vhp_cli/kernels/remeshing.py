"""Remeshing by guarded local operations: splits, collapses, flips and relocations that leave a valid mesh valid.

An operation is done only if the surface stays manifold, no face touches, crosses or is folded onto another one that
it did not before (decided exactly, as `vhp check` does), none turns over, the surface stays within `deviation` of the
reference and the reference within `deviation` of the surface, and the triangles do not get worse. Every coordinate is
a float32 value, and judged as such: writing an STL changes nothing.
"""

from __future__ import annotations

import ctypes
import math
import weakref
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vhp_cli import rounding
from vhp_cli.errors import KernelError
from vhp_cli.kernels import surface
from vhp_cli.kernels._arguments import MAX_FACES, checked_mesh
from vhp_cli.kernels._library import address, check_allocation, f64, function, i64, pointer
from vhp_cli.kernels.spatial import Tree, _tree

Float = NDArray[np.float64]
Int = NDArray[np.int32]

# Mirrored from guarded.h.
_COUNTS = 11

# The guards look at points only, and between them the surface is a little farther away: they keep to this part of the
# deviation. Measured densely on 152 closed surfaces, 147 then stayed within it, and the worst within 1.3 of it.
_MARGIN = 0.9

# An edge of the reference gets samples along it if cutting it off could take the surface farther away than this part
# of the deviation; so far apart, in wanted lengths; and so many at most.
_CUT_SHARE = 0.25
_SAMPLE_SPACING = 0.2
_MOST_EDGE_SAMPLES = 500

# Half a degree: edges are never folded more sharply than this (unless they were before).
_LEAST_FOLD_DEG = 0.5

# Beyond it the exact predicates could overflow (predicates.h).
_LARGEST = 1e38


class _Settings(ctypes.Structure):
    """`Settings` of guarded.h."""

    _fields_ = (
        ("deviation", f64),
        ("target_quality", f64),
        ("floor", f64),
        ("min_edge", f64),
        ("edge_floor", f64),
        ("fold_cosine", f64),
        ("unit", f64),
        ("max_faces", i64),
        ("max_work", i64),
    )


_settings = ctypes.POINTER(_Settings)
_create = function(
    "vhp_guarded_create",
    pointer,
    [pointer, i64, pointer, i64, pointer, pointer, _tree, pointer, pointer, i64, _settings],
)
_free = function("vhp_guarded_free", None, [pointer])
_set = function("vhp_guarded_set", None, [pointer, _settings])
_extent = function("vhp_guarded_extent", None, [pointer, pointer, pointer])
_read = function("vhp_guarded_read", ctypes.c_int, [pointer] * 4)
_counts = function("vhp_guarded_counts", None, [pointer, pointer])
_run = function("vhp_guarded_run", i64, [pointer, i64, ctypes.c_int])
_split = function("vhp_guarded_split", i64, [pointer, f64, ctypes.c_int])
_collapse = function("vhp_guarded_collapse", i64, [pointer, f64, f64, f64])
_flip = function("vhp_guarded_flip", i64, [pointer, ctypes.c_int])
_relax = function("vhp_guarded_relax", i64, [pointer, f64])
_improve = function("vhp_guarded_improve", i64, [pointer, f64, i64, ctypes.c_int])
_restore_volume = function("vhp_guarded_restore_volume", i64, [pointer, i64, f64])
_components = function("vhp_guarded_components", i64, [pointer])
_volumes = function("vhp_guarded_volumes", None, [pointer] * 4)


@dataclass(frozen=True, slots=True)
class Counts:
    """What a `Remesher` has done since it was made.

    Parameters
    ----------
    splits, collapses, flips, relocations
        Operations done.
    refused_topology, refused_quality, refused_normal, refused_envelope, refused_contact, refused_coverage
        Operations that a guard refused; flips without a gain are not counted.
    work
        Boxes and triangles looked at, the measure of `max_work`.
    exhausted
        True if `max_work` was reached: the mesh is valid, but not finished.
    """

    splits: int
    collapses: int
    flips: int
    relocations: int
    refused_topology: int
    refused_quality: int
    refused_normal: int
    refused_envelope: int
    refused_contact: int
    refused_coverage: int
    work: int
    exhausted: bool


class Remesher:
    """A mesh under guarded local operations.

    One thread at a time may use it; different ones can work at once, since the kernels release the GIL.

    The vertices on edges that do not have exactly two faces in opposite directions never move, and these edges
    stay; so do frozen vertices and the edges between them. Contacts that the mesh has already are left alone or
    vanish; none is added.

    Parameters
    ----------
    vertices : (V, 3) array_like
        Coordinates in mm, which must be float32 values.
    faces : (F, 3) array_like
        Vertex indices of each triangle.
    sizes : (V,) array_like or float
        Wanted edge length at each vertex in mm.
    reference : tuple of vertices and faces, optional
        The surface to stay at; by default the mesh as it is given.
    reference_sizes : (V of the reference,) array_like, optional
        Wanted edge lengths there, taken over by vertices that move; by default `sizes`. Required with a reference.
    deviation
        Largest distance between surface and reference, either way, in mm. The surface is looked at in points of each
        triangle, so that between them it can be exceeded a little.
    target_quality
        q = 2 r_in / r_out up to which the quality phase goes on working on a triangle.
    floor
        q below which an operation must not take the worst triangle around, unless it was worse before.
    min_edge
        The quality phase collapses shorter edges, in mm.
    edge_floor
        Length in mm below which an operation must not take the shortest edge around, unless it was shorter before.
    max_triangles
        No edge is split beyond that number.
    max_work
        Bound on the time, by number of boxes and triangles looked at (about 3e7 a second): after it no operation
        begins.
    frozen : (V,) array_like of bool, optional
        Vertices that never move.

    Raises
    ------
    ValueError
        If a shape, an index, a coordinate or a setting is wrong.
    KernelError
        If memory runs out.
    """

    __slots__ = ("__weakref__", "_finalizer", "_handle", "_settings", "_tree")

    def __init__(
        self,
        vertices: ArrayLike,
        faces: ArrayLike,
        *,
        sizes: ArrayLike | float,
        deviation: float,
        reference: tuple[ArrayLike, ArrayLike] | None = None,
        reference_sizes: ArrayLike | float | None = None,
        target_quality: float = 0.45,
        floor: float = 0.35,
        min_edge: float = 0.01,
        edge_floor: float = 0.0,
        max_triangles: int = 1_000_000,
        max_work: int = 1_000_000_000,
        frozen: ArrayLike | None = None,
    ) -> None:
        vertices, faces = _checked_mesh(vertices, faces)
        sizes = _checked_sizes(sizes, len(vertices))
        marks = None
        if frozen is not None:
            marks = np.ascontiguousarray(frozen, dtype=np.uint8)
            if marks.shape != (len(vertices),):
                raise ValueError(f"frozen must have shape ({len(vertices)},), not {marks.shape}")
        if reference is None:
            to_vertices, to_faces, to_sizes = vertices, faces, sizes
        else:
            if reference_sizes is None:
                raise ValueError("a reference needs reference_sizes")
            to_vertices, to_faces = _checked_mesh(*reference)
        if reference_sizes is not None:
            to_sizes = _checked_sizes(reference_sizes, len(to_vertices))
        if not (deviation > 0 and math.isfinite(deviation)):
            raise ValueError(f"deviation must be above 0, not {deviation}")
        self._settings = _Settings(
            deviation=_MARGIN * deviation,
            target_quality=target_quality,
            floor=floor,
            min_edge=min_edge,
            edge_floor=edge_floor,
            fold_cosine=math.cos(math.radians(180 - _LEAST_FOLD_DEG)),
            unit=rounding.unit_mm(),
            max_faces=min(max_triangles, MAX_FACES // 4),
            max_work=max_work,
        )
        samples = _reference_samples(to_vertices, to_faces, to_sizes, deviation)
        corner_sizes = np.ascontiguousarray(to_sizes[to_faces])
        self._tree = Tree(to_vertices, to_faces)
        self._handle = _create(
            address(vertices),
            len(vertices),
            address(faces),
            len(faces),
            address(sizes),
            None if marks is None else address(marks),
            self._tree._view,
            address(corner_sizes),
            address(samples),
            len(samples),
            self._settings,
        )
        if not self._handle:
            raise KernelError("out of memory in a compiled kernel")
        self._finalizer = weakref.finalize(self, _free, self._handle)

    def run(self, iterations: int = 5, *, bulk: bool = True) -> Counts:
        """Bring edges to their wanted length and triangles to their target quality.

        Parameters
        ----------
        iterations
            Rounds of splits, collapses, flips and relocations.
        bulk
            False: only the quality phase.
        """
        check_allocation(_run(self._handle, iterations, bulk))
        return self.counts

    def split(self, factor: float = 1.35, *, settling: bool = True) -> int:
        """Split edges longer than `factor` wanted lengths, the longest first; return their number.

        Parameters
        ----------
        factor
            Ratio to the wanted length.
        settling
            Move each new vertex to where it lies well; otherwise the surface stays as it is.
        """
        return self._done(_split(self._handle, factor, settling))

    def collapse(self, factor: float = 0.75, *, least_quality: float = 0.25, longest: float = 1.35) -> int:
        """Collapse edges shorter than `factor` wanted lengths, the shortest first; return their number.

        Parameters
        ----------
        factor
            Ratio to the wanted length.
        least_quality
            No triangle may get worse than this, or than the worst around.
        longest
            No edge may get longer than so many wanted lengths.
        """
        return self._done(_collapse(self._handle, factor, least_quality, longest))

    def flip(self, *, balance: bool = False) -> int:
        """Flip edges where the worse of two triangles gets better; return their number.

        Parameters
        ----------
        balance
            Instead, flip where the number of faces at vertices gets closer to six.
        """
        return self._done(_flip(self._handle, int(balance)))

    def relax(self, step: float = 0.8) -> int:
        """Move vertices towards the centroid of their faces, along the reference; return the number of moves.

        Parameters
        ----------
        step
            Part of the way.
        """
        return self._done(_relax(self._handle, step))

    def improve(self, quality: float | None = None, *, rounds: int = 12, moving: bool = True) -> int:
        """Work on triangles below a quality and on edges below the least length; return the number of operations.

        Parameters
        ----------
        quality
            By default the target quality.
        rounds
            Most rounds over the mesh.
        moving
            Move vertices, too, besides flips and collapses.
        """
        quality = self._settings.target_quality if quality is None else quality
        return self._done(_improve(self._handle, quality, rounds, moving))

    def restore_volume(self, *, rounds: int = 5, tolerance: float = 1e-4) -> int:
        """Bring the volume of every closed component back to that at the beginning; return the number of moves.

        Vertices move along their normals, within all guards. `volumes` tells what was reached.

        Parameters
        ----------
        rounds
            Most rounds over the mesh.
        tolerance
            Relative error that is left alone.
        """
        return self._done(_restore_volume(self._handle, rounds, tolerance))

    def set_deviation(self, deviation: float) -> None:
        """Change the largest distance between surface and reference (mm)."""
        if not (deviation > 0 and math.isfinite(deviation)):
            raise ValueError(f"deviation must be above 0, not {deviation}")
        self._settings.deviation = _MARGIN * deviation
        _set(self._handle, self._settings)

    @property
    def counts(self) -> Counts:
        """What has been done so far."""
        counts = np.zeros(_COUNTS, np.int64)
        _counts(self._handle, address(counts))
        found: list[int] = counts.tolist()
        return Counts(
            splits=found[0],
            collapses=found[1],
            flips=found[2],
            relocations=found[3],
            refused_topology=found[4],
            refused_quality=found[5],
            refused_normal=found[6],
            refused_envelope=found[7],
            refused_contact=found[8],
            refused_coverage=found[9],
            work=found[10],
            exhausted=found[10] > self._settings.max_work,
        )

    @property
    def n_triangles(self) -> int:
        """Number of triangles now."""
        return self._extent()[1]

    def volumes(self) -> tuple[Float, Float]:
        """Return the volume of each component now and at the beginning, in mm3; NaN for an open one."""
        volume, area, wanted = (np.empty(_components(self._handle)) for _ in range(3))
        _volumes(self._handle, address(volume), address(area), address(wanted))
        return volume, wanted

    def result(self) -> tuple[Float, Int]:
        """Return the mesh: vertices (V, 3) float64 with float32 values, and faces (F, 3) int32."""
        vertices, faces, _ = self.result_with_sizes()
        return vertices, faces

    def result_with_sizes(self) -> tuple[Float, Int, Float]:
        """Return vertices and faces as `result`, and the wanted edge length at each vertex."""
        n_vertices, n_faces = self._extent()
        vertices, sizes = np.empty((n_vertices, 3)), np.empty(n_vertices)
        faces = np.empty((n_faces, 3), np.int32)
        check_allocation(_read(self._handle, address(vertices), address(sizes), address(faces)))
        return vertices, faces, sizes

    def _extent(self) -> tuple[int, int]:
        extent = np.zeros(2, np.int64)
        _extent(self._handle, address(extent), address(extent) + 8)
        return int(extent[0]), int(extent[1])

    @staticmethod
    def _done(status: int) -> int:
        check_allocation(status)
        return int(status)


def remesh(
    vertices: ArrayLike,
    faces: ArrayLike,
    sizes: ArrayLike | float,
    *,
    deviation: float,
    iterations: int = 5,
    target_quality: float = 0.45,
    floor: float = 0.35,
    min_edge: float = 0.01,
    max_triangles: int = 1_000_000,
    frozen: ArrayLike | None = None,
) -> tuple[Float, Int, Counts]:
    """Remesh a surface to wanted edge lengths and restore its volume.

    Parameters
    ----------
    vertices, faces, sizes, deviation, target_quality, floor, min_edge, max_triangles, frozen
        As for `Remesher`.
    iterations
        As for `Remesher.run`.

    Returns
    -------
    vertices : (V, 3) float64
        With float32 values.
    faces : (F, 3) int32
    counts
    """
    remesher = Remesher(
        vertices,
        faces,
        sizes=sizes,
        deviation=deviation,
        target_quality=target_quality,
        floor=floor,
        min_edge=min_edge,
        max_triangles=max_triangles,
        frozen=frozen,
    )
    remesher.run(iterations)
    remesher.restore_volume()
    return *remesher.result(), remesher.counts


def _checked_mesh(vertices: ArrayLike, faces: ArrayLike) -> tuple[Float, Int]:
    vertices, faces = checked_mesh(vertices, faces)
    if not (np.abs(vertices) <= _LARGEST).all():
        raise ValueError("a coordinate is not finite, or above 1e38 mm")
    if not (rounding.rounded(vertices) == vertices).all():
        raise ValueError("coordinates must be float32 values; round them and check the mesh first")
    if (faces == np.roll(faces, 1, axis=1)).any():
        raise ValueError("a face has the same vertex twice")
    return vertices, faces


def _checked_sizes(sizes: ArrayLike | float, n_vertices: int) -> Float:
    found = np.asarray(sizes, dtype=np.float64)
    if found.ndim == 0:
        found = np.full(n_vertices, float(found))
    if found.shape != (n_vertices,):
        raise ValueError(f"sizes must have shape ({n_vertices},), not {found.shape}")
    if not (np.isfinite(found).all() and (found > 0).all()):
        raise ValueError("sizes must be above 0")
    return np.ascontiguousarray(found)


def _reference_samples(vertices: Float, faces: Int, sizes: Float, deviation: float) -> Float:
    """Return the points of the reference that must stay covered: its vertices, and points along bent edges."""
    used = np.zeros(len(vertices), bool)
    used[faces.ravel()] = True
    topology = surface.topology(vertices, faces)
    edges = topology.inner_edges
    bend = np.radians(180 - surface.dihedral_angles(vertices, faces, edges, topology.inner_edge_faces))
    size = sizes[edges].mean(axis=1)
    # A chord of one wanted length across an edge that is bent by b misses it by size / 2 * tan(b / 2) at most.
    cut = 0.5 * size * np.tan(np.minimum(np.nan_to_num(bend, nan=np.pi), 3.0) / 2)
    bent = cut > _CUT_SHARE * deviation
    ends = np.concatenate([edges[bent], topology.boundary_edges, topology.nonmanifold_edges]).astype(np.int64)
    start, along = vertices[ends[:, 0]], vertices[ends[:, 1]] - vertices[ends[:, 0]]
    spacing = _SAMPLE_SPACING * sizes[ends].mean(axis=1)
    parts = np.ceil(np.linalg.norm(along, axis=1) / spacing)
    parts = np.clip(parts, 1, _MOST_EDGE_SAMPLES).astype(np.int64)
    inner = np.repeat(np.arange(len(ends)), parts - 1)
    rank = np.arange(len(inner)) - np.repeat(np.cumsum(parts - 1) - (parts - 1), parts - 1) + 1
    between = start[inner] + (rank / parts[inner])[:, None] * along[inner]
    return np.ascontiguousarray(np.concatenate([vertices[used], between]))
