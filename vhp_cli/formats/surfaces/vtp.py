"""Surfaces as VTK XML polygons (VTK file formats, "XML file formats"): zlib-compressed binary data within the XML."""

from __future__ import annotations

from collections.abc import Sequence
from typing import BinaryIO
from xml.sax.saxutils import quoteattr

import numpy as np

from vhp_cli.formats.surfaces.named import NamedSurface, combined
from vhp_cli.formats.volume.vtu import write_array


def write(file: BinaryIO, surfaces: Sequence[NamedSurface], unit: str) -> None:
    """Write the combined mesh (thesis eq. 2.16) with cell data ``tissue``.

    Field data of a tissue's name holds the number that it stands for, as in the files of tetrahedra; a comment names
    the unit, for which VTK has no place.
    """
    mesh = combined(surfaces)
    file.write(
        b'<?xml version="1.0" encoding="UTF-8"?>\n'
        b'<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64" '
        b'compressor="vtkZLibDataCompressor">\n'
    )
    file.write(f"<!-- vhp, unit: {unit} -->\n<PolyData>\n<FieldData>\n".encode())
    for number, surface in enumerate(surfaces, start=1):
        name = quoteattr(surface.name)
        file.write(f'<DataArray type="Int32" Name={name} NumberOfTuples="1" format="ascii">'.encode())
        file.write(f"{number}</DataArray>\n".encode())
    count = len(mesh.faces)
    file.write(
        f'</FieldData>\n<Piece NumberOfPoints="{len(mesh.vertices)}" NumberOfVerts="0" NumberOfLines="0" '
        f'NumberOfStrips="0" NumberOfPolys="{count}">\n<Points>\n'.encode()
    )
    write_array(file, "Points", mesh.vertices.astype("<f8"), components=3)
    file.write(b"</Points>\n<Polys>\n")
    write_array(file, "connectivity", mesh.faces.astype("<i4"))
    write_array(file, "offsets", np.arange(3, 3 * count + 1, 3, dtype="<i8"))
    file.write(b'</Polys>\n<CellData Scalars="tissue">\n')
    write_array(file, "tissue", mesh.tissue.astype("<i4"))
    file.write(b"</CellData>\n</Piece>\n</PolyData>\n</VTKFile>\n")
