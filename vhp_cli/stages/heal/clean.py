"""First rung: take out what is no surface at all (collapsed, flat and double faces, specks) and weld a soup of faces.

Each function takes a mesh and returns it, changed or the same object, with what it did.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vhp_cli.inspection.places import MAX_PLACES, at_faces
from vhp_cli.kernels.reading import weld
from vhp_cli.kernels.repairing import BOUNDARY, edge_keys, mates
from vhp_cli.kernels.surface import quality, topology
from vhp_cli.measures import Action
from vhp_cli.mesh import Mesh
from vhp_cli.stages.heal.candidate import diagonal, face_areas

# Components whose box has a diagonal below this share of that of the tissue are specks.
SPECK_SHARE = 0.002
# A mesh is a soup if this share of its half-edges has no second one.
SOUP_SHARE = 0.05
# Tolerances tried on a soup, as shares of the diagonal. A weld counts if at most this share of the open edges is left.
_WELD_STEPS = (1e-7, 1e-6, 3e-6, 1e-5, 3e-5, 1e-4, 3e-4)
_WELD_GAIN = 0.8
# Welding must not touch the shape: at most this share of a short edge (the 2 % quantile).
_WELD_EDGE_SHARE = 0.3
_MOST_FLIP_ROUNDS = 20


def clean(mesh: Mesh, min_component: float | None = None) -> tuple[Mesh, list[Action]]:
    """Run all functions of this module in their order.

    Parameters
    ----------
    mesh
        Any mesh.
    min_component
        As of `remove_specks`.
    """
    actions: list[Action] = []
    for step in (remove_collapsed, weld_soup, remove_duplicates, flip_flat):
        mesh, done = step(mesh)
        actions += done
    mesh, done = remove_specks(mesh, min_component)
    actions += done
    mesh, done = remove_unreferenced(mesh)
    return mesh, actions + done


def compact(mesh: Mesh) -> Mesh:
    """Return a mesh without the vertices that no face uses; the same object if all are used."""
    used = np.zeros(len(mesh.vertices), np.bool_)
    used[mesh.faces] = True
    if used.all():
        return mesh
    number = np.cumsum(used) - 1
    return Mesh(mesh.vertices[used], number[mesh.faces])


def remove_unreferenced(mesh: Mesh) -> tuple[Mesh, list[Action]]:
    """Remove the vertices that no face uses."""
    smaller = compact(mesh)
    count = len(mesh.vertices) - len(smaller.vertices)
    if not count:
        return mesh, []
    return smaller, [{"step": "clean", "message": f"{count} unused vertices removed", "count": count, "places": []}]


def remove_collapsed(mesh: Mesh) -> tuple[Mesh, list[Action]]:
    """Remove the faces that use a vertex twice; nothing opens, as such a face has no area and at most one edge."""
    collapsed = (mesh.faces == mesh.faces[:, [1, 2, 0]]).any(axis=1)
    return _without(mesh, collapsed, "collapsed faces removed")


def _without(mesh: Mesh, drop: NDArray[np.bool_], message: str) -> tuple[Mesh, list[Action]]:
    chosen = np.flatnonzero(drop)
    if not len(chosen):
        return mesh, []
    areas = face_areas(mesh)[chosen]
    largest = np.argsort(-areas, kind="stable")[:MAX_PLACES]
    action: Action = {
        "step": "clean",
        "message": f"{len(chosen)} {message}",
        "count": len(chosen),
        "places": at_faces(mesh, chosen[largest], np.sqrt(areas[largest])),
        "area_mm2": float(areas.sum()),
    }
    return Mesh(mesh.vertices, mesh.faces[~drop]), [action]


def weld_soup(mesh: Mesh) -> tuple[Mesh, list[Action]]:
    """Weld vertices that lie almost on each other, if the faces are hardly joined at all.

    Of a row of growing tolerances, that is taken from which on no larger one closes many more edges. None of them
    may exceed 30 % of a short edge, so no face of ordinary size collapses.
    """
    open_edges, crowded = _flawed_edges(mesh)
    if open_edges <= SOUP_SHARE * mesh.faces.size:
        return mesh, []
    sides = np.linalg.norm(mesh.vertices[mesh.faces] - mesh.vertices[np.roll(mesh.faces, 1, axis=1)], axis=2)
    sides = sides[sides > 0]
    longest = _WELD_EDGE_SHARE * float(np.quantile(sides, 0.02)) if len(sides) else 0.0
    best, best_score, best_tolerance = mesh, open_edges + 10 * crowded, 0.0
    for tolerance in np.array(_WELD_STEPS) * diagonal(mesh):
        if tolerance > longest:
            break
        vertices, index = weld(mesh.vertices, float(tolerance))
        trial, _ = remove_collapsed(Mesh(vertices, index[mesh.faces]))
        left, crowded = _flawed_edges(trial)
        if left + 10 * crowded < _WELD_GAIN * best_score:
            best, best_score, best_tolerance = trial, left + 10 * crowded, float(tolerance)
    if best is mesh:
        return mesh, []
    merged = len(mesh.vertices) - len(best.vertices)
    message = f"{merged} vertices welded that lay within {best_tolerance:.2g} mm of another one"
    return best, [{"step": "weld", "message": message, "count": merged, "places": []}]


def _flawed_edges(mesh: Mesh) -> tuple[int, int]:
    """Count the edges with one face, and those with more than two."""
    glued, crowds = mates(mesh.faces, len(mesh.vertices))
    return int((glued == BOUNDARY).sum()), len(crowds)


def remove_duplicates(mesh: Mesh) -> tuple[Mesh, list[Action]]:
    """Remove faces that others lie on, with the same three vertices.

    One of several equal faces is kept. Where as many face one way as the other, they bound no volume: all go, if
    that leaves fewer open and non-manifold edges around the whole patch of such faces than if one is kept, and
    unless the patch is most of the mesh (a sheet that was meshed on both sides).
    """
    ordered = np.sort(mesh.faces, axis=1)
    _, first, group, count = np.unique(ordered, axis=0, return_index=True, return_inverse=True, return_counts=True)
    group = group.reshape(-1)
    if (count == 1).all():
        return mesh, []
    several = np.flatnonzero(count > 1)
    ways = np.bincount(group, _way(mesh.faces), minlength=len(count))
    balanced = several[ways[several] == 0]
    dropped_groups = balanced[_better_gone(mesh, first[balanced], count[balanced])]
    drop = np.ones(len(mesh.faces), np.bool_)
    drop[first] = False
    drop[first[dropped_groups]] = True
    # Of an odd number of faces the one kept must face the way of the majority.
    keeper = first.copy()
    for member in np.flatnonzero(np.isin(group, several[ways[several] != 0])):
        if _way(mesh.faces[member : member + 1])[0] * ways[group[member]] > 0 and drop[member]:
            kept = keeper[group[member]]
            if _way(mesh.faces[kept : kept + 1])[0] * ways[group[member]] < 0:
                drop[kept], drop[member] = True, False
                keeper[group[member]] = member
    return _without(mesh, drop, "double faces removed")


def _way(faces: NDArray[np.int32]) -> NDArray[np.float64]:
    """Return 1 for faces that name their vertices in an even permutation of ascending order, else -1."""
    a, b, c = faces.T
    return np.where((a < b) ^ (b < c) ^ (a < c), 1.0, -1.0)


def _better_gone(mesh: Mesh, faces: NDArray[np.int64], count: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Tell for groups of faces on each other, named by one of them, whether none of them should be kept."""
    if not len(faces):
        return np.zeros(0, np.bool_)
    sheet = mesh.faces[faces]
    patch = topology(mesh.vertices, sheet).component
    n_patches = int(patch.max()) + 1
    n_vertices = len(mesh.vertices)
    all_keys, totals = np.unique(edge_keys(mesh.faces, n_vertices), return_counts=True)
    keys, own = np.unique(edge_keys(sheet, n_vertices), return_inverse=True)
    own = own.reshape(-1)
    taken = np.bincount(own, np.repeat(count, 3))
    others = totals[np.searchsorted(all_keys, keys)] - taken.astype(np.int64)
    once = others + np.bincount(own)
    # Every edge of the sheet belongs to one patch, for they are joined by edges.
    patch_of = np.zeros(len(keys), np.int64)
    patch_of[own] = np.repeat(patch, 3)
    flaws_without = np.bincount(patch_of, (others == 1) | (others > 2), minlength=n_patches)
    flaws_with = np.bincount(patch_of, (once == 1) | (once > 2), minlength=n_patches)
    areas = face_areas(mesh)
    share = np.bincount(patch, areas[faces] * count, minlength=n_patches) / max(float(areas.sum()), 1e-300)
    gone: NDArray[np.bool_] = ((flaws_without < flaws_with) & (share < 0.5))[patch]
    return gone


def flip_flat(mesh: Mesh) -> tuple[Mesh, list[Action]]:
    """Take out faces without area by flipping their longest edge.

    Such a face is a needle on the long edge of its neighbour, with its third vertex on that edge: after the flip the
    neighbour is cut at that vertex, and the surface lies where it was. Left alone if no neighbour has the room.
    """
    total = 0
    places: list[int] = []
    faces = mesh.faces.copy()
    for _ in range(_MOST_FLIP_ROUNDS):
        component = np.zeros(len(faces), np.int32)
        flat = quality(mesh.vertices, faces, component, 1).degenerate
        if not len(flat):
            break
        done = _flip_each(mesh.vertices, faces, flat)
        if not done:
            break
        total += len(done)
        places += done
    if not total:
        return mesh, []
    flipped = Mesh(mesh.vertices, faces)
    message = f"{total} faces without area removed by flipping an edge"
    return flipped, [
        {"step": "clean", "message": message, "count": total, "places": at_faces(flipped, places[:MAX_PLACES])}
    ]


def _flip_each(vertices: NDArray[np.float64], faces: NDArray[np.int32], flat: NDArray[np.int32]) -> list[int]:
    """Flip the longest edge of faces without area, in place; returns the faces that were flipped."""
    glued, _ = mates(faces, len(vertices))
    known = set(np.unique(edge_keys(faces, len(vertices))).tolist())
    touched: set[int] = set()
    done = []
    for face in flat.tolist():
        corners = vertices[faces[face]]
        k = int(np.argmax(np.linalg.norm(corners - np.roll(corners, -1, axis=0), axis=1)))
        mate = int(glued[face, k])
        other, m = divmod(mate, 3)
        if mate < 0 or face in touched or other in touched or faces[face, k] == faces[other, m]:
            continue
        a, b, tip = (int(faces[face, (k + i) % 3]) for i in range(3))
        far = int(faces[other, (m + 2) % 3])
        key = min(tip, far) * len(vertices) + max(tip, far)
        if far == tip or key in known:
            continue
        fresh = np.array([[a, far, tip], [far, b, tip]], np.int32)
        u, v = (vertices[fresh[:, i]] - vertices[fresh[:, 0]] for i in (1, 2))
        longest = np.maximum((u * u).sum(axis=1), (v * v).sum(axis=1))
        if (np.linalg.norm(np.cross(u, v), axis=1) <= 1e-11 * longest).any():
            continue
        faces[face], faces[other] = fresh
        known.add(key)
        # The faces around change their neighbours, not their own edges.
        touched |= {face, other, *(int(h) // 3 for f in (face, other) for h in glued[f] if h >= 0)}
        done.append(face)
    return done


def remove_specks(mesh: Mesh, min_component: float | None = None) -> tuple[Mesh, list[Action]]:
    """Remove the components that are too small to be meant, and faces that are joined to no other.

    Parameters
    ----------
    mesh
        Any mesh without collapsed faces.
    min_component
        Smallest diagonal of a component's box in mm; None: 0.2 % of that of the mesh.

    Returns
    -------
    mesh, actions
        One action for every component that was removed. The largest component always stays.
    """
    components = topology(mesh.vertices, mesh.faces).component
    if not len(components) or components.max() <= 0:
        return mesh, []
    limit = SPECK_SHARE * diagonal(mesh) if min_component is None else min_component
    sizes = component_diagonals(mesh, components)
    specks = (sizes < limit) | (np.bincount(components) == 1)
    specks[np.argmax(sizes)] = False
    if not specks.any():
        return mesh, []
    drop = specks[components]
    areas = face_areas(mesh)
    actions: list[Action] = []
    for speck in np.flatnonzero(specks):
        own = np.flatnonzero(components == speck)
        plural = "" if len(own) == 1 else "s"
        actions.append(
            {
                "step": "clean",
                "message": f"a separate part of {len(own)} face{plural}, {sizes[speck]:.3g} mm across, removed",
                "count": len(own),
                "places": at_faces(mesh, own[:1], sizes[speck : speck + 1]),
                "area_mm2": float(areas[own].sum()),
            }
        )
    return Mesh(mesh.vertices, mesh.faces[~drop]), actions


def remove_plugs(mesh: Mesh, thickness: float) -> tuple[Mesh, list[Action]]:
    """Remove closed components that are thinner than what the file can hold, as exact cuts leave them behind.

    Parameters
    ----------
    mesh
        Closed and oriented.
    thickness
        Three times volume over area, the radius of a ball, below which a component is removed, in mm.

    Returns
    -------
    mesh, actions
        One action for every component that was removed. The largest component always stays.
    """
    found = topology(mesh.vertices, mesh.faces)
    if found.n_components <= 1:
        return mesh, []
    measured = quality(mesh.vertices, mesh.faces, found.component, found.n_components)
    thin = 3 * np.abs(measured.component_volume) < thickness * measured.component_area
    thin[np.argmax(measured.component_area)] = False
    if not thin.any():
        return mesh, []
    sizes = component_diagonals(mesh, found.component)
    actions: list[Action] = []
    for plug in np.flatnonzero(thin):
        own = np.flatnonzero(found.component == plug)
        actions.append(
            {
                "step": "clean",
                "message": f"a separate part of next to no thickness, {sizes[plug]:.3g} mm across, removed",
                "count": len(own),
                "places": at_faces(mesh, own[:1], sizes[plug : plug + 1]),
                "area_mm2": float(measured.component_area[plug]),
                "volume_mm3": -float(abs(measured.component_volume[plug])),
            }
        )
    return compact(Mesh(mesh.vertices, mesh.faces[~thin[found.component]])), actions


def component_diagonals(mesh: Mesh, components: NDArray[np.int32]) -> NDArray[np.float64]:
    """Return the diagonal of the box around each component, in mm.

    Parameters
    ----------
    mesh
        The mesh.
    components : (F,) int32
        Component of each face, all numbers up to the largest in use.
    """
    order = np.argsort(components, kind="stable")
    starts = np.searchsorted(components[order], np.arange(int(components.max()) + 1))
    corners = mesh.vertices[mesh.faces[order]]
    lower = np.minimum.reduceat(corners.min(axis=1), starts, axis=0)
    upper = np.maximum.reduceat(corners.max(axis=1), starts, axis=0)
    sizes: NDArray[np.float64] = np.linalg.norm(upper - lower, axis=1)
    return sizes
