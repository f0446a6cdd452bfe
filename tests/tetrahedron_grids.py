"""Small tetrahedral meshes of a box, for tests."""

from __future__ import annotations

from itertools import permutations

import numpy as np

from vhp_cli.volume import VolumeMesh, volumes


def grid(cells=3, edge=10.0) -> tuple[np.ndarray, np.ndarray]:
    """Return points and positive tetrahedra of a cube, six in each of ``cells`` cubed boxes (Kuhn's triangulation)."""
    ticks = np.linspace(0.0, edge, cells + 1)
    points = np.stack(np.meshgrid(ticks, ticks, ticks, indexing="ij"), -1).reshape(-1, 3)
    corner = np.stack(np.meshgrid(*[np.arange(cells)] * 3, indexing="ij"), -1).reshape(-1, 3)
    weights = np.array([(cells + 1) ** 2, cells + 1, 1])
    tetrahedra = []
    for axes in permutations(range(3)):
        steps = np.cumsum([np.zeros(3, int), *(np.eye(3, dtype=int)[axis] for axis in axes)], axis=0)
        tetrahedra.append((corner[:, None] + steps) @ weights)
    found = np.concatenate(tetrahedra)
    inverted = volumes(points, found) < 0
    found[inverted] = found[inverted][:, [0, 2, 1, 3]]
    return points, found.astype(np.int32)


def labelled_grid(names=("liver", "kidney", "bone"), *, cells=3, air=False, seed=0) -> VolumeMesh:
    """Return a grid with uneven coordinates whose labels change from one tetrahedron to the next."""
    points, tetrahedra = grid(cells)
    uneven = points + np.random.default_rng(seed).uniform(-0.3, 0.3, points.shape) - 4.0
    first = 0 if air else 1
    labels = first + np.arange(len(tetrahedra)) % (len(names) + 1 - first)
    return VolumeMesh(uneven, tetrahedra, labels, tuple(names))
