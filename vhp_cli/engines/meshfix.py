"""MeshFix, by pymeshfix: an optional engine under the AGPL. Runs in a child process only."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vhp_cli.kernels import surface

Arrays = tuple[NDArray[np.float64], NDArray[np.int32]]


def repair(vertices: NDArray[np.float64], faces: NDArray[np.int32], options: Mapping[str, Any]) -> Arrays:
    """Close each component and cut out and refill what crosses in it (Attene 2010, MeshFix).

    Each component keeps the sign of its volume; one of which nothing is left is left out.
    """
    pymeshfix = importlib.import_module("pymeshfix")

    topology = surface.topology(vertices, faces)
    pieces: list[Arrays] = []
    for component in range(topology.n_components):
        part, part_faces = _compact(vertices, faces[topology.component == component])
        engine = pymeshfix.MeshFix(part, part_faces)
        # By itself it keeps the largest component only, so each goes alone.
        engine.repair()
        fixed, fixed_faces = np.array(engine.points), np.array(engine.faces, dtype=np.int32)
        if not len(fixed_faces):
            continue
        if (_volume(part, part_faces) < 0) != (_volume(fixed, fixed_faces) < 0):
            fixed_faces = fixed_faces[:, ::-1]
        pieces.append((fixed, fixed_faces))
    if not pieces:
        return np.empty((0, 3)), np.empty((0, 3), np.int32)
    starts = np.cumsum([0, *(len(points) for points, _ in pieces[:-1])])
    return (
        np.concatenate([points for points, _ in pieces]),
        np.concatenate([part + start for (_, part), start in zip(pieces, starts, strict=True)]).astype(np.int32),
    )


def _compact(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> Arrays:
    used, index = np.unique(faces, return_inverse=True)
    return vertices[used], index.reshape(-1, 3).astype(np.int32)


def _volume(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> float:
    a, b, c = (vertices[faces[:, k]] - vertices[0] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)
