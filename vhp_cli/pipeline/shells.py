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
from vhp_cli.formats.atomic import make_directory, write_atomically
from vhp_cli.formats.npy import parse_values
from vhp_cli.measures import Report, ShellRecord
from vhp_cli.mesh import Mesh
from vhp_cli.model import find_model
from vhp_cli.pipeline.check import Progress, available_cores, check_model
from vhp_cli.pipeline.measuring import parse_in_mm, scaled
from vhp_cli.pipeline.output import sole_writer
from vhp_cli.pipeline.stage import Limits
from vhp_cli.processes import CallFailed, Child
from vhp_cli.processes.calling import Reason
from vhp_cli.rounding import file_unit
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


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why no shells were made: what a child process tells instead of raising, so that hint and reason get through."""

    message: str
    hint: str = ""
    reason: Reason | None = None

    def error(self) -> VhpError:
        """Return what to raise."""
        return CallFailed(self.reason, self.message) if self.reason else VhpError(self.message, hint=self.hint)


def work(
    mesh: Mesh,
    skin_mm: float,
    fat_mm: NDArray[np.float64],
    grid_mm: float | None,
    memory_gb: float | None,
    threads: int,
    unit_mm: float,
) -> list[Shell] | Refusal:
    """Make the shells, for files in a unit; what a child process runs."""
    try:
        with file_unit(unit_mm):
            return shells(mesh, skin_mm, fat_mm, grid_mm=grid_mm, memory_gb=memory_gb, threads=threads)
    except CallFailed as failed:
        return Refusal(failed.detail, reason=failed.reason)
    except VhpError as error:
        return Refusal(str(error), hint=error.hint)


def described(shell: Shell) -> ShellRecord:
    """Return what the report says of a shell."""
    median, p99, deepest = shell.depth
    return {
        "name": shell.name,
        "thickness_mm": {"min": shell.thickness_mm[0], "max": shell.thickness_mm[1]},
        "gap_mm": shell.gap_mm,
        "gap_xyz_mm": list(shell.gap_xyz_mm),
        "depth": {"min": shell.shallowest, "median": median, "p99": p99, "max": deepest},
        "ends": [
            {"area_mm2": end.area_mm2, "distance_mm": end.distance_mm, "xyz_mm": list(end.xyz_mm)} for end in shell.ends
        ],
        "dropped": [{"volume_mm3": piece.volume_mm3, "xyz_mm": list(piece.xyz_mm)} for piece in shell.dropped],
    }


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
    make_directory(out)
    if out.resolve() in source.resolve().parents:
        raise UsageError(f"{source} lies in the output directory {out}", hint="inputs are never written to")
    if any(out.iterdir()) and not overwrite:
        raise UsageError(f"{out} is not empty", hint="give another directory, or --overwrite")
    with sole_writer(out), Child(memory_gb=limits.memory_gb, name="the worker") as child:
        if progress:
            progress(COMMAND, 0, 1)
        timeout_s, threads = limits.timeout_for(len(data)), jobs or available_cores()
        unit = UNITS[settings.units]
        made: list[Shell] | Refusal = child.call(
            _WORK, mesh, skin_mm, thickness, grid_mm, limits.memory_gb, threads, unit, timeout_s=timeout_s
        )
        if isinstance(made, Refusal):
            raise made.error()
        suffix = source.suffix.lower()
        write_atomically(out / f"{SKIN}{suffix}", data)
        for shell in made:
            shown = scaled(shell.mesh, 1.0 / unit)
            path = out / f"{shell.name}{suffix}"
            write_atomically(path, formats.mesh_bytes(path, shown))
        if progress:
            progress(COMMAND, 1, 1)
    files = [out / f"{name}{suffix}" for name in (SKIN, *(shell.name for shell in made))]
    report = check_model(find_model(files), settings, paths=[out], jobs=jobs).report
    asked = {"skin": skin_mm, "fat": fat, "grid": grid_mm, "source": source.as_posix()}
    settings_of_run = {**report["settings"], COMMAND: asked}
    section = [described(shell) for shell in made]
    return Made({**report, "command": COMMAND, "settings": settings_of_run, "shells": section}, made)
