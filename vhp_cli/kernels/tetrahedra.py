"""Measure tetrahedra, and better them by moving corners and swapping; kernels in tetrahedra_*.c."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vhp_cli.errors import KernelError
from vhp_cli.kernels._library import address, check_allocation, function, i32, i64, pointer

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

_shape = function("vhp_tetrahedra_shape", None, [pointer, pointer, i64, pointer])
_relax = function(
    "vhp_tetrahedra_relax",
    pointer,
    [pointer, i64, pointer, pointer, pointer, i64, *[pointer] * 5, i64, pointer, pointer],
)
_take = function("vhp_tetrahedra_take", None, [pointer, pointer, pointer, pointer])
_advance = function(
    "vhp_tetrahedra_advance", i32, [pointer, i64, pointer, pointer, i64, pointer, pointer, i64, pointer, pointer]
)


_faces = function("vhp_tetrahedra_faces", i32, [pointer, i64, i64, pointer, pointer])


class Target(NamedTuple):
    """What tetrahedra are to keep or to reach: the smallest dihedral angle, and the radius ratio 3 r_in / r_out."""

    min_dihedral_deg: float
    radius_ratio: float


def shape(points: Floats, tetrahedra: Ints) -> tuple[Floats, ...]:
    """Return the shape of tetrahedra (M, 4) as six arrays (M,).

    Signed volume in mm3, radius ratio, smallest and largest dihedral angle in degrees, scaled Jacobian, mean edge in
    mm; see `vhp_cli.inspection.tetrahedra.TetrahedronQuality`.
    """
    points, tetrahedra = _checked(points, tetrahedra)
    columns = np.empty((6, len(tetrahedra)))
    _shape(address(points), address(tetrahedra), len(tetrahedra), address(columns))
    return tuple(columns)


def equal_faces(tetrahedra: Ints) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Find the faces of tetrahedra (M, 4) that are equal; face 4 t + k lies opposite to corner k of tetrahedron t.

    Returns
    -------
    order : (4 M,) int64
        Faces in the order of their sorted corners, equal ones in that of their numbers.
    equal : (4 M,) bool
        Which of them, in that order, have the same corners as the one before.
    """
    corners = np.ascontiguousarray(tetrahedra, dtype=np.int32)
    if corners.ndim != 2 or corners.shape[1] != 4 or corners.min(initial=0) < 0:
        raise ValueError("tetrahedra must be (M, 4), with indices from 0")
    order, equal = np.empty(4 * len(corners), np.int64), np.empty(4 * len(corners), np.uint8)
    count = int(corners.max(initial=-1)) + 1
    check_allocation(_faces(address(corners), len(corners), count, address(order), address(equal)))
    return order, equal.astype(np.bool_)


class Relaxed(NamedTuple):
    """A mesh that was bettered.

    Parameters
    ----------
    points : (N, 3) float64
        In mm.
    tetrahedra : (M, 4) int32
        Those that stayed in their order, then new ones.
    labels : (M,) int32
        Of each.
    used : (M,) bool
        Which have to meet the targets.
    swaps, moves
        What was done how often.
    """

    points: Floats
    tetrahedra: Ints
    labels: Ints
    used: NDArray[np.bool_]
    swaps: int
    moves: int


def relax(
    points: Floats,
    tetrahedra: Ints,
    labels: Ints,
    used: NDArray[np.bool_],
    *,
    target: Target,
    unused: Target,
    fixed: NDArray[np.bool_],
    border: NDArray[np.bool_],
    normals: Floats,
    leash_mm: Floats,
    rounds: int,
) -> Relaxed:
    """Move corners of bad tetrahedra and swap these for others, as long as the worst around gets better by it.

    Tetrahedra are swapped within a label, or at an edge between two labels that changes within the leash.

    Parameters
    ----------
    points : (N, 3) float64
        In mm.
    tetrahedra : (M, 4) int32
        Positively oriented.
    labels : (M,) int32
        Of each.
    used : (M,) bool
        Which are to meet `target`; the others `unused`.
    target, unused
        What is aimed at; nothing is done to what is as good.
    fixed : (N,) bool
        Points that stay.
    border : (N,) bool
        Points on a surface that is to stay, within the leash.
    normals : (N, 3) float64
        Of that surface, where points may slide along it; else 0.
    leash_mm : (N,) float64
        How far a point on a surface may leave it or, where it has no normal, its place.
    rounds
        Over all bad tetrahedra, at most.
    """
    points, tetrahedra = _checked(points, tetrahedra)
    points = points.copy()
    n, m = len(points), len(tetrahedra)
    labels = np.ascontiguousarray(labels, dtype=np.int32)
    masks = [np.ascontiguousarray(mask, dtype=np.uint8) for mask in (used, fixed, border)]
    normals = np.ascontiguousarray(normals, dtype=np.float64)
    leash = np.ascontiguousarray(leash_mm, dtype=np.float64)
    targets = np.array([*unused, *target], dtype=np.float64)
    shapes = [labels.shape, *(mask.shape for mask in masks), normals.shape, leash.shape]
    if shapes != [(m,), (m,), (n,), (n,), (n, 3), (n,)]:
        raise ValueError("the shapes of the arrays do not agree")
    counts, made = np.zeros(2, np.int64), np.zeros(1, np.int64)
    used_mask, *point_masks = (address(mask) for mask in masks)
    found = _relax(
        address(points), n, address(tetrahedra), address(labels), used_mask, m, address(targets), *point_masks,
        address(normals), address(leash), rounds, address(counts), address(made),
    )  # fmt: skip
    if not found:
        raise KernelError("out of memory in a compiled kernel", hint="mesh with longer edges")
    result = np.empty((int(made[0]), 4), np.int32)
    new_labels, new_used = np.empty(len(result), np.int32), np.empty(len(result), np.uint8)
    _take(found, address(result), address(new_labels), address(new_used))
    return Relaxed(points, result, new_labels, new_used.astype(np.bool_), int(counts[0]), int(counts[1]))


def advance(
    points: Floats,
    tetrahedra: Ints,
    used: NDArray[np.bool_],
    *,
    target: Target,
    unused: Target,
    moving: Ints,
    ways: Floats,
) -> tuple[Floats, Floats]:
    """Move points one after the other along ways, each as far as its tetrahedra allow.

    No tetrahedron becomes inverted, nor falls below a target by that, or below what it was if that was less.

    Parameters
    ----------
    points, tetrahedra, used, target, unused
        As of `relax`.
    moving : (K,) int32
        Points that are to move.
    ways : (K, 3) float64
        How far, in mm.

    Returns
    -------
    points (N, 3), parts (K,)
        Where points are, and the part of its way that each went: 1, 1/2, 1/4, 1/8 or 0.
    """
    points, tetrahedra = _checked(points, tetrahedra)
    points = points.copy()
    mask = np.ascontiguousarray(used, dtype=np.uint8)
    moving = np.ascontiguousarray(moving, dtype=np.int32)
    ways = np.ascontiguousarray(ways, dtype=np.float64)
    if mask.shape != (len(tetrahedra),) or ways.shape != (len(moving), 3):
        raise ValueError("the shapes of the arrays do not agree")
    if len(moving) and (moving.min() < 0 or moving.max() >= len(points)):
        raise ValueError("a point that is to move does not exist")
    targets = np.array([*unused, *target], dtype=np.float64)
    parts = np.zeros(len(moving))
    status = _advance(
        address(points), len(points), address(tetrahedra), address(mask), len(tetrahedra), address(targets),
        address(moving), len(moving), address(ways), address(parts),
    )  # fmt: skip
    check_allocation(status)
    return points, parts


def _checked(points: ArrayLike, tetrahedra: ArrayLike) -> tuple[Floats, Ints]:
    points = np.ascontiguousarray(points, dtype=np.float64)
    corners = np.ascontiguousarray(tetrahedra, dtype=np.int32)
    if points.ndim != 2 or points.shape[1] != 3 or corners.ndim != 2 or corners.shape[1] != 4:
        raise ValueError("points must be (N, 3) and tetrahedra (M, 4)")
    if len(corners) and (corners.min() < 0 or corners.max() >= len(points)):
        raise ValueError("a tetrahedron refers to a point that does not exist")
    return points, corners
