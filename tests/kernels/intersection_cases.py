"""Meshes and pairs of meshes that meet, or just don't, in every way that a kernel could get wrong."""

from __future__ import annotations

import numpy as np
from shapes import box, flipped, joined, moved, sphere

from vhp_cli.kernels.spatial import KIND_COPLANAR, KIND_CROSSING, KIND_DUPLICATE, KIND_FOLD, KIND_TOUCH
from vhp_cli.mesh import Mesh

BASE = [(0, 0, 0), (10, 0, 0), (0, 10, 0)]
TINY = 2.0**-20
FAR = 512.0  # where the unit in the last place of float32 is 2^-14


def _apart(*others):
    """Two faces without a common vertex."""
    return Mesh(np.array([*BASE, *others], float), np.array([(0, 1, 2), (3, 4, 5)]))


def _at_vertex(*others):
    return Mesh(np.array([*BASE, *others], float), np.array([(0, 1, 2), (0, 3, 4)]))


def _at_edge(other):
    return Mesh(np.array([*BASE, other], float), np.array([(0, 1, 2), (1, 0, 3)]))


def _far(height):
    corners = [(0, 0, 0), (10, 0, 0), (0, 10, 0), (2, 2, height), (3, 2, 5), (2, 3, 6)]
    return Mesh(np.array(corners) + FAR, np.array([(0, 1, 2), (3, 4, 5)]))


def _changed(mesh, vertex, position):
    vertices = mesh.vertices.copy()
    vertices[vertex] = position
    return Mesh(vertices, mesh.faces)


def _spike():
    ball = sphere(10, subdivisions=2)
    return _changed(ball, np.argmax(ball.vertices[:, 2]), (0.3, 0.2, -14))


def _pulled():
    """A vertex drawn over its neighbour."""
    ball = sphere(10, subdivisions=2)
    top = np.argmax(ball.vertices[:, 2])
    neighbour = ball.faces[(ball.faces == top).any(axis=1)][0]
    neighbour = neighbour[neighbour != top][0]
    return _changed(ball, top, np.round(1.02 * (2 * ball.vertices[neighbour] - ball.vertices[top]), 3))


def self_cases():
    """Return {name: (mesh, kind of its one pair, or None for no pair, or a set of kinds for many)}."""
    return {
        "crossing": (_apart((2, 2, -3), (3, 2, 5), (2, 3, 6)), KIND_CROSSING),
        "coplanar, partly over": (_apart((1, 1, 0), (12, 2, 0), (2, 12, 0)), KIND_COPLANAR),
        "coplanar, contained": (_apart((1, 1, 0), (3, 1, 0), (1, 3, 0)), KIND_COPLANAR),
        "coplanar, apart in one box": (_apart((9, 9, 0), (9, 3, 0), (3, 9, 0)), None),
        "vertex, crossing": (_at_vertex((2, 3, 4), (3, 2, -4)), KIND_CROSSING),
        "vertex, on one side": (_at_vertex((2, 3, 4), (3, 2, 5)), None),
        "vertex, coplanar over": (_at_vertex((4, 1, 0), (1, 4, 0)), KIND_COPLANAR),
        "vertex, coplanar beside": (_at_vertex((-4, 1, 0), (-4, 4, 0)), None),
        "edge, folded flat": (_at_edge((3, 4, 0)), KIND_FOLD),
        "edge, flat neighbours": (_at_edge((3, -4, 0)), None),
        "edge, fold just open": (_at_edge((3, 4, TINY)), None),
        "vertex on interior": (_apart((2, 2, 0), (3, 2, 5), (2, 3, 6)), KIND_TOUCH),
        "vertex just above": (_apart((2, 2, TINY), (3, 2, 5), (2, 3, 6)), None),
        "vertex on edge, coplanar": (_apart((5, 0, 0), (3, -4, 0), (7, -4, 0)), KIND_TOUCH),
        "edges cross in a point": (
            Mesh(
                np.array([(0, 0, 0), (10, 0, 0), (5, 0, -10), (5, -5, 0), (5, 5, 0), (5, 0, 10)], float),
                np.array([(0, 1, 2), (3, 4, 5)]),
            ),
            KIND_TOUCH,
        ),
        "vertex on vertex, not welded": (_apart((0, 0, 0), (-4, 1, 1), (-4, 4, 2)), KIND_TOUCH),
        "sliver crosses": (_apart((2, 2, -3), (2, 2, 5), (2 + TINY, 2, 1)), KIND_CROSSING),
        "sliver beside": (
            Mesh(
                np.array([(0, 0, 0), (10, 0, 0), (5, TINY, 0), (5, 2 * TINY, -4), (5, 2 * TINY, 4), (6, 3, 0)], float),
                np.array([(0, 1, 2), (3, 4, 5)]),
            ),
            None,
        ),
        "crossing by one ulp": (_far(-(2.0**-14)), KIND_CROSSING),
        "missing by one ulp": (_far(2.0**-14), None),
        "duplicate": (Mesh(np.array(BASE, float), np.array([(0, 1, 2), (2, 1, 0)])), KIND_DUPLICATE),
        "vertex, pierced at the edge": (_at_vertex((10, 0, 4), (10, 0, -4)), KIND_TOUCH),
        "edge not welded, folded flat": (_apart((0, 0, 0), (10, 0, 0), (3, 4, 0)), KIND_COPLANAR),
        "clean sphere": (sphere(10, subdivisions=2), None),
        "two spheres overlap": (
            joined(sphere(10, subdivisions=2), sphere(10, (12, 1.5, 0.75), 2)),
            {KIND_CROSSING},
        ),
        "spike through the wall": (_spike(), {KIND_CROSSING}),
        "vertex over its neighbour": (_pulled(), {KIND_CROSSING, KIND_TOUCH}),
    }


def grid_box(lower, upper, cells):
    """Return a box with `cells` squares along each edge."""
    lower, upper = np.asarray(lower, float), np.asarray(upper, float)
    triangles = []
    steps = np.linspace(0, 1, cells + 1)
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        for end in (0, 1):
            for i in range(cells):
                for j in range(cells):
                    corners = np.empty((4, 3))
                    corners[:, axis] = end
                    corners[:, u] = steps[[i, i + 1, i + 1, i]]
                    corners[:, v] = steps[[j, j, j + 1, j + 1]]
                    for k in ((0, 1, 2), (0, 2, 3)):
                        triangles.append(corners[list(k if end else k[::-1])])
    corners = lower + np.array(triangles).reshape(-1, 3) * (upper - lower)
    vertices, numbers = np.unique(np.round(corners, 6), axis=0, return_inverse=True)
    return Mesh(vertices, numbers.reshape(-1, 3))


def torus(major, minor, centre=(0, 0, 0), axis=2, around=24, across=10):
    """Return a torus about a coordinate axis."""
    u, v = np.meshgrid(np.arange(around) * 2 * np.pi / around, np.arange(across) * 2 * np.pi / across, indexing="ij")
    rim = major + minor * np.cos(v)
    points = np.stack([rim * np.cos(u), rim * np.sin(u), minor * np.sin(v)], axis=-1).reshape(-1, 3)
    faces = []
    for i in range(around):
        for j in range(across):
            i2, j2 = (i + 1) % around, (j + 1) % across
            a, b, c, d = i * across + j, i2 * across + j, i2 * across + j2, i * across + j2
            faces += [(a, b, c), (a, c, d)]
    return Mesh(np.roll(points, axis - 2, axis=1).astype(np.float32) + np.asarray(centre, float), np.array(faces))


def wedge(turned):
    """Return a long wedge with a sharp edge along x, or one upside down along y, 0.5 above it."""
    vertices = np.array([(-30, 0, 0), (30, 0, 0), (-30, -8, -8), (30, -8, -8), (-30, 8, -8), (30, 8, -8)], float)
    faces = np.array([(0, 1, 5), (0, 5, 4), (1, 0, 2), (1, 2, 3), (2, 4, 5), (2, 5, 3), (0, 4, 2), (1, 3, 5)])
    if turned:
        vertices = vertices[:, [1, 0, 2]] * (1, 1, -1) + (0, 0, 0.5)
    return Mesh(vertices, faces)


def open_hemisphere(radius, subdivisions=2):
    ball = sphere(radius, subdivisions=subdivisions)
    return Mesh(ball.vertices, ball.faces[ball.vertices[ball.faces].mean(axis=1)[:, 2] > 0])


def pair_cases():
    """Return {name: (mesh, mesh, gap or None if not known in closed form, overlap volume or None)}.

    The gap is 0 on contact; the overlap volume is nan for an open surface.
    """
    ball = sphere(10)
    shell = joined(ball, flipped(sphere(8)))
    return {
        "nested spheres": (ball, sphere(5), None, "b"),
        "spheres overlap by 2^-20": (ball, sphere(10, (20 - TINY, 0, 0)), 0, 0),
        "spheres apart by 2^-20": (ball, moved(ball, (20 + TINY, 0, 0)), TINY, 0),
        "spheres touch in a vertex": (ball, moved(ball, (20, 0, 0)), 0, 0),
        "same sphere twice": (ball, ball, 0, "a"),
        "boxes share a face": (grid_box((0, 0, 0), (10, 10, 10), 4), grid_box((10, 0, 0), (20, 10, 10), 4), 0, 0),
        "boxes share part of a face": (grid_box((0, 0, 0), (10, 10, 10), 4), grid_box((10, 1, 1), (20, 9, 9), 3), 0, 0),
        "plate through a sphere": (ball, box((-30, -30, -0.25), (30, 30, 0.25)), 0, None),
        "crossed rods": (box((-20, -1, -1), (20, 1, 1)), box((-1.5, -20, -1.5), (1.5, 20, 1.5)), 0, 12),
        "wedges edge over edge": (wedge(False), wedge(True), 0.5, 0),
        "linked tori": (torus(20, 4), torus(20, 4, (20, 0, 0), axis=1), None, 0),
        "ball in a cavity": (shell, sphere(3), None, 0),
        "nested, thin wall": (sphere(20, subdivisions=3), sphere(19, subdivisions=3), None, "b"),
        "deep overlap": (ball, sphere(10, (8, 3, 1)), 0, None),
        "far apart": (ball, moved(ball, (50, 0, 0)), 30, 0),
        "boxes overlap on one grid": (grid_box((0, 0, 0), (4, 4, 4), 4), grid_box((1, 1, 1), (5, 5, 5), 4), 0, 27),
        "ball before an open hemisphere": (open_hemisphere(10), sphere(4, (0, 0, 3)), None, float("nan")),
    }
