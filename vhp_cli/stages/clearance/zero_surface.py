"""The surface on which a function vanishes, by marching tetrahedra on the cells that it runs through."""

from __future__ import annotations

from collections.abc import Callable
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from vhp_cli.errors import VhpError
from vhp_cli.mesh import Mesh

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Function = Callable[[Floats, float], Floats]

_LEVELS = 5
_MOST_AT_ONCE = 500_000
# A bit more than the rounding of distances.
_SLACK = 1.0001
# No vertex comes nearer to a node of the grid than this part of the way, so that no triangle is without area.
_NEAREST = 0.02
_CORNERS = np.array([[k & 1, k >> 1 & 1, k >> 2 & 1] for k in range(8)])


def _tetrahedra() -> Ints:
    """Cut a cube into six tetrahedra along its diagonal, alike in all cubes, so that the cuts fit (Kuhn)."""
    found = []
    for order in permutations(range(3)):
        path = [0, 1 << order[0], 1 << order[0] | 1 << order[1], 7]
        a, b, c, d = (_CORNERS[k] for k in path)
        if np.linalg.det(np.stack([b - a, c - a, d - a])) < 0:
            path[2:] = path[:1:-1]
        found.append(path)
    return np.array(found)


_TETRAHEDRA = _tetrahedra()
# Even permutations that bring one corner, or two, to the front.
_ONE = np.array([(0, 1, 2, 3), (1, 0, 3, 2), (2, 0, 1, 3), (3, 0, 2, 1)])
_TWO = {3: (0, 1, 2, 3), 5: (0, 2, 3, 1), 9: (0, 3, 1, 2), 6: (1, 2, 0, 3), 10: (1, 3, 2, 0), 12: (2, 3, 0, 1)}


class TooFineError(VhpError):
    """The surface has more cells than allowed."""


def zero_surface(
    function: Function, lower: Floats, upper: Floats, cell_mm: float, *, most_cells: int = 3_000_000
) -> Mesh:
    """Return the closed surface around the places where a function is negative.

    Only cells near the surface are looked at, so that memory goes with its area.

    Parameters
    ----------
    function
        Takes points (P, 3) and a reach in mm, and returns values (P,). It changes by at most the way between two
        points, and is positive on the border of the box. A value farther from 0 than the reach may be any other
        such value of the same sign.
    lower, upper
        Corners of the box, in mm.
    cell_mm
        Edge of the cells.
    most_cells
        Bound on their number.

    Raises
    ------
    TooFineError
        If there are more cells than that.
    """
    origin = np.floor(np.asarray(lower) / cell_mm) * cell_mm
    cells = _cells(function, origin, np.asarray(upper), cell_mm, most_cells)
    nodes, index = _unique_rows((cells[:, None] + _CORNERS).reshape(-1, 3))
    values = _evaluated(function, origin + cell_mm * nodes, _SLACK * cell_mm * 3**0.5)
    corners = index.reshape(-1, 8)[:, _TETRAHEDRA].reshape(-1, 4)
    triangles = _triangles(corners, values < 0)
    ends, faces = _unique_rows(np.sort(triangles.reshape(-1, 2), axis=1))
    first, second = values[ends[:, 0]], values[ends[:, 1]]
    part = np.clip(first / (first - second), _NEAREST, 1 - _NEAREST)
    along = nodes[ends[:, 0]] + part[:, None] * (nodes[ends[:, 1]] - nodes[ends[:, 0]])
    return Mesh(origin + cell_mm * along, faces.reshape(-1, 3).astype(np.int32))


def _cells(function: Function, origin: Floats, upper: Floats, cell_mm: float, most_cells: int) -> Ints:
    """Return the cells (N, 3), by their lower corners in the grid, through which the surface can run."""
    size = 1 << _LEVELS
    counts = np.maximum(np.ceil((upper - origin) / (cell_mm * size)).astype(np.int64), 1)
    if counts.prod() > most_cells:
        raise TooFineError(f"a grid of {cell_mm:.3g} mm is too fine for the size of the tissue")
    cells = size * np.stack(np.meshgrid(*(np.arange(n) for n in counts), indexing="ij"), axis=-1).reshape(-1, 3)
    while True:
        reach = _SLACK * cell_mm * size * 3**0.5 / 2
        values = _evaluated(function, origin + cell_mm * (cells + size / 2), reach)
        cells = cells[np.abs(values) <= reach]
        if len(cells) > most_cells:
            raise TooFineError(f"a grid of {cell_mm:.3g} mm takes more than {most_cells} cells")
        if size == 1:
            return cells
        size //= 2
        cells = (cells[:, None] + size * _CORNERS).reshape(-1, 3)


def _evaluated(function: Function, points: Floats, reach_mm: float) -> Floats:
    starts = range(0, len(points), _MOST_AT_ONCE)
    parts = [function(points[start : start + _MOST_AT_ONCE], reach_mm) for start in starts]
    return np.concatenate([*parts, np.empty(0)])


def _unique_rows(rows: Ints) -> tuple[Ints, Ints]:
    """Return the different rows in ascending order, and the number of each row among them."""
    if not len(rows):
        return rows, np.empty(0, np.int64)
    low = rows.min(axis=0)
    spans = rows.max(axis=0) - low + 1
    keys = np.zeros(len(rows), np.int64)
    for column, span in enumerate(spans):
        keys = keys * span + (rows[:, column] - low[column])
    _, first, index = np.unique(keys, return_index=True, return_inverse=True)
    return rows[first], index


def _triangles(corners: Ints, negative: NDArray[np.bool_]) -> Ints:
    """Return the triangles (T, 3, 2) that part negative corners from others, by the edges that they cut."""
    inside = negative[corners]
    number = inside.sum(axis=1)
    found = [np.empty((0, 3, 2), np.int64)]
    for lone, outward in ((1, True), (3, False)):
        at = np.flatnonzero(number == lone)
        alone = (inside[at] if outward else ~inside[at]).argmax(axis=1)
        a, b, c, d = np.take_along_axis(corners[at], _ONE[alone], axis=1).T
        fan = [(a, b), (a, c), (a, d)] if outward else [(a, b), (a, d), (a, c)]
        found.append(_stacked(fan))
    code = inside @ np.array([1, 2, 4, 8])
    for bits, order in _TWO.items():
        a, b, c, d = corners[code == bits][:, order].T
        found.append(_stacked([(a, c), (a, d), (b, d)]))
        found.append(_stacked([(a, c), (b, d), (b, c)]))
    return np.concatenate(found)


def _stacked(edges: list[tuple[Ints, Ints]]) -> Ints:
    return np.stack([np.stack(edge, axis=1) for edge in edges], axis=1)
