"""Tetrahedral mesh files: one module per format, behind a registry by name.

Every format stores points, tetrahedra, the label of each tetrahedron and the names of the labels, in mm. Labels are the
same numbers in all of them: those of the mesh, and for air (0 in the mesh) the number after the last name. A
tetrahedron keeps its number, its place in the mesh, where the format has numbers.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import BinaryIO

import numpy as np

from vhp_cli.errors import UsageError, VhpError
from vhp_cli.formats.atomic import write_atomically
from vhp_cli.formats.reading import LARGEST
from vhp_cli.formats.volume import abaqus, gmsh, matlab, med, nastran, vtu, xdmf
from vhp_cli.formats.volume.regions import FormatLimit, Naming, Region, regions_of
from vhp_cli.volume import VolumeMesh

__all__ = ["FORMS", "Form", "check_form", "write_volume", "written_names"]

Writer = Callable[[BinaryIO, VolumeMesh, tuple[Region, ...]], None]


@dataclass(frozen=True, slots=True)
class Form:
    """A format of tetrahedral meshes.

    Parameters
    ----------
    suffix
        Of its files, with the dot.
    writer
        Writes a mesh to an open binary file.
    naming
        What the format takes as name of a label.
    description
        What it is and who reads it, in one clause.
    library
        What has to be installed besides the dependencies of the package.
    """

    suffix: str
    writer: Writer
    naming: Naming
    description: str
    library: str = ""


FORMS: Mapping[str, Form] = MappingProxyType(
    {
        "vtu": Form(".vtu", vtu.write, vtu.NAMING, "VTK unstructured grid: ParaView, PyVista"),
        "msh": Form(".msh", gmsh.write_41, gmsh.NAMING, "Gmsh 4.1: Gmsh, GetDP, DOLFINx"),
        "msh22": Form(".msh", gmsh.write_22, gmsh.NAMING, "Gmsh 2.2: older readers of Gmsh files"),
        "bdf": Form(".bdf", nastran.write, nastran.NAMING, "Nastran bulk data, PID = label: Nastran, Ansys, HyperMesh"),
        "comsol": Form(
            ".nas", nastran.write, nastran.NAMING, "Nastran bulk data under the suffix that COMSOL asks for"
        ),
        "inp": Form(".inp", abaqus.write, abaqus.NAMING, "Abaqus, an ELSET for each label: Abaqus, CalculiX"),
        "med": Form(".med", med.write, med.NAMING, "MED 3.0 (HDF5; needs h5py): Salome, code_aster", "h5py"),
        "xdmf": Form(".xdmf", xdmf.write, xdmf.NAMING, "XDMF 3 with its data in the file: FEniCS, ParaView"),
        "mat": Form(".mat", matlab.write, matlab.NAMING, "MATLAB 5: P, t (1-based), label, names"),
    }
)


def check_form(form: str) -> None:
    """Refuse a format that can't be written here, before there is something to write.

    Raises
    ------
    UsageError
        If there is no such format, or the library that it needs is not installed.
    """
    if form not in FORMS:
        raise UsageError(f"no such format of tetrahedral meshes: {form}", hint=f"known: {', '.join(FORMS)}")
    library = FORMS[form].library
    if not library:
        return
    try:
        importlib.import_module(library)
    except ImportError as error:
        raise UsageError(
            f"the format {form} needs {library}, which can't be loaded: {error}",
            hint=f"pip install 'vhp-cli[{form}]', or choose another format",
        ) from error


def write_volume(path: Path, mesh: VolumeMesh, form: str) -> dict[str, str]:
    """Write a tetrahedral mesh; the file appears whole or not at all.

    Parameters
    ----------
    path
        Final name; an existing file is replaced.
    mesh
        The mesh, in mm. Names without tetrahedra are left out, except from ``mat``, where `names` is indexed.
    form
        Key of `FORMS`.

    Returns
    -------
    dict
        Name as written of each label that could not keep its name (``"air"`` of what has no tissue included), by its
        name in the mesh.

    Raises
    ------
    UsageError
        If there is no such format, or the library that it needs is not installed.
    VhpError
        If the mesh has no tetrahedra, a coordinate is not finite or beyond 1e30, the format can't hold the mesh, or
        the file system refuses.
    """
    path = Path(path)
    check_form(form)
    if not len(mesh.tetrahedra):
        raise VhpError(f"can't write {path}: the mesh has no tetrahedra")
    wild = ~(np.abs(mesh.points) <= LARGEST).all(axis=1)
    if wild.any():
        point = int(np.flatnonzero(wild)[0])
        raise VhpError(f"can't write {path}: point {point} is not finite or beyond 1e30 mm")
    regions = regions_of(mesh, FORMS[form].naming)
    try:
        write_atomically(path, lambda file: FORMS[form].writer(file, mesh, regions))
    except FormatLimit as error:
        raise VhpError(f"can't write {path}: {error}") from error
    return {region.name: region.written for region in regions if region.written != region.name}


def written_names(mesh: VolumeMesh, form: str) -> dict[int, str]:
    """Return the name of each label that has tetrahedra, by its number, both as a format stores them."""
    return {region.number: region.written for region in regions_of(mesh, FORMS[form].naming) if region.count}
