"""MED 3.0 (MED file format of Salome, on HDF5), by h5py: a family and a group per label."""

from __future__ import annotations

import importlib
from typing import Any, BinaryIO

import numpy as np

from vhp_cli.formats.volume.regions import Naming, Region, numbers_of
from vhp_cli.volume import VolumeMesh

_NAME_SIZE = 80  # of a group
NAMING = Naming(r"[^\x20-\x7e]", _NAME_SIZE)
_MESH = "mesh"
_STEP = "-0000000000000000001-0000000000000000001"  # neither time step nor iteration
_PROFILE = np.bytes_("MED_NO_PROFILE_INTERNAL")
# MED counts the first three corners the other way round, seen from the fourth.
_CORNERS = [0, 2, 1, 3]


def write(file: BinaryIO, mesh: VolumeMesh, regions: tuple[Region, ...]) -> None:
    """Write the mesh; the family of a tetrahedron is the negative of its label. Needs h5py."""
    h5py = importlib.import_module("h5py")
    # HDF5 seeks as it writes: the file is made in memory.
    with h5py.File("mesh.med", "w", driver="core", backing_store=False) as made:
        _fill(made, mesh, regions)
        made.flush()
        image = made.id.get_file_image()
    file.write(image)


def _fill(made: Any, mesh: VolumeMesh, regions: tuple[Region, ...]) -> None:
    _attributes(made.create_group("INFOS_GENERALES"), MAJ=3, MIN=0, REL=0)
    grid = made.create_group(f"ENS_MAA/{_MESH}")
    axes, unit = (np.bytes_("".join(f"{text:<16}" for text in texts)) for texts in ("XYZ", ["mm"] * 3))
    _attributes(grid, DIM=3, ESP=3, REP=0, UNT=np.bytes_(""), UNI=unit, SRT=1, NOM=axes, TYP=0)
    _attributes(grid, DES=np.bytes_("vhp, millimetres"))
    step = grid.create_group(_STEP)
    _attributes(step, CGT=1, NDT=-1, NOR=-1, PDT=-1.0)

    nodes = step.create_group("NOE")
    _attributes(nodes, CGT=1, CGS=1, PFL=_PROFILE)
    _dataset(nodes, "COO", mesh.points.ravel(order="F"), len(mesh.points))
    step.create_group("MAI").attrs["CGT"] = np.int32(1)
    cells = step.create_group("MAI/TE4")
    _attributes(cells, CGT=1, CGS=1, PFL=_PROFILE)
    corners = mesh.tetrahedra[:, _CORNERS] + np.int32(1)
    _dataset(cells, "NOD", corners.ravel(order="F"), len(mesh.tetrahedra))
    _dataset(cells, "FAM", -numbers_of(mesh), len(mesh.tetrahedra))

    families = made.create_group(f"FAS/{_MESH}")
    _attributes(families.create_group("FAMILLE_ZERO"), NUM=0)
    for region in regions:
        if region.count:
            family = families.create_group(f"ELEME/FAM_-{region.number}")
            _attributes(family, NUM=-region.number)
            group = family.create_group("GRO")
            _attributes(group, NBR=1)
            letters = np.frombuffer(region.written.encode("ascii").ljust(_NAME_SIZE, b"\0"), dtype="i1")
            group.create_dataset("NOM", (1,), dtype=f"{_NAME_SIZE}i1", track_times=False)[0] = letters


def _attributes(place: Any, **values: Any) -> None:
    for key, value in values.items():
        place.attrs[key] = np.int32(value) if isinstance(value, int) else value


def _dataset(place: Any, name: str, values: Any, count: int) -> None:
    _attributes(place.create_dataset(name, data=values, track_times=False), CGT=1, NBR=count)
