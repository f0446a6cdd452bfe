"""Nastran bulk data (MSC Nastran Quick Reference Guide): a solid property and a material per label.

COMSOL reads the same file; it parts the domains by material, so each label has one of its own.
"""

from __future__ import annotations

from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from vhp_cli.formats.volume.regions import FormatLimit, Naming, Region, numbers_of
from vhp_cli.formats.volume.text import counting, write_rows
from vhp_cli.volume import VolumeMesh

# Names stand in comments, of lines of 80 characters.
NAMING = Naming(r"[^\x20-\x7e]", 48)
_LARGEST_NUMBER = 10**8 - 1  # of a field of 8 characters
_LARGEST_COORDINATE = 1e12  # of a field of 16 characters, with a decimal


def write(file: BinaryIO, mesh: VolumeMesh, regions: tuple[Region, ...]) -> None:
    """Write points as GRID* of 16 characters a coordinate, and tetrahedra as CTETRA with the label as property.

    Coordinates are rounded to at least 9 decimals where all lie within 10 m. The materials are placeholders.

    Raises
    ------
    FormatLimit
        If there are more points or tetrahedra than a field holds, or a coordinate is too large.
    """
    if max(len(mesh.points), len(mesh.tetrahedra)) > _LARGEST_NUMBER:
        raise FormatLimit(f"Nastran numbers of 8 digits end at {_LARGEST_NUMBER}")
    grid = grid_template(mesh.points)
    write_head(file, "millimetres")
    for region in regions:
        if region.count:
            number = region.number
            file.write(f"$ PID {number} = {region.written}\n".encode("ascii"))
            file.write(f"PSOLID  {number:8d}{number:8d}\n".encode("ascii"))
            write_placeholder_material(file, number)
    # Adding zero turns -0.0 into 0.0.
    write_rows(file, grid, counting(len(mesh.points)), mesh.points + 0.0)
    numbers = numbers_of(mesh)
    write_rows(
        file, "CTETRA  %8d%8d%8d%8d%8d%8d\n", counting(len(mesh.tetrahedra)), numbers, mesh.tetrahedra.astype("i8") + 1
    )
    file.write(b"ENDDATA\n")


def write_head(file: BinaryIO, unit: str) -> None:
    """Write what a file begins with; `unit` is that of the coordinates, in words."""
    file.write(f"$ vhp, {unit}\nSOL 101\nCEND\nBEGIN BULK\n".encode("ascii"))


def write_placeholder_material(file: BinaryIO, number: int) -> None:
    """Write a material: Young's modulus and Poisson's ratio must be there; what they are is up to the user."""
    file.write(f"MAT1    {number:8d}     1.0             0.3\n".encode("ascii"))


def grid_template(points: NDArray[np.float64], unit: str = "mm") -> str:
    """Return the GRID* card of a point as a template of its number and coordinates, with all decimals that fit.

    Raises
    ------
    FormatLimit
        If there are more points than a field numbers, or a coordinate is too large for one.
    """
    if len(points) > _LARGEST_NUMBER:
        raise FormatLimit(f"Nastran numbers of 8 digits end at {_LARGEST_NUMBER}")
    largest = float(np.abs(points).max(initial=0.0))
    if not largest < _LARGEST_COORDINATE:
        raise FormatLimit(f"a coordinate is beyond 1e12 {unit}, too large for a Nastran field")
    # A sign, the digits before the point, and the point; one more digit may come from rounding up.
    decimals = 16 - 2 - max(len(str(int(largest + 1))), 1)
    coordinate = f"%16.{decimals}f"
    return f"GRID*   %16d{'':16}{coordinate}{coordinate}\n*       {coordinate}\n"
