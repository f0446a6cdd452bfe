"""In place of fTetWild, called in a child process as it is."""

from __future__ import annotations

import numpy as np


def mesh_by_delaunay(vertices, faces, options):
    """Fill a box around convex surfaces with the Delaunay tetrahedra of their vertices, the same ones each time."""
    from scipy.spatial import Delaunay

    lower, upper = vertices.min(axis=0), vertices.max(axis=0)
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    box = lower - 5 + corners * (upper - lower + 10)
    used = np.unique(faces)
    points = np.concatenate((vertices[used], [vertices[used].mean(axis=0)], box))
    # No four in a plane, no five on a sphere.
    points += np.random.default_rng(0).uniform(-1e-3, 1e-3, points.shape)
    tetrahedra = Delaunay(points).simplices
    a, b, c, d = (points[tetrahedra[:, corner]] for corner in range(4))
    volume = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a)
    tetrahedra[volume < 0] = tetrahedra[volume < 0][:, [0, 2, 1, 3]]
    return points, tetrahedra.astype(np.int32)
