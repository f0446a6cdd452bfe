"""Small closed surfaces with known measures, for tests."""

from __future__ import annotations

import numpy as np

from vhp_cli.mesh import Mesh


def box(lower=(0, 0, 0), upper=(10, 10, 10)) -> Mesh:
    """Return a box of 12 triangles, outward."""
    corners = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], dtype=float)
    lower, upper = np.asarray(lower, float), np.asarray(upper, float)
    faces = [
        (0, 2, 3), (0, 3, 1), (4, 5, 7), (4, 7, 6), (0, 1, 5), (0, 5, 4),
        (2, 6, 7), (2, 7, 3), (0, 4, 6), (0, 6, 2), (1, 3, 7), (1, 7, 5),
    ]  # fmt: skip
    return Mesh(lower + corners * (upper - lower), np.array(faces))


def sphere(radius=10.0, centre=(0, 0, 0), subdivisions=2) -> Mesh:
    """Return a subdivided icosahedron on a sphere, outward; coordinates are float32 values."""
    t = (1 + 5**0.5) / 2
    points = [(-1, t, 0), (1, t, 0), (-1, -t, 0), (1, -t, 0), (0, -1, t), (0, 1, t),
              (0, -1, -t), (0, 1, -t), (t, 0, -1), (t, 0, 1), (-t, 0, -1), (-t, 0, 1)]  # fmt: skip
    faces = [(0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4), (11, 10, 2),
             (10, 7, 6), (7, 1, 8), (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9), (4, 9, 5),
             (2, 4, 11), (6, 2, 10), (8, 6, 7), (9, 8, 1)]  # fmt: skip
    vertices = [np.array(point) / np.linalg.norm(point) for point in points]
    for _ in range(subdivisions):
        middles: dict[tuple[int, int], int] = {}

        def middle(a: int, b: int, middles: dict[tuple[int, int], int] = middles) -> int:
            key = (min(a, b), max(a, b))
            if key not in middles:
                xyz = vertices[a] + vertices[b]
                middles[key] = len(vertices)
                vertices.append(xyz / np.linalg.norm(xyz))
            return middles[key]

        faces = [
            face
            for a, b, c in faces
            for ab, bc, ca in [(middle(a, b), middle(b, c), middle(c, a))]
            for face in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))
        ]
    placed = np.array(vertices) * radius + np.asarray(centre, float)
    return Mesh(placed.astype(np.float32).astype(float), np.array(faces))


def joined(*meshes: Mesh) -> Mesh:
    """Return several meshes as one, without joining vertices."""
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + offset for mesh, offset in zip(meshes, offsets[:-1], strict=True)]),
    )


def flipped(mesh: Mesh) -> Mesh:
    """Return a mesh turned inside out."""
    return Mesh(mesh.vertices, mesh.faces[:, ::-1])


def moved(mesh: Mesh, by) -> Mesh:
    """Return a mesh shifted by a vector."""
    return Mesh(mesh.vertices + np.asarray(by, float), mesh.faces)
