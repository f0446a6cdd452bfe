"""Inner shells of a body surface: the fat shell within the skin, the average body within the fat (thesis 5.1.6).

Where the body is thick enough, every vertex of a surface goes inward until its faces are as deep as asked, and the
triangulation stays. Where that fails (ears, lips, between fingers), what is too shallow is cut off along the surface
on which the distance from the outer one is the thickness; there a shell ends where the body is too thin for it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from vhp_cli.errors import VhpError
from vhp_cli.kernels import decimating, surface
from vhp_cli.kernels.measuring import closest
from vhp_cli.kernels.spatial import Tree, gap
from vhp_cli.mesh import Mesh
from vhp_cli.processes import CallFailed
from vhp_cli.stages.clearance.carving import known_vertices
from vhp_cli.stages.clearance.finishing import rescued
from vhp_cli.stages.heal.candidate import Candidate, as_written, judge
from vhp_cli.stages.heal.cascade import heal
from vhp_cli.stages.heal.options import HealOptions
from vhp_cli.stages.shells.deepening import deepened
from vhp_cli.stages.shells.displacing import displaced
from vhp_cli.stages.shells.layer import Layer, interpolated
from vhp_cli.stages.shells.thickness import gentle
from vhp_cli.stages.shells.trimming import cell_size, shallow_parts, trimmed

Floats = NDArray[np.float64]

# Vertices go deeper than asked by this share of the thickness; the second one is enough where nothing has to be cut.
# What is less deep still is cut to such a depth, with such an error of what is left, as shares of the thickness; then
# what is too shallow is cut again.
_SHARE, _EXACT_SHARE = 0.05, 0.01
_CUTS = ((0.035, 0.05), (0.05, 0.03), (0.07, 0.015), (0.1, 0.01))
# At creases, shells may be deeper than asked by this share of the thickness.
_LOOSE = 0.5
_CELL_SHARE = 0.5
_LEAST_QUALITY, _TARGET_QUALITY, _MIN_EDGE = 0.1, 0.3, 0.02
_DEEPENED_SHARE = 0.01
# Where thickness varies, so much of it has to be reached at every point that is looked at.
_LEAST_SHARE = 0.98
# A shell ends under what is so many thicknesses away from it.
_ENDS_AT = 2.5
# Pieces with less than this share of the largest one's volume are crumbs, such as the tips of fingers.
_CRUMB = 1e-4
_THINNER = "ask for thinner layers, and look at --units"


@dataclass(frozen=True, slots=True)
class Piece:
    """A separate piece of a shell that was left out: its volume in mm3, and the middle of its box in mm."""

    volume_mm3: float
    xyz_mm: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class End:
    """A part of the outer surface under which a shell ends, as the body is too thin for the layer.

    Parameters
    ----------
    area_mm2
        Of the outer surface there.
    distance_mm
        How far the shell is from the farthest point.
    xyz_mm
        That point.
    """

    area_mm2: float
    distance_mm: float
    xyz_mm: tuple[float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Shell:
    """An inner shell.

    Parameters
    ----------
    name
        What it is called.
    mesh
        The surface in mm.
    thickness_mm
        The least and the largest thickness asked for, after it was made gentle.
    gap_mm
        Its smallest distance from the surface around it, exact.
    gap_xyz_mm
        Where that is, on the shell.
    shallowest
        Least depth of vertices, middles of edges and centres of faces, as a share of the thickness wanted there.
    depth
        What half of them, 99 % of them and all of them do not exceed.
    ends
        Where it ends, the largest first.
    dropped
        What was left out, the largest first.
    """

    name: str
    mesh: Mesh
    thickness_mm: tuple[float, float]
    gap_mm: float
    gap_xyz_mm: tuple[float, float, float]
    shallowest: float
    depth: tuple[float, float, float]
    ends: tuple[End, ...]
    dropped: tuple[Piece, ...]

    @property
    def reached(self) -> bool:
        """Whether it is as deep as asked everywhere; where thickness varies, up to 2 % at the points looked at."""
        return self.gap_mm >= self.thickness_mm[0] and self.shallowest >= _LEAST_SHARE


def shells(
    skin: Mesh,
    skin_mm: float,
    fat_mm: Floats,
    *,
    grid_mm: float | None = None,
    memory_gb: float | None = None,
    threads: int = 1,
) -> list[Shell]:
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
        Cells in which cuts are worked out; None: by the thickness, and by how much is cut.
    memory_gb
        Limit of each call of the engine that cuts.
    threads
        How many threads look for distances; the result is the same.

    Raises
    ------
    VhpError
        If the skin is not sound, or nothing is left at such a depth.
    """
    judged = judge(skin)
    if not judged.sound:
        raise VhpError(f"the skin is no sound solid: {', '.join(judged.flaws)}", hint="heal it first: vhp heal")
    fat = _shell("fat", Layer(skin, np.full(len(skin.vertices), skin_mm), threads), grid_mm, memory_gb)
    near = closest(Tree(skin.vertices, skin.faces), fat.mesh.vertices)
    under = interpolated(skin, gentle(skin, fat_mm), near.points, near.faces)
    return [fat, _shell("average_body", Layer(fat.mesh, gentle(fat.mesh, under), threads), grid_mm, memory_gb)]


def _shell(name: str, layer: Layer, grid_mm: float | None, memory_gb: float | None) -> Shell:
    """Return the inner side of a layer."""
    moved = displaced(layer, share=_SHARE, loose=_LOOSE)
    if not moved.shallow.any():
        exact = displaced(layer, share=_EXACT_SHARE, loose=_LOOSE)
        moved = moved if exact.shallow.any() else exact
    current, places, dropped = judge(moved.mesh), moved.shallow, list[Piece]()
    best: Mesh | None = None
    most, flaws = (-1.0, 0), current.flaws
    for share, error in _CUTS:
        made, crumbs = current, list[Piece]()
        shallow = shallow_parts(current.mesh, layer, places, share)
        if len(shallow.corners):
            cells = grid_mm or cell_size(shallow, _CELL_SHARE)
            try:
                cut = trimmed(current.mesh, layer, shallow, share=share, cell_mm=cells, memory_gb=memory_gb)
            except CallFailed as failed:
                if failed.reason == "error" and failed.detail.endswith("no faces"):
                    message = f"nothing of the body is left for the shell {name!r}"
                    raise VhpError(message, hint=_THINNER) from failed
                raise
            whole, crumbs = _without_crumbs(cut)
            made = _finished(whole, layer, error)
        if not made.sound:
            # The next cut is another one.
            flaws = made.flaws
            continue
        dropped += crumbs
        new = ~known_vertices(made.mesh, current.mesh)[made.mesh.faces].all(axis=1)
        mesh, reached, still = deepened(made.mesh, layer, np.flatnonzero(new), share=_DEEPENED_SHARE)
        current = judge(mesh)
        merit = min(reached, layer.least), -len(still)
        if current.sound and merit > most:
            best, most = current.mesh, merit
        if reached >= layer.least and not len(still):
            break
        places = np.zeros(len(current.mesh.faces), dtype=np.bool_)
        places[still] = True
    if best is None:
        hint = "smooth the skin first: vhp smooth"
        raise VhpError(f"the shell {name!r} can't be made sound: {', '.join(flaws)}", hint=hint)
    return _measured(name, layer, best, dropped)


def _finished(mesh: Mesh, layer: Layer, error: float) -> Candidate:
    """Return a cut surface with about as many triangles as the outer one, and without slivers."""
    written = as_written(mesh)
    fewer = decimating.decimate(
        written.vertices,
        written.faces,
        target_triangles=len(layer.outer.faces),
        max_error=error * layer.least,
        min_quality=_LEAST_QUALITY,
    )
    better = partial(
        rescued,
        deviation_mm=error * layer.least,
        target_quality=_TARGET_QUALITY,
        min_edge_mm=_MIN_EDGE * layer.least,
    )
    candidate = better(judge(Mesh(fewer.vertices, fewer.faces)))
    if not candidate.sound:
        # Slivers that cross each other once they are rounded.
        healed = heal(candidate.mesh, HealOptions(only_topology=True)).mesh
        if healed is not None:
            candidate = better(judge(healed))
    return candidate


def _without_crumbs(mesh: Mesh) -> tuple[Mesh, list[Piece]]:
    """Return a surface without small separate pieces; cavities stay, as they are holes in the body around too."""
    topology = surface.topology(mesh.vertices, mesh.faces)
    if topology.n_components < 2:
        return mesh, []
    volumes = surface.quality(mesh.vertices, mesh.faces, topology.component, topology.n_components).component_volume
    crumbs = (volumes >= 0) & (volumes < _CRUMB * float(volumes.max()))
    if not crumbs.any():
        return mesh, []
    faces = mesh.faces[~crumbs[topology.component]]
    used, index = np.unique(faces, return_inverse=True)
    pieces = []
    for number in np.flatnonzero(crumbs):
        own = mesh.vertices[mesh.faces[topology.component == number].ravel()]
        pieces.append(Piece(float(volumes[number]), _point((own.min(axis=0) + own.max(axis=0)) / 2)))
    return Mesh(mesh.vertices[used], index.reshape(-1, 3).astype(np.int32)), pieces


def _measured(name: str, layer: Layer, mesh: Mesh, dropped: list[Piece]) -> Shell:
    outer, tree = layer.outer, Tree(mesh.vertices, mesh.faces)
    nearest = gap(layer.tree, tree)
    if nearest is None:
        raise VhpError(f"nothing of the body is left for the shell {name!r}", hint=_THINNER)
    joined = surface.topology(mesh.vertices, mesh.faces)
    middles = mesh.vertices[joined.inner_edges].mean(axis=1)
    found, wanted = layer.depths(np.concatenate([mesh.vertices, middles, mesh.vertices[mesh.faces].mean(axis=1)]))
    shares = found / wanted
    away = closest(tree, outer.vertices).distances
    return Shell(
        name,
        mesh,
        (layer.least, layer.most),
        0.0 if nearest.contact_kind else nearest.distance,
        _point(nearest.points[1]),
        float(shares.min()),
        (float(np.median(shares)), float(np.quantile(shares, 0.99)), float(shares.max())),
        _ends(outer, away, away > _ENDS_AT * layer.thickness),
        tuple(sorted(dropped, key=lambda piece: (-piece.volume_mm3, piece.xyz_mm))),
    )


def _ends(outer: Mesh, away: Floats, beyond: NDArray[np.bool_]) -> tuple[End, ...]:
    """Return the parts of the outer surface, as connected faces, that are too far from the shell within it."""
    faces = np.flatnonzero(beyond[outer.faces].all(axis=1))
    if not len(faces):
        return ()
    corners = outer.vertices[outer.faces[faces]]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    joined = surface.topology(outer.vertices, outer.faces[faces])
    ends = []
    for number in range(joined.n_components):
        own = joined.component == number
        vertices = np.unique(outer.faces[faces[own]])
        farthest = vertices[away[vertices].argmax()]
        ends.append(End(float(areas[own].sum()), float(away[farthest]), _point(outer.vertices[farthest])))
    return tuple(sorted(ends, key=lambda end: (-end.area_mm2, end.xyz_mm)))


def _point(xyz: Floats) -> tuple[float, float, float]:
    return float(xyz[0]), float(xyz[1]), float(xyz[2])
