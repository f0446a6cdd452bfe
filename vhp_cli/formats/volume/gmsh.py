"""Gmsh MSH 4.1 and 2.2, ASCII (Gmsh reference manual, "MSH file format"): a volume and physical group per label."""

from __future__ import annotations

from typing import BinaryIO

import numpy as np

from vhp_cli.formats.volume.regions import Naming, Region, by_number, numbers_of
from vhp_cli.formats.volume.text import counting, write_rows
from vhp_cli.volume import VolumeMesh

# Gmsh reads a name between double quotes into 128 bytes.
# A backslash would escape the closing quote for some readers.
NAMING = Naming(r'["\\\x00-\x1f\x7f]', 127)
_TETRAHEDRON = 4


def write_41(file: BinaryIO, mesh: VolumeMesh, regions: tuple[Region, ...]) -> None:
    """Write MSH 4.1; tetrahedra lie together by label, but keep the numbers of their places in the mesh."""
    present = [region for region in regions if region.count]
    n_points, n_tetrahedra = len(mesh.points), len(mesh.tetrahedra)
    order = by_number(mesh)
    ends = np.cumsum([region.count for region in present])
    blocks = [order[end - region.count : end] for region, end in zip(present, ends.tolist(), strict=True)]

    file.write(b"$MeshFormat\n4.1 0 8\n$EndMeshFormat\n")
    _write_names(file, present)
    file.write(f"$Entities\n0 0 0 {len(present)}\n".encode())
    for region, block in zip(present, blocks, strict=True):
        corners = mesh.points[np.unique(mesh.tetrahedra[block])]
        box = " ".join(repr(value) for value in (*corners.min(axis=0).tolist(), *corners.max(axis=0).tolist()))
        # A volume: its number, box, one physical group, and no bounding surfaces.
        file.write(f"{region.number} {box} 1 {region.number} 0\n".encode())
    file.write(b"$EndEntities\n")
    # A point of several volumes can be listed in one only: all are listed in the first.
    file.write(f"$Nodes\n1 {n_points} 1 {n_points}\n3 {present[0].number} 0 {n_points}\n".encode())
    write_rows(file, "%d\n", counting(n_points))
    write_rows(file, "%r %r %r\n", mesh.points)
    file.write(f"$EndNodes\n$Elements\n{len(present)} {n_tetrahedra} 1 {n_tetrahedra}\n".encode())
    for region, block in zip(present, blocks, strict=True):
        file.write(f"3 {region.number} {_TETRAHEDRON} {region.count}\n".encode())
        write_rows(file, "%d %d %d %d %d\n", block + 1, mesh.tetrahedra[block] + 1)
    file.write(b"$EndElements\n")


def write_22(file: BinaryIO, mesh: VolumeMesh, regions: tuple[Region, ...]) -> None:
    """Write MSH 2.2; each tetrahedron carries its label as physical group and as volume."""
    numbers = numbers_of(mesh)
    file.write(b"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n")
    _write_names(file, [region for region in regions if region.count])
    file.write(f"$Nodes\n{len(mesh.points)}\n".encode())
    write_rows(file, "%d %r %r %r\n", counting(len(mesh.points)), mesh.points)
    file.write(f"$EndNodes\n$Elements\n{len(mesh.tetrahedra)}\n".encode())
    template = f"%d {_TETRAHEDRON} 2 %d %d %d %d %d %d\n"
    write_rows(file, template, counting(len(mesh.tetrahedra)), numbers, numbers, mesh.tetrahedra + 1)
    file.write(b"$EndElements\n")


def _write_names(file: BinaryIO, regions: list[Region]) -> None:
    file.write(f"$PhysicalNames\n{len(regions)}\n".encode())
    for region in regions:
        file.write(f'3 {region.number} "{region.written}"\n'.encode())
    file.write(b"$EndPhysicalNames\n")
