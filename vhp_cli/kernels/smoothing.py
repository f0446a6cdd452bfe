"""Laplacian smoothing of surface meshes, by the kernels in smooth.c, smooth_volume.c and smooth_flips.c.

The update rules are those of thesis 2.3.3, without any guard: triangles may invert, and surfaces shrink and cross.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vhp_cli.kernels._arguments import checked_mesh
from vhp_cli.kernels._library import address, check_allocation, f64, function, i32, i64, pointer

Int = NDArray[np.int32]
Float = NDArray[np.float64]
Mask = NDArray[np.bool_]

# In the order of the enum in smooth.c.
METHODS = ("standard", "lumped", "cvt", "wcc", "cvt-equal", "wcc-equal")
UPDATES = ("simultaneous", "sequential")
CORRECTIONS = ("none", "hc", "taubin", "volume")

# Relative; one digit better than is promised, so that another order of summation finds it kept too.
_VOLUME_TOLERANCE = 1e-13

_adjacency = function("vhp_smooth_adjacency", i32, [pointer, i64, i64, *[pointer] * 5])
_vertex_normals = function("vhp_smooth_normals", None, [pointer, i64, *[pointer] * 4])
_smooth_pass = function("vhp_smooth_pass", None, [pointer, i64, *[pointer] * 6, i32, f64, pointer, pointer])
_push_back = function("vhp_smooth_push_back", None, [pointer, i64, *[pointer] * 3, f64, pointer, pointer])
_vertex_components = function("vhp_smooth_components", i32, [pointer, i64, i64, pointer])
_component_volumes = function("vhp_smooth_volumes", None, [*[pointer] * 2, i64, pointer, i64, *[pointer] * 3])
_match_volumes = function(
    "vhp_smooth_match", i32, [pointer, i64, pointer, i64, pointer, i64, *[pointer] * 6, f64, pointer]
)
_delaunay_flips = function("vhp_smooth_flips", i64, [pointer, i64, pointer, i64, pointer])


@dataclass(frozen=True, slots=True)
class Smoothing:
    """How to smooth. ``p*`` is where the method would move a vertex ``p``; neighbours share an edge with it.

    Parameters
    ----------
    method
        One of `METHODS`:
        ``"standard"``, the mean of the neighbours (thesis eq. 2.12);
        ``"lumped"``, a third of the vertex and two thirds of that mean (2.13);
        ``"cvt"``, the area-weighted mean of the centroids of its triangles (2.14, centroid Voronoi tessellation);
        ``"wcc"``, the same of their circumcentres (2.15, weighted centroid of circumcentres);
        ``"cvt-equal"`` and ``"wcc-equal"``, these with equal weights. At an inner vertex of a manifold, ``"cvt-equal"``
        is the same as ``"lumped"``. A triangle without area has no circumcentre and is left out of ``"wcc"`` and
        ``"wcc-equal"``; nothing else is, and a circumcentre may lie far outside its triangle.
    update
        ``"simultaneous"``: every ``p*`` depends on the old positions only; ``"sequential"``: vertices move at once, in
        their order (thesis 2.3.4).
    step
        Factor lambda in ``p := p + lambda (p* - p)``. None: 1, or 0.5 with Taubin's correction.
    correction
        Against shrinkage; one of `CORRECTIONS`:

        ``"hc"``: each iteration moves the vertices from ``q`` to ``p`` by the method and then back by
        ``beta b + (1 - beta) mean(b of the neighbours)`` with ``b = p - (alpha o + (1 - alpha) q)``, ``o`` being the
        vertices at the start; b of a fixed vertex is 0 (HC algorithm of J. Vollmer, R. Mencl, H. Müller, Improved
        Laplacian smoothing of noisy surface meshes, Computer Graphics Forum 18(3), 1999, 131-138).

        ``"taubin"``: each iteration is one pass with `step` and one with `taubin_mu` (G. Taubin, A signal processing
        approach to fair surface design, SIGGRAPH 1995, 351-358).

        ``"volume"``: after each iteration the free vertices of each component move by one distance along their normals
        that restores the component's volume at the start to 1e-12 relative: what remains of the normal motion is its
        deviation from the mean, as in G. Huisken, The volume preserving mean curvature flow, J. reine angew. Math. 382,
        1987, 35-48. A component is what is joined through common vertices; one that an iteration would turn inside out
        or shrink beyond repair skips the iteration. The faces must be oriented consistently.
    alpha, beta
        Of the HC algorithm, both in [0, 1]: the pull towards the vertices at the start, and the share of a vertex' own
        b in the way back.
    taubin_mu
        Below -`step`. None: ``1 / (0.1 - 1 / step)``, which passes frequencies below 0.1.
    tangential
        Moves of the method, and those back of the HC algorithm, are projected to the tangent plane, perpendicular to
        the area-weighted normal of the vertex at the start of the pass. Vertices without a normal stay.

    Raises
    ------
    ValueError
        If a name is unknown or a number is out of range.
    """

    method: str = "standard"
    update: str = "simultaneous"
    step: float | None = None
    correction: str = "none"
    alpha: float = 0.0
    beta: float = 0.5
    taubin_mu: float | None = None
    tangential: bool = False

    def __post_init__(self) -> None:
        for what, value, known in (
            ("method", self.method, METHODS),
            ("update", self.update, UPDATES),
            ("correction", self.correction, CORRECTIONS),
        ):
            if value not in known:
                raise ValueError(f"{what} must be one of {', '.join(known)}, not {value!r}")
        for name, number in (("alpha", self.alpha), ("beta", self.beta)):
            if not 0 <= number <= 1:
                raise ValueError(f"{name} must lie in [0, 1], not {number}")
        if not (math.isfinite(self.factor) and self.factor > 0):
            raise ValueError(f"step must be positive, not {self.step}")
        if self.correction == "taubin":
            if self.taubin_mu is None and self.factor >= 10:
                raise ValueError(f"step must be below 10 with Taubin's correction, not {self.step}")
            if not (math.isfinite(self.mu) and self.mu < -self.factor):
                raise ValueError(f"taubin_mu must be below minus the step {self.factor}, not {self.mu}")

    @property
    def factor(self) -> float:
        """The factor lambda."""
        if self.step is None:
            return 0.5 if self.correction == "taubin" else 1.0
        return self.step

    @property
    def mu(self) -> float:
        """The factor of Taubin's second pass."""
        return 1 / (0.1 - 1 / self.factor) if self.taubin_mu is None else self.taubin_mu


@dataclass(frozen=True, slots=True, eq=False)
class Adjacency:
    """Corners and neighbours of every vertex, in the order of the faces; collapsed faces take no part.

    Parameters
    ----------
    corner_offsets : (V + 1,) int64
        Those of vertex v are ``corners[corner_offsets[v]:corner_offsets[v + 1]]``.
    corners : (C,) int32
        Corner k of face f is 3 f + k.
    neighbour_offsets : (V + 1,) int64
        The same for the neighbours.
    neighbours : (N,) int32
        Vertices at the other end of an edge, each once.
    boundary : (V,) bool
        Ends of an edge that has exactly one face.
    """

    corner_offsets: NDArray[np.int64]
    corners: Int
    neighbour_offsets: NDArray[np.int64]
    neighbours: Int
    boundary: Mask


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """A mesh after an iteration.

    Parameters
    ----------
    vertices : (V, 3) float64
        Coordinates in mm; not changed by later iterations.
    faces : (F, 3) int32
        Likewise; another array than before only if an edge was flipped.
    flips
        Edges flipped in this iteration.
    held
        Components that skipped this iteration, because it would have lost their volume.
    """

    vertices: Float
    faces: Int
    flips: int
    held: int


@dataclass(frozen=True, slots=True, eq=False)
class _Volumes:
    """Volumes to keep: of each component, about an anchor that does not move."""

    component: Int
    anchors: Float
    volumes: Float
    spreads: Float
    closed: Mask


def _mask(fixed: Mask | None, n_vertices: int) -> Mask:
    if fixed is None:
        return np.zeros(n_vertices, dtype=np.bool_)
    fixed = np.asarray(fixed)
    if fixed.dtype != np.bool_ or fixed.shape != (n_vertices,):
        raise ValueError(f"fixed must hold {n_vertices} booleans, not {fixed.dtype} of shape {fixed.shape}")
    return np.ascontiguousarray(fixed)


def adjacency(n_vertices: int, faces: Int) -> Adjacency:
    """Return corners, neighbours and boundary of the vertices, in time linear in the faces.

    Parameters
    ----------
    n_vertices
        Number of vertices.
    faces : (F, 3) int32
        Vertex indices.

    Raises
    ------
    ValueError
        If a shape or an index is wrong.
    KernelError
        If memory runs out.
    """
    _, faces = checked_mesh(np.broadcast_to(np.float64(0), (n_vertices, 3)), faces)
    return _adjacency_of(n_vertices, faces)


def _adjacency_of(n_vertices: int, faces: Int) -> Adjacency:
    n = len(faces)
    corner_offsets, neighbour_offsets = np.empty((2, n_vertices + 1), dtype=np.int64)
    corners, neighbours = np.empty(3 * n, dtype=np.int32), np.empty(6 * n, dtype=np.int32)
    boundary = np.empty(n_vertices, dtype=np.bool_)
    outputs = (corner_offsets, corners, neighbour_offsets, neighbours, boundary)
    check_allocation(_adjacency(address(faces), n, n_vertices, *(address(array) for array in outputs)))
    return Adjacency(
        corner_offsets=corner_offsets,
        corners=corners[: corner_offsets[-1]],
        neighbour_offsets=neighbour_offsets,
        neighbours=neighbours[: neighbour_offsets[-1]].copy(),
        boundary=boundary,
    )


def _normals(vertices: Float, faces: Int, around: Adjacency) -> Float:
    normals = np.empty_like(vertices)
    _vertex_normals(
        address(vertices),
        len(vertices),
        address(faces),
        address(around.corner_offsets),
        address(around.corners),
        address(normals),
    )
    return normals


def delaunay_flips(vertices: Float, faces: Int, *, constrained: Mask | None = None) -> tuple[Int, int]:
    """Flip edges until the angles opposite to each are at most pi in sum (thesis 2.3.4).

    The edges are visited in the order of the faces, and those around a flip again. An edge stays if it does not have
    exactly two faces that run along it in opposite directions, if the new edge exists already, or if a new face would
    have no area: a manifold remains one. Every flip reduces the area of the surface, so they end (R. Dyer, H. Zhang,
    T. Möller, Delaunay mesh construction, Symposium on Geometry Processing 2007, 273-282); where the surface is bent, a
    flip changes its shape and its volume.

    Parameters
    ----------
    vertices : (V, 3) float64
        Coordinates in mm.
    faces : (F, 3) int32
        Vertex indices.
    constrained : (V,) bool
        Edges between two such vertices stay. None: no vertex.

    Returns
    -------
    (F, 3) int32, int
        The faces, a flip keeping the numbers of its two; and the number of flips.

    Raises
    ------
    ValueError
        If a shape or an index is wrong.
    KernelError
        If memory runs out.
    """
    vertices, faces = checked_mesh(vertices, faces)
    flipped = faces.copy()
    n_flips = _delaunay_flips(
        address(vertices), len(vertices), address(flipped), len(faces), address(_mask(constrained, len(vertices)))
    )
    check_allocation(n_flips)
    return flipped, int(n_flips)


def volume_about(vertices: Float, faces: Int, anchor: Float) -> float:
    """Return the sum of the signed tetrahedra between the faces and a point, in mm3.

    That is the volume within a closed surface, whatever the point. As long as the boundary of an open surface rests,
    the volume between two states of it is the difference of these sums about any one point.

    Parameters
    ----------
    vertices : (V, 3) float64
        Coordinates in mm.
    faces : (F, 3) int32
        Vertex indices.
    anchor : (3,) float64
        The point; the nearer, the smaller is the rounding error.

    Raises
    ------
    ValueError
        If a shape or an index is wrong.
    """
    vertices, faces = checked_mesh(vertices, faces)
    anchor = np.ascontiguousarray(anchor, dtype=np.float64)
    if anchor.shape != (3,):
        raise ValueError(f"the anchor must have shape (3,), not {anchor.shape}")
    component, volume = np.zeros(len(vertices), dtype=np.int32), np.empty(1)
    _component_volumes(
        address(vertices), address(faces), len(faces), address(component), 1, address(anchor), address(volume), None
    )
    return float(volume[0])


def _volumes_of(vertices: Float, faces: Int, boundary: Mask) -> _Volumes:
    component = np.empty(len(vertices), dtype=np.int32)
    n_components = _vertex_components(address(faces), len(faces), len(vertices), address(component))
    used = component >= 0
    counts = np.bincount(component[used], minlength=n_components)
    sums = [np.bincount(component[used], vertices[used, axis], n_components) for axis in range(3)]
    anchors = np.ascontiguousarray(np.stack(sums, axis=1) / counts[:, None])
    volumes, spreads = np.empty((2, n_components))
    _component_volumes(
        address(vertices),
        address(faces),
        len(faces),
        address(component),
        n_components,
        address(anchors),
        address(volumes),
        address(spreads),
    )
    closed = np.ones(n_components, dtype=np.bool_)
    closed[component[boundary]] = False
    return _Volumes(component, anchors, volumes, spreads, closed)


def _restored(vertices: Float, faces: Int, around: Adjacency, fixed: Mask, kept: _Volumes) -> tuple[Float, Mask]:
    """Return the vertices with each component offset to its volume, and the components where no offset restores it."""
    normals = _normals(vertices, faces, around)
    vertices = vertices.copy()
    misses = np.empty(len(kept.volumes), dtype=np.bool_)
    status = _match_volumes(
        address(vertices),
        len(vertices),
        address(faces),
        len(faces),
        address(kept.component),
        len(kept.volumes),
        address(kept.anchors),
        address(fixed),
        address(normals),
        address(kept.volumes),
        address(kept.spreads),
        address(kept.closed),
        _VOLUME_TOLERANCE,
        address(misses),
    )
    check_allocation(status)
    return vertices, misses


def smoothing_steps(
    vertices: Float, faces: Int, settings: Smoothing, *, fixed: Mask | None = None, flips: bool = False
) -> Iterator[Step]:
    """Smooth a mesh, one iteration at a time, without end; wrong input is told at the first.

    Boundary vertices (at an edge with one face), those of `fixed`, and those without faces stay.

    Parameters
    ----------
    vertices : (V, 3) float64
        Coordinates in mm.
    faces : (F, 3) int32
        Vertex indices, outward where the volume is to be kept.
    settings
        The method.
    fixed : (V,) bool
        Vertices that stay; with flips, edges between two of them stay too. None: no vertex.
    flips
        Whether each iteration ends with edge flips (`delaunay_flips`); the volume is restored after them.

    Yields
    ------
    Step
        The mesh after each iteration.

    Raises
    ------
    ValueError
        If a shape or an index is wrong.
    KernelError
        If memory runs out.
    """
    vertices, faces = checked_mesh(vertices, faces)
    given = _mask(fixed, len(vertices))
    around = _adjacency_of(len(vertices), faces)
    # Flips keep the boundary.
    stays = given | around.boundary
    kept = _volumes_of(vertices, faces, around.boundary) if settings.correction == "volume" else None
    original = vertices
    while True:
        before = vertices
        vertices, normals = _pass(vertices, faces, around, stays, settings, settings.factor)
        if settings.correction == "taubin":
            vertices, _ = _pass(vertices, faces, around, stays, settings, settings.mu)
        elif settings.correction == "hc":
            displacement = vertices - (settings.alpha * original + (1 - settings.alpha) * before)
            displacement[stays] = 0
            _push_back(
                address(displacement),
                len(vertices),
                address(around.neighbour_offsets),
                address(around.neighbours),
                address(stays),
                settings.beta,
                None if normals is None else address(normals),
                address(vertices),
            )
        smoothed, unflipped, n_flips, held = vertices, faces, 0, 0
        if flips:
            faces, n_flips = delaunay_flips(smoothed, unflipped, constrained=given)
        if kept is not None:
            around = _adjacency_of(len(vertices), faces) if n_flips else around
            vertices, misses = _restored(smoothed, faces, around, stays, kept)
            held = int(misses.sum())
            if held:
                skipped = misses[kept.component] & (kept.component >= 0)
                vertices[skipped] = before[skipped]
                if n_flips:
                    # Once more without these components: one does not depend on another.
                    faces, n_flips = delaunay_flips(smoothed, unflipped, constrained=given | skipped)
        if n_flips or (flips and held):
            around = _adjacency_of(len(vertices), faces)
        yield Step(vertices, faces, n_flips, held)


def _pass(
    vertices: Float, faces: Int, around: Adjacency, stays: Mask, settings: Smoothing, factor: float
) -> tuple[Float, Float | None]:
    """Return the vertices after one pass of the method, and the normals before it if it is tangential."""
    normals = _normals(vertices, faces, around) if settings.tangential else None
    if settings.update == "sequential":
        source = target = vertices.copy()
    else:
        source, target = vertices, np.empty_like(vertices)
    _smooth_pass(
        address(source),
        len(vertices),
        address(faces),
        address(around.corner_offsets),
        address(around.corners),
        address(around.neighbour_offsets),
        address(around.neighbours),
        address(stays),
        METHODS.index(settings.method),
        factor,
        None if normals is None else address(normals),
        address(target),
    )
    return target, normals


def smooth_vertices(
    vertices: Float,
    faces: Int,
    *,
    method: str = "standard",
    iterations: int = 1,
    update: str = "simultaneous",
    step: float | None = None,
    correction: str = "none",
    alpha: float = 0.0,
    beta: float = 0.5,
    taubin_mu: float | None = None,
    tangential: bool = False,
    fixed: Mask | None = None,
) -> Float:
    """Return the vertices after some iterations of smoothing; the faces remain.

    Parameters
    ----------
    vertices : (V, 3) float64
        Coordinates in mm.
    faces : (F, 3) int32
        Vertex indices.
    iterations
        How many.
    method, update, step, correction, alpha, beta, taubin_mu, tangential
        As for `Smoothing`.
    fixed : (V,) bool
        Vertices that stay, besides those on the boundary. None: no vertex.

    Returns
    -------
    (V, 3) float64
        A new array.

    Raises
    ------
    ValueError
        If a shape, an index, a name or a number is wrong.
    KernelError
        If memory runs out.
    """
    settings = Smoothing(method, update, step, correction, alpha, beta, taubin_mu, tangential)
    if iterations < 0:
        raise ValueError(f"iterations must not be negative, not {iterations}")
    smoothed, faces = checked_mesh(vertices, faces)
    if not iterations:
        _mask(fixed, len(smoothed))
        return smoothed.copy()
    steps = smoothing_steps(smoothed, faces, settings, fixed=fixed)
    for _ in range(iterations):
        smoothed = next(steps).vertices
    return smoothed
