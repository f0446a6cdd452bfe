"""Surfaces as a short text that a browser unpacks with what it has built in."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vhp_cli.report.html.thinning import Thinned

_LEVELS = 65535  # of a coordinate, over the longest side of the tissue's box
_MORTON_BITS = 10


@dataclass(frozen=True, slots=True)
class Packed:
    """Surfaces as text.

    Parameters
    ----------
    text
        Base64 of the deflated bytes: planes of bytes of positions, of corners and of qualities; see `pack`.
    tissues
        Of each: ``low`` (3) and ``step`` in mm (a coordinate is low + step times a whole number), numbers of
        ``vertices`` and ``faces``.
    """

    text: str
    tissues: list[dict[str, object]]


def pack(surfaces: Sequence[Thinned]) -> Packed:
    """Pack surfaces.

    Faces follow a curve through space, and vertices the faces. The stream of all tissues holds, one after another:
    positions as differences from the vertex before, modulo 2**16 and with the sign in the lowest bit, low bytes of
    x, y, z, then their high bytes; corners as differences from the next vertex that no face has used yet (Guthe &
    Goetz 2005), in three planes; ``round(255 sqrt(q))`` of each face.

    Parameters
    ----------
    surfaces
        Of the tissues, in order.
    """
    places, corners, qualities, tissues = [], [], [], []
    for surface in surfaces:
        vertices, faces, q = _in_order(surface)
        low, step = np.zeros(3), 1.0
        if len(vertices):
            low = vertices.min(axis=0)
            step = float(np.ptp(vertices, axis=0).max()) / _LEVELS or 1.0
        levels = np.rint((vertices - low) / step).astype(np.int64)
        change = np.diff(levels, axis=0, prepend=0).astype(np.uint16).astype(np.int16)
        places.append(((change.astype(np.int32) << 1) ^ (change.astype(np.int32) >> 15)).astype(np.uint16))
        used = np.maximum.accumulate(faces.ravel(), axis=0) if len(faces) else faces.ravel()
        corners.append(np.concatenate(([0], used + 1))[: len(used)] - faces.ravel())
        qualities.append(np.rint(255.0 * np.sqrt(q)).astype(np.uint8))
        tissues.append({"low": low.tolist(), "step": step, "vertices": len(vertices), "faces": len(faces)})
    place = np.concatenate(places) if places else np.empty((0, 3), np.uint16)
    corner = np.concatenate(corners) if corners else np.empty(0, np.int64)
    planes = [
        *((place[:, axis] & 255) for axis in range(3)),
        *((place[:, axis] >> 8) for axis in range(3)),
        *((corner >> shift) & 255 for shift in (0, 8, 16)),
        np.concatenate(qualities) if qualities else np.empty(0, np.uint8),
    ]
    raw = b"".join(plane.astype(np.uint8).tobytes() for plane in planes)
    return Packed(base64.b64encode(zlib.compress(raw, 6)).decode("ascii"), tissues)


def _in_order(surface: Thinned) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
    """Return vertices in use, faces and qualities in an order that follows the surface."""
    faces = surface.faces
    if not len(faces):
        return np.empty((0, 3)), np.empty((0, 3), np.int64), np.empty(0)
    middle = surface.vertices[faces].sum(axis=1)
    order = np.argsort(_morton(middle), kind="stable")
    faces = faces[order]
    used, first, number = np.unique(faces.ravel(), return_index=True, return_inverse=True)
    by_use = np.argsort(first, kind="stable")
    rank = np.empty(len(used), dtype=np.int64)
    rank[by_use] = np.arange(len(used))
    return surface.vertices[used[by_use]], rank[number].reshape(-1, 3), surface.q[order]


def _morton(points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return where points lie on a Z-curve through their box (Morton 1966)."""
    low = points.min(axis=0)
    size = float(np.ptp(points, axis=0).max()) or 1.0
    cell = ((points - low) / size * (2**_MORTON_BITS - 1)).astype(np.int64)
    code = np.zeros(len(points), dtype=np.int64)
    for bit in range(_MORTON_BITS):
        for axis in range(3):
            code |= ((cell[:, axis] >> bit) & 1) << (3 * bit + axis)
    return code
