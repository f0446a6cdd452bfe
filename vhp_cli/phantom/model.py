"""Choose the tissues, share out the triangles, and mesh."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from vhp_cli.errors import UsageError
from vhp_cli.mesh import Mesh
from vhp_cli.phantom.curves import Array, monotone_curve
from vhp_cli.phantom.details import further_parts
from vhp_cli.phantom.parts import Part
from vhp_cli.phantom.torso import default_parts

SKIN_THICKNESS = 1.3
THIN_FAT = 1.4
BODY = "average_body"


def generate(triangles: int = 100_000, tissues: int | None = None) -> dict[str, Mesh]:
    """Make the phantom.

    Parameters
    ----------
    triangles
        Number of triangles of all tissues together, met within 10 %.
    tissues
        Number of tissues; the most important ones are taken first. Default: those of `default_parts`.

    Returns
    -------
    dict of str to Mesh
        Closed, outward oriented surfaces in mm (LPS) with float32 coordinates, in anatomical order. No two
        of them are closer than 1.02 mm.

    Raises
    ------
    UsageError
        If there are not that many tissues, or too few triangles for that many.
    """
    parts = list(default_parts())
    if tissues is not None and tissues > sum(len(_all_names(part)) for part in parts):
        parts += further_parts()
    names = _chosen(parts, tissues)
    parts = [part for part in parts if any(name in names for name in _all_names(part))]
    edge = _edge_for(parts, names, triangles)
    result: dict[str, Mesh] = {}
    for part in parts:
        vertices, faces = part.surface.mesh(part.surface.plan(edge))
        if part.name == BODY:
            fat = _grown(vertices, faces, _fat_thickness(vertices))
            shells = {"skin": _grown(fat, faces, np.full(len(fat), SKIN_THICKNESS)), "fat": fat, BODY: vertices}
            result |= {name: _mesh(shells[name], faces) for name in shells if name in names}
            continue
        for name, mirror in zip(part.names, (1.0, -1.0), strict=False):
            if name in names:
                result[name] = _mesh(vertices * [mirror, 1, 1], faces if mirror > 0 else faces[:, ::-1])
    return result


def _all_names(part: Part) -> tuple[str, ...]:
    return ("skin", "fat", BODY) if part.name == BODY else part.names


def _chosen(parts: Sequence[Part], tissues: int | None) -> set[str]:
    """Names of the `tissues` most important tissues."""
    ranked = [(part.rank, name) for part in parts for name in _all_names(part)]
    if tissues is None:
        return {name for _, name in ranked}
    if not 1 <= tissues <= len(ranked):
        raise UsageError(f"the phantom has 1 to {len(ranked)} tissues, not {tissues}")
    return {name for _, name in sorted(ranked, key=lambda item: item[0])[:tissues]}


def _edge_for(parts: Sequence[Part], names: set[str], triangles: int) -> float:
    """Edge length by which the whole phantom has `triangles` triangles (bisection in its logarithm)."""
    copies = [sum(name in names for name in _all_names(part)) for part in parts]

    def total(edge: float) -> int:
        return sum(n * part.surface.plan(edge).triangles for n, part in zip(copies, parts, strict=True))

    short, long = 0.05, 200.0
    if (fewest := total(long)) > 1.1 * triangles:
        raise UsageError(f"{len(names)} tissues need at least {fewest} triangles, not {triangles}")
    for _ in range(14):
        edge = float(np.sqrt(short * long))
        if total(edge) > triangles:
            short = edge
        else:
            long = edge
    return long


def _mesh(vertices: Array, faces: NDArray[np.int32]) -> Mesh:
    # As a binary STL stores them, so that writing and reading changes nothing.
    return Mesh(vertices.astype(np.float32).astype(np.float64), faces)


def _fat_thickness(p: Array) -> Array:
    """Thickness of the fat over the body at points (n, 3): thin on neck, breastbone and spine."""
    x, y, z = p.T
    waist = monotone_curve(np.array([-226.0, -150, -60, 60, 180, 240]), np.array([8.0, 11, 9, 5, 3, 0]))(z)
    flank = 1 - np.exp(-((x / 45.0) ** 2))
    breast = 30.0 * np.exp(-(((np.abs(x) - 76) / 34) ** 2) - (((z - 92) / 36) ** 2)) * (y < 0)
    taper = np.clip(-y / 60.0, 0, 1)
    result: Array = THIN_FAT + waist * flank + breast * taper * taper * (3 - 2 * taper)
    return result


def _grown(vertices: Array, faces: NDArray[np.int32], thickness: Array) -> Array:
    """Move each vertex outwards until it is `thickness` mm above the planes of all its faces.

    On smooth closed surfaces the two meshes then lie at least min(thickness) apart: the corners of each
    new face are that far above the plane of the old one and above those of its neighbours.
    """
    corners = vertices[faces]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat = area / np.linalg.norm(area, axis=1)[:, None]
    normal = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(normal, faces[:, k], flat)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    lean = np.ones(len(vertices))
    for k in range(3):
        np.minimum.at(lean, faces[:, k], (normal[faces[:, k]] * flat).sum(axis=1))
    return vertices + normal * (thickness / lean)[:, None]
