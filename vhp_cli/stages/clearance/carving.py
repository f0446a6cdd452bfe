"""Cut from a tissue what lies outside of its room, and let it grow around what does not give way."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vhp_cli import engines
from vhp_cli.kernels import surface
from vhp_cli.mesh import Mesh
from vhp_cli.stages.clearance.cell import Bound, Cell
from vhp_cli.stages.clearance.distance import SignedDistance
from vhp_cli.stages.clearance.zero_surface import zero_surface

Floats = NDArray[np.float64]

# The cutter reaches so many cells beyond the surface of the tissue: its own edge, out there, is cut off by the grid.
_BEYOND = 2.2
_FARTHER = 1.01
# Vertices of the cutter that are off the border by less than this part of a cell are brought nearer by such a step.
_FARTHEST_STEP, _STEP = 0.3, 0.9
_BULGES = 2
# ... if they are in the tissue, or outside by less than this part of a cell.
_NEAR = 0.6
# Cutters are simplified by this part of a cell.
_SIMPLIFY = 0.03
# Separate pieces left over by a cut are crumbs if they have less than this many cubic gaps, or this share of the
# tissue: it was one piece before.
_CRUMB, _CRUMB_SHARE = 8.0, 0.03


def carved(
    mesh: Mesh,
    cell: Cell,
    *,
    grid_mm: float,
    margin_mm: float,
    most_cells: int = 3_000_000,
    timeout_s: float | None = None,
    memory_gb: float | None = None,
) -> tuple[Mesh, float]:
    """Return a tissue without what lies outside of its room, and the volume of crumbs dropped in mm3.

    Parameters
    ----------
    mesh
        Closed, 2-manifold, outward; the given surface, or one made of it.
    cell
        Its room.
    grid_mm
        Cells in which the cut is worked out.
    margin_mm
        How much farther in than the border of the room it is cut.
    most_cells
        Bound on their number.
    timeout_s, memory_gb
        Limits of each call of the engine.

    Raises
    ------
    CallFailed
        If the engine came to no result, as when nothing is left of the tissue.
    TooFineError
        If the grid is too fine.
    """
    current = cell.own if mesh is cell.own.mesh else SignedDistance(mesh)
    limits = {"timeout_s": timeout_s, "memory_gb": memory_gb}
    pad = (_BEYOND + 2) * grid_mm
    lower, upper = current.tree.lower - pad, current.tree.upper + pad

    def forbidden(points: Floats, reach_mm: float) -> Floats:
        own = current(points, 2 * reach_mm + _BEYOND * grid_mm)
        values = own - _BEYOND * grid_mm
        at = np.flatnonzero(values <= reach_mm)
        known = own[at] if current is cell.own else None
        # A bit farther than asked: what is known only to be beyond that must not look as if it were at the limit.
        excess = cell.excess(points[at], _FARTHER * reach_mm + margin_mm, cores=False, own=known)
        values[at] = np.maximum(values[at], -(excess + margin_mm))
        return values

    made = mesh
    cutter = zero_surface(forbidden, lower, upper, grid_mm, most_cells=most_cells)
    if len(cutter.faces):
        cutter = _on_border(cutter, current, cell, grid_mm, margin_mm)
        made = _combined("difference", made, cutter, _SIMPLIFY * grid_mm, limits)
    for bound in cell.bounds:
        if bound.kind == "core":
            made = _grown(made, current, bound, grid_mm, margin_mm, limits)
    if made is mesh:
        return mesh, 0.0
    gaps = [bound.gap_mm for bound in cell.bounds]
    return _without_crumbs(made, mesh, _CRUMB * float(np.median(gaps)) ** 3)


def _on_border(cutter: Mesh, current: SignedDistance, room: Cell, grid_mm: float, margin_mm: float) -> Mesh:
    """Return a cutter with its vertices on the border of the room, from which they are off by what the grid rounds.

    They go a part of the way along the gradient of the excess: where the border has an edge, all of it may lead
    beyond. Then what bulges between them is taken along: no face may lie outside of the room.
    """
    vertices = cutter.vertices.copy()
    is_near = current(vertices, grid_mm) < _NEAR * grid_mm
    near = np.flatnonzero(is_near)
    found = room.located(vertices[near], margin_mm + grid_mm)
    off = found.values + margin_mm
    steep = (found.gradients**2).sum(axis=1)
    at = np.flatnonzero((np.abs(off) < _FARTHEST_STEP * grid_mm) & (steep > 0.25))
    vertices[near[at]] -= _STEP * (off[at] / steep[at])[:, None] * found.gradients[at]
    faces = cutter.faces[is_near[cutter.faces].all(axis=1)]
    for _ in range(_BULGES):
        found = room.located(vertices[faces].mean(axis=1), margin_mm + grid_mm)
        off = found.values + margin_mm
        out = np.flatnonzero((off > 0) & (off < _FARTHEST_STEP * grid_mm))
        if not len(out):
            break
        order = out[np.argsort(off[out], kind="stable")]
        step = np.zeros_like(vertices)
        # The face that bulges most has the last word on its corners.
        step[faces[order].ravel()] = np.repeat(-off[order, None] * found.gradients[order], 3, axis=0)
        vertices += step
    return Mesh(vertices, cutter.faces)


def _grown(
    mesh: Mesh, current: SignedDistance, core: Bound, grid_mm: float, margin_mm: float, limits: dict[str, float | None]
) -> Mesh:
    """Return the tissue together with all that lies near a core, where that is not within it anyway."""
    reach = core.gap_mm + margin_mm

    def near(points: Floats, reach_mm: float) -> Floats:
        values = core.distance(points, 2 * reach_mm + reach) - reach
        at = np.flatnonzero(values <= reach_mm)
        values[at] = np.maximum(values[at], -current(points[at]) - _BEYOND * grid_mm)
        return values

    pad = reach + 2 * grid_mm
    padding = zero_surface(near, core.distance.tree.lower - pad, core.distance.tree.upper + pad, grid_mm)
    if not len(padding.faces):
        return mesh
    return _combined("merge", mesh, padding, _SIMPLIFY * grid_mm, limits)


def _combined(
    operation: engines.Name, first: Mesh, second: Mesh, simplify_mm: float, limits: dict[str, float | None]
) -> Mesh:
    both = Mesh(
        np.concatenate([first.vertices, second.vertices]),
        np.concatenate([first.faces, second.faces + len(first.vertices)]),
    )
    return engines.call(
        operation,
        both,
        timeout_s=limits["timeout_s"],
        memory_gb=limits["memory_gb"],
        first_faces=len(first.faces),
        simplify_mm=simplify_mm,
    )


def _without_crumbs(mesh: Mesh, given: Mesh, least_mm3: float) -> tuple[Mesh, float]:
    """Return a surface without the small pieces that cuts left over, and their volume."""
    topology = surface.topology(mesh.vertices, mesh.faces)
    if topology.n_components < 2:
        return mesh, 0.0
    volumes = surface.quality(mesh.vertices, mesh.faces, topology.component, topology.n_components).component_volume
    new = ~known_vertices(mesh, given)
    is_cut = np.zeros(topology.n_components, dtype=np.bool_)
    is_cut[topology.component[new[mesh.faces].any(axis=1)]] = True
    whole = float(np.abs(volumes).sum())
    crumbs = is_cut & (np.abs(volumes) < max(min(least_mm3, 0.1 * float(volumes.max())), _CRUMB_SHARE * whole))
    if not crumbs.any():
        return mesh, 0.0
    return Mesh(mesh.vertices, mesh.faces[~crumbs[topology.component]]), float(volumes[crumbs].sum())


def known_vertices(mesh: Mesh, given: Mesh) -> NDArray[np.bool_]:
    """Tell which vertices of a mesh lie exactly, as float32 values, on one of another mesh."""
    old = np.ascontiguousarray(given.vertices.astype(np.float32) + np.float32(0)).view("V12").ravel()
    new = np.ascontiguousarray(mesh.vertices.astype(np.float32) + np.float32(0)).view("V12").ravel()
    order = np.unique(np.concatenate([old, new]), return_inverse=True)[1]
    known: NDArray[np.bool_] = np.isin(order[len(old) :], order[: len(old)])
    return known
