"""The surfaces that a report is about, read again for its pictures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from vhp_cli import formats
from vhp_cli.config import UNITS
from vhp_cli.errors import UnreadableFileError, UsageError
from vhp_cli.measures import Report, TissueRecord
from vhp_cli.model import find_model
from vhp_cli.pipeline.measuring import scaled
from vhp_cli.report.html import Shown, Surfaces


def surfaces_of(report: Report, base: str) -> Surfaces:
    """Return a function that reads the surface of a tissue of the report.

    A file is looked for in `base`, then where the report says that the model is. Only the bytes that the report is
    about are shown: a file with another hash is not.

    Parameters
    ----------
    report
        Any report.
    base
        Directory of the results, ending in ``/``; or of the model; or empty.
    """
    files = _files_of_model(report)
    settings = report["settings"]
    scale = UNITS.get(str(settings.get("units", report["model"].get("units", "mm"))), 1.0)
    tolerance = settings.get("weld_tolerance_mm")
    weld = float(tolerance) / scale if isinstance(tolerance, (int, float)) else 0.0

    def surface(tissue: TissueRecord) -> Shown | str:
        if not tissue["sha256"]:
            return "could not be read"
        candidates = [Path(base + tissue["file"])] if base else []
        candidates += [files[tissue["file"]]] if tissue["file"] in files else []
        said = "its file was not found"
        for path in candidates:
            if not path.exists():
                continue
            try:
                data = formats.read_bytes(path)
                if formats.sha256(data) != tissue["sha256"]:
                    said = "its file is another one by now"
                    continue
                reading = formats.parse_mesh(path, data, weld_tolerance=weld)
            except UnreadableFileError as error:
                said = error.message
                continue
            mesh = reading.mesh if scale == 1.0 else scaled(reading.mesh, scale)
            return Shown(mesh, reading.face_number)
        return said

    return surface


def _files_of_model(report: Report) -> Mapping[str, Path]:
    """Return the files of the model by the names that the report has for them; none if the model is gone."""
    paths = report["model"].get("paths")
    if not isinstance(paths, list) or not paths:
        return {}
    try:
        model = find_model([Path(str(path)) for path in paths], recursive=bool(report["settings"].get("recursive")))
    except UsageError:
        return {}
    return {tissue.file: tissue.path for tissue in model.tissues}
