"""Abaqus input (Abaqus Analysis User's Guide, "Input syntax rules"): an element set per label."""

from __future__ import annotations

from typing import BinaryIO

import numpy as np

from vhp_cli.formats.volume.regions import Naming, Region, by_number
from vhp_cli.formats.volume.text import counting, write_rows
from vhp_cli.volume import VolumeMesh

# A label: a letter, then letters, digits and underscores, up to 80; upper and lower case are the same.
NAMING = Naming(r"[^A-Za-z0-9_]", 80, letter_first=True, ignores_case=True)


def write(file: BinaryIO, mesh: VolumeMesh, regions: tuple[Region, ...]) -> None:
    """Write the tetrahedra as C3D4, in one block for each label, with the numbers of their places in the mesh."""
    present = [region for region in regions if region.count]
    file.write(b"*HEADING\nvhp, millimetres\n")
    for region in present:
        name = region.name.encode("ascii", "backslashreplace").decode("ascii")
        file.write(f"** ELSET {region.written}: label {region.number}, {name!r}\n".encode("ascii"))
    file.write(b"*NODE\n")
    write_rows(file, "%d, %r, %r, %r\n", counting(len(mesh.points)), mesh.points)
    order = by_number(mesh)
    ends = np.cumsum([region.count for region in present]).tolist()
    for region, end in zip(present, ends, strict=True):
        block = order[end - region.count : end]
        file.write(f"*ELEMENT, TYPE=C3D4, ELSET={region.written}\n".encode("ascii"))
        write_rows(file, "%d, %d, %d, %d, %d\n", block + 1, mesh.tetrahedra[block] + 1)
