"""From the bytes of one file to everything measured on its tissue, the same way for every command."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from vhp_cli import formats
from vhp_cli.config import UNITS, Settings
from vhp_cli.errors import UnreadableFileError
from vhp_cli.formats.reading import Reading
from vhp_cli.inspection.tissue import ShapeLimits, Surface, inspect_nothing, inspect_tissue
from vhp_cli.measures import Defects, TissueMeasures
from vhp_cli.mesh import Mesh


@dataclass(frozen=True, slots=True)
class Issue:
    """What a reader said of a file, in the form in which it is kept."""

    rule: str
    count: int
    detail: str


def shape_limits(settings: Settings, name: str) -> ShapeLimits:
    """Return the limits below which shapes of a tissue are counted as defects."""
    return ShapeLimits(*(settings.rule(code, name).limit or 0.0 for code in ("Q001", "Q002", "X005")))


def geometry_key(settings: Settings) -> str:
    """Identify the settings that decide how coordinates are read."""
    return f"{settings.units} {settings.weld_tolerance_mm!r}"


def parse_in_mm(path: Path, data: bytes, settings: Settings) -> Reading:
    """Read a mesh from the bytes of a file, in mm.

    Raises
    ------
    UnreadableFileError
        If nothing in the file can be measured.
    """
    scale = UNITS[settings.units]
    reading = formats.parse_mesh(path, data, weld_tolerance=settings.weld_tolerance_mm / scale)
    return reading if scale == 1.0 else replace(reading, mesh=scaled(reading.mesh, scale))


def scaled(mesh: Mesh, factor: float) -> Mesh:
    """Return a mesh with all coordinates multiplied."""
    return Mesh(mesh.vertices * factor, mesh.faces)


def measure(reading: Reading, limits: ShapeLimits) -> tuple[TissueMeasures, Defects, Surface | None]:
    """Return what was measured and what is wrong, with faces numbered as in the file, and the surface itself."""
    if not len(reading.mesh.faces):
        return inspect_nothing(), {}, None
    measures, defects, surface = inspect_tissue(reading.mesh, limits, unreferenced=reading.unreferenced)
    for place in (place for defect in defects.values() for place in defect["places"]):
        if place["face"] is not None:
            place["face"] = number_in_file(reading.face_number, place["face"])
    return measures, defects, surface


def number_in_file(face_number: np.ndarray | None, face: int) -> int:
    """Return the number of a face as its file counts, where the reader left faces out or cut polygons."""
    return face if face_number is None else int(face_number[face])


def issues_of(reading: Reading) -> list[Issue]:
    """Return what the reader had to say."""
    return [Issue(issue.rule, issue.count, issue.detail) for issue in reading.issues]


def unreadable(error: UnreadableFileError) -> Issue:
    """Return the issue of a file that can't be read at all."""
    where = f" ({error.where})" if error.where else ""
    return Issue("F001", 1, f"{error.message}{where}" + (f"; {error.hint}" if error.hint else ""))
