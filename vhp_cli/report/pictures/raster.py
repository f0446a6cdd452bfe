"""A rasteriser: which face is seen at each pixel, and how far away."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
Int = NDArray[np.int32]

_AT_ONCE = 2**20  # pixels tried together
_MOST = 2**24  # pixels tried in all; above, the picture is drawn with half the pixels
_NOTHING = np.uint64(2**64 - 1)
_DEPTHS = 2.0**31


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """What is seen at each pixel.

    Parameters
    ----------
    face : (H, W) int32
        The nearest face, -1 for none; of equally near ones that of the lowest number.
    depth : (H, W) float64
        Its depth there; inf for none.
    """

    face: Int
    depth: Float


def rasterise(points: Float, faces: Int, width: int, height: int) -> Seen:
    """Find the nearest face at the centre of each pixel.

    Parameters
    ----------
    points : (V, 3) float64
        Column and row in pixels (pixel i reaches from i to i + 1) and depth, which grows away from the viewer.
    faces : (F, 3) int32
        Seen from both sides.
    width, height
        Of the picture in pixels.
    """
    step = 1
    while True:
        first, last = _boxes(points / (step, step, 1.0), faces, -(-width // step), -(-height // step))
        tried = int((last - first).clip(min=0).prod(axis=1).sum())
        if tried <= _MOST or step >= 64:
            break
        step *= 2
    seen = _drawn(points / (step, step, 1.0), faces, first, last, -(-width // step), -(-height // step))
    if step == 1:
        return seen
    rows, columns = np.arange(height)[:, None] // step, np.arange(width)[None, :] // step
    return Seen(seen.face[rows, columns], seen.depth[rows, columns])


def _boxes(points: Float, faces: Int, width: int, height: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first pixel and the one after the last whose centre each face may cover: (F, 2), (F, 2)."""
    corners = points[:, :2][faces]
    limit = np.array([width, height])
    first = np.clip(np.ceil(corners.min(axis=1) - 0.5), 0, limit).astype(np.int64)
    last = np.clip(np.floor(corners.max(axis=1) - 0.5) + 1, 0, limit).astype(np.int64)
    return first, last


def _drawn(
    points: Float, faces: Int, first: NDArray[np.int64], last: NDArray[np.int64], width: int, height: int
) -> Seen:
    nearest = np.full(width * height, _NOTHING)
    size = (last - first).clip(min=0)
    drawn = np.flatnonzero(size.all(axis=1))
    corner_depths = points[:, 2][faces[drawn]]
    low = float(corner_depths.min()) if len(drawn) else 0.0
    span = (float(corner_depths.max()) - low if len(drawn) else 0.0) or 1.0
    tried = np.cumsum(size[drawn].prod(axis=1))
    begin = 0
    while begin < len(drawn):
        done = tried[begin - 1] if begin else 0
        end = max(int(np.searchsorted(tried, done + _AT_ONCE, side="right")), begin + 1)
        some = drawn[begin:end]
        owner, column, row, depth = _pixels(points[faces[some]], first[some, 1], last[some, 1], width)
        level = ((depth - low) / span).clip(0.0, 1.0) * (_DEPTHS - 1)
        key = (level.astype(np.uint64) << np.uint64(32)) | some[owner].astype(np.uint64)
        np.minimum.at(nearest, row * width + column, key)
        begin = end
    nothing = nearest == _NOTHING
    face = np.where(nothing, -1, (nearest & np.uint64(2**32 - 1)).astype(np.int64)).astype(np.int32)
    depth = np.where(nothing, np.inf, low + (nearest >> np.uint64(32)).astype(np.float64) / (_DEPTHS - 1) * span)
    return Seen(face.reshape(height, width), depth.reshape(height, width))


def _pixels(
    corners: Float, top: NDArray[np.int64], bottom: NDArray[np.int64], width: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], Float]:
    """Return the pixels whose centres lie in faces, edges included: face, column, row and depth of each.

    Parameters
    ----------
    corners : (F, 3, 3) float64
        Of the faces.
    top, bottom : (F,) int64
        The first row that each may cover, and the one after the last.
    width
        Of the picture.
    """
    owner, row = _counted_out(bottom - top)
    row += top[owner]
    # Where each row enters and leaves the face. An edge gives the same in both faces that share it, as its ends are
    # taken from top to bottom: there is no gap between the two.
    enter, leave = np.full(len(row), np.inf), np.full(len(row), -np.inf)
    sides = corners[:, 1:, :2] - corners[:, :1, :2]
    has_area = (sides[:, 0, 0] * sides[:, 1, 1] != sides[:, 0, 1] * sides[:, 1, 0])[owner]
    y = row + 0.5
    for corner in range(3):
        a, b = corners[:, corner, :2], corners[:, (corner + 1) % 3, :2]
        upside = (a[:, 1] > b[:, 1]) | ((a[:, 1] == b[:, 1]) & (a[:, 0] > b[:, 0]))
        start, end = np.where(upside[:, None], b, a)[owner], np.where(upside[:, None], a, b)[owner]
        height = end[:, 1] - start[:, 1]
        crosses = (start[:, 1] <= y) & (y <= end[:, 1]) & (height > 0) & has_area
        with np.errstate(divide="ignore", invalid="ignore"):
            x = start[:, 0] + (end[:, 0] - start[:, 0]) * ((y - start[:, 1]) / height)
        enter = np.where(crosses, np.minimum(enter, x), enter)
        leave = np.where(crosses, np.maximum(leave, x), leave)
    found = np.flatnonzero(enter <= leave)
    owner, row = owner[found], row[found]
    left = np.clip(np.ceil(enter[found] - 0.5), 0, width).astype(np.int64)
    right = np.clip(np.floor(leave[found] - 0.5) + 1, 0, width).astype(np.int64)
    which, column = _counted_out((right - left).clip(min=0))
    column += left[which]
    owner, row = owner[which], row[which]
    slope = _slopes(corners)[owner]
    start = corners[:, 0][owner]
    depth = start[:, 2] + slope[:, 0] * (column + 0.5 - start[:, 0]) + slope[:, 1] * (row + 0.5 - start[:, 1])
    # The slope of a face that is seen edge-on is steep and not to be trusted.
    depths = corners[:, :, 2]
    return owner, column, row, np.clip(depth, depths.min(axis=1)[owner], depths.max(axis=1)[owner])


def _counted_out(counts: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return each index as often as its count says, and beside it 0, 1, 2, ..."""
    owner = np.repeat(np.arange(len(counts)), counts)
    before = np.cumsum(counts) - counts
    return owner, np.arange(len(owner)) - before[owner]


def _slopes(corners: Float) -> Float:
    """Return how depth changes with column and row in each face (F, 2); 0 for faces seen edge-on."""
    along, across = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = along[:, 0] * across[:, 1] - along[:, 1] * across[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        made = np.stack(
            [
                (along[:, 2] * across[:, 1] - across[:, 2] * along[:, 1]) / area,
                (across[:, 2] * along[:, 0] - along[:, 2] * across[:, 0]) / area,
            ],
            axis=1,
        )
    return np.where(np.isfinite(made), made, 0.0)


def edge_functions(corners: Float, x: Float, y: Float) -> Float:
    """Return twice the area that points (F, N) span with the side opposite to each corner (Pineda 1988): (3, F, N)."""
    made = np.empty((3, *x.shape))
    for corner in range(3):
        a, b = corners[:, (corner + 1) % 3, :, None], corners[:, (corner + 2) % 3, :, None]
        made[corner] = (b[:, 0] - a[:, 0]) * (y - a[:, 1]) - (b[:, 1] - a[:, 1]) * (x - a[:, 0])
    return made
