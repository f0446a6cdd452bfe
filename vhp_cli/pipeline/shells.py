"""Read a skin, make its inner shells in a bounded child process, write all three, and check them."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vhp_cli import formats
from vhp_cli.config import UNITS, Settings
from vhp_cli.errors import UsageError, VhpError
from vhp_cli.formats.atomic import refused, write_atomically
from vhp_cli.formats.npy import parse_values
from vhp_cli.measures import Report
from vhp_cli.mesh import Mesh
from vhp_cli.model import find_model
from vhp_cli.pipeline.check import Progress, check_model
from vhp_cli.pipeline.measuring import parse_in_mm, scaled
from vhp_cli.pipeline.output import sole_writer
from vhp_cli.pipeline.stage import Limits
from vhp_cli.processes import Child
from vhp_cli.stages.shells.offsetting import Shell, shells
from vhp_cli.stages.shells.thickness import at_vertices, from_map, interpolated

COMMAND = "shells"
_WORK = "vhp_cli.pipeline.shells:work"
SKIN = "skin"


@dataclass(frozen=True, slots=True, eq=False)
class Made:
    """The report of the check of what was written, and the shells."""

    report: Report
    shells: Sequence[Shell]


def work(
    mesh: Mesh, skin_mm: float, fat_mm: NDArray[np.float64], grid_mm: float | None
) -> list[tuple[str, NDArray[np.float64], NDArray[np.int32], float, float]]:
    """Make the shells; what a child process runs."""
    found = shells(mesh, skin_mm, fat_mm, grid_mm=grid_mm)
    return [(one.name, one.mesh.vertices, one.mesh.faces, one.gap_mm, one.crumbs_mm3) for one in found]


def fat_thickness(text: str, mesh: Mesh) -> NDArray[np.float64]:
    """Return the thickness of the fat at each vertex of the skin (V,), as the command line says it.

    Parameters
    ----------
    text
        A number of mm; the path of a map (.toml); or of an array (.npy) with a number for each vertex or triangle.
    mesh
        The skin, in mm.

    Raises
    ------
    UsageError
        If it is none of these, or does not fit the skin.
    """
    path = Path(text)
    if path.suffix.lower() == ".npy":
        return at_vertices(mesh, parse_values(path, formats.read_bytes(path)), text)
    if path.suffix.lower() == ".toml":
        try:
            values = tomllib.loads(formats.read_bytes(path).decode("utf-8-sig"))
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise UsageError(f"{path}: not valid TOML: {error}") from error
        return interpolated(mesh, from_map(values, text))
    try:
        thickness = float(text)
    except ValueError:
        raise UsageError(f"--fat {text}: expected a number of mm, a .toml or an .npy file") from None
    return at_vertices(mesh, np.full(len(mesh.vertices), thickness), f"--fat {text}")


def make_shells(
    source: Path,
    out: Path,
    settings: Settings,
    *,
    skin_mm: float,
    fat: str,
    grid_mm: float | None = None,
    jobs: int | None = None,
    limits: Limits | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Made:
    """Make the shells of a skin and write them, with a copy of the skin, into a directory.

    Parameters
    ----------
    source
        The skin's file.
    out
        The directory to write to.
    settings
        How files are read, and how the result is judged.
    skin_mm, grid_mm
        As of `vhp_cli.stages.shells.shells`.
    fat
        As of `fat_thickness`.
    jobs, limits, progress
        As of `vhp_cli.pipeline.stage.run_stage`.
    overwrite
        Write into a directory that is not empty.

    Raises
    ------
    UsageError
        If a setting is wrong or the directory can't be used.
    VhpError
        If the skin can't be read or is not sound, or there is no room for the shells.
    CallFailed
        If a limit was broken.
    """
    limits = limits or Limits()
    data = formats.read_bytes(source)
    mesh = parse_in_mm(source, data, settings).mesh
    if not len(mesh.faces):
        raise VhpError(f"{source}: no triangle in the file")
    thickness = fat_thickness(fat, mesh)
    try:
        out.mkdir(parents=True, exist_ok=True)
        occupied = any(out.iterdir())
    except OSError as error:
        raise refused(out, error) from error
    if out.resolve() in source.resolve().parents:
        raise UsageError(f"{source} lies in the output directory {out}", hint="inputs are never written to")
    if occupied and not overwrite:
        raise UsageError(f"{out} is not empty", hint="give another directory, or --overwrite")
    with sole_writer(out), Child(memory_gb=limits.memory_gb, name="the worker") as child:
        if progress:
            progress(COMMAND, 0, 1)
        found = child.call(_WORK, mesh, skin_mm, thickness, grid_mm, timeout_s=limits.timeout_for(len(data)))
        made = [Shell(name, Mesh(vertices, faces), gap, crumbs) for name, vertices, faces, gap, crumbs in found]
        suffix = source.suffix.lower()
        write_atomically(out / f"{SKIN}{suffix}", data)
        for shell in made:
            shown = scaled(shell.mesh, 1.0 / UNITS[settings.units])
            path = out / f"{shell.name}{suffix}"
            write_atomically(path, formats.mesh_bytes(path, shown))
        if progress:
            progress(COMMAND, 1, 1)
    files = [out / f"{name}{suffix}" for name in (SKIN, *(shell.name for shell in made))]
    report = check_model(find_model(files), settings, paths=[out], jobs=jobs).report
    described = {"skin": skin_mm, "fat": fat, "grid": grid_mm, "source": source.as_posix()}
    return Made({**report, "command": COMMAND, "settings": {**report["settings"], COMMAND: described}}, made)
