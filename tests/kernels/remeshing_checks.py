"""What every result of the remesher must fulfil, measured independently of it."""

from __future__ import annotations

import numpy as np

from vhp_cli.kernels import surface
from vhp_cli.kernels.spatial import Tree
from vhp_cli.mesh import Mesh


def measure(vertices, faces):
    topology = surface.topology(vertices, faces)
    return topology, surface.quality(vertices, faces, topology.component, topology.n_components)


def is_closed(topology) -> bool:
    return not (
        len(topology.boundary_edges)
        or len(topology.nonmanifold_edges)
        or len(topology.inconsistent_edges)
        or len(topology.nonmanifold_vertices)
        or len(topology.duplicate_faces)
        or len(topology.collapsed_faces)
    )


def n_contacts(vertices, faces) -> int:
    return Tree(vertices, faces).self_hits(0).n_pairs


def assert_valid(vertices, faces):
    """Closed, 2-manifold, without contacts, in single precision; return topology and quality."""
    topology, quality = measure(vertices, faces)
    assert is_closed(topology)
    assert n_contacts(vertices, faces) == 0
    assert not len(quality.degenerate)
    assert (vertices.astype(np.float32) == vertices).all()
    return topology, quality


def distances(points, vertices, faces, chunk=400):
    """Distance of each point to the nearest triangle: to all those whose bounding sphere leaves it open."""
    centre = vertices[faces].mean(axis=1)
    radius = np.linalg.norm(vertices[faces] - centre[:, None], axis=2).max(axis=1)
    found = np.full(len(points), np.inf)
    for start in range(0, len(points), chunk):
        p = points[start : start + chunk]
        to_centre = np.linalg.norm(p[:, None] - centre, axis=2)
        point, face = np.nonzero(to_centre - radius <= to_centre.min(axis=1)[:, None] + 1e-9)
        np.minimum.at(found, start + point, triangle_distance(p[point], *(vertices[faces[face, k]] for k in range(3))))
    return found


def triangle_distance(p, a, b, c):
    best = np.minimum(segment_distance(p, a, b), segment_distance(p, b, c))
    best = np.minimum(best, segment_distance(p, c, a))
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1)
    normal /= np.where(length > 0, length, 1)[:, None]
    height = ((p - a) * normal).sum(axis=1)
    foot = p - height[:, None] * normal
    inside = length > 0
    for u, v in ((a, b), (b, c), (c, a)):
        inside &= (np.cross(v - u, foot - u) * normal).sum(axis=1) >= 0
    return np.where(inside, np.minimum(best, np.abs(height)), best)


def segment_distance(p, u, v):
    along = v - u
    square = (along * along).sum(axis=1)
    t = np.clip(((p - u) * along).sum(axis=1) / np.where(square > 0, square, 1), 0, 1)
    return np.linalg.norm(p - u - t[:, None] * along, axis=1)


def points_on(vertices, faces, count, seed=0):
    rng = np.random.default_rng(seed)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    of = np.searchsorted(np.cumsum(area) / area.sum(), rng.random(count)).clip(0, len(faces) - 1)
    s, t = rng.random((2, count, 1))
    turned = s + t > 1
    s, t = np.where(turned, 1 - s, s), np.where(turned, 1 - t, t)
    return a[of] + s * (b - a)[of] + t * (c - a)[of]


def hausdorff(first, second, count=1500) -> float:
    """The larger of the two one-sided distances, sampled at the vertices and at random points."""
    there = np.concatenate([first[0], points_on(*first, count)])
    back = np.concatenate([second[0], points_on(*second, count)])
    return max(distances(there, *second).max(), distances(back, *first).max())


def single(vertices):
    return np.asarray(vertices).astype(np.float32).astype(float)


def tube(radius=1.0, length=300.0, sides=8, rings=40, bend=0.0) -> Mesh:
    """Return a closed tube along x that bends upward by a half wave."""
    x = np.repeat(np.linspace(0, length, rings), sides)
    angle = np.tile(np.arange(sides) * 2 * np.pi / sides, rings)
    rise = bend * np.sin(x / length * np.pi)
    vertices = np.column_stack([x, radius * np.cos(angle), radius * np.sin(angle) + rise])
    vertices = np.vstack([vertices, [0, 0, 0], [length, 0, bend * np.sin(np.pi)]])
    faces = []
    for ring in range(rings - 1):
        for k in range(sides):
            p, q = ring * sides + k, ring * sides + (k + 1) % sides
            faces += [(p, q, p + sides), (q, q + sides, p + sides)]
    last, start, end = (rings - 1) * sides, rings * sides, rings * sides + 1
    for k in range(sides):
        faces += [(start, (k + 1) % sides, k), (end, last + k, last + (k + 1) % sides)]
    return Mesh(single(vertices), np.array(faces))
