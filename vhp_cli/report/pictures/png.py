"""PNG files: of colours, or of numbers into a table of colours."""

from __future__ import annotations

import struct
import zlib

import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]


def png_bytes(pixels: Bytes, palette: Bytes | None = None) -> bytes:
    """Return a PNG file (ISO/IEC 15948).

    Parameters
    ----------
    pixels : (H, W, 4) or (H, W) uint8
        Red, green, blue and opacity; or with a palette, rows of it.
    palette : (N, 4) uint8
        At most 256 colours.

    Raises
    ------
    ValueError
        If a shape is wrong.
    """
    if pixels.ndim != (3 if palette is None else 2) or (palette is None and pixels.shape[2] != 4):
        raise ValueError(f"pixels must not have shape {pixels.shape}")
    height, width = pixels.shape[:2]
    rows = pixels.reshape(height, -1)
    chunks = []
    if palette is not None:
        if not 0 < len(palette) <= 256:
            raise ValueError(f"a palette holds 1 to 256 colours, not {len(palette)}")
        chunks = [(b"PLTE", palette[:, :3].tobytes()), (b"tRNS", palette[:, 3].tobytes())]
        # Numbers of colours have no slope: no filter.
        filtered = np.concatenate((np.zeros((height, 1), np.uint8), rows), axis=1)
    else:
        # Filter 2: the difference from the row above.
        above = np.concatenate((np.zeros((1, rows.shape[1]), np.uint8), rows[:-1]))
        filtered = np.concatenate((np.full((height, 1), 2, np.uint8), rows - above), axis=1)
    header = struct.pack(">IIBBBBB", width, height, 8, 6 if palette is None else 3, 0, 0, 0)
    data = zlib.compress(filtered.tobytes(), 6)
    made = [_chunk(kind, content) for kind, content in ((b"IHDR", header), *chunks, (b"IDAT", data), (b"IEND", b""))]
    return b"\x89PNG\r\n\x1a\n" + b"".join(made)


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
