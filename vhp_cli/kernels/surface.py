"""Topology and triangle quality of a surface mesh, by the kernels in topology.c and quality.c."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vhp_cli.kernels._arguments import checked_mesh
from vhp_cli.kernels._library import address, check_allocation, function, i32, i64, pointer

Int = NDArray[np.int32]
Float = NDArray[np.float64]

_topology = function("vhp_topology", i32, [pointer, i64, pointer, i64, *[pointer] * 11])
_edge_loops = function("vhp_edge_loops", i32, [pointer, i64, i64, pointer])
_quality = function("vhp_quality", i64, [pointer, i64, pointer, i64, pointer, i64, *[pointer] * 5])
_dihedral_angles = function("vhp_dihedral_angles", i64, [pointer, pointer, pointer, pointer, i64, pointer])


@dataclass(frozen=True, slots=True, eq=False)
class Topology:
    """How the faces of a mesh are joined. Collapsed faces count in `collapsed_faces` only.

    Parameters
    ----------
    n_edges
        Undirected edges.
    n_components
        Sets of faces connected through shared edges.
    n_boundary_loops
        Connected pieces of the graph of boundary edges.
    n_referenced
        Vertices that a face uses.
    euler
        Euler number: referenced vertices - edges + faces.
    component : (F,) int32
        Component of each face, numbered by their first faces; -1 for a collapsed face.
    boundary_edges, boundary_faces, boundary_loop : (k, 2), (k,), (k,) int32
        Edges with one face, lower vertex first; that face; the number of the loop that the edge belongs to.
    nonmanifold_edges, nonmanifold_edge_faces : (k, 2), (k,) int32
        Edges with more than two faces, and one of these.
    inconsistent_edges, inconsistent_faces : (k, 2), (k,) int32
        Edges that exactly two faces run along in the same direction, and one of these.
    nonmanifold_vertices, nonmanifold_vertex_faces : (k,), (k,) int32
        Vertices whose faces do not form one fan, or that lie on a non-manifold edge; the first face of each.
    duplicate_faces : (k,) int32
        Faces with the same three vertices as an earlier face, in any order.
    collapsed_faces : (k,) int32
        Faces with two or three equal vertices.
    inner_edges, inner_edge_faces : (m, 2), (m, 2) int32
        Edges with exactly two faces, and these.
    edge_length_min, edge_length_mean, edge_length_max
        Over all edges, in mm; NaN if there is none.
    shortest_edge, shortest_edge_face
        Its two vertices and one of its faces; -1 if there is none.
    """

    n_edges: int
    n_components: int
    n_boundary_loops: int
    n_referenced: int
    euler: int
    component: Int
    boundary_edges: Int
    boundary_faces: Int
    boundary_loop: Int
    nonmanifold_edges: Int
    nonmanifold_edge_faces: Int
    inconsistent_edges: Int
    inconsistent_faces: Int
    nonmanifold_vertices: Int
    nonmanifold_vertex_faces: Int
    duplicate_faces: Int
    collapsed_faces: Int
    inner_edges: Int
    inner_edge_faces: Int
    edge_length_min: float
    edge_length_mean: float
    edge_length_max: float
    shortest_edge: tuple[int, int]
    shortest_edge_face: int


@dataclass(frozen=True, slots=True, eq=False)
class Quality:
    """Shape and size of the triangles of a mesh and of the whole.

    Parameters
    ----------
    q : (F,) float64
        2 r_in / r_out of each face (thesis eq. 2.4): 1 equilateral, 0 degenerate.
    r_out_min, r_out_mean, r_out_max
        Circumradius in mm, the triangle size of thesis 2.1.4; half the longest edge for a degenerate face.
        NaN if there is no face.
    area
        Of all faces, in mm2.
    volume
        In mm3; the sum of the signed tetrahedra between the faces and the mean of the vertices. Positive if a closed
        surface is oriented outward; depends on that point if the surface is open.
    area_centroid, volume_centroid : (3,) float64
        Centre of the area and of the volume, in mm; NaN where area or volume is 0.
        The second has a meaning for a closed surface only.
    degenerate : (k,) int32
        Faces whose area is at most 1e-12 times the square of their longest edge; collapsed ones are among them.
    component_volume, component_area : (C,) float64
        The same for each component, in mm3 and mm2; the volume about one of its own vertices.
    """

    q: Float
    r_out_min: float
    r_out_mean: float
    r_out_max: float
    area: float
    volume: float
    area_centroid: Float
    volume_centroid: Float
    degenerate: Int
    component_volume: Float
    component_area: Float


def _integers(*shape: int) -> Int:
    return np.empty(shape, dtype=np.int32)


def topology(vertices: Float, faces: Int) -> Topology:
    """Return how the faces are joined, in time linear in their number.

    Parameters
    ----------
    vertices : (V, 3) float64
        Coordinates in mm, welded: two faces are joined where they name the same vertices.
    faces : (F, 3) int32
        Vertex indices.

    Raises
    ------
    ValueError
        If a shape or an index is wrong.
    KernelError
        If memory runs out.
    """
    vertices, faces = checked_mesh(vertices, faces)
    n, n_vertices = len(faces), len(vertices)
    edges, edge_faces, inconsistent = _integers(3 * n, 2), _integers(3 * n, 2), _integers(3 * n // 2)
    component, duplicates, collapsed = _integers(n), _integers(n), _integers(n)
    pinched, pinched_faces = _integers(n_vertices), _integers(n_vertices)
    counts, lengths, shortest = np.zeros(9, dtype=np.int64), np.empty(3), _integers(3)
    outputs = (
        edges,
        edge_faces,
        inconsistent,
        component,
        pinched,
        pinched_faces,
        duplicates,
        collapsed,
        counts,
        lengths,
        shortest,
    )
    check_allocation(
        _topology(address(vertices), n_vertices, address(faces), n, *(address(array) for array in outputs))
    )
    # The order of the enum in topology.c.
    (
        n_edges,
        n_inner,
        n_outer,
        n_inconsistent,
        n_components,
        n_referenced,
        n_pinched,
        n_duplicates,
        n_collapsed,
    ) = counts.tolist()

    inner, inner_faces = edges[:n_inner], edge_faces[:n_inner]
    # The kernel fills in the other edges from the back.
    outer, outer_faces = edges[3 * n - n_outer :][::-1], edge_faces[3 * n - n_outer :][::-1]
    is_boundary = outer_faces[:, 1] == -1
    boundary = np.ascontiguousarray(outer[is_boundary])
    loop, n_loops = _integers(len(boundary)), 0
    if len(boundary):
        n_loops = _edge_loops(address(boundary), len(boundary), n_vertices, address(loop))
        check_allocation(n_loops)
    reversed_edges = inconsistent[:n_inconsistent]
    no_edge = n_edges == 0
    return Topology(
        n_edges=n_edges,
        n_components=n_components,
        n_boundary_loops=n_loops,
        n_referenced=n_referenced,
        euler=n_referenced - n_edges + n - n_collapsed,
        component=component,
        boundary_edges=boundary,
        boundary_faces=outer_faces[is_boundary, 0],
        boundary_loop=loop,
        nonmanifold_edges=outer[~is_boundary],
        nonmanifold_edge_faces=outer_faces[~is_boundary, 0],
        inconsistent_edges=inner[reversed_edges],
        inconsistent_faces=inner_faces[reversed_edges, 0],
        nonmanifold_vertices=pinched[:n_pinched].copy(),
        nonmanifold_vertex_faces=pinched_faces[:n_pinched].copy(),
        duplicate_faces=duplicates[:n_duplicates].copy(),
        collapsed_faces=collapsed[:n_collapsed].copy(),
        inner_edges=inner.copy(),
        inner_edge_faces=inner_faces.copy(),
        edge_length_min=float("nan") if no_edge else float(lengths[0]),
        edge_length_mean=float("nan") if no_edge else float(lengths[1]) / n_edges,
        edge_length_max=float("nan") if no_edge else float(lengths[2]),
        shortest_edge=(int(shortest[0]), int(shortest[1])),
        shortest_edge_face=int(shortest[2]),
    )


def quality(vertices: Float, faces: Int, component: Int, n_components: int) -> Quality:
    """Return shape and size of every triangle, area, volume and centroids.

    Parameters
    ----------
    vertices : (V, 3) float64
        Coordinates in mm.
    faces : (F, 3) int32
        Vertex indices.
    component : (F,) int32
        Component of each face as `topology` returns it; -1: none.
    n_components
        Number of components.

    Raises
    ------
    ValueError
        If a shape, an index or a label is wrong.
    KernelError
        If memory runs out.
    """
    vertices, faces = checked_mesh(vertices, faces)
    component = np.ascontiguousarray(component, dtype=np.int32)
    n = len(faces)
    if component.shape != (n,) or (n and component.max() >= n_components):
        raise ValueError(f"component must hold {n} labels below {n_components}")
    q, degenerate, totals = np.empty(n), _integers(n), np.empty(14)
    component_volume, component_area = np.empty(n_components), np.empty(n_components)
    n_degenerate = _quality(
        address(vertices),
        len(vertices),
        address(faces),
        n,
        address(component),
        n_components,
        address(q),
        address(degenerate),
        address(component_volume),
        address(component_area),
        address(totals),
    )
    check_allocation(n_degenerate)
    # The order of the enum in quality.c.
    r_min, r_sum, r_max, area, volume = totals[:5].tolist()
    surface_moment, volume_moment, reference = totals[5:8], totals[8:11], totals[11:14]
    nowhere = np.full(3, np.nan)
    return Quality(
        q=q,
        r_out_min=r_min if n else float("nan"),
        r_out_mean=r_sum / n if n else float("nan"),
        r_out_max=r_max if n else float("nan"),
        area=area,
        volume=volume,
        area_centroid=reference + surface_moment / area if area else nowhere,
        volume_centroid=reference + volume_moment / volume if volume else nowhere,
        degenerate=degenerate[:n_degenerate].copy(),
        component_volume=component_volume,
        component_area=component_area,
    )


def dihedral_angles(vertices: Float, faces: Int, inner_edges: Int, inner_edge_faces: Int) -> Float:
    """Return the angle between the two faces at each inner edge, in degrees.

    180 is flat, 0 folded back onto itself; the orientation of the faces plays no part. NaN where a face has no area.

    Parameters
    ----------
    vertices : (V, 3) float64
        Coordinates in mm.
    faces : (F, 3) int32
        Vertex indices.
    inner_edges, inner_edge_faces : (m, 2) int32
        As `topology` returns them.

    Returns
    -------
    (m,) float64
        Degrees in [0, 180].

    Raises
    ------
    ValueError
        If a shape or an index is wrong, or a face does not have the edge.
    """
    vertices, faces = checked_mesh(vertices, faces)
    edges = np.ascontiguousarray(inner_edges, dtype=np.int32)
    edge_faces = np.ascontiguousarray(inner_edge_faces, dtype=np.int32)
    m = len(edges)
    if edges.shape != (m, 2) or edge_faces.shape != (m, 2):
        raise ValueError(f"edges and their faces must have shape (m, 2), not {edges.shape}, {edge_faces.shape}")
    if m and not (edges.min() >= 0 and edges.max() < len(vertices)):
        raise ValueError("edges refer to vertices that do not exist")
    if m and not (edge_faces.min() >= 0 and edge_faces.max() < len(faces)):
        raise ValueError("edges refer to faces that do not exist")
    degrees = np.empty(m)
    wrong = _dihedral_angles(
        address(vertices), address(faces), address(edges), address(edge_faces), m, address(degrees)
    )
    if wrong >= 0:
        raise ValueError(f"faces {edge_faces[wrong].tolist()} do not both have edge {edges[wrong].tolist()}")
    return degrees
