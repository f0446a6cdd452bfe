"""Made defects: clean shapes of known truth, and what was done to them.

Everything is seeded by the name of the case, so a case is the same in every run, whichever others are made.
Unions that serve as truth are computed by manifold3d, exactly up to rounding; cases whose truth no library can
tell have none.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from vhp_cli.mesh import Mesh
from vhp_cli.stages.heal.candidate import as_written

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Generator = np.random.Generator

# What a defect does to the set of points of the surface: nothing, takes some away, adds some, moves some.
Kind = Literal["topology", "missing", "extra", "moved"]


@dataclass(frozen=True, slots=True)
class Case:
    """One defective mesh, as it would be read from a file.

    Parameters
    ----------
    name
        Shape and defect.
    kind
        Where the defective surface lies, compared with the clean one.
    damaged
        The mesh to be healed.
    clean
        What it was made from, or what it means; None: nobody can tell.
    """

    name: str
    kind: Kind
    damaged: Mesh
    clean: Mesh | None


# ---------------------------------------------------------------------------------------------------- shapes


def sphere(radius: float = 20.0, centre: ArrayLike = (0, 0, 0), subdivisions: int = 4) -> Mesh:
    """Return a subdivided icosahedron, outward."""
    made = trimesh.creation.icosphere(subdivisions, radius)
    return Mesh(made.vertices + np.asarray(centre, float), made.faces)


def torus(large: float = 20.0, small: float = 6.0) -> Mesh:
    """Return a ring around the z axis."""
    made = trimesh.creation.torus(large, small, 60, 24)
    return Mesh(made.vertices, made.faces)


def box(size: ArrayLike, lower: ArrayLike = (0, 0, 0), counts: tuple[int, int, int] = (8, 8, 8)) -> Mesh:
    """Return a box with a grid of triangles on every side."""
    triangles = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        i, j = (grid.reshape(-1, 1) for grid in np.meshgrid(np.arange(counts[u]), np.arange(counts[v])))
        for side in (0, 1):
            squares = np.empty((len(i), 4, 3))
            squares[:, :, axis] = side
            squares[:, :, u] = np.add(i, (0, 1, 1, 0)) / counts[u]
            squares[:, :, v] = np.add(j, (0, 0, 1, 1)) / counts[v]
            squares = squares if side else squares[:, ::-1]
            triangles += [squares[:, :3], squares[:, [0, 2, 3]]]
    corners = np.asarray(lower, float) + np.concatenate(triangles) * np.asarray(size, float)
    points, index = np.unique(corners.reshape(-1, 3).round(9), axis=0, return_inverse=True)
    return Mesh(points, index.reshape(-1, 3))


def plate() -> Mesh:
    """Return a plate of 30 x 30 x 0.2 mm."""
    return box((30, 30, 0.2), counts=(30, 30, 1))


def tube(
    path: Floats, radius: float, around: int, *, caps: bool = True, closed: bool = False, turn: float = 0.0
) -> Mesh:
    """Return a tube of circular section along points (N, 3), by rings that are not twisted against each other."""
    tangents = np.roll(path, -1, axis=0) - np.roll(path, 1, axis=0) if closed else np.gradient(path, axis=0)
    tangents = tangents / np.linalg.norm(tangents, axis=1, keepdims=True)
    angles = turn + np.linspace(0, 2 * np.pi, around, endpoint=False)[:, None]
    normal = np.cross(tangents[0], (0.3, 0.5, 0.8))
    rings = []
    for point, tangent in zip(path, tangents, strict=True):
        normal = normal - tangent * (normal @ tangent)
        normal /= np.linalg.norm(normal)
        rings.append(point + radius * (np.cos(angles) * normal + np.sin(angles) * np.cross(tangent, normal)))
    count = len(path)
    i, j = (grid.ravel() for grid in np.meshgrid(np.arange(count if closed else count - 1), np.arange(around)))
    following = (i + 1) % count
    # The last ring of a closed tube may be turned against the first: join nearest points.
    shift = 0
    if closed:
        shift = int(np.linalg.norm(rings[0] - rings[-1][0], axis=1).argmin())
    a, b = i * around + j, i * around + (j + 1) % around
    step = np.where(following < i, shift, 0)
    c, d = following * around + (j + step) % around, following * around + (j + 1 + step) % around
    faces = [np.column_stack((a, b, d)), np.column_stack((a, d, c))]
    points = np.concatenate(rings)
    if caps and not closed:
        first, last = np.arange(around), (count - 1) * around + np.arange(around)
        faces += [
            np.column_stack((np.full(around, len(points)), np.roll(first, -1), first)),
            np.column_stack((np.full(around, len(points) + 1), last, np.roll(last, -1))),
        ]
        points = np.concatenate((points, path[[0, -1]]))
    return Mesh(points, np.concatenate(faces))


def course(stations: ArrayLike) -> Floats:
    """Return points of a gently bent course of 300 mm; stations run from 0 to 1."""
    t = np.asarray(stations, float)
    return np.column_stack((300 * t, 15 * np.sin(6 * t), 10 * np.cos(5 * t)))


def thin_tube(offset: ArrayLike = (0, 0, 0)) -> Mesh:
    """Return a nerve: 300 mm long, radius 1 mm, capped."""
    return tube(course(np.linspace(0, 1, 451)) + np.asarray(offset, float), 1.0, 12)


def hollow() -> Mesh:
    """Return a ball with a cavity."""
    return joined(sphere(), inverted(sphere(15.0, subdivisions=3)))


def branches() -> tuple[Mesh, ...]:
    """Return three nerves of radius 1 mm that meet in a Y and cross each other there."""
    found = []
    for direction in ((1.0, 0.0, 0.0), (-0.6, 0.8, 0.0), (-0.6, -0.8, 0.2)):
        unit = np.array(direction) / np.linalg.norm(direction)
        found.append(tube(np.outer(np.linspace(-1.2, 60, 100), unit), 1.0, 14))
    return tuple(found)


def trefoil() -> Mesh:
    """Return a knotted tube so thick that it crosses itself."""
    t = np.linspace(0, 2 * np.pi, 240, endpoint=False)
    knot = (np.sin(t) + 2 * np.sin(2 * t), np.cos(t) - 2 * np.cos(2 * t), -np.sin(3 * t))
    return tube(8 * np.column_stack(knot), 6.0, 20, closed=True)


def pipe(*, ends: bool) -> Mesh:
    """Return the wall of a vessel between radii 2 and 1.4 mm, its ends open or closed by rings."""
    path, around = course(np.linspace(0, 0.3, 121)), 24
    outer, inner = tube(path, 2.0, around, caps=False), inverted(tube(path, 1.4, around, caps=False))
    both = joined(outer, inner)
    if not ends:
        return both
    rings = []
    for start, forward in ((0, False), (len(outer.vertices) - around, True)):
        first = start + np.arange(around)
        second = first + len(outer.vertices)
        following, opposite = np.roll(first, -1), np.roll(second, -1)
        ring = np.concatenate(
            (np.column_stack((first, following, opposite)), np.column_stack((first, opposite, second)))
        )
        rings.append(ring if forward else ring[:, ::-1])
    return Mesh(both.vertices, np.concatenate((both.faces, *rings)))


# --------------------------------------------------------------------------------------------------- defects


def joined(*meshes: Mesh) -> Mesh:
    """Return several meshes as one, without joining vertices."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts[:-1], strict=True)]),
    )


def inverted(mesh: Mesh) -> Mesh:
    """Turn a mesh inside out."""
    return Mesh(mesh.vertices, mesh.faces[:, ::-1])


def holes(mesh: Mesh, random: Generator, count: int, rings: int, among: Ints | None = None) -> Mesh:
    """Take away the faces around some vertices (of those `among`), so many rings wide."""
    gone = np.zeros(len(mesh.faces), dtype=np.bool_)
    for vertex in random.choice(np.unique(mesh.faces) if among is None else among, count, replace=False):
        reached = np.zeros(len(mesh.vertices), dtype=np.bool_)
        reached[vertex] = True
        for _ in range(rings):
            near = reached[mesh.faces].any(axis=1)
            reached[mesh.faces[near]] = True
        gone |= near
    return Mesh(mesh.vertices, mesh.faces[~gone])


def riddled(mesh: Mesh, random: Generator, share: float) -> Mesh:
    """Take away a share of the faces, anywhere."""
    return Mesh(mesh.vertices, mesh.faces[random.random(len(mesh.faces)) >= share])


def flipped(mesh: Mesh, random: Generator, share: float) -> Mesh:
    """Turn a share of the faces over."""
    faces = mesh.faces.copy()
    turned = random.random(len(faces)) < share
    faces[turned] = faces[turned][:, ::-1]
    return Mesh(mesh.vertices, faces)


def duplicates(mesh: Mesh, random: Generator, share: float) -> Mesh:
    """Repeat a share of the faces, every second one turned over."""
    extra = mesh.faces[random.random(len(mesh.faces)) < share].copy()
    extra[::2] = extra[::2, ::-1]
    return Mesh(mesh.vertices, np.concatenate((mesh.faces, extra)))


def t_junctions(mesh: Mesh, random: Generator, share: float) -> Mesh:
    """Put a vertex on an edge of some faces, without their neighbours."""
    faces, first = mesh.faces, random.random(len(mesh.faces)) < share
    a, b, c = faces[first].T
    # Halves of float32 values: exactly on the edge as long as no bit is lost.
    middle = (mesh.vertices[a] + mesh.vertices[b]) / 2
    new = len(mesh.vertices) + np.arange(len(a))
    halves = np.concatenate((np.column_stack((a, new, c)), np.column_stack((new, b, c))))
    return Mesh(np.concatenate((mesh.vertices, middle)), np.concatenate((faces[~first], halves)))


def jittered(mesh: Mesh, random: Generator, size_mm: float) -> Mesh:
    """Take the faces apart and shift every corner by noise: nothing is welded any more."""
    corners = mesh.vertices[mesh.faces].reshape(-1, 3)
    noise = random.normal(size=corners.shape) * size_mm
    return Mesh(corners + noise, np.arange(len(corners)).reshape(-1, 3))


def noise(mesh: Mesh, random: Generator, share_of_edge: float) -> Mesh:
    """Shift every vertex by a share of the mean edge: neighbours cross each other."""
    shift = random.normal(size=mesh.vertices.shape) * share_of_edge * _mean_edge(mesh)
    return Mesh(mesh.vertices + shift, mesh.faces)


def folds(mesh: Mesh, random: Generator, count: int) -> Mesh:
    """Shift some vertices within the surface, past their neighbours."""
    normals = np.zeros(mesh.vertices.shape)
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    for k in range(3):
        np.add.at(normals, mesh.faces[:, k], np.cross(b - a, c - a))
    moved = random.choice(len(mesh.vertices), count, replace=False)
    normal = normals[moved] / np.linalg.norm(normals[moved], axis=1, keepdims=True)
    along = random.normal(size=normal.shape)
    along -= normal * (along * normal).sum(axis=1, keepdims=True)
    along *= 1.3 * _mean_edge(mesh) / np.linalg.norm(along, axis=1, keepdims=True)
    vertices = mesh.vertices.copy()
    vertices[moved] += along
    return Mesh(vertices, mesh.faces)


def dented(mesh: Mesh) -> Mesh:
    """Push one side of a ball of radius 20 mm in, and out through the other side."""
    strength = np.clip((mesh.vertices[:, :1] / 20 - 0.93) / 0.07, 0, 1)
    return Mesh(mesh.vertices - strength * (46.0, 0.0, 0.0), mesh.faces)


def slivers(mesh: Mesh, random: Generator, count: int, *, one_side: bool = False) -> Mesh:
    """Cut edges next to one end, or (`one_side`) cut one face and close the gap by a face of zero area."""
    faces = mesh.faces.tolist()
    vertices = [*mesh.vertices]
    sides = {(face[k], face[(k + 1) % 3]): index for index, face in enumerate(faces) for k in range(3)}
    used: set[int] = set()
    for index in random.permutation(len(faces))[: 4 * count]:
        if len(used) >= 2 * count:
            break
        if index in used:
            continue
        a, b, c = faces[index]
        other = sides[b, a]
        if other in used:
            continue
        used |= {int(index), other}
        share = 0.5 if one_side else 10 ** -random.uniform(2, 4)
        new = len(vertices)
        vertices.append((1 - share) * vertices[a] + share * vertices[b])
        faces[index] = [a, new, c]
        faces.append([new, b, c])
        if one_side:
            faces.append([a, b, new])
            continue
        opposite = next(vertex for vertex in faces[other] if vertex not in (a, b))
        faces[other] = [b, new, opposite]
        faces.append([new, a, opposite])
    return Mesh(np.array(vertices), np.array(faces))


def with_wall(mesh: Mesh) -> Mesh:
    """Close the equator of a ball by a disc of its own: an inner wall."""
    ring = np.flatnonzero(np.abs(mesh.vertices[:, 2]) < 1e-9)
    ring = ring[np.argsort(np.arctan2(mesh.vertices[ring, 1], mesh.vertices[ring, 0]))]
    disc = np.column_stack((np.full(len(ring), len(mesh.vertices)), ring, np.roll(ring, -1)))
    return Mesh(np.concatenate((mesh.vertices, np.zeros((1, 3)))), np.concatenate((mesh.faces, disc)))


def with_specks(mesh: Mesh, random: Generator, count: int) -> Mesh:
    """Strew tiny balls around a ball of radius 20 mm."""
    directions = random.normal(size=(count, 3))
    places = directions / np.linalg.norm(directions, axis=1, keepdims=True) * random.uniform(25, 40, (count, 1))
    specks = [sphere(random.uniform(0.02, 0.06), place, 1) for place in places]
    return joined(mesh, *specks)


def united(*meshes: Mesh) -> Mesh:
    """Return the union of solids by manifold3d."""
    import manifold3d

    solids = [
        manifold3d.Manifold(
            # It takes no arrays that are read-only.
            manifold3d.Mesh64(vert_properties=np.array(mesh.vertices), tri_verts=mesh.faces.astype(np.uint64))
        )
        for mesh in meshes
    ]
    whole = manifold3d.Manifold.batch_boolean(solids, manifold3d.OpType.Add).to_mesh64()
    return Mesh(np.array(whole.vert_properties[:, :3]), np.array(whole.tri_verts, dtype=np.int64))


def _mean_edge(mesh: Mesh) -> float:
    corners = mesh.vertices[mesh.faces]
    return float(np.linalg.norm(np.roll(corners, 1, axis=1) - corners, axis=2).mean())


# ----------------------------------------------------------------------------------------------------- cases

Made = tuple[Mesh, Mesh | None]


def _on(shape: Callable[[], Mesh], damage: Callable[[Mesh, Generator], Mesh]) -> Callable[[Generator], Made]:
    """A defect made on a clean shape."""

    def make(random: Generator) -> Made:
        # Halving an edge of float32 corners loses at most one bit, that of an odd corner.
        clean = as_written(shape())
        return damage(clean, random), clean

    return make


def _together(*meshes: Callable[[], Mesh]) -> Callable[[Generator], Made]:
    """Solids in one file; what they mean is their union."""
    return lambda random: (joined(*(mesh() for mesh in meshes)), united(*(mesh() for mesh in meshes)))


def _uneven_tube(random: Generator) -> Made:
    stations = np.sort(np.concatenate(([0.0, 1.0], random.random(300))))
    return tube(course(stations), 1.0, 24), tube(course(np.linspace(0, 1, 901)), 1.0, 24)


def _branches_with_holes(random: Generator) -> Made:
    return flipped(holes(joined(*branches()), random, 8, 1), random, 0.1), united(*branches())


def _plate_with_holes(random: Generator) -> Made:
    clean = as_written(plate())
    # A corner that is gone, nobody can know of.
    inner = np.flatnonzero((np.abs(clean.vertices[:, :2] - 15) < 12).all(axis=1))
    return holes(clean, random, 6, 2, inner), clean


def _everything(random: Generator) -> Made:
    nerve = thin_tube((-150, 0, 12))
    mesh = riddled(joined(sphere(), nerve), random, 0.02)
    mesh = duplicates(flipped(mesh, random, 0.1), random, 0.01)
    return jittered(mesh, random, 1e-6), united(sphere(), nerve)


def _cavity_outward(random: Generator) -> Made:
    return joined(sphere(), sphere(15.0, subdivisions=3)), hollow()


def _double_sheet(random: Generator) -> Made:
    return joined(sphere(), inverted(sphere())), sphere()


def _pipe(random: Generator) -> Made:
    return pipe(ends=False), pipe(ends=True)


def _at_a_vertex(random: Generator) -> Made:
    two = joined(sphere(), sphere(centre=(40, 0, 0)))
    return two, two


def _at_an_edge(random: Generator) -> Made:
    two = joined(box((10, 10, 10)), box((10, 10, 10), (10, 10, 0)))
    return two, two


CASES: dict[str, tuple[Kind, Callable[[Generator], Made]]] = {
    "sphere, holes": ("missing", _on(sphere, lambda mesh, random: holes(mesh, random, 4, 5))),
    "sphere, riddled": ("missing", _on(sphere, lambda mesh, random: riddled(mesh, random, 0.3))),
    "sphere, flipped faces": ("topology", _on(sphere, lambda mesh, random: flipped(mesh, random, 0.2))),
    "sphere, duplicate faces": ("topology", _on(sphere, lambda mesh, random: duplicates(mesh, random, 0.1))),
    "sphere, slivers": ("topology", _on(sphere, lambda mesh, random: slivers(mesh, random, 200))),
    "sphere, faces without area": (
        "topology",
        _on(sphere, lambda mesh, random: slivers(mesh, random, 100, one_side=True)),
    ),
    "sphere, unwelded": ("moved", _on(sphere, lambda mesh, random: jittered(mesh, random, 1e-5))),
    "sphere, noise": ("moved", _on(sphere, lambda mesh, random: noise(mesh, random, 0.35))),
    "sphere, folds": ("moved", _on(sphere, lambda mesh, random: folds(mesh, random, 60))),
    "sphere, dented through": ("moved", lambda random: (dented(sphere()), None)),
    "sphere, inner wall": ("extra", _on(sphere, lambda mesh, random: with_wall(mesh))),
    "sphere, specks and a hole": (
        "extra",
        _on(sphere, lambda mesh, random: with_specks(holes(mesh, random, 1, 3), random, 40)),
    ),
    "sphere, inside out": ("topology", _on(sphere, lambda mesh, random: inverted(mesh))),
    "sphere, double sheet": ("topology", _double_sheet),
    "torus, holes": ("missing", _on(torus, lambda mesh, random: holes(mesh, random, 4, 3))),
    "torus, flipped faces": ("topology", _on(torus, lambda mesh, random: flipped(mesh, random, 0.4))),
    "torus, T-junctions": ("topology", _on(torus, lambda mesh, random: t_junctions(mesh, random, 0.05))),
    "torus, unwelded": ("moved", _on(torus, lambda mesh, random: jittered(mesh, random, 1e-5))),
    "torus, noise": ("moved", _on(torus, lambda mesh, random: noise(mesh, random, 0.2))),
    "torus, folds": ("moved", _on(torus, lambda mesh, random: folds(mesh, random, 40))),
    "tube, uneven rings": ("moved", _uneven_tube),
    "tube, holes": ("missing", _on(thin_tube, lambda mesh, random: holes(mesh, random, 20, 1))),
    "tube, flipped faces": ("topology", _on(thin_tube, lambda mesh, random: flipped(mesh, random, 0.3))),
    "tube, T-junctions": ("topology", _on(thin_tube, lambda mesh, random: t_junctions(mesh, random, 0.02))),
    "tube, slivers": ("topology", _on(thin_tube, lambda mesh, random: slivers(mesh, random, 200))),
    "tube, unwelded": ("moved", _on(thin_tube, lambda mesh, random: jittered(mesh, random, 1e-5))),
    "tube, folds": ("moved", _on(thin_tube, lambda mesh, random: folds(mesh, random, 40))),
    "tube, inside out": ("topology", _on(thin_tube, lambda mesh, random: inverted(mesh))),
    "hollow sphere, cavity outward": ("topology", _cavity_outward),
    "hollow sphere, holes": ("missing", _on(hollow, lambda mesh, random: holes(mesh, random, 6, 3))),
    "hollow sphere, flipped faces": ("topology", _on(hollow, lambda mesh, random: flipped(mesh, random, 0.2))),
    "plate, holes": ("missing", _plate_with_holes),
    "plate, flipped and duplicate": (
        "topology",
        _on(plate, lambda mesh, random: duplicates(flipped(mesh, random, 0.2), random, 0.05)),
    ),
    "plate, noise": ("moved", _on(plate, lambda mesh, random: noise(mesh, random, 0.07))),
    "two spheres, overlap": ("extra", _together(sphere, lambda: sphere(15.0, (22, 3, 1)))),
    "two spheres, joined at a vertex": ("topology", _at_a_vertex),
    "two boxes, joined at an edge": ("topology", _at_an_edge),
    "two boxes, common side": (
        "extra",
        _together(lambda: box((10, 10, 10)), lambda: box((10, 10, 10), (10, 0, 0))),
    ),
    "two boxes, one on the other": (
        "extra",
        _together(lambda: box((20, 20, 5)), lambda: box((6, 7, 8), (5.3, 6.1, 5), (5, 6, 7))),
    ),
    "branches, overlap": ("extra", _together(*(lambda number=number: branches()[number] for number in range(3)))),
    "branches, overlap and holes": ("extra", _branches_with_holes),
    "pipe, open ends": ("missing", _pipe),
    "trefoil, crosses itself": ("extra", lambda random: (trefoil(), None)),
    "sphere and tube, everything": ("extra", _everything),
}


_BY_UNION = (
    "two spheres, overlap",
    "two boxes, common side",
    "two boxes, one on the other",
    "branches, overlap",
    "branches, overlap and holes",
    "sphere and tube, everything",
)


def needs_union(name: str) -> bool:
    """Tell if the truth of a case is computed by manifold3d."""
    return name in _BY_UNION


def case(name: str) -> Case:
    """Return one case, always the same."""
    kind, make = CASES[name]
    damaged, clean = make(np.random.default_rng(zlib.crc32(name.encode())))
    return Case(name, kind, as_written(damaged), None if clean is None else as_written(clean))


def cases() -> Iterator[Case]:
    """Yield all cases."""
    return map(case, CASES)
