"""Surfaces as MATLAB level 5 MAT-files, in the arrays of the thesis (2.1): `P`, `t`, `normals`.

One tissue: `P` n x 3, `t` m x 3 (1-based), `normals` m x 3 (outward unit normals), `unit`. All tissues: the same of the
combined mesh (eq. 2.16), `tissue` m x 1 and `names` k x 1 cell, so that ``t(tissue == i, :)`` are the faces of
``names{i}``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import BinaryIO

import numpy as np

from vhp_cli.formats.normals import unit_normals
from vhp_cli.formats.surfaces.named import UNIT_WORDS, Combined, NamedSurface, combined
from vhp_cli.formats.volume.matlab import write_cells, write_head, write_numbers, write_text


def write_one(file: BinaryIO, surfaces: Sequence[NamedSurface], unit: str) -> None:
    """Write one tissue.

    Raises
    ------
    FormatLimit
        If an array takes more than 2 GiB.
    """
    (surface,) = surfaces
    _write_mesh(file, combined([surface]), unit)


def write_all(file: BinaryIO, surfaces: Sequence[NamedSurface], unit: str) -> None:
    """Write all tissues; errors as of `write_one`."""
    mesh = combined(surfaces)
    _write_mesh(file, mesh, unit)
    write_numbers(file, "tissue", mesh.tissue.astype("<i4")[:, None])
    write_cells(file, "names", [surface.name for surface in surfaces])


def _write_mesh(file: BinaryIO, mesh: Combined, unit: str) -> None:
    write_head(file, UNIT_WORDS[unit])
    write_numbers(file, "P", mesh.vertices.astype("<f8"))
    write_numbers(file, "t", mesh.faces.astype("<i4") + np.int32(1))
    write_numbers(file, "normals", unit_normals(mesh.vertices[mesh.faces]).astype("<f8"))
    write_text(file, "unit", unit)
