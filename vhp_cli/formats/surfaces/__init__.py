"""Files of tissue surfaces for other programs: one module per format, behind a registry by name.

Some formats hold one tissue a file, others the whole model. Coordinates are written as they are, in the unit that is
named; vertices and faces keep their order.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import BinaryIO, Literal

import numpy as np

from vhp_cli.errors import UsageError, VhpError
from vhp_cli.formats.atomic import write_atomically
from vhp_cli.formats.obj import obj_bytes
from vhp_cli.formats.ply import ply_bytes
from vhp_cli.formats.reading import LARGEST
from vhp_cli.formats.stl import stl_bytes
from vhp_cli.formats.surfaces import matlab, nastran, threemf, vtp
from vhp_cli.formats.surfaces.named import UNIT_WORDS, NamedSurface
from vhp_cli.formats.volume.regions import FormatLimit

__all__ = ["FORMS", "UNIT_WORDS", "Form", "NamedSurface", "check_forms", "write_surfaces"]

Scope = Literal["tissue", "model"]
Writer = Callable[[BinaryIO, Sequence[NamedSurface], str], None]


@dataclass(frozen=True, slots=True)
class Form:
    """A format of surfaces.

    Parameters
    ----------
    suffix
        Of its files, with the dot.
    scope
        Whether a file holds one tissue or the whole model.
    writer
        Writes surfaces, of which there is one for the scope ``"tissue"``, in a unit of `UNIT_WORDS`.
    description
        What it is and who reads it, in one clause.
    single
        Whether coordinates are rounded to float32.
    """

    suffix: str
    scope: Scope
    writer: Writer
    description: str
    single: bool = False


def _one(make: Callable[..., bytes]) -> Writer:
    def write(file: BinaryIO, surfaces: Sequence[NamedSurface], unit: str) -> None:
        (surface,) = surfaces
        file.write(make(surface.mesh, UNIT_WORDS[unit]))

    return write


FORMS: Mapping[str, Form] = MappingProxyType(
    {
        "stl": Form(".stl", "tissue", _one(stl_bytes), "binary STL, float32: every CAD program", single=True),
        "ply": Form(".ply", "tissue", _one(ply_bytes), "binary PLY"),
        "obj": Form(".obj", "tissue", _one(obj_bytes), "Wavefront OBJ, as text"),
        "mat": Form(".mat", "tissue", matlab.write_one, "MATLAB 5: P, t (1-based), normals"),
        "mat-all": Form(".mat", "model", matlab.write_all, "MATLAB 5: all tissues in one P and t, with their index"),
        "3mf": Form(".3mf", "model", threemf.write, "3MF core: printers, CAD; an object for each tissue"),
        "bdf": Form(".bdf", "model", nastran.write, "Nastran bulk data, CTRIA3, a PID for each tissue"),
        "nas": Form(".nas", "model", nastran.write, "Nastran bulk data under the suffix that COMSOL asks for"),
        "vtp": Form(".vtp", "model", vtp.write, "VTK polygons: ParaView, PyVista"),
    }
)


def check_forms(forms: Sequence[str]) -> None:
    """Refuse formats that are not known, by `UsageError`."""
    for form in forms:
        if form not in FORMS:
            raise UsageError(f"no such format of surfaces: {form!r}", hint=f"known: {', '.join(FORMS)}")


def write_surfaces(path: Path, surfaces: Sequence[NamedSurface], form: str, unit: str = "mm") -> None:
    """Write one tissue or a model; the file appears whole or not at all, the same bytes for the same surfaces.

    Parameters
    ----------
    path
        Final name; an existing file is replaced.
    surfaces
        One, or for formats of the scope ``"model"`` any number.
    form
        Key of `FORMS`.
    unit
        Of the coordinates, key of `UNIT_WORDS`.

    Raises
    ------
    UsageError
        If there is no such format.
    VhpError
        If a coordinate is not finite or beyond 1e30, the format can't hold the surfaces, or the file system refuses.
    """
    check_forms([form])
    for surface in surfaces:
        wild = ~(np.abs(surface.mesh.vertices) <= LARGEST).all(axis=1)
        if wild.any():
            vertex = int(np.flatnonzero(wild)[0])
            raise VhpError(f"can't write {path}: vertex {vertex} of {surface.name} is not finite or beyond 1e30")
    try:
        write_atomically(path, lambda file: FORMS[form].writer(file, surfaces, unit))
    except FormatLimit as error:
        raise VhpError(f"can't write {path}: {error}") from error
