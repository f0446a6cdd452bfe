"""Animated pictures in the Graphics Interchange Format, version 89a (CompuServe 1990)."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]

# Codes have 12 bits at most; then the table begins anew.
_MOST_CODES = 4096
_BLOCK = 255


def gif_bytes(pictures: Sequence[tuple[Bytes, int]], palette: Bytes) -> bytes:
    """Return an animation that repeats for ever.

    Parameters
    ----------
    pictures
        Each with the time that it stays in hundredths of a second: (H, W) uint8, rows of the palette.
    palette : (N, 3) uint8
        Red, green and blue of at most 256 colours.

    Raises
    ------
    ValueError
        If there is no picture, or a shape or the palette does not fit.
    """
    if not pictures or not 0 < len(palette) <= 256:
        raise ValueError("a GIF needs a picture and 1 to 256 colours")
    height, width = pictures[0][0].shape
    bits = max(2, int(len(palette) - 1).bit_length())
    table = np.zeros((2**bits, 3), np.uint8)
    table[: len(palette)] = palette
    parts = [
        b"GIF89a",
        struct.pack("<HHBBB", width, height, 0xF0 | (bits - 1), 0, 0),
        table.tobytes(),
        b"\x21\xff\x0bNETSCAPE2.0\x03\x01\x00\x00\x00",
    ]
    # Many pictures are shown twice, on the way in and on the way out.
    known: dict[bytes, bytes] = {}
    for pixels, delay in pictures:
        if pixels.shape != (height, width) or int(pixels.max()) >= len(palette):
            raise ValueError("the pictures of a GIF have one size, and colours of its palette")
        raw = np.ascontiguousarray(pixels, dtype=np.uint8).tobytes()
        if raw not in known:
            known[raw] = _compressed(raw, bits)
        parts += [
            struct.pack("<BBBBHBB", 0x21, 0xF9, 4, 4, delay, 0, 0),
            struct.pack("<BHHHHB", 0x2C, 0, 0, width, height, 0),
            known[raw],
        ]
    return b"".join([*parts, b"\x3b"])


def _compressed(pixels: bytes, bits: int) -> bytes:
    """Return the picture data: by Lempel, Ziv and Welch (1984), in blocks."""
    packed = bytearray()
    held, count = 0, 0
    for code, size in _codes(pixels, bits):
        held |= code << count
        count += size
        while count >= 8:
            packed.append(held & 0xFF)
            held >>= 8
            count -= 8
    if count:
        packed.append(held)
    blocks = (packed[i : i + _BLOCK] for i in range(0, len(packed), _BLOCK))
    return bytes([bits]) + b"".join(bytes([len(block)]) + block for block in blocks) + b"\x00"


def _codes(pixels: bytes, bits: int) -> Iterator[tuple[int, int]]:
    """Give each code and its size in bits."""
    clear, end = 1 << bits, (1 << bits) + 1
    size, following = bits + 1, end + 1
    # A string is known by the code of all but its last pixel, and that.
    table: dict[int, int] = {}
    yield clear, size
    current = pixels[0]
    for pixel in pixels[1:]:
        key = current << 8 | pixel
        known = table.get(key)
        if known is not None:
            current = known
            continue
        yield current, size
        if following < _MOST_CODES:
            table[key] = following
            if following == 1 << size:
                size += 1
            following += 1
        else:
            yield clear, size
            table.clear()
            size, following = bits + 1, end + 1
        current = pixel
    yield current, size
    # The reader adds an entry for every code, the last one too.
    if following == 1 << size and size < 12:
        size += 1
    yield end, size
