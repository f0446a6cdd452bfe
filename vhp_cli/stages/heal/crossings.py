"""Clear the places where a surface crosses or touches itself, each by itself and by the least change that does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vhp_cli.inspection.places import MAX_PLACES, point
from vhp_cli.kernels.measuring import closest
from vhp_cli.kernels.spatial import Tree
from vhp_cli.kernels.surface import topology
from vhp_cli.measures import Action, Place
from vhp_cli.mesh import Mesh
from vhp_cli.rounding import rounded, spacing
from vhp_cli.stages.heal.candidate import diagonal, face_areas
from vhp_cli.stages.heal.clean import compact
from vhp_cli.stages.heal.holes import fill_holes, holes
from vhp_cli.stages.heal.pushing import push, smooth
from vhp_cli.stages.heal.zones import Floats, Ints, Mask, Zones, all_hits, connected, edges_of, find_zones, grown

# How far vertices may be moved: this share of the diagonal of the box, within these bounds in mm.
_REACH_SHARE = 5e-3
_LEAST_REACH = 0.2
_MOST_REACH = 1.0
# A zone that was cleared by moving vertices no farther than this share of the reach needs no better way.
_GOOD_SHARE = 0.1
# Rings of neighbours taken along, whether winding numbers tell the way, and share of smoothing, in the order in which
# they are tried.
_PUSHES = (
    (0, True, 0.0),
    (0, False, 0.0),
    (2, True, 0.0),
    (2, False, 0.0),
    (0, True, 0.02),
    (0, False, 0.02),
    (0, True, 0.1),
)
# A zone is not pushed if it holds more vertices than this, or more than this share of all and than the last number:
# what is wrong there is not a matter of a few vertices.
_LARGEST_CORE = 3000
_LARGEST_SHARE = 0.3
_SMALL_CORE = 500
_MOST_MERGES = 5
# Pairs of faces that meet over all faces, beyond which a surface of some size is one tangle: moving vertices takes long
# and leads nowhere.
_MOST_TANGLED = 0.5
_FEW_PAIRS = 500
_CUT_RINGS = (0, 1, 2)
_MOST_CUTS = 50


def default_reach(mesh: Mesh) -> float:
    """Return how far repairs may move a surface: 0.5 % of the diagonal of its box, but 0.2 to 1 mm."""
    return float(np.clip(_REACH_SHARE * diagonal(mesh), _LEAST_REACH, _MOST_REACH))


def untangle(mesh: Mesh, reach_mm: float | None = None, gap_mm: float = 0.01) -> tuple[Mesh, list[Action]]:
    """Clear self-intersections by moving the vertices around them.

    Every zone is treated by itself in all ways, and the one that moves it least is taken: tangles are smoothed, and
    sheets that pass through each other, or touch, are pushed apart. Nothing is lost or joined that way. A zone that
    no way clears keeps its vertices exactly, as does all that lies outside of zones.

    Parameters
    ----------
    mesh
        Closed, consistently oriented and manifold by its indices; with float32 values as coordinates.
    reach_mm
        Farthest way of a vertex; None: `default_reach`.
    gap_mm
        Distance to which sheets are pushed apart.

    Returns
    -------
    mesh, actions
        The places of an action are one for each zone; `value` is the way of its farthest vertex.
    """
    if Tree(mesh.vertices, mesh.faces).self_hits(0).n_pairs > max(_FEW_PAIRS, _MOST_TANGLED * len(mesh.faces)):
        return mesh, []
    reach = default_reach(mesh) if reach_mm is None else reach_mm
    # What is apart in float64 has to be apart in the file too.
    gap = max(gap_mm, 8 * spacing(mesh.vertices))
    zones = find_zones(mesh)
    if not zones.count:
        return mesh, []
    for _ in range(_MOST_MERGES):
        best, ways, how = _best_moves(mesh, zones, gap, reach)
        cleared = np.isfinite(ways)
        placed = np.where(np.append(cleared, False)[zones.labels][:, None], best, mesh.vertices)
        pairs = all_hits(Tree(placed, mesh.faces)).pairs
        fewer = _merged(zones, cleared, zones.labels[mesh.faces[pairs]].reshape(-1, 6))
        if fewer is None:
            break
        zones = fewer
    else:
        return mesh, []
    if not cleared.any():
        return mesh, []
    actions: list[Action] = []
    for number, message in enumerate(("tangles smoothed", "sheets pushed apart where they met")):
        done = np.flatnonzero(cleared & (how == number))
        if len(done):
            actions.append(_report(mesh, zones, done, ways, "untangle", message))
    return Mesh(placed, mesh.faces), actions


def _merged(zones: Zones, cleared: Mask, meeting: Ints) -> Zones | None:
    """Merge zones that were cleared but got into each other's way; None if none did.

    `meeting` holds the zones of the vertices of each pair of faces that meet (M, 6).
    """
    meeting = meeting[np.append(cleared, False)[meeting].any(axis=1)]
    links = np.stack([meeting.max(axis=1, keepdims=True).repeat(6, axis=1), meeting], axis=2).reshape(-1, 2)
    links = links[(links[:, 0] != links[:, 1]) & (links >= 0).all(axis=1)]
    if not len(links):
        return None
    _, number = np.unique(connected(zones.count, links), return_inverse=True)
    labels = np.append(number, -1)[zones.labels].astype(np.int32)
    return Zones(int(number.max()) + 1, labels, zones.core)


def _best_moves(mesh: Mesh, zones: Zones, gap: float, reach: float) -> tuple[Floats, Floats, Ints]:
    """Return for each zone the positions, how far they are from the old ones, and by which way they were found."""
    vertices, faces, labels = mesh.vertices, mesh.faces, zones.labels
    best, ways = smooth(vertices, faces, labels, zones.count, zones.core)
    ways[ways > reach] = np.inf
    how = np.zeros(zones.count, np.int32)
    sizes = np.bincount(labels[zones.core], minlength=zones.count)
    largest = min(max(_LARGEST_SHARE * len(vertices), _SMALL_CORE), _LARGEST_CORE)
    for spread, by_winding, smoothing in _PUSHES:
        active = (ways > _GOOD_SHARE * reach) & (sizes <= largest)
        if not active.any():
            break
        moved, distances = push(
            vertices,
            faces,
            labels,
            active,
            zones.core,
            gap=gap,
            reach=reach,
            spread=spread,
            by_winding=by_winding,
            smoothing=smoothing,
        )
        better = distances < ways
        ways[better] = distances[better]
        how[better] = 1
        taken = np.append(better, False)[labels]
        best[taken] = moved[taken]
    return best, ways, how


def _report(mesh: Mesh, zones: Zones, done: NDArray[np.intp], sizes: Floats, step: str, message: str) -> Action:
    ordered = done[np.argsort(-sizes[done], kind="stable")]
    places: list[Place] = []
    for zone in ordered[:MAX_PLACES]:
        own = np.flatnonzero(zones.core & (zones.labels == zone))
        middle = mesh.vertices[own].mean(axis=0)
        places.append({"xyz_mm": point(middle), "face": None, "value": float(sizes[zone])})
    count = len(done)
    noun = "place" if count == 1 else "places"
    return {
        "step": step,
        "message": f"{message} in {count} {noun}, by up to {sizes[done].max():.3g} mm",
        "count": count,
        "places": places,
    }


@dataclass(frozen=True, slots=True, eq=False)
class _Cut:
    """A mesh after one zone was cut out and filled, and what that changed."""

    mesh: Mesh
    distance: float
    removed_mm2: float


def cut_and_fill(mesh: Mesh, reach_mm: float | None = None) -> tuple[Mesh, list[Action]]:
    """Cut out the faces around self-intersections and close the holes.

    Zones are cut one after the other. A cut counts only if its zone is cleared, the mesh is as closed and manifold
    as before, and what was removed and what was put in lie no farther apart than allowed.

    Parameters
    ----------
    mesh
        Closed, consistently oriented and manifold by its indices; with float32 values as coordinates.
    reach_mm
        Largest distance; None: `default_reach`.

    Returns
    -------
    mesh, actions
        The places of the action are one for each zone; `value` is the distance between old and new surface.
    """
    reach = default_reach(mesh) if reach_mm is None else reach_mm
    places: list[Place] = []
    area, farthest = 0.0, 0.0
    skipped = 0
    for _ in range(_MOST_CUTS):
        zones = find_zones(mesh)
        if zones.count <= skipped:
            break
        # Zones that withstood keep their order, as cuts elsewhere only take zones away.
        zone = skipped
        cut = _cut_zone(mesh, zones, zone, reach)
        if cut is None:
            skipped += 1
            continue
        own = zones.core & (zones.labels == zone)
        middle = point(mesh.vertices[own].mean(axis=0))
        places.append({"xyz_mm": middle, "face": None, "value": cut.distance})
        area += cut.removed_mm2
        farthest = max(farthest, cut.distance)
        mesh = cut.mesh
    if not places:
        return mesh, []
    noun = "place" if len(places) == 1 else "places"
    return mesh, [
        {
            "step": "cut",
            "message": f"faces that crossed replaced in {len(places)} {noun}, by up to {farthest:.3g} mm",
            "count": len(places),
            "places": sorted(places, key=lambda place: -place["value"])[:MAX_PLACES],
            "area_mm2": area,
        }
    ]


def _cut_zone(mesh: Mesh, zones: Zones, zone: int, reach: float) -> _Cut | None:
    """Return the narrowest cut of a zone that clears it; None if there is none."""
    edges = edges_of(mesh.faces)
    core = zones.core & (zones.labels == zone)
    pairs = all_hits(Tree(mesh.vertices, mesh.faces)).pairs
    hit = np.zeros(len(mesh.faces), np.bool_)
    hit[pairs] = True
    hit &= core[mesh.faces].all(axis=1)
    wrong = core & ~_corners(mesh, hit)
    others = np.unique(pairs[~hit[pairs].any(axis=1)])
    for rings in _CUT_RINGS:
        reached = grown(core if rings else wrong, edges, max(rings - 1, 0))
        removed = hit | reached[mesh.faces].any(axis=1)
        cut = _filled(mesh, removed, len(others), reach)
        if cut is not None:
            return cut
    return None


def _corners(mesh: Mesh, chosen: Mask) -> Mask:
    found = np.zeros(len(mesh.vertices), np.bool_)
    found[mesh.faces[chosen]] = True
    return found


def _filled(mesh: Mesh, removed: Mask, still_hit: int, reach: float) -> _Cut | None:
    """Take faces out, close the holes, and see whether that is better."""
    removed = removed | _islands(mesh, removed)
    if removed.all():
        return None
    opened = compact(Mesh(mesh.vertices, mesh.faces[~removed]))
    before = topology(opened.vertices, opened.faces)
    if len(before.nonmanifold_vertices) or len(before.nonmanifold_edges):
        return None
    openings = holes(opened)
    closed, _, caps = fill_holes(opened, openings)
    closed = Mesh(rounded(closed.vertices), closed.faces)
    after = topology(closed.vertices, closed.faces)
    flaws = (after.boundary_edges, after.nonmanifold_edges, after.nonmanifold_vertices, after.duplicate_faces)
    if any(len(flaw) for flaw in flaws) or len(after.collapsed_faces):
        return None
    pairs = all_hits(Tree(closed.vertices, closed.faces)).pairs
    if caps[pairs].any() or len(np.unique(pairs)) > still_hit:
        return None
    distance = max(
        _farthest_from(mesh, removed, Tree(closed.vertices, closed.faces)),
        _farthest_from(closed, caps, Tree(mesh.vertices, mesh.faces)),
    )
    if distance > reach:
        return None
    return _Cut(closed, distance, float(face_areas(mesh)[removed].sum()))


def _islands(mesh: Mesh, removed: Mask) -> Mask:
    """Return what the cut would leave of a component apart from its largest piece."""
    whole = topology(mesh.vertices, mesh.faces).component
    left = np.flatnonzero(~removed)
    rest = topology(mesh.vertices, mesh.faces[left])
    areas = np.bincount(rest.component, face_areas(mesh)[left], minlength=rest.n_components)
    owner = np.empty(rest.n_components, np.int64)
    owner[rest.component] = whole[left]
    largest = np.zeros(whole.max() + 1)
    np.maximum.at(largest, owner, areas)
    found = np.zeros(len(mesh.faces), np.bool_)
    found[left] = (areas < largest[owner])[rest.component]
    return found


def _farthest_from(mesh: Mesh, chosen: Mask, tree: Tree) -> float:
    """Return the largest distance of corners, edge midpoints and centres of faces from a surface."""
    corners = mesh.vertices[mesh.faces[chosen]]
    middles = (corners + np.roll(corners, 1, axis=1)) / 2
    samples = np.concatenate([corners.reshape(-1, 3), middles.reshape(-1, 3), corners.mean(axis=1)])
    return float(closest(tree, samples).distances.max(initial=0.0))
