"""Slow references for the phantom's tests: plain numpy for topology, Fractions for contact."""

from __future__ import annotations

from fractions import Fraction
from itertools import product

import fcl
import numpy as np

from vhp_cli.formats.stl import stl_bytes
from vhp_cli.mesh import Mesh

RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def reread(mesh: Mesh) -> Mesh:
    """What a binary STL file of the mesh holds, welded where the float32 coordinates are equal."""
    corners = np.frombuffer(stl_bytes(mesh), RECORD, offset=84)["corners"].reshape(-1, 3)
    vertices, faces = np.unique(corners, axis=0, return_inverse=True)
    return Mesh(vertices.astype(np.float64), faces.reshape(-1, 3).astype(np.int32))


def directed_edges(faces: np.ndarray) -> np.ndarray:
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def edge_uses(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Undirected edges and the number of faces at each."""
    return np.unique(np.sort(directed_edges(faces), axis=1), axis=0, return_counts=True)


def is_closed_and_oriented(faces: np.ndarray) -> bool:
    edges = directed_edges(faces)
    there, back = ({tuple(edge) for edge in rows} for rows in (edges.tolist(), edges[:, ::-1].tolist()))
    return len(there) == len(edges) and there == back


def components(labels: int, links: np.ndarray) -> int:
    """Number of connected components of a graph."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    graph = coo_matrix((np.ones(len(links)), links.T), shape=(labels, labels))
    return int(connected_components(graph, directed=False)[0])


def fans(faces: np.ndarray, vertex: int) -> int:
    """Number of groups of faces around a vertex that hang together by edges at it."""
    around = faces[(faces == vertex).any(axis=1)]
    others = [[int(v) for v in row if v != vertex] for row in around]
    names = {v: i for i, v in enumerate(sorted({v for pair in others for v in pair}))}
    return components(len(names), np.array([[names[v] for v in pair] for pair in others]))


def volume(mesh: Mesh) -> float:
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return float((a * np.cross(b, c)).sum() / 6)


def quality(mesh: Mesh) -> np.ndarray:
    """2 r_in / r_out, by r_in = area / half perimeter and r_out = product of sides / (4 area)."""
    corners = mesh.vertices[mesh.faces]
    a, b, c = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).T
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return 2 * (area / (0.5 * (a + b + c))) / (a * b * c / (4 * area))


def shortest_edge(mesh: Mesh) -> float:
    corners = mesh.vertices[mesh.faces]
    return float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).min())


def winding(mesh: Mesh, point: np.ndarray) -> float:
    """How often a closed surface winds around a point (van Oosterom and Strackee 1983)."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] - point for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    top = (a * np.cross(b, c)).sum(axis=1)
    bottom = la * lb * lc + (a * b).sum(axis=1) * lc + (b * c).sum(axis=1) * la + (c * a).sum(axis=1) * lb
    return float(2 * np.arctan2(top, bottom).sum() / (4 * np.pi))


class Distances:
    """Gaps between tissues by fcl."""

    def __init__(self, tissues: dict[str, Mesh]) -> None:
        self.boxes = {name: (mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)) for name, mesh in tissues.items()}
        self.objects = {}
        for name, mesh in tissues.items():
            model = fcl.BVHModel()
            model.beginModel(len(mesh.vertices), len(mesh.faces))
            model.addSubModel(mesh.vertices, mesh.faces)
            model.endModel()
            self.objects[name] = fcl.CollisionObject(model, fcl.Transform())

    def near(self, a: str, b: str, limit: float) -> bool:
        (low_a, high_a), (low_b, high_b) = self.boxes[a], self.boxes[b]
        return bool(np.maximum(low_a - high_b, low_b - high_a).max() < limit)

    def gap(self, a: str, b: str) -> float:
        """0 if the surfaces meet."""
        if fcl.collide(self.objects[a], self.objects[b], fcl.CollisionRequest(), fcl.CollisionResult()):
            return 0.0
        return float(fcl.distance(self.objects[a], self.objects[b], fcl.DistanceRequest(), fcl.DistanceResult()))


def rational(points: np.ndarray) -> list[list[Fraction]]:
    return [[Fraction(float(value)) for value in point] for point in points]


def minus(p: list, q: list) -> list:
    return [x - y for x, y in zip(p, q, strict=True)]


def cross(p: list, q: list) -> list:
    return [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]]


def side(a: list, b: list, c: list, d: list) -> int:
    """Sign of the volume of a tetrahedron, exact."""
    value = sum(x * y for x, y in zip(cross(minus(b, a), minus(c, a)), minus(d, a), strict=True))
    return (value > 0) - (value < 0)


def segment_pierces(p: list, q: list, triangle: list) -> bool:
    """Whether a segment crosses the inside of a triangle, exact."""
    a, b, c = triangle
    if side(a, b, c, p) * side(a, b, c, q) >= 0:
        return False
    turns = {side(p, q, a, b), side(p, q, b, c), side(p, q, c, a)}
    return turns in ({1}, {-1})


def faces_near(mesh: Mesh, place: np.ndarray, reach: float) -> np.ndarray:
    corners = mesh.vertices[mesh.faces]
    low, high = corners.min(axis=1) - reach, corners.max(axis=1) + reach
    return np.flatnonzero(((low <= place) & (high >= place)).all(axis=1))


def crossings(a: Mesh, b: Mesh, place: np.ndarray, reach: float = 0.5) -> int:
    """Number of pairs of faces, near a place, of which an edge of one pierces the other."""
    corners_a, corners_b = (
        [rational(row) for row in mesh.vertices[mesh.faces[faces_near(mesh, place, reach)]]] for mesh in (a, b)
    )
    found = 0
    for first, second in product(corners_a, corners_b):
        for edges, triangle in ((first, second), (second, first)):
            if any(segment_pierces(edges[k], edges[k - 1], triangle) for k in range(3)):
                found += 1
                break
    return found


def strictly_inside(p: list, triangle: list) -> bool:
    """Whether a point lies in the plane and in the inside of a triangle, exact."""
    a, b, c = triangle
    if side(a, b, c, p) != 0:
        return False
    normal = cross(minus(b, a), minus(c, a))
    turns = [
        sum(x * y for x, y in zip(cross(minus(v, u), minus(p, u)), normal, strict=True))
        for u, v in ((a, b), (b, c), (c, a))
    ]
    return all(turn > 0 for turn in turns)
