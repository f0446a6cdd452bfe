"""Surfaces to smooth, and what may be said of the result."""

from __future__ import annotations

import numpy as np
from shapes import box, sphere

from vhp_cli.kernels import surface
from vhp_cli.kernels.spatial import Tree
from vhp_cli.mesh import Mesh


def single(vertices):
    return np.asarray(vertices).astype(np.float32).astype(float)


def rough_sphere(seed=0, scale=0.5, subdivisions=3, radius=10.0):
    """A sphere whose vertices were moved along it, so that its triangles are poor."""
    mesh = sphere(radius, subdivisions=subdivisions)
    noise = np.random.default_rng(seed).normal(scale=scale, size=mesh.vertices.shape)
    moved = mesh.vertices + noise
    return Mesh(single(radius * moved / np.linalg.norm(moved, axis=1)[:, None]), mesh.faces)


def tube(radius=0.5, length=30.0, sides=10, rings=120, bend=8.0, seed=None, noise=0.0):
    """A closed nerve of 1 mm width that bends by a half wave, its rings moved along it at random."""
    x = np.linspace(0, length, rings)
    rng = np.random.default_rng(seed)
    x[1:-1] += rng.uniform(-noise, noise, rings - 2) * (x[1] - x[0])
    angle = np.arange(sides) * 2 * np.pi / sides
    slope = bend * np.pi / length * np.cos(x / length * np.pi)
    along = np.column_stack([np.ones(rings), np.zeros(rings), slope])
    along /= np.linalg.norm(along, axis=1)[:, None]
    across = np.array([0.0, 1.0, 0.0])
    up = np.cross(along, across)
    centre = np.column_stack([x, np.zeros(rings), bend * np.sin(x / length * np.pi)])
    round_ = radius * (np.cos(angle)[None, :, None] * across + np.sin(angle)[None, :, None] * up[:, None, :])
    vertices = np.vstack([(centre[:, None] + round_).reshape(-1, 3), centre[0], centre[-1]])
    first, last = rings * sides, rings * sides + 1
    faces = []
    for ring in range(rings - 1):
        for k in range(sides):
            p, q = ring * sides + k, ring * sides + (k + 1) % sides
            faces += [(p, q, p + sides), (q, q + sides, p + sides)]
    for k in range(sides):
        end = (rings - 1) * sides
        faces += [(first, (k + 1) % sides, k), (last, end + k, end + (k + 1) % sides)]
    mesh = Mesh(single(vertices), np.array(faces))
    return mesh if volume(mesh) > 0 else Mesh(mesh.vertices, mesh.faces[:, ::-1])


def fine_box(size=10.0, parts=8, seed=None, noise=0.0):
    """A box of many triangles with sharp edges; the vertices within its sides are moved at random."""
    mesh = box((0, 0, 0), (size, size, size))
    for _ in range(int(np.log2(parts))):
        mesh = halved(mesh)
    vertices = np.array(mesh.vertices)
    rng = np.random.default_rng(seed)
    on_side = (vertices == 0) | (vertices == size)
    flat = on_side.sum(axis=1) == 1
    shift = rng.uniform(-noise, noise, vertices.shape) * size / parts
    vertices[flat] += np.where(on_side[flat], 0, shift[flat])
    return Mesh(single(vertices), mesh.faces)


def halved(mesh):
    """Every triangle cut into four."""
    ends = np.sort(mesh.faces[:, [[1, 2], [2, 0], [0, 1]]].reshape(-1, 2), axis=1)
    edges, number = np.unique(ends, axis=0, return_inverse=True)
    middle = number.reshape(-1, 3) + len(mesh.vertices)
    a, b, c = mesh.faces.T
    p, q, r = middle.T
    faces = np.concatenate([np.stack(corners, axis=1) for corners in ((a, r, q), (b, p, r), (c, q, p), (p, q, r))])
    return Mesh(np.concatenate([mesh.vertices, mesh.vertices[edges].mean(axis=1)]), faces)


def volume(mesh):
    """By the divergence theorem."""
    corners = mesh.vertices[mesh.faces]
    return np.linalg.det(corners).sum() / 6


def q_of(mesh):
    """2 r_in / r_out = 8 (s - a) (s - b) (s - c) / (a b c), with half the perimeter s."""
    corners = mesh.vertices[mesh.faces]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    half = sides.sum(axis=1, keepdims=True) / 2
    return 8 * (half - sides).prod(axis=1) / sides.prod(axis=1)


def largest_turn(mesh):
    """In degrees, from the normals of the two faces at each edge."""
    joined = surface.topology(mesh.vertices, mesh.faces)
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    pair = normals[joined.inner_edge_faces]
    return float(np.degrees(np.arccos(np.clip((pair[:, 0] * pair[:, 1]).sum(axis=1), -1, 1)).max()))


def defects(mesh):
    """Counts of everything that must not get more."""
    joined = surface.topology(mesh.vertices, mesh.faces)
    return {
        "open": len(joined.boundary_edges),
        "nonmanifold": len(joined.nonmanifold_edges),
        "pinched": len(joined.nonmanifold_vertices),
        "inconsistent": len(joined.inconsistent_edges),
        "duplicate": len(joined.duplicate_faces),
        "components": joined.n_components,
        "euler": joined.euler,
        "contacts": Tree(mesh.vertices, mesh.faces).self_hits(0).n_pairs,
        "triangles": len(mesh.faces),
        "vertices": joined.n_referenced,
    }


def assert_as_sound(before, after):
    """Nothing got worse, counted on the coordinates as they are written."""
    assert (after.vertices == single(after.vertices)).all()
    assert defects(after) == defects(before)
    assert (q_of(after) > 0).all() or q_of(before).min() <= 0
