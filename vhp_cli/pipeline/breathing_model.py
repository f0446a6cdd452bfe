"""A model on its way through `breathe`: read, turned into LPS and mm, and turned back to be written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vhp_cli import formats
from vhp_cli.config import UNITS, Settings
from vhp_cli.errors import UnreadableFileError, UsageError
from vhp_cli.mesh import Mesh
from vhp_cli.model import Model, TissueFile
from vhp_cli.pipeline.output import output_files
from vhp_cli.stages.breathe.axes import Axes, recognise
from vhp_cli.stages.breathe.options import TISSUE_KEYS
from vhp_cli.stages.breathe.roles import Role, assign
from vhp_cli.stages.breathe.tissue import Tissue
from vhp_cli.stages.options import nearest

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """One tissue as its file has it.

    Parameters
    ----------
    file
        Where it is.
    place
        Where it goes below a frame's directory.
    mesh
        In the units and axes of the file.
    """

    file: TissueFile
    place: str
    mesh: Mesh


@dataclass(frozen=True, slots=True, eq=False)
class BreathingModel:
    """A model in its own frame and in LPS.

    Parameters
    ----------
    sources
        As read.
    tissues
        The same in LPS and mm, in the same order.
    axes
        How the model lies.
    mm_per_unit
        Of the files.
    roles
        By name.
    said
        What the settings say of each tissue.
    """

    sources: tuple[Source, ...]
    tissues: tuple[Tissue, ...]
    axes: Axes
    mm_per_unit: float
    roles: Mapping[str, Role]
    said: Mapping[str, Mapping[str, object]]

    def to_file(self, index: int, moved: Array) -> Mesh:
        """Return a tissue, moved in LPS, in the units and axes of its file; unmoved points keep their coordinates."""
        source, rest = self.sources[index], self.tissues[index].mesh.vertices
        if self.mm_per_unit == 1.0 and np.array_equal(self.axes.to_lps, np.eye(3)):
            return Mesh(moved, source.mesh.faces)
        steps = (moved - rest) @ self.axes.to_lps / self.mm_per_unit
        return Mesh(source.mesh.vertices + steps, source.mesh.faces)

    def from_file(self, mesh: Mesh) -> Array:
        """Return the vertices of a mesh in the units and axes of the files, in LPS and mm."""
        return to_lps(mesh, self.axes, self.mm_per_unit).vertices


def load_model(model: Model, settings: Settings, paths: Sequence[Path], jobs: int) -> BreathingModel:
    """Read every tissue of a model.

    Raises
    ------
    UsageError
        If a file can't be read, a tissue has no face, or names, settings or places do not fit together.
    """
    said = {tissue.name: _said(tissue.name, settings) for tissue in model.tissues}
    places = output_files(model, paths)
    tolerance = settings.weld_tolerance_mm / UNITS[settings.units]

    def read(tissue: TissueFile) -> formats.Reading | UnreadableFileError:
        try:
            return formats.read_mesh(tissue.path, weld_tolerance=tolerance)
        except UnreadableFileError as error:
            return error

    with ThreadPoolExecutor(jobs, thread_name_prefix="vhp") as executor:
        readings = list(executor.map(read, model.tissues))
    wrong = [f"{error.path}: {error.message}" for error in readings if isinstance(error, UnreadableFileError)]
    wrong += [
        f"{tissue.path}: no triangle"
        for tissue, reading in zip(model.tissues, readings, strict=True)
        if isinstance(reading, formats.Reading) and not len(reading.mesh.faces)
    ]
    if wrong:
        raise UsageError(
            "the whole model must be readable to prove that nothing collides:\n  " + "\n  ".join(wrong[:10]),
            hint="repair these files, or take them out of the model",
        )
    sources = tuple(
        Source(tissue, place, reading.mesh)
        for tissue, place, reading in zip(model.tissues, places, readings, strict=True)
        if isinstance(reading, formats.Reading)
    )
    names = [source.file.name for source in sources]
    types = {name: settings.tissue_type(name) for name in names}
    roles = assign(names, said, types)
    scale = UNITS[settings.units]
    raw = [Tissue.from_mesh(s.file.name, _scaled(s.mesh, scale), roles[s.file.name]) for s in sources]
    if not any(tissue.role.part == "lung" for tissue in raw):
        raise UsageError(
            "the model has no lungs",
            hint='say which tissue they are in vhp.toml: [[tissue]] match = "NAME" breathe = { role = "lung" }',
        )
    axes = recognise(raw)
    tissues = raw
    if not np.array_equal(axes.to_lps, np.eye(3)):
        tissues = [Tissue.from_mesh(s.file.name, to_lps(s.mesh, axes, scale), roles[s.file.name]) for s in sources]
    return BreathingModel(sources, tuple(tissues), axes, scale, roles, said)


def to_lps(mesh: Mesh, axes: Axes, mm_per_unit: float) -> Mesh:
    """Return a mesh in LPS and mm: exact but for the unit, as axes are only swapped and negated."""
    if np.array_equal(axes.to_lps, np.eye(3)):
        return _scaled(mesh, mm_per_unit)
    return Mesh((mesh.vertices * mm_per_unit) @ axes.to_lps.T, mesh.faces)


def _scaled(mesh: Mesh, factor: float) -> Mesh:
    return mesh if factor == 1.0 else Mesh(mesh.vertices * factor, mesh.faces)


def _said(name: str, settings: Settings) -> dict[str, object]:
    said: dict[str, object] = {}
    for where, table in settings.stage_tables("breathe", name):
        for key, value in table.items():
            if key not in TISSUE_KEYS:
                raise UsageError(f"{where}: {key!r} is not known{nearest(key, TISSUE_KEYS)}")
            said[key] = value
    return said
