"""VTK XML unstructured grid (VTK file formats, "XML file formats"): zlib-compressed binary data within the XML."""

from __future__ import annotations

import base64
import zlib
from typing import Any, BinaryIO
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from vhp_cli.formats.volume.regions import Naming, Region, numbers_of
from vhp_cli.volume import VolumeMesh

NAMING = Naming(r"[\x00-\x1f\x7f]", 255)
_TETRAHEDRON = 10
_BLOCK = 1 << 20
_TYPES = {"f8": "Float64", "i4": "Int32", "i8": "Int64", "u1": "UInt8"}


def write(file: BinaryIO, mesh: VolumeMesh, regions: tuple[Region, ...]) -> None:
    """Write the mesh with cell data ``label``; field data of a tissue's name holds the label that it stands for."""
    count = len(mesh.tetrahedra)
    file.write(
        b'<?xml version="1.0" encoding="UTF-8"?>\n'
        b'<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" header_type="UInt64" '
        b'compressor="vtkZLibDataCompressor">\n<UnstructuredGrid>\n<FieldData>\n'
    )
    for region in regions:
        if region.count:
            name = quoteattr(region.written)
            file.write(f'<DataArray type="Int32" Name={name} NumberOfTuples="1" format="ascii">'.encode())
            file.write(f"{region.number}</DataArray>\n".encode())
    file.write(f'</FieldData>\n<Piece NumberOfPoints="{len(mesh.points)}" NumberOfCells="{count}">\n'.encode())
    file.write(b"<Points>\n")
    write_array(file, "Points", mesh.points.astype("<f8"), components=3)
    file.write(b"</Points>\n<Cells>\n")
    write_array(file, "connectivity", mesh.tetrahedra.astype("<i4"))
    write_array(file, "offsets", np.arange(4, 4 * count + 1, 4, dtype="<i8"))
    write_array(file, "types", np.full(count, _TETRAHEDRON, dtype="u1"))
    file.write(b'</Cells>\n<CellData Scalars="label">\n')
    write_array(file, "label", numbers_of(mesh).astype("<i4"))
    file.write(b"</CellData>\n</Piece>\n</UnstructuredGrid>\n</VTKFile>\n")


def write_array(file: BinaryIO, name: str, values: NDArray[Any], components: int = 0) -> None:
    """Write a ``DataArray``; the file that it is in names zlib and headers of 8 bytes, as `write` does."""
    shape = f' NumberOfComponents="{components}"' if components else ""
    kind = _TYPES[values.dtype.str[1:]]
    file.write(f'<DataArray type="{kind}" Name="{name}"{shape} format="binary">\n'.encode())
    data = values.reshape(-1).view("u1").data
    blocks = [zlib.compress(data[start : start + _BLOCK]) for start in range(0, len(data), _BLOCK)]
    # Number and size of the blocks, size of the last one if it is smaller, and what each takes compressed.
    header = np.array([len(blocks), _BLOCK, len(data) % _BLOCK, *map(len, blocks)], dtype="<u8")
    # The header is encoded by itself, the blocks as one.
    file.write(base64.b64encode(header.tobytes()))
    file.write(base64.b64encode(b"".join(blocks)))
    file.write(b"\n</DataArray>\n")
