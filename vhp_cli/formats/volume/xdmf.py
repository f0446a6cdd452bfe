"""XDMF 3 (XDMF Model and Format), with the numbers as text within the XML: one file, no HDF5."""

from __future__ import annotations

from typing import BinaryIO
from xml.sax.saxutils import escape, quoteattr

from vhp_cli.formats.volume.regions import Naming, Region, numbers_of
from vhp_cli.formats.volume.text import write_rows
from vhp_cli.volume import VolumeMesh

NAMING = Naming(r"[\x00-\x1f\x7f]", 255)


def write(file: BinaryIO, mesh: VolumeMesh, regions: tuple[Region, ...]) -> None:
    """Write the mesh with the cell attribute ``label``; names and labels stand in an Information element.

    Its text is XML again, ``<main><map key="name" dim="3">label</map></main>``, as meshio reads it.
    """
    n_points, count = len(mesh.points), len(mesh.tetrahedra)
    names = "".join(
        f'<map key={quoteattr(region.written)} dim="3">{region.number}</map>' for region in regions if region.count
    )
    file.write(
        b'<?xml version="1.0" encoding="UTF-8"?>\n<Xdmf Version="3.0">\n<Domain>\n'
        b'<Grid Name="mesh" GridType="Uniform">\n'
    )
    file.write(f'<Information Name="labels" Value="names">{escape(f"<main>{names}</main>")}</Information>\n'.encode())
    file.write(b'<Geometry GeometryType="XYZ">\n')
    file.write(f'<DataItem Format="XML" DataType="Float" Precision="8" Dimensions="{n_points} 3">\n'.encode())
    write_rows(file, "%r %r %r\n", mesh.points)
    file.write(b"</DataItem>\n</Geometry>\n")
    file.write(f'<Topology TopologyType="Tetrahedron" NumberOfElements="{count}">\n'.encode())
    file.write(f'<DataItem Format="XML" DataType="Int" Precision="4" Dimensions="{count} 4">\n'.encode())
    write_rows(file, "%d %d %d %d\n", mesh.tetrahedra)
    file.write(b'</DataItem>\n</Topology>\n<Attribute Name="label" AttributeType="Scalar" Center="Cell">\n')
    file.write(f'<DataItem Format="XML" DataType="Int" Precision="4" Dimensions="{count}">\n'.encode())
    write_rows(file, "%d\n", numbers_of(mesh))
    file.write(b"</DataItem>\n</Attribute>\n</Grid>\n</Domain>\n</Xdmf>\n")
