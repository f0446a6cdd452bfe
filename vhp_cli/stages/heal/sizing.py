"""How long edges should be: a target at each vertex, from curvature, wall thickness and a triangle budget.

An edge of length L over a surface of radius r misses it by L**2 / (8 r). The targets keep this chord error below
0.6 of the allowed deviation, which leaves the rest to the remesher, and below 0.6 of 0.15 of the local wall
thickness, so that two sides of a curved wall keep clear of each other. At least about five edges go around
whatever is round. Thin flat plates need no short edges on their sides, but at their rims, where a strip as
narrow as the wall has to be filled with well shaped triangles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vhp_cli.kernels.measuring import thickness
from vhp_cli.kernels.spatial import Tree
from vhp_cli.kernels.surface import Topology, topology
from vhp_cli.mesh import Mesh

Floats = NDArray[np.float64]

_CHORD_SHARE = 0.6  # of the deviation for the chord error
_WALL_SHARE = 0.15  # of the wall thickness that its sides may deviate
_AROUND = 1.2  # longest edge over the radius of curvature: 5.2 edges around a circle
_RIM_WIDTHS = 2.0  # longest edge over the wall thickness at a crease
_CREASE = np.radians(75)  # edges bent more than this are rims to keep, not curvature to follow
_PARALLEL = 0.8  # cosine from which on the face across is the other side of a wall, and not of a wedge
_TRIANGLE = 3**0.5 / 4  # area of the equilateral triangle of edge length 1


@dataclass(frozen=True, slots=True, eq=False)
class Sizes:
    """Target edge lengths.

    Parameters
    ----------
    vertex : (V,) float64
        At each vertex, in mm; to be interpolated linearly.
    face : (F,) float64
        At the centre of each face, in mm.
    estimate
        Triangles that a mesh of these sizes would have: the sum of area / (sqrt(3) / 4 L**2).
    """

    vertex: Floats
    face: Floats
    estimate: int


@dataclass(frozen=True, slots=True)
class Limits:
    """Between which lengths a mesh is best remeshed, and how closely; all in mm.

    Parameters
    ----------
    longest_mm, shortest_mm
        Longest and shortest target length of an edge.
    deviation_mm
        How far the result may deviate; reduced where walls are thin.
    wall_mm
        Thickness below which 5 % of the area lie; ``inf`` if less than that has another side.
    """

    longest_mm: float
    shortest_mm: float
    deviation_mm: float
    wall_mm: float


def walls(mesh: Mesh, tree: Tree | None = None) -> Floats:
    """Return the thickness of the wall under each face in mm (F,), ``inf`` where there is none.

    It is taken at the centre of the face against its normal, and only from faces across that are nearly parallel.

    Parameters
    ----------
    mesh
        Oriented outward.
    tree
        Its search tree; built if None.
    """
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    tree = tree or Tree(mesh.vertices, mesh.faces)
    hits = thickness(tree, corners.mean(axis=1), -normals, np.arange(len(mesh.faces)))
    return np.where(hits.cosines > _PARALLEL, hits.distances, np.inf)


def propose_limits(
    mesh: Mesh,
    *,
    deviation_mm: float,
    longest_mm: float | None = None,
    input_triangles: int | None = None,
    wall_thickness: Floats | None = None,
) -> Limits:
    """Propose limits of the edge length that suit a mesh.

    The longest edge is the mean of the mesh itself, weighted by area, but at most 1/12 of the diagonal of its box
    and 2.5 times the median. The deviation is reduced to 0.15 of the thickness of thin walls, but not below 2e-5
    of the diagonal.

    Parameters
    ----------
    mesh
        The mesh, with at least one face of an area.
    deviation_mm
        How far the result may deviate at most.
    longest_mm
        Longest edge, if it is given.
    input_triangles
        Triangles that the tissue had before repair: if that multiplied them, longer edges undo it.
    wall_thickness : (F,) float64
        As `walls` returns it; computed if None.

    Raises
    ------
    ValueError
        If the mesh has no area.
    """
    corners = mesh.vertices[mesh.faces]
    areas = _areas(corners)
    area = float(areas.sum())
    if not area > 0:
        raise ValueError("a mesh without area has no edge length to propose")
    extent = corners.reshape(-1, 3).max(axis=0) - corners.reshape(-1, 3).min(axis=0)
    diagonal = float(np.linalg.norm(extent))
    if longest_mm is None:
        edges = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).mean(axis=1)
        longest_mm = min(float(areas @ edges) / area, diagonal / 12, 2.5 * float(np.median(edges)))
        if input_triangles and len(mesh.faces) > 3 * input_triangles:
            as_many = (area / (_TRIANGLE * 2 * input_triangles)) ** 0.5
            longest_mm = max(longest_mm, min(diagonal / 12, as_many))
    wall = _quantile(walls(mesh) if wall_thickness is None else wall_thickness, areas, 0.05)
    deviation = min(deviation_mm, max(_WALL_SHARE * wall, 2e-5 * diagonal))
    shortest = max(0.12 * longest_mm, min(0.3 * wall, 0.3 * longest_mm))
    if 2.5 * deviation < 0.5 * longest_mm:
        shortest = max(shortest, 2.5 * deviation)
    return Limits(longest_mm, shortest, deviation, wall)


def sizing(
    mesh: Mesh,
    *,
    deviation_mm: float,
    longest_mm: float,
    shortest_mm: float,
    gradation: float = 0.4,
    budget_triangles: int | None = None,
    wall_thickness: Floats | None = None,
) -> Sizes:
    """Compute the target edge length at each vertex and face.

    Parameters
    ----------
    mesh
        Closed and oriented, as a rule; edges at holes, between more than two faces or two faces that run along
        it in the same direction say nothing of curvature.
    deviation_mm
        How far the remeshed surface may lie from this one.
    longest_mm, shortest_mm
        Limits of the targets.
    gradation
        Most change of the target per mm along an edge.
    budget_triangles
        Where more triangles than this are estimated, all targets grow by a common factor, beyond the longest
        edge if it must be; None: no limit.
    wall_thickness : (F,) float64
        As `walls` returns it; computed if None.

    Raises
    ------
    ValueError
        If a limit is not positive or the shortest edge above the longest.
    """
    if not (0 < shortest_mm <= longest_mm and deviation_mm > 0 and gradation > 0):
        raise ValueError(f"impossible limits: {shortest_mm} to {longest_mm} mm, {deviation_mm} mm, {gradation}")
    if budget_triangles is not None and budget_triangles < 1:
        raise ValueError(f"a budget of {budget_triangles} triangles is impossible")
    if wall_thickness is None:
        wall_thickness = walls(mesh)
    areas = _areas(mesh.vertices[mesh.faces])
    joined = topology(mesh.vertices, mesh.faces)
    edges = np.concatenate((joined.inner_edges, joined.boundary_edges, joined.nonmanifold_edges))
    graph = _Graph(
        edges, np.linalg.norm(mesh.vertices[edges[:, 0]] - mesh.vertices[edges[:, 1]], axis=1), len(mesh.vertices)
    )

    curvature, on_crease = _curvature(mesh, areas, joined, graph, shortest_mm)
    vertex_areas = _to_vertices(mesh, areas)
    # The harmonic mean: what has no other side counts as infinitely thick, and slivers for nothing.
    wall = _ratio(vertex_areas, _to_vertices(mesh, areas / np.maximum(wall_thickness, 1e-9 * longest_mm)))
    radius = _ratio(np.ones(len(curvature)), curvature)
    error = _CHORD_SHARE * np.minimum(deviation_mm, _WALL_SHARE * wall)
    with np.errstate(invalid="ignore", over="ignore"):
        wanted = np.minimum(np.sqrt(8 * radius * error), _AROUND * radius)
    wanted = np.where(on_crease, np.minimum(wanted, _RIM_WIDTHS * wall), wanted)
    # Rounding in the averages may leave the limits.
    wanted = np.clip(graph.averaged(np.clip(wanted, shortest_mm, longest_mm)), shortest_mm, longest_mm)
    return _within_budget(mesh, areas, graph, wanted, gradation, budget_triangles)


def sizes_around(mesh: Mesh, bad: NDArray[np.bool_], *, gradation: float = 0.4) -> Floats:
    """Return edge lengths (V,) in mm that refine a mesh around bad faces and leave it as it is elsewhere.

    A needle gets neighbours as small as its shortest edge; the lengths grow back to those of the mesh around.

    Parameters
    ----------
    mesh
        The mesh.
    bad : (F,) bool
        Its bad faces.
    gradation
        Growth of the lengths in mm per mm.
    """
    joined = topology(mesh.vertices, mesh.faces)
    edges = np.concatenate((joined.inner_edges, joined.boundary_edges, joined.nonmanifold_edges))
    lengths = np.linalg.norm(mesh.vertices[edges[:, 0]] - mesh.vertices[edges[:, 1]], axis=1)
    graph = _Graph(edges, lengths, len(mesh.vertices))
    count = np.bincount(edges.ravel(), minlength=len(mesh.vertices))
    total = np.bincount(edges[:, 0], lengths, len(mesh.vertices)) + np.bincount(
        edges[:, 1], lengths, len(mesh.vertices)
    )
    wanted = np.where(count > 0, total / np.maximum(count, 1), lengths.mean() if len(lengths) else 1.0)
    corners = mesh.vertices[mesh.faces[bad]]
    shortest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).min(axis=1)
    np.minimum.at(wanted, mesh.faces[bad].ravel(), np.repeat(shortest, 3))
    return graph.graded(np.maximum(wanted, 1e-300), gradation)


class _Graph:
    """The vertices of a mesh and their neighbours."""

    def __init__(self, edges: NDArray[np.int32], lengths: Floats, n_vertices: int) -> None:
        ends = np.concatenate((edges[:, 0], edges[:, 1]))
        order = np.argsort(ends, kind="stable")
        self._neighbours = np.concatenate((edges[:, 1], edges[:, 0]))[order]
        self._lengths = np.concatenate((lengths, lengths))[order]
        self._counts = np.bincount(ends, minlength=n_vertices)
        self._connected = np.flatnonzero(self._counts)
        self._starts = np.searchsorted(ends[order], self._connected)

    def with_ring(self, values: Floats) -> Floats:
        """Return the sum of the values (V, ...) of each vertex and its neighbours."""
        total = values.copy()
        if len(self._starts):
            total[self._connected] += np.add.reduceat(values[self._neighbours], self._starts)
        return total

    def averaged(self, lengths: Floats) -> Floats:
        """Return lengths half-way between each vertex and the geometric mean around it: single outliers vanish."""
        logarithms = np.log(lengths)
        around = (self.with_ring(logarithms) - logarithms) / np.maximum(self._counts, 1)
        result: Floats = np.exp(np.where(self._counts > 0, (logarithms + around) / 2, logarithms))
        return result

    def graded(self, lengths: Floats, gradation: float) -> Floats:
        """Return the largest lengths (V,) below the given ones that change by at most `gradation` per mm."""
        lengths = lengths.copy()
        reach = gradation * self._lengths
        while len(self._starts):
            reached = np.minimum.reduceat(lengths[self._neighbours] + reach, self._starts)
            lower = np.minimum(lengths[self._connected], reached)
            if np.array_equal(lower, lengths[self._connected]):
                break
            lengths[self._connected] = lower
        return lengths


def _within_budget(
    mesh: Mesh, areas: Floats, graph: _Graph, wanted: Floats, gradation: float, budget: int | None
) -> Sizes:
    """Grade the wanted lengths, and make them longer until the estimate is within the budget."""
    factor = 1.0
    while True:
        vertex = graph.graded(factor * wanted, gradation)
        face = vertex[mesh.faces].mean(axis=1)
        estimate = float((areas / (_TRIANGLE * face**2)).sum())
        if budget is None or estimate <= budget:
            return Sizes(vertex, face, round(estimate))
        # The small lengths grow by the factor, those near them by less: a few rounds.
        factor *= 1.001 * (estimate / budget) ** 0.5


def _curvature(
    mesh: Mesh, areas: Floats, joined: Topology, graph: _Graph, scale: float
) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the larger principal curvature at each vertex in 1/mm (V,), and which vertices lie on a crease.

    Cohen-Steiner & Morvan 2003, Restricted Delaunay triangulations and normal cycle: the sum of bend angle times
    length along each edge, over the area around a vertex. Angles have a sign, so the wild normals of slivers
    cancel out. The area is that of two rings of faces, but no less than that of a disk as wide as `scale`.
    """
    edges, faces = joined.inner_edges, joined.inner_edge_faces
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    along = _runs_along(mesh, edges, faces[:, 0])
    opposed = along != _runs_along(mesh, edges, faces[:, 1])
    edges, faces, along = edges[opposed], faces[opposed], along[opposed]
    vectors = mesh.vertices[edges[:, 1]] - mesh.vertices[edges[:, 0]]
    vectors[~along] *= -1
    lengths = np.linalg.norm(vectors, axis=1)
    directions = vectors / np.maximum(lengths, np.finfo(np.float64).tiny)[:, None]
    first, second = normals[faces[:, 0]], normals[faces[:, 1]]
    sines = np.einsum("ij,ij->i", directions, np.cross(first, second))
    angles = np.arctan2(sines, np.einsum("ij,ij->i", first, second))

    creased = np.abs(angles) > _CREASE
    on_crease = np.zeros(len(mesh.vertices), dtype=np.bool_)
    on_crease[edges[creased]] = True
    strengths = np.where(creased, 0.0, angles * lengths) / 2
    tensors = np.empty((len(mesh.vertices), 3, 3))
    for i in range(3):
        for j in range(i + 1):
            shares = strengths * directions[:, i] * directions[:, j]
            ends = [_sums(edges[:, k], shares, len(mesh.vertices)) for k in range(2)]
            tensors[:, i, j] = tensors[:, j, i] = ends[0] + ends[1]
    around = graph.with_ring(_to_vertices(mesh, areas))
    tensors = graph.with_ring(tensors) / np.maximum(around, np.pi / 4 * scale**2)[:, None, None]
    curvature: Floats = np.abs(np.linalg.eigvalsh(tensors)).max(axis=1, initial=0.0)
    return curvature, on_crease


def _runs_along(mesh: Mesh, edges: NDArray[np.int32], faces: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Whether each face runs along its edge from the first to the second end."""
    rings = mesh.faces[faces]
    found: NDArray[np.bool_] = ((rings == edges[:, :1]) & (rings[:, [1, 2, 0]] == edges[:, 1:])).any(axis=1)
    return found


def _areas(corners: Floats) -> Floats:
    areas: Floats = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    return areas


def _to_vertices(mesh: Mesh, values: Floats) -> Floats:
    """Return a third of the values of the faces at each vertex, added up."""
    n = len(mesh.vertices)
    return _sums(mesh.faces.reshape(-1), np.repeat(values / 3, 3), n)


def _sums(indices: NDArray[np.int32], values: Floats, n: int) -> Floats:
    """Return the sum of the values at each index below n."""
    # Without any index, bincount gives integers.
    sums: Floats = np.asarray(np.bincount(indices, values, n), dtype=np.float64)
    return sums


def _ratio(numerator: Floats, denominator: Floats) -> Floats:
    """Return the ratio, ``inf`` where the denominator is 0."""
    infinite = np.full(len(numerator), np.inf)
    np.divide(numerator, denominator, out=infinite, where=denominator > 0)
    return infinite


def _quantile(values: Floats, weights: Floats, share: float) -> float:
    """Return the value below which a share of the weight lies."""
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(total, share * total[-1])]])
