"""Refine one tissue: pick triangles, split them at the midpoints of their edges, and smooth the result."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vhp_cli.inspection.deviation import deviation
from vhp_cli.kernels import surface
from vhp_cli.kernels.reading import weld
from vhp_cli.kernels.spatial import Tree
from vhp_cli.measures import Action
from vhp_cli.mesh import Mesh
from vhp_cli.rounding import rounded
from vhp_cli.stages.heal.candidate import diagonal
from vhp_cli.stages.outcome import Outcome
from vhp_cli.stages.refine.options import ALL_EDGES, BY_ERROR, SCENARIOS, SHARED_EDGES, RefineOptions
from vhp_cli.stages.refine.picking import sizes, with_neighbours, worst
from vhp_cli.stages.refine.splitting import Mask, Sides, Split, cut_edges, sides_of
from vhp_cli.stages.smooth import smooth
from vhp_cli.stages.smooth.options import SmoothOptions

# Rounds in which faces that rounding brings into contact are left whole; one or two is all that was ever needed.
_ROUNDS = 8
# Contacts to list besides those of the input.
_LISTED_CONTACTS = 4096
# A face of at most this area, as a part of the square of its longest edge, counts as one without area.
_NO_AREA = 2e-12


def refine(mesh: Mesh, options: RefineOptions, errors: NDArray[np.float64] | None = None) -> Outcome:
    """Refine the worst triangles of one tissue.

    Parameters
    ----------
    mesh
        The surface as read from its file, in mm.
    options
        How many triangles to pick and by what, which of their edges to cut, and how to smooth.
    errors : (F,) float64, optional
        Error of each face, finite and not negative; needed to pick by error.

    Returns
    -------
    Outcome
        ``changed`` with the new surface, whose coordinates are float32 values, and as reason how many picked triangles
        could not be split, if any; ``refused`` with the reason if none could be.

    Raises
    ------
    ValueError
        If there is no percentage, or not one error for each face.
    """
    if options.percent is None:
        raise ValueError("the percentage of triangles to refine is missing")
    if options.by == BY_ERROR and (errors is None or len(errors) != len(mesh.faces)):
        raise ValueError("there must be one error for each face")
    given, kept = _as_written(mesh)
    if not len(given.faces):
        return Outcome(None, "unchanged")
    values = errors[kept] if options.by == BY_ERROR and errors is not None else sizes(given)
    picked = worst(values, options.percent)
    made = _divided(given, picked, options)
    if made is None:
        return Outcome(None, "refused", "it meets itself, and that could not be left as it is; heal it first")
    n_picked = int(picked.sum())
    if made.n_whole == n_picked:
        return Outcome(None, "refused", f"none of {_triangles(n_picked)} could be split: {_why_whole(options)}")
    actions = [_pick_action(values, picked, options), _split_action(given, made, options)]
    limit = options.max_deviation_mm or min(1e-3 * diagonal(mesh), 0.1)
    result = made.mesh
    if options.smooth:
        smoothed = smooth(made.mesh, SmoothOptions(max_deviation_mm=limit, min_edge_mm=options.min_edge_mm))
        if smoothed.mesh is not None:
            result = smoothed.mesh
            actions += smoothed.actions
    reason = f"{_triangles(made.n_whole)} picked and left whole: {_why_whole(options)}" if made.n_whole else ""
    return Outcome(result, "changed", reason, actions, deviation(mesh, result, lost_limit_mm=limit))


@dataclass(frozen=True, slots=True, eq=False)
class _Divided:
    """A mesh with its picked triangles split.

    Parameters
    ----------
    mesh
        float32 coordinates.
    n_whole
        Picked triangles of the given mesh that were not split.
    n_picked_split, n_others_split
        Triangles that were split, in all levels, because they were picked or so that the others fit.
    """

    mesh: Mesh
    n_whole: int
    n_picked_split: int
    n_others_split: int


def _as_written(mesh: Mesh) -> tuple[Mesh, NDArray[np.int64]]:
    """Return a mesh with float32 coordinates, equal ones welded, without collapsed faces, and the faces it keeps."""
    vertices, index = weld(rounded(mesh.vertices)[mesh.faces].reshape(-1, 3))
    faces = index.reshape(-1, 3)
    kept = np.flatnonzero((faces != faces[:, [1, 2, 0]]).all(axis=1))
    return Mesh(vertices, faces[kept]), kept


def _divided(given: Mesh, picked: Mask, options: RefineOptions) -> _Divided | None:
    """Split the picked triangles as often as asked for; None if the surface meets itself and can't be split.

    What was divided only to fit is not divided again, or it would get thinner each time: the triangles around the
    picked ones are split with them, a ring for each level to come, or those at their rim are left out.
    """
    mesh, mine, counts = given, picked, []
    for level in range(options.levels):
        chosen = mine
        if options.scenario == ALL_EDGES:
            for _ in range(level + 1, options.levels):
                chosen = with_neighbours(mesh, chosen)
        split = _split(mesh, chosen, options)
        if split is None:
            return None
        counts.append((int((mine & (split.n_cuts > 0)).sum()), int((~mine & (split.n_cuts > 0)).sum())))
        again = mine if options.scenario == ALL_EDGES else mine & (split.n_cuts == 3)
        mesh, mine = split.mesh, again[split.parents]
    n_mine, n_others = (sum(column) for column in zip(*counts, strict=True))
    return _Divided(mesh, int(picked.sum()) - counts[0][0], n_mine, n_others)


def _split(mesh: Mesh, picked: Mask, options: RefineOptions) -> Split | None:
    """Split the picked triangles once and round the result, with no contact that was not there before.

    A midpoint that is rounded leaves its edge by half a unit in the last place, which can matter where a tissue is
    extremely thin. Triangles for which it does stay whole.
    """
    sides, tree = sides_of(mesh), Tree(mesh.vertices, mesh.faces)
    hits = tree.self_hits(0)
    if not hits.complete:
        return None
    pairs = tree.self_hits(hits.n_pairs).pairs
    left = _edges_to_leave(mesh, sides, pairs, options)
    for _ in range(_ROUNDS):
        split = cut_edges(mesh, sides, SCENARIOS[options.scenario](sides, picked) & ~left)
        written = Mesh(rounded(split.mesh.vertices), split.mesh.faces)
        parents = np.unique(split.parents[_broken_by_rounding(mesh, written, split, len(pairs))])
        if not len(parents):
            return replace(split, mesh=written)
        left[sides.of_face[parents]] = True
    return None


def _edges_to_leave(mesh: Mesh, sides: Sides, contacts: NDArray[np.int32], options: RefineOptions) -> Mask:
    """Return the edges that are not cut: short ones, and those at defects, of which there would be more (E,)."""
    joined = surface.topology(mesh.vertices, mesh.faces)
    measured = surface.quality(mesh.vertices, mesh.faces, joined.component, joined.n_components)
    ends = mesh.vertices[sides.ends]
    left: Mask = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) < 2 * options.min_edge_mm
    for faces in (contacts.ravel(), joined.duplicate_faces, measured.degenerate):
        left[sides.of_face[faces]] = True
    enclosed = surface.dihedral_angles(mesh.vertices, mesh.faces, joined.inner_edges, joined.inner_edge_faces)
    folds = joined.inner_edges[enclosed < options.fold_deg]
    keys = sides.ends @ [len(mesh.vertices), 1]
    for edges in (joined.nonmanifold_edges, joined.inconsistent_edges, folds):
        left[np.searchsorted(keys, edges.astype(np.int64) @ [len(mesh.vertices), 1])] = True
    return left


def _broken_by_rounding(mesh: Mesh, written: Mesh, split: Split, n_known: int) -> NDArray[np.int64]:
    """Return the new faces without area, turned over, or in contact; known contacts are between faces left whole."""
    is_part = split.n_cuts[split.parents] > 0
    parts = np.flatnonzero(is_part)
    old, new = _normals(mesh, split.parents[parts]), _normals(written, parts)
    lengths = np.linalg.norm(new, axis=1)
    bad = is_part.copy()
    bad[parts] = ~(np.einsum("ij,ij->i", old, new) > 0) | (lengths <= _NO_AREA * _longest_squares(written, parts))
    pairs = Tree(written.vertices, written.faces).self_hits(n_known + _LISTED_CONTACTS).pairs
    bad[pairs.ravel()] = True
    return np.flatnonzero(bad & is_part)


def _normals(mesh: Mesh, faces: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the normals of some faces, twice as long as their areas."""
    a, b, c = (mesh.vertices[mesh.faces[faces, k]] for k in range(3))
    return np.cross(b - a, c - a)


def _longest_squares(mesh: Mesh, faces: NDArray[np.int64]) -> NDArray[np.float64]:
    corners = mesh.vertices[mesh.faces[faces]]
    longest: NDArray[np.float64] = ((corners - np.roll(corners, -1, axis=1)) ** 2).sum(axis=2).max(axis=1)
    return longest


def _why_whole(options: RefineOptions) -> str:
    shared = "shares no edge with another picked one, " if options.scenario == SHARED_EDGES else ""
    return f"each {shared}has only edges shorter than {2 * options.min_edge_mm:g} mm, or lies at a defect"


def _pick_action(values: NDArray[np.float64], picked: Mask, options: RefineOptions) -> Action:
    count = int(picked.sum())
    what = "error" if options.by == BY_ERROR else "size in mm"
    message = (
        f"{count} of {len(picked)} triangles picked ({options.percent:g} %), {what} from {values[picked].min():.3g} up"
    )
    return {"step": "pick", "message": message, "count": count, "places": []}


def _split_action(given: Mesh, made: _Divided, options: RefineOptions) -> Action:
    n_split = made.n_picked_split + made.n_others_split
    times = f", {options.levels} times" if options.levels > 1 else ""
    message = (
        f"{options.scenario}{times}: {made.n_picked_split} picked triangles and {made.n_others_split} others split, "
        f"{len(given.faces)} -> {len(made.mesh.faces)} triangles, "
        f"{len(made.mesh.vertices) - len(given.vertices)} new vertices"
    )
    return {"step": "split", "message": message, "count": n_split, "places": []}


def _triangles(count: int) -> str:
    return f"{count} triangle" if count == 1 else f"{count} triangles"
