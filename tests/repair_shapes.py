"""Open and broken surfaces, and measures of them, for the tests of repair."""

from __future__ import annotations

import numpy as np

from vhp_cli.kernels.reading import weld
from vhp_cli.kernels.spatial import Tree
from vhp_cli.kernels.surface import topology
from vhp_cli.mesh import Mesh


def tube(radius=5.0, length=30.0, corners=12, rings=6, turned=0.0, start=0.0) -> Mesh:
    """Return an open tube along x, outward."""
    angles = np.arange(corners) * 2 * np.pi / corners + turned
    circle = radius * np.stack([0 * angles, np.cos(angles), np.sin(angles)], axis=1)
    vertices = np.concatenate([circle + np.array([start + length * i / (rings - 1), 0, 0]) for i in range(rings)])
    faces = []
    for i in range(rings - 1):
        for j in range(corners):
            a, b = i * corners + j, i * corners + (j + 1) % corners
            faces += [(a, b, b + corners), (a, b + corners, a + corners)]
    return Mesh(vertices.astype(np.float32).astype(float), np.array(faces))


def without(mesh: Mesh, faces) -> Mesh:
    """Return a mesh without some faces."""
    return Mesh(mesh.vertices, np.delete(mesh.faces, faces, axis=0))


def welded(mesh: Mesh) -> Mesh:
    """Return a mesh with equal vertices joined."""
    vertices, index = weld(mesh.vertices)
    return Mesh(vertices, index[mesh.faces])


def soup(mesh: Mesh) -> Mesh:
    """Return a mesh in which no two faces share a vertex."""
    return Mesh(mesh.vertices[mesh.faces].reshape(-1, 3), np.arange(3 * len(mesh.faces)).reshape(-1, 3))


def volume(mesh: Mesh) -> float:
    """Return the signed volume."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def area(mesh: Mesh) -> float:
    """Return the area of all faces."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def flaws(mesh: Mesh) -> dict[str, int]:
    """Return what is wrong with a mesh that should be a solid, after it was written and read."""
    written = welded(Mesh(mesh.vertices.astype(np.float32), mesh.faces))
    found = topology(written.vertices, written.faces)
    counts = {
        "open": len(found.boundary_edges),
        "crowded": len(found.nonmanifold_edges),
        "pinched": len(found.nonmanifold_vertices),
        "inconsistent": len(found.inconsistent_edges),
        "collapsed": len(found.collapsed_faces),
        "double": len(found.duplicate_faces),
        "hits": Tree(written.vertices, written.faces).self_hits().n_pairs,
    }
    return {name: count for name, count in counts.items() if count}
