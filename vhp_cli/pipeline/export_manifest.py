"""What goes beside the files of an export: the manifest, and the table of materials."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence

from vhp_cli.measures import ExportTissue, Report
from vhp_cli.report.as_json import dumps

MANIFEST = "manifest.json"
SCHEMA = "vhp-manifest/1"

_COLUMNS = (
    "name", "object", "material", "density", "permittivity", "conductivity", "own_volume_mm3", "mass_kg",
    "dielectric_source", "density_source",
)  # fmt: skip


def manifest_bytes(report: Report) -> bytes:
    """Return the manifest of an export: every file with its hash, every tissue with its object, and all settings.

    It depends on the model and the settings alone; nothing in it is of the machine or the moment.
    """
    export = report["export"]
    document: dict[str, object] = {
        "schema": SCHEMA,
        "tool": report["tool"],
        "versions": report["run"]["versions"],
        "settings": report["settings"],
        "model": report["model"],
        "gate": {
            "profile": report["settings"]["profile"],
            "passed": export["passed"],
            "forced": export["forced"],
            "counts": report["summary"]["counts"],
        },
        **{key: export[key] for key in ("target", "unit", "mm_per_unit", "frequency_hz", "mass_kg")},
        "files": export["files"],
        "tissues": export["tissues"],
        "left_out": export["left_out"],
        "notes": export["notes"],
    }
    return dumps(document).encode("ascii")


def materials_csv(tissues: Sequence[ExportTissue]) -> str:
    """Return the properties of all tissues as a table: density in kg/m3, conductivity in S/m; empty: not known."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(_COLUMNS)
    for tissue in tissues:
        table.writerow(["" if (value := tissue[key]) is None else value for key in _COLUMNS])  # type: ignore[literal-required]
    return text.getvalue()
