"""Split triangles at the midpoints of their edges, conformingly (thesis 2.4.1 and fig. 2.13)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vhp_cli.mesh import Mesh

Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Sides:
    """The edges of a mesh, and which of them are the sides of each face.

    Parameters
    ----------
    ends : (E, 2) int64
        The two vertices of each edge, the lower one first.
    of_face : (F, 3) int64
        Edge from corner k of a face to the next corner.
    """

    ends: Ints
    of_face: Ints


@dataclass(frozen=True, slots=True, eq=False)
class Split:
    """A mesh after some edges were cut in two.

    Parameters
    ----------
    mesh
        The old vertices, then one new vertex for each cut edge. The parts of a face follow each other, in the order of
        the faces they come from.
    parents : (F,) int64
        The face that each face is a part of.
    n_cuts : (F of the given mesh,) int64
        How many sides of each face were cut.
    """

    mesh: Mesh
    parents: Ints
    n_cuts: Ints


def sides_of(mesh: Mesh) -> Sides:
    """Return the edges of a mesh, numbered in the order of their vertices."""
    start = mesh.faces.astype(np.int64)
    end = np.roll(start, -1, axis=1)
    n_vertices = max(len(mesh.vertices), 1)
    keys, edge = np.unique(np.minimum(start, end) * n_vertices + np.maximum(start, end), return_inverse=True)
    return Sides(np.column_stack(np.divmod(keys, n_vertices)), edge.reshape(-1, 3))


def all_sides(sides: Sides, picked: Mask) -> Mask:
    """Return all three edges of every picked face: scenario a of thesis fig. 2.13.

    Parameters
    ----------
    sides
        The edges of the mesh.
    picked : (F,) bool
        The faces to refine.

    Returns
    -------
    (E,) bool
        The edges to cut.
    """
    cut = np.zeros(len(sides.ends), dtype=np.bool_)
    cut[sides.of_face[picked]] = True
    return cut


def shared_sides(sides: Sides, picked: Mask) -> Mask:
    """Return the edges all of whose faces are picked: scenario b of thesis fig. 2.13.

    These are the edges between two picked faces, and the boundary edges of picked faces: no other face is divided.
    Parameters and result as of `all_sides`.
    """
    count = len(sides.ends)
    inside = np.bincount(sides.of_face[picked].ravel(), minlength=count)
    cut: Mask = (inside > 0) & (inside == np.bincount(sides.of_face.ravel(), minlength=count))
    return cut


def cut_edges(mesh: Mesh, sides: Sides, cut: Mask) -> Split:
    """Put a vertex at the exact middle of some edges, and divide the faces at them.

    A face with three cut sides becomes four, one with two becomes three (the four-sided rest is divided by its shorter
    diagonal), one with one becomes two. Every face at a cut edge is divided there, so that no vertex hangs.

    Parameters
    ----------
    mesh
        No face with two equal vertices.
    sides
        Its edges.
    cut : (E,) bool
        The edges to cut.
    """
    ends = sides.ends[cut]
    middles = mesh.vertices[ends].mean(axis=1)
    vertices = np.concatenate([mesh.vertices, middles])
    number = np.cumsum(cut) - 1 + len(mesh.vertices)
    is_cut = cut[sides.of_face]
    n_cuts = is_cut.sum(axis=1)
    first = np.cumsum(n_cuts + 1) - (n_cuts + 1)
    faces = np.empty((len(mesh.faces) + int(n_cuts.sum()), 3), dtype=np.int32)

    # The faces are turned so that the cut sides come first: one cut is between a and b, two meet at b.
    turn = np.where(n_cuts == 1, is_cut.argmax(axis=1), np.where(n_cuts == 2, (~is_cut).argmax(axis=1) + 1, 0)) % 3
    corner = (turn[:, None] + np.arange(3)) % 3
    a, b, c = np.take_along_axis(mesh.faces.astype(np.int64), corner, axis=1).T
    ab, bc, ca = number[np.take_along_axis(sides.of_face, corner, axis=1)].T

    def put(kind: Mask, *parts: tuple[Ints, Ints, Ints]) -> None:
        for place, part in enumerate(parts):
            faces[first[kind] + place] = np.column_stack([numbers[kind] for numbers in part])

    put(n_cuts == 0, (a, b, c))
    put(n_cuts == 1, (a, ab, c), (ab, b, c))
    put(n_cuts == 3, (a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
    two = n_cuts == 2
    from_a = np.zeros(len(mesh.faces), dtype=np.bool_)
    from_a[two] = _is_shorter(vertices, (a[two], bc[two]), (c[two], ab[two]))
    put(two & from_a, (ab, b, bc), (a, ab, bc), (a, bc, c))
    put(two & ~from_a, (ab, b, bc), (a, ab, c), (ab, bc, c))
    return Split(Mesh(vertices, faces), np.repeat(np.arange(len(mesh.faces)), n_cuts + 1), n_cuts)


def _is_shorter(vertices: NDArray[np.float64], one: tuple[Ints, Ints], other: tuple[Ints, Ints]) -> Mask:
    """Tell which diagonals are shorter than the others; of equal ones, the one from the lower old vertex."""
    lengths = [((vertices[end] - vertices[start]) ** 2).sum(axis=1) for start, end in (one, other)]
    shorter: Mask = (lengths[0] < lengths[1]) | ((lengths[0] == lengths[1]) & (one[0] < other[0]))
    return shorter
