"""Surfaces as Nastran bulk data (MSC Nastran Quick Reference Guide): CTRIA3 shells, a property for each tissue."""

from __future__ import annotations

from collections.abc import Sequence
from typing import BinaryIO

import numpy as np

from vhp_cli.formats.surfaces.named import UNIT_WORDS, NamedSurface, combined
from vhp_cli.formats.volume.nastran import NAMING, grid_template, write_head, write_placeholder_material
from vhp_cli.formats.volume.regions import valid_names
from vhp_cli.formats.volume.text import counting, write_rows
from vhp_cli.mesh import Mesh


def write(file: BinaryIO, surfaces: Sequence[NamedSurface], unit: str) -> None:
    """Write the combined mesh (thesis eq. 2.16): GRID* of 16 characters a coordinate, CTRIA3 with the tissue as PID.

    A comment ``$ PID 3 = liver`` names each property. Coordinates are rounded to as many decimals as
    fit into the field. Thickness and material of the shells are placeholders.

    Raises
    ------
    FormatLimit
        If there are more vertices or faces than a field numbers, or a coordinate is too large.
    """
    mesh = combined(surfaces)
    grid = grid_template(mesh.vertices, unit)
    write_head(file, UNIT_WORDS[unit])
    names = valid_names([surface.name for surface in surfaces], NAMING)
    for number, name in enumerate(names, start=1):
        file.write(f"$ PID {number} = {name}\n".encode("ascii"))
        file.write(f"PSHELL  {number:8d}{number:8d}     1.0\n".encode("ascii"))
        write_placeholder_material(file, number)
    # Adding zero turns -0.0 into 0.0.
    write_rows(file, grid, counting(len(mesh.vertices)), mesh.vertices + 0.0)
    write_rows(file, "CTRIA3  %8d%8d%8d%8d%8d\n", counting(len(mesh.faces)), mesh.tissue, mesh.faces.astype("i8") + 1)
    file.write(b"ENDDATA\n")


def parse(data: bytes) -> list[Mesh]:
    """Return the meshes of a file that `write` made of meshes without unused vertices, in the order of properties.

    Raises
    ------
    ValueError
        If the file is not of this form.
    """
    lines = data.decode("ascii").split("\n")
    properties = sum(line.startswith("PSHELL") for line in lines)
    first = [line for line in lines if line.startswith("GRID*")]
    second = [line for line in lines if line.startswith("*")]
    faces = [line for line in lines if line.startswith("CTRIA3")]
    if len(first) != len(second) or lines[-2:] != ["ENDDATA", ""]:
        raise ValueError("the file was cut short")
    vertices = np.array(
        [(float(a[40:56]), float(a[56:72]), float(b[8:24])) for a, b in zip(first, second, strict=True)]
    ).reshape(-1, 3)
    rows = np.array([[int(line[8 * k : 8 * k + 8]) for k in range(2, 6)] for line in faces], np.int64).reshape(-1, 4)
    meshes = []
    start = 0
    for number in range(1, properties + 1):
        mine = rows[rows[:, 0] == number, 1:] - 1
        stop = int(mine.max(initial=start - 1)) + 1
        meshes.append(Mesh(vertices[start:stop], (mine - start).astype(np.int32)))
        start = stop
    return meshes
