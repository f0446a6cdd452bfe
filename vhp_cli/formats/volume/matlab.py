"""MATLAB level 5 MAT-file (MathWorks, "MAT-File Format"), uncompressed.

Load it with ``load('mesh.mat')``: `P` n x 3 in mm, `t` m x 4 (1-based), `label` m x 1, `names` k x 1 cell, so that
``names{label(i)}`` is the tissue of tetrahedron i, and ``triangulation(t, P)`` shows the mesh. All numbers are doubles
there; whole ones are stored in 4 bytes.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from vhp_cli.formats.volume.regions import FormatLimit, Naming, Region, numbers_of
from vhp_cli.volume import VolumeMesh

NAMING = Naming(r"[\x00-\x1f\x7f]", 4096)
# Types of data elements, and classes of arrays.
_INT8, _INT32, _UINT16, _UINT32, _DOUBLE, _MATRIX, _UTF16 = 1, 5, 4, 6, 9, 14, 17
_CELL_CLASS, _CHAR_CLASS, _DOUBLE_CLASS = 1, 4, 6
_STORED = {"<f8": _DOUBLE, "<i4": _INT32}
_LARGEST = 2**31 - 1  # bytes of a variable


def write(file: BinaryIO, mesh: VolumeMesh, regions: tuple[Region, ...]) -> None:
    """Write `P`, `t`, `label` and `names`.

    Raises
    ------
    FormatLimit
        If an array takes more than 2 GiB.
    """
    write_head(file, "millimetres")
    write_numbers(file, "P", mesh.points.astype("<f8"))
    write_numbers(file, "t", mesh.tetrahedra.astype("<i4") + np.int32(1))
    write_numbers(file, "label", numbers_of(mesh).astype("<i4")[:, None])
    write_cells(file, "names", [region.written for region in regions])


def write_head(file: BinaryIO, unit: str) -> None:
    """Write what a file begins with; `unit` is that of the coordinates, in words."""
    # No date in the text, so that the same mesh gives the same bytes; then the version and the byte order.
    text = f"MATLAB 5.0 MAT-file, vhp, {unit}".encode("ascii")
    file.write(text.ljust(116) + bytes(8) + struct.pack("<H2s", 0x0100, b"IM"))


def write_cells(file: BinaryIO, name: str, texts: Sequence[str]) -> None:
    """Write a column of texts as a cell array."""
    cells = b"".join(_text(text) for text in texts)
    file.write(_tagged(_MATRIX, _head(_CELL_CLASS, (len(texts), 1), name) + cells))


def write_text(file: BinaryIO, name: str, text: str) -> None:
    """Write one text as a row of characters."""
    file.write(_text(text, name))


def write_numbers(file: BinaryIO, name: str, values: NDArray[Any]) -> None:
    """Write a matrix of ``<f8`` or ``<i4`` numbers, (N, K).

    Raises
    ------
    FormatLimit
        If it takes more than 2 GiB.
    """
    head = _head(_DOUBLE_CLASS, values.shape, name)
    length = len(head) + 8 + values.nbytes + -values.nbytes % 8
    if length > _LARGEST:
        raise FormatLimit(f"the array {name} takes more than 2 GiB, too much for a MATLAB 5 file")
    file.write(struct.pack("<II", _MATRIX, length) + head)
    file.write(struct.pack("<II", _STORED[values.dtype.str], values.nbytes))
    # Column by column.
    for column in values.T:
        file.write(np.ascontiguousarray(column).tobytes())
    file.write(bytes(-values.nbytes % 8))


def _text(text: str, name: str = "") -> bytes:
    letters = text.encode("utf-16-le")
    # Readers take plain numbers of 2 bytes best, but not for letters beyond ASCII.
    kind = _UINT16 if text.isascii() else _UTF16
    return _tagged(_MATRIX, _head(_CHAR_CLASS, (1, len(letters) // 2), name) + _tagged(kind, letters))


def _head(array_class: int, shape: tuple[int, ...], name: str) -> bytes:
    return (
        _tagged(_UINT32, struct.pack("<II", array_class, 0))
        + _tagged(_INT32, struct.pack("<2i", *shape))
        + _tagged(_INT8, name.encode("ascii"))
    )


def _tagged(kind: int, data: bytes) -> bytes:
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)
