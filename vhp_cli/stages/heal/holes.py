"""Find the openings of a surface and close them by caps that do not cross it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vhp_cli.inspection.places import point
from vhp_cli.kernels.repairing import FillMethod, fill_loop, mates
from vhp_cli.kernels.spatial import Tree
from vhp_cli.kernels.surface import topology
from vhp_cli.measures import Action
from vhp_cli.mesh import Mesh
from vhp_cli.rounding import rounded

# Root mean square distance of a loop from its plane, over its length, up to which a cap is first tried in that plane.
_NEAR_PLANE = 0.02
# Ways to close a hole, in the order in which they are tried; the last is a fan about a new vertex in the middle.
_METHODS: tuple[FillMethod, ...] = ("angle", "plane", "area")
_METHODS_IN_PLANE: tuple[FillMethod, ...] = ("plane", "angle", "area")
_MOST_CAPS = len(_METHODS) + 1
# Pairs of faces listed when caps are checked; if a surface has more, those beyond do not speak against a cap.
_MOST_PAIRS = 200_000


@dataclass(frozen=True, slots=True, eq=False)
class Hole:
    """An opening, bounded by one simple loop of edges.

    Parameters
    ----------
    loop : (n,) int32
        Its vertices, in the direction in which the faces of a cap run along them.
    component
        Component of the mesh that the loop bounds, as `kernels.surface.topology` numbers them.
    face
        A face beside the loop.
    length_mm
        Around the loop.
    area_mm2
        Area of the loop as seen along its normal, the least that a cap can have.
    planarity
        Root mean square distance of its vertices from the plane through their mean, over its length.
    centre : (3,) float64
        Mean of the loop, in mm.
    normal : (3,) float64
        Unit normal of a cap; zero if the loop has no area.
    """

    loop: NDArray[np.int32]
    component: int
    face: int
    length_mm: float
    area_mm2: float
    planarity: float
    centre: NDArray[np.float64]
    normal: NDArray[np.float64]

    @property
    def edges(self) -> int:
        """Number of edges of the loop."""
        return len(self.loop)


@dataclass(frozen=True, slots=True, eq=False)
class Cap:
    """Faces that close a hole.

    Parameters
    ----------
    faces : (n, 3) int32
        Indices from the number of vertices of the mesh on mean `points`.
    points : (k, 3) float64
        New vertices in mm.
    """

    faces: NDArray[np.int32]
    points: NDArray[np.float64]


def holes(mesh: Mesh) -> list[Hole]:
    """Describe the openings of a mesh.

    Where a loop passes through a vertex twice it is cut into two there. Edges that lead nowhere, as they do if the
    faces are not oriented coherently, belong to no hole.

    Parameters
    ----------
    mesh
        Oriented coherently, without collapsed faces.

    Returns
    -------
    list of Hole
        In the order of their lowest half-edges.
    """
    glued, _ = mates(mesh.faces, len(mesh.vertices))
    face, k = np.nonzero(glued < 0)
    if not len(face):
        return []
    start, end = mesh.faces[face, (k + 1) % 3], mesh.faces[face, k]
    component = topology(mesh.vertices, mesh.faces).component
    return [
        _describe(mesh, np.array([start[e] for e in chain], np.int32), int(face[chain[0]]), component)
        for chain in _simple_loops(start.tolist(), end.tolist())
    ]


def _simple_loops(start: list[int], end: list[int]) -> list[list[int]]:
    """Chain directed edges into loops that pass through no vertex twice; returns the numbers of their edges."""
    leaving: dict[int, list[int]] = {}
    for edge in range(len(start) - 1, -1, -1):
        leaving.setdefault(start[edge], []).append(edge)
    loops = []
    for seed in range(len(start)):
        if not (leaving[start[seed]] and leaving[start[seed]][-1] == seed):
            continue
        chain: list[int] = []
        position = {start[seed]: 0}  # of each vertex on the way, the length of the chain up to it
        vertex = start[seed]
        while leaving.get(vertex):
            edge = leaving[vertex].pop()
            chain.append(edge)
            vertex = end[edge]
            if vertex in position:
                begin = position[vertex]
                loop, chain = chain[begin:], chain[:begin]
                for passed in loop[1:]:
                    del position[start[passed]]
                if len(loop) > 2:
                    loops.append(loop)
            else:
                position[vertex] = len(chain)
    return sorted(loops, key=min)


def _describe(mesh: Mesh, loop: NDArray[np.int32], face: int, component: NDArray[np.int32]) -> Hole:
    points = mesh.vertices[loop]
    centre = points.mean(axis=0)
    arms = points - centre
    length = float(np.linalg.norm(points - np.roll(points, -1, axis=0), axis=1).sum())
    area = np.cross(arms, np.roll(arms, -1, axis=0)).sum(axis=0) / 2
    size = float(np.linalg.norm(area))
    # Smallest eigenvalue of the covariance: mean square distance from the best plane through the mean.
    spread = np.linalg.eigvalsh(arms.T @ arms / len(loop))[0]
    return Hole(
        loop=loop,
        component=int(component[face]),
        face=face,
        length_mm=length,
        area_mm2=size,
        planarity=float(np.sqrt(max(spread, 0.0))) / length if length else 0.0,
        centre=centre,
        normal=area / size if size else area,
    )


def fill_holes(mesh: Mesh, which: Iterable[Hole] | None = None) -> tuple[Mesh, list[Action], NDArray[np.bool_]]:
    """Close openings.

    Each cap is checked against the surface and the other caps with exact predicates; if it meets them, other
    triangulations are tried, and the one that meets least is taken.

    Parameters
    ----------
    mesh
        Oriented coherently, without collapsed faces.
    which
        The holes to close, from `holes` of the same mesh; None: all.

    Returns
    -------
    mesh, actions
        One action for each hole, in their order; its message tells of caps that meet the surface. `value` of its
        place is the length around the hole.
    caps : (F,) bool
        True for the faces of caps.
    """
    chosen = holes(mesh) if which is None else list(which)
    if not chosen:
        return mesh, [], np.zeros(len(mesh.faces), np.bool_)
    caps, hits = best_caps(mesh, chosen)
    return _closed(mesh, chosen, caps, hits)


def best_caps(mesh: Mesh, chosen: list[Hole]) -> tuple[list[Cap | None], list[int]]:
    """Return the caps that `fill_holes` would take, and the number of faces pairs in which each meets the rest.

    Parameters
    ----------
    mesh
        Oriented coherently, without collapsed faces.
    chosen
        Holes of this mesh.
    """
    capping, check = _Capping(mesh, chosen), CapCheck(mesh)
    caps = [capping.next_cap(number) for number in range(len(chosen))]
    hits = check.hits(caps)
    # All caps that meet something are exchanged together, so that the surface is checked once in a round.
    for _ in range(_MOST_CAPS):
        trial = list(caps)
        for number in np.flatnonzero(hits).tolist():
            trial[number] = capping.next_cap(number) or caps[number]
        changed = [number for number in range(len(chosen)) if trial[number] is not caps[number]]
        if not changed:
            break
        found = check.hits(trial)
        worse = [number for number in changed if found[number] >= hits[number]]
        for number in worse:
            trial[number] = caps[number]
        caps = trial
        hits = check.hits(caps) if worse else found
    return caps, hits


class _Capping:
    """The caps that can close the holes of a mesh.

    Parameters
    ----------
    mesh
        The mesh.
    chosen
        The holes to be closed.
    """

    def __init__(self, mesh: Mesh, chosen: list[Hole]) -> None:
        self.mesh = mesh
        self.chosen = chosen
        self._attempts = [0] * len(chosen)
        # Edges of the cap now in each hole, if both ends are in another one too.
        self._chords: dict[int, NDArray[np.int64]] = {}
        n_vertices = len(mesh.vertices)
        loops = np.concatenate([hole.loop for hole in chosen])
        self._is_shared = np.bincount(loops, minlength=n_vertices) > 1
        glued, _ = mates(mesh.faces, n_vertices)
        face, k = np.nonzero(glued < 0)
        keys = mesh.faces[face, (k + 1) % 3].astype(np.int64) * n_vertices + mesh.faces[face, k]
        order = np.argsort(keys, kind="stable")
        a, b, c = (mesh.vertices[mesh.faces[face, i]] for i in range(3))
        self._border_keys = keys[order]
        self._rim_normals = np.cross(b - a, c - a)[order]
        on_border = np.zeros(n_vertices, np.bool_)
        on_border[mesh.faces[face, k]] = on_border[mesh.faces[face, (k + 1) % 3]] = True
        start, end = mesh.faces, np.roll(mesh.faces, -1, axis=1)
        between = on_border[start] & on_border[end]
        self._joined = np.stack([start[between], end[between]], axis=1).astype(np.int64)
        self._position = np.full(n_vertices, -1)

    def next_cap(self, number: int) -> Cap | None:
        """Return the next cap to try for a hole; None if there is no more."""
        hole = self.chosen[number]
        methods = _METHODS_IN_PLANE if hole.planarity < _NEAR_PLANE else _METHODS
        while self._attempts[number] < _MOST_CAPS:
            attempt = self._attempts[number]
            self._attempts[number] += 1
            cap = self._fan(hole) if attempt == len(methods) else self._triangulated(number, hole, methods[attempt])
            if hole.edges == 3:
                self._attempts[number] = _MOST_CAPS
                if self._is_loose_face(hole):
                    cap = None
            if cap is not None:
                chords = np.stack([cap.faces, np.roll(cap.faces, -1, axis=1)], axis=2).reshape(-1, 2)
                chords = chords[(chords < len(self.mesh.vertices)).all(axis=1)]
                self._chords[number] = chords[self._is_shared[chords].all(axis=1)].astype(np.int64)
                return cap
        return None

    def _fan(self, hole: Hole) -> Cap:
        after, tip = np.roll(hole.loop, -1), np.full(hole.edges, len(self.mesh.vertices), np.int32)
        # What is written is float32.
        centre = rounded(hole.centre)
        return Cap(np.stack([hole.loop, after, tip], axis=1), centre[None, :])

    def _triangulated(self, number: int, hole: Hole, method: FillMethod) -> Cap | None:
        n_vertices = len(self.mesh.vertices)
        keys = hole.loop.astype(np.int64) * n_vertices + np.roll(hole.loop, -1)
        rims = self._rim_normals[np.searchsorted(self._border_keys, keys)]
        faces = fill_loop(self.mesh.vertices[hole.loop], rims, self._banned(number, hole), method)
        return None if faces is None else Cap(hole.loop[faces], np.empty((0, 3)))

    def _is_loose_face(self, hole: Hole) -> bool:
        """Tell whether a hole is the back of one face that is joined to no other."""
        return bool(np.isin(self.mesh.faces[hole.face], hole.loop).all())

    def _banned(self, number: int, hole: Hole) -> NDArray[np.int32]:
        """Return the pairs of corners of a hole that an edge of the mesh or of another cap joins already."""
        self._position[hole.loop] = np.arange(hole.edges)
        others = [chords for other, chords in self._chords.items() if other != number and len(chords)]
        pairs = np.concatenate([self._joined, *others])
        corners = self._position[pairs]
        self._position[hole.loop] = -1
        corners = corners[(corners >= 0).all(axis=1)]
        apart = np.abs(corners[:, 0] - corners[:, 1])
        banned: NDArray[np.int32] = corners[(apart > 1) & (apart < hole.edges - 1)].astype(np.int32)
        return banned


class CapCheck:
    """Exact test of caps against the mesh that they are to close.

    Parameters
    ----------
    mesh
        The mesh.
    """

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh
        corners = mesh.vertices[mesh.faces]
        self._lower, self._upper = corners.min(axis=1), corners.max(axis=1)

    def hits(self, caps: list[Cap | None]) -> list[int]:
        """Count for each cap the pairs of faces in which it meets the mesh, itself or another cap."""
        vertices, fresh = append_caps(self.mesh, caps)
        if not len(fresh):
            return [0] * len(caps)
        owner = np.repeat(np.arange(len(caps)), [0 if cap is None else len(cap.faces) for cap in caps])
        # Only faces whose box meets that of a cap can meet the cap.
        corners, starts = vertices[fresh], np.unique(owner, return_index=True)[1]
        lowers = np.minimum.reduceat(corners.min(axis=1), starts, axis=0)
        uppers = np.maximum.reduceat(corners.max(axis=1), starts, axis=0)
        near = np.zeros(len(self.mesh.faces), np.bool_)
        for lower, upper in zip(lowers, uppers, strict=True):
            near |= ((self._lower <= upper) & (self._upper >= lower)).all(axis=1)
        owner = np.concatenate([np.full(near.sum(), -1), owner])
        found = Tree(vertices, np.concatenate([self.mesh.faces[near], fresh])).self_hits(_MOST_PAIRS)
        first, second = owner[found.pairs[:, 0]], owner[found.pairs[:, 1]]
        counts = np.bincount(first[first >= 0], minlength=len(caps))
        counts += np.bincount(second[(second >= 0) & (second != first)], minlength=len(caps))
        return [int(count) for count in counts]


def append_caps(mesh: Mesh, caps: list[Cap | None]) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return the vertices of the mesh and of all caps, and the faces of the caps that refer to them."""
    n_vertices = count = len(mesh.vertices)
    vertices, faces = [mesh.vertices], [np.empty((0, 3), np.int32)]
    for cap in caps:
        if cap is not None:
            faces.append(np.where(cap.faces >= n_vertices, cap.faces + (count - n_vertices), cap.faces))
            vertices.append(cap.points)
            count += len(cap.points)
    return np.concatenate(vertices), np.concatenate(faces).astype(np.int32)


def _closed(
    mesh: Mesh, chosen: list[Hole], caps: list[Cap | None], hits: list[int]
) -> tuple[Mesh, list[Action], NDArray[np.bool_]]:
    vertices, fresh = append_caps(mesh, caps)
    actions: list[Action] = []
    for hole, cap, met in zip(chosen, caps, hits, strict=True):
        message = f"a hole of {hole.edges} edges, {hole.length_mm:.3g} mm around, "
        area = 0.0
        if cap is None:
            message += "can't be closed: its corners are joined by edges already"
        else:
            area = cap_area(mesh, cap)
            shape = f"{100 * hole.planarity:.2g} % off a plane" if hole.planarity > 1e-4 else "plane"
            message += f"closed by {area:.3g} mm2 ({shape})"
            if met:
                message += f"; the cap meets {met} other faces"
        actions.append(
            {
                "step": "holes",
                "message": message,
                "count": 0 if cap is None else 1,
                "places": [{"xyz_mm": point(hole.centre), "face": hole.face, "value": hole.length_mm}],
                "area_mm2": area,
            }
        )
    is_cap = np.arange(len(mesh.faces) + len(fresh)) >= len(mesh.faces)
    return (Mesh(vertices, np.concatenate([mesh.faces, fresh])) if len(fresh) else mesh), actions, is_cap


def cap_area(mesh: Mesh, cap: Cap) -> float:
    """Return the area of a cap in mm2."""
    a, b, c = (np.concatenate([mesh.vertices, cap.points])[cap.faces[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) / 2
