"""Inner shells of a body surface, top-down from the signed distance to the skin (thesis 5.1.6).

The shell at depth t(x) is where phi(x) + t(x) = 0. As thickness changes gently, deeper shells lie within shallower ones
by construction, whatever the fingers, ears and armpits look like; where the body is too thin there is no shell.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vhp_cli.errors import VhpError
from vhp_cli.kernels import surface
from vhp_cli.kernels.measuring import closest
from vhp_cli.kernels.spatial import Tree, gap
from vhp_cli.mesh import Mesh
from vhp_cli.stages.clearance.zero_surface import zero_surface
from vhp_cli.stages.decimate import decimate
from vhp_cli.stages.decimate.options import DecimateOptions
from vhp_cli.stages.heal.candidate import Candidate, judge
from vhp_cli.stages.shells.thickness import STEEPEST, gentle

Floats = NDArray[np.float64]

# The grid: part of the skin's thickness or mean edge, whichever is more, and bounded by the number of cells.
_GRID_SHARE, _GRID_EDGES, _MOST_CELLS = 1.0, 0.35, 1_500_000
# Cells of the grid for each cell's face of surface, by measurement.
_CELLS_PER_FACE = 2.2
_ATTEMPTS = 4
# Shells are worked out deeper by this part of their distance at first, for what the grid and fewer triangles round.
_FIRST = 0.05
# What a shell lacks in depth is added so many times over.
_MORE = 1.2
_DEVIATION_SHARE = 0.08
# Pieces with less than this share of the largest one's volume are crumbs, such as the tips of fingers.
_CRUMB = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class Shell:
    """An inner shell.

    Parameters
    ----------
    name
        What it is called.
    mesh
        The surface in mm.
    gap_mm
        Its smallest distance from the shell around it.
    crumbs_mm3
        Volume of the small pieces that were left out.
    """

    name: str
    mesh: Mesh
    gap_mm: float
    crumbs_mm3: float


def shells(skin: Mesh, skin_mm: float, fat_mm: Floats, *, grid_mm: float | None = None) -> list[Shell]:
    """Return the fat shell, which is the inner side of the skin, and the average body within the fat.

    Parameters
    ----------
    skin
        The body surface: closed, outward, free of self-intersections.
    skin_mm
        Thickness of the skin.
    fat_mm : (V,) float64
        Thickness of the fat under each vertex of the skin; lowered where it changes too steeply.
    grid_mm
        Cells in which shells are worked out; None: decided by the skin's thickness, its edges and its area.

    Raises
    ------
    VhpError
        If the skin is not sound, or nothing is left at such a depth.
    """
    judged = judge(skin)
    if not judged.sound:
        raise VhpError(f"the skin is no sound solid: {', '.join(judged.flaws)}", hint="heal it first: vhp heal")
    topology = surface.topology(skin.vertices, skin.faces)
    area = float(judged.measures["area_mm2"])
    least = (_CELLS_PER_FACE * area / _MOST_CELLS) ** 0.5
    grid = grid_mm or max(_GRID_SHARE * skin_mm, _GRID_EDGES * topology.edge_length_mean, least)
    fat = gentle(skin, fat_mm)
    found = []
    around = skin
    for name, depth in (("fat", np.full(len(skin.vertices), skin_mm)), ("average_body", skin_mm + fat)):
        wanted = skin_mm if name == "fat" else float(fat.min())
        shell = _shell(name, skin, around, depth, wanted, grid)
        found.append(shell)
        around = shell.mesh
    return found


def _shell(name: str, skin: Mesh, around: Mesh, depth: Floats, gap_mm: float, grid_mm: float) -> Shell:
    """Return the shell at a depth, made deeper until it keeps its distance from the one around it."""
    tree, outer = Tree(skin.vertices, skin.faces), Tree(around.vertices, around.faces)
    deeper, last = _FIRST * gap_mm, None
    for _ in range(_ATTEMPTS):
        marched = _marched(tree, skin, depth + deeper, grid_mm)
        if not len(marched.faces):
            raise VhpError(f"nothing of the body is left for the shell {name!r}", hint="ask for thinner layers")
        made, crumbs = _without_crumbs(marched)
        candidate = _decimated(made, len(skin.faces), _DEVIATION_SHARE * gap_mm)
        nearest = gap(outer, Tree(candidate.mesh.vertices, candidate.mesh.faces))
        reached = 0.0 if nearest is None or nearest.contact_kind else nearest.distance
        last = Shell(name, candidate.mesh, reached, crumbs)
        if reached >= gap_mm and candidate.sound:
            break
        deeper += _MORE * max(gap_mm - reached, 0.01 * gap_mm)
    assert last is not None
    return last


def _marched(tree: Tree, skin: Mesh, depth: Floats, grid_mm: float) -> Mesh:
    deepest = float(depth.max())

    def level(points: Floats, reach_mm: float) -> Floats:
        # Divided by its steepest slope, so that it changes by at most the way between two points.
        reach = (1 + STEEPEST) * reach_mm
        near = closest(tree, points, deepest + 2 * reach)
        sign = np.where(tree.inside(points) == 1, -1.0, 1.0)
        values = sign * (deepest + 2 * reach)
        at = np.flatnonzero(near.faces >= 0)
        local = _interpolated(skin, depth, near.points[at], near.faces[at])
        values[at] = sign[at] * near.distances[at] + local
        return values / (1 + STEEPEST)

    return zero_surface(level, tree.lower - 2 * grid_mm, tree.upper + 2 * grid_mm, grid_mm, most_cells=2 * _MOST_CELLS)


def _interpolated(skin: Mesh, values: Floats, points: Floats, faces: NDArray[np.int32]) -> Floats:
    """Return values at points of faces, linear in between their corners."""
    a, b, c = (skin.vertices[skin.faces[faces, k]] for k in range(3))
    first, second, way = b - a, c - a, points - a
    ff, fs, ss = ((u * v).sum(axis=1) for u, v in ((first, first), (first, second), (second, second)))
    fw, sw = (first * way).sum(axis=1), (second * way).sum(axis=1)
    area = ff * ss - fs * fs
    flat = area <= 1e-12 * np.maximum(ff * ss, 1e-300)
    divisor = np.where(flat, 1.0, area)
    v = np.where(flat, 0.0, (ss * fw - fs * sw) / divisor)
    w = np.where(flat, 0.0, (ff * sw - fs * fw) / divisor)
    weights = np.clip(np.stack([1 - v - w, v, w], axis=1), 0.0, 1.0)
    weights /= weights.sum(axis=1, keepdims=True)
    found: Floats = (weights * values[skin.faces[faces]]).sum(axis=1)
    return found


def _without_crumbs(mesh: Mesh) -> tuple[Mesh, float]:
    topology = surface.topology(mesh.vertices, mesh.faces)
    if topology.n_components < 2:
        return mesh, 0.0
    volumes = surface.quality(mesh.vertices, mesh.faces, topology.component, topology.n_components).component_volume
    crumbs = np.abs(volumes) < _CRUMB * float(volumes.max())
    if not crumbs.any():
        return mesh, 0.0
    faces = mesh.faces[~crumbs[topology.component]]
    used, index = np.unique(faces, return_inverse=True)
    return Mesh(mesh.vertices[used], index.reshape(-1, 3).astype(np.int32)), float(np.abs(volumes[crumbs]).sum())


def _decimated(mesh: Mesh, triangles: int, deviation_mm: float) -> Candidate:
    """Return a surface with about as many triangles as the skin, and better ones than the grid gave."""
    outcome = decimate(mesh, DecimateOptions(triangles=max(triangles, 4), max_deviation_mm=deviation_mm))
    return judge(mesh if outcome.mesh is None else outcome.mesh)
