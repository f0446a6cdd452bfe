"""Join the sheets of a wall: where a hollow organ or vessel was cut, its outer and inner surface end in two loops."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vhp_cli.inspection.places import point
from vhp_cli.kernels.repairing import BandMethod, FillMethod, fill_band, fill_loop
from vhp_cli.kernels.surface import topology
from vhp_cli.measures import Action
from vhp_cli.mesh import Mesh
from vhp_cli.stages.heal.holes import Cap, CapCheck, Hole, append_caps, best_caps, cap_area, holes

# When two loops may be the rims of one wall; lengths in mean radii of the outer loop.
_MOST_ASIDE = 0.6  # of the centres, across the normal, unless the inner loop lies within the outer one
_MOST_AHEAD = 0.8  # of the centres, along the normal
_LEAST_COSINE = 0.7  # of the angle between the planes
_MOST_GAP = 0.75  # mean distance of the inner loop's vertices from the outer loop
_MOST_AREA = 1.05  # area of the inner loop over that of the outer one
# Corners tried to begin a band with.
_STARTS = 12
_METHODS: tuple[BandMethod, ...] = ("length", "area")
_BRIDGED_METHODS: tuple[FillMethod, ...] = ("angle", "area")

# An outer loop and the inner ones within it, by their places in the list of holes.
_Rim = tuple[int, tuple[int, ...]]


def join_walls(mesh: Mesh) -> tuple[Mesh, list[Action]]:
    """Close the rims of walls by bands between their outer and their inner loops.

    Loops belong together if they are nearly concentric, nearly parallel and nearly as wide, the nearest ones first;
    or if several of one component lie in the plane of a larger one and within it, as at the fork of a vessel. If
    they belong to different components, the inner one is turned so that its faces look into the lumen. A band is
    made only where it meets nothing, or where it meets less than caps would, as in a wall that crosses itself.

    Parameters
    ----------
    mesh
        Oriented: each component outward as if it were closed.

    Returns
    -------
    mesh, actions
        One action for each rim; the same mesh if there is none.
    """
    found = holes(mesh)
    rims = _rims(mesh, found)
    if not rims:
        return mesh, []
    components = topology(mesh.vertices, mesh.faces).component
    turned = _inner_sheets(found, rims)
    lining = np.isin(components, sorted(turned))
    trial = Mesh(mesh.vertices, np.where(lining[:, None], mesh.faces[:, ::-1], mesh.faces))
    loops = [_turned(hole) if hole.component in turned else hole for hole in found]
    rims = [(i, inner) for i, inner in rims if all(loops[i].normal @ loops[j].normal < 0 for j in inner)]
    check = CapCheck(trial)
    bands: list[Cap | None] = [None] * len(rims)
    hits = [0] * len(rims)
    for attempt in range(len(_METHODS)):
        others = [
            _band(trial, loops, rim, attempt) if band is None or met else None
            for rim, band, met in zip(rims, bands, hits, strict=True)
        ]
        for number, met in enumerate(check.hits(others)):
            if others[number] is not None and (bands[number] is None or met < hits[number]):
                bands[number], hits[number] = others[number], met
    kept = [
        number
        for number, (band, met) in enumerate(zip(bands, hits, strict=True))
        if band is not None and (not met or met < _cap_hits(mesh, found, rims[number]))
    ]
    if not kept:
        return mesh, []
    # A lining that was not joined to anything is turned back.
    joined = {loops[side].component for number in kept for side in rims[number][1]}
    lining &= np.isin(components, sorted(joined))
    mesh = Mesh(mesh.vertices, np.where(lining[:, None], mesh.faces[:, ::-1], mesh.faces))
    vertices, fresh = append_caps(mesh, [bands[number] for number in kept])
    actions = [_report(mesh, loops, rims[number], bands[number], hits[number]) for number in kept]
    return Mesh(vertices, np.concatenate([mesh.faces, fresh])), actions


def _rims(mesh: Mesh, found: list[Hole]) -> list[_Rim]:
    """Return which loops bound walls; each loop once at most."""
    near, opposite = _near(found)
    taken: set[int] = set()
    rims: list[_Rim] = []
    # Forks first: one of their lumens alone would look like the inner rim of the whole.
    for i in np.argsort([-hole.area_mm2 for hole in found], kind="stable").tolist():
        if i in taken:
            continue
        inner = tuple(
            j
            for j in np.flatnonzero(near[i] & opposite[i]).tolist()
            if j not in taken and found[i].component == found[j].component and _surrounds(mesh, found[i], found[j])
        )
        if len(inner) > 1 and sum(found[j].area_mm2 for j in inner) < found[i].area_mm2:
            rims.append((i, inner))
            taken |= {i, *inner}
    candidates = []
    for i, j in np.argwhere(near).tolist():
        if not taken & {i, j} and (gap := _gap(mesh, found[i], found[j])) is not None:
            candidates.append((gap, i, j))
    for _, i, j in sorted(candidates):
        if not taken & {i, j}:
            rims.append((i, (j,)))
            taken |= {i, j}
    return rims


def _near(found: list[Hole]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Tell of all pairs of loops whether the second can lie in the first, and whether they run opposite ways round."""
    centres = np.array([hole.centre for hole in found]).reshape(-1, 3)
    normals = np.array([hole.normal for hole in found]).reshape(-1, 3)
    lengths = np.array([hole.length_mm for hole in found])
    areas = np.array([hole.area_mm2 for hole in found])
    cosine = normals @ normals.T
    near = (np.abs(cosine) >= _LEAST_COSINE) & (areas[None] <= _MOST_AREA * areas[:, None])
    # No two points within a loop are farther apart than half its length.
    near &= np.linalg.norm(centres[:, None] - centres[None], axis=2) <= lengths[:, None] / 2
    np.fill_diagonal(near, False)
    return near, cosine < 0


def _surrounds(mesh: Mesh, outer: Hole, inner: Hole) -> bool:
    """Tell whether a loop lies near the plane of another one and, projected into it, within it."""
    arms = mesh.vertices[inner.loop] - outer.centre
    if np.abs(arms @ outer.normal).max() > _MOST_ASIDE * outer.length_mm / (2 * np.pi):
        return False
    # Each vertex of the inner loop sees the outer one all the way round.
    ring = mesh.vertices[outer.loop] - outer.centre
    ring = ring - np.outer(ring @ outer.normal, outer.normal)
    for arm in arms - np.outer(arms @ outer.normal, outer.normal):
        a, b = ring - arm, np.roll(ring, -1, axis=0) - arm
        angle = np.arctan2(np.cross(a, b) @ outer.normal, (a * b).sum(axis=1)).sum()
        if abs(angle) < np.pi:
            return False
    return True


def _gap(mesh: Mesh, outer: Hole, inner: Hole) -> float | None:
    """Return the mean distance of two near loops, in mean radii of the outer one, if they can be rims of one wall."""
    radius = outer.length_mm / (2 * np.pi)
    offset = inner.centre - outer.centre
    ahead = abs(float(offset @ outer.normal))
    aside = float(np.linalg.norm(offset - (offset @ outer.normal) * outer.normal))
    if ahead > _MOST_AHEAD * radius or (aside > _MOST_ASIDE * radius and not _surrounds(mesh, outer, inner)):
        return None
    gap = _mean_distance(mesh.vertices[inner.loop], mesh.vertices[outer.loop])
    if gap > _MOST_GAP * radius or (outer.component == inner.component and not _is_deep(mesh, outer, inner, gap)):
        return None
    return gap / radius


def _mean_distance(points: NDArray[np.float64], loop: NDArray[np.float64]) -> float:
    """Return the mean distance of points from a closed polygon."""
    sides = np.roll(loop, -1, axis=0) - loop
    squares = np.maximum((sides * sides).sum(axis=1), 1e-300)
    total = 0.0
    for xyz in points:
        along = np.clip(((xyz - loop) * sides).sum(axis=1) / squares, 0, 1)
        total += float(np.linalg.norm(loop + along[:, None] * sides - xyz, axis=1).min())
    return total / len(points)


def _is_deep(mesh: Mesh, outer: Hole, inner: Hole, gap: float) -> bool:
    """Tell whether the component of two loops is a wall between them, not a short tube of which they are the ends.

    A short tube lies between its ends; a wall leads away from both rims and back.
    """
    if outer.normal @ inner.normal >= 0:
        return False
    component = topology(mesh.vertices, mesh.faces).component == outer.component
    depth = (outer.centre - mesh.vertices[np.unique(mesh.faces[component])]) @ outer.normal
    return float(depth.max()) > 2 * max(gap, abs(float((outer.centre - inner.centre) @ outer.normal)))


def _inner_sheets(found: list[Hole], rims: list[_Rim]) -> set[int]:
    """Return the components that line another one and face the wrong way."""
    votes: dict[int, int] = {}
    for i, inner in rims:
        for j in inner:
            if found[i].component != found[j].component:
                vote = 1 if found[i].normal @ found[j].normal > 0 else -1
                votes[found[j].component] = votes.get(found[j].component, 0) + vote
    outer = {found[i].component for i, _ in rims}
    return {component for component, balance in votes.items() if balance > 0 and component not in outer}


def _turned(hole: Hole) -> Hole:
    return replace(hole, loop=hole.loop[::-1].copy(), normal=-hole.normal)


def _band(mesh: Mesh, loops: list[Hole], rim: _Rim, attempt: int) -> Cap | None:
    """Return the band between an outer loop and inner ones that run the opposite way round."""
    outer, inner = loops[rim[0]].loop, [loops[j].loop for j in rim[1]]
    if len(inner) > 1:
        return _bridged(mesh, outer, inner, _BRIDGED_METHODS[attempt])
    opposite = inner[0][::-1]
    a, b = mesh.vertices[outer], mesh.vertices[opposite]
    starts = np.argsort(np.linalg.norm(b - a[0], axis=1), kind="stable")[:_STARTS].astype(np.int32)
    faces = np.concatenate([outer, opposite])[fill_band(a, b, starts, _METHODS[attempt])]
    return Cap(faces, np.empty((0, 3)))


def _bridged(mesh: Mesh, outer: NDArray[np.int32], inner: list[NDArray[np.int32]], method: FillMethod) -> Cap | None:
    """Triangulate what is between an outer loop and several inner ones: cut open along the shortest bridges."""
    loop, left = outer, list(inner)
    while left:
        lengths = [np.linalg.norm(mesh.vertices[loop][:, None] - mesh.vertices[own][None], axis=2) for own in left]
        nearest = min(range(len(left)), key=lambda number: float(lengths[number].min()))
        here, there = divmod(int(lengths[nearest].argmin()), len(left[nearest]))
        own = np.roll(left.pop(nearest), -there)
        loop = np.concatenate([loop[: here + 1], own, own[:1], loop[here:]])
    # A corner that occurs twice must not be joined to itself.
    same = np.argwhere(np.triu(loop[:, None] == loop[None], 1)).astype(np.int32)
    faces = fill_loop(mesh.vertices[loop], np.full((len(loop), 3), np.nan), same, method)
    return None if faces is None else Cap(loop[faces], np.empty((0, 3)))


def _cap_hits(mesh: Mesh, found: list[Hole], rim: _Rim) -> int:
    """Count what the loops of a rim would meet if each were closed by a cap of its own."""
    return sum(best_caps(mesh, [found[side] for side in (rim[0], *rim[1])])[1])


def _report(mesh: Mesh, loops: list[Hole], rim: _Rim, band: Cap | None, met: int) -> Action:
    outer = loops[rim[0]]
    inner = " and ".join(f"{loops[j].length_mm:.3g}" for j in rim[1])
    message = f"the rim of a wall closed between a loop of {outer.length_mm:.3g} mm and {inner} mm within it"
    if met:
        message += f"; it meets {met} other faces"
    return {
        "step": "walls",
        "message": message,
        "count": 1,
        "places": [{"xyz_mm": point(outer.centre), "face": outer.face, "value": outer.length_mm}],
        "area_mm2": 0.0 if band is None else cap_area(mesh, band),
    }
