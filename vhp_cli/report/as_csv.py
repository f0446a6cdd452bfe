"""The report as CSV: one row per tissue."""

from __future__ import annotations

import csv
import io

from vhp_cli.measures import Report, SelfIntersections, Topology
from vhp_cli.report.text import visible
from vhp_cli.report.verdict import tissue_verdicts

_FORMULA = tuple("=+-@\uff1d\uff0b\uff0d\uff20")  # and their full-width forms

_AXES = (("x", 0), ("y", 1), ("z", 2))
_SPREAD = ("min", "mean", "max")
_PLAIN = (
    *("triangles", "vertices", "components", "euler", "genus", "closed", "manifold", "oriented", "outward"),
    *("volume_mm3", "area_mm2"),
)
_TOPOLOGY = tuple(Topology.__annotations__)
_INTERSECTIONS = tuple(SelfIntersections.__annotations__)

# Column -> where its value is in the record of a tissue.
_MEASURES: dict[str, tuple[str | int, ...]] = {
    **{key: (key,) for key in _PLAIN},
    **{f"q_{key}": ("quality", key) for key in ("min", "p01", "p05", "p50", "mean")},
    **{f"size_{key}_mm": ("size_mm", key) for key in _SPREAD},
    **{f"edge_{key}_mm": ("edge_mm", key) for key in _SPREAD},
    "min_dihedral_deg": ("min_dihedral_deg",),
    **{key: ("topology", key) for key in _TOPOLOGY},
    **{f"self_intersection_{key}": ("self_intersections", key) for key in _INTERSECTIONS},
    **{f"{axis}_min_mm": ("bounds_mm", "min", index) for axis, index in _AXES},
    **{f"{axis}_max_mm": ("bounds_mm", "max", index) for axis, index in _AXES},
    **{f"{axis}_centroid_mm": ("centroid_mm", index) for axis, index in _AXES},
    "format": ("format",),
    "sha256": ("sha256",),
}
# What heal, smooth and the like add to a tissue.
_STAGE: dict[str, tuple[str | int, ...]] = {
    "status": ("status",),
    "reason": ("reason",),
    "deviation_max_mm": ("deviation_mm", "max"),
    "deviation_mean_mm": ("deviation_mm", "mean"),
    "volume_change": ("volume_change",),
    **{f"{key}_before": ("before", key) for key in ("triangles", "closed", "manifold", "oriented", "outward")},
    "self_intersection_pairs_before": ("before", "self_intersections", "pairs"),
    "q_min_before": ("before", "quality", "min"),
    "edge_min_before_mm": ("before", "edge_mm", "min"),
    "volume_before_mm3": ("before", "volume_mm3"),
    "sha256_before": ("before", "sha256"),
}
_VERDICT = ("name", "file", "tissue_type", "verdict", "errors", "warnings", "notes", "known", "rules")


def _value(record: object, path: tuple[str | int, ...]) -> object:
    for step in path:
        if isinstance(record, dict):
            record = record.get(step)
        elif isinstance(record, list) and isinstance(step, int) and step < len(record):
            record = record[step]
        else:
            return None
    return record


def _cell(value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (int, float)):
        return repr(value)
    text = visible(str(value))
    # A spreadsheet runs what begins like a formula; an apostrophe keeps it text.
    return f"'{text}" if text.lstrip().startswith(_FORMULA) else text


def render_csv(report: Report) -> str:
    """Return one row per tissue with all its scalar measures; lengths in mm, empty where there is no value."""
    staged = any("status" in tissue for tissue in report["tissues"])
    columns = _MEASURES | _STAGE if staged else _MEASURES
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow((*_VERDICT, *columns))
    for tissue, verdict in zip(report["tissues"], tissue_verdicts(report), strict=True):
        outcome = (
            *(tissue["name"], tissue["file"], tissue["tissue_type"], "pass" if verdict.passed else "fail"),
            *(verdict.errors, verdict.warnings, verdict.notes, verdict.known, " ".join(verdict.rules)),
        )
        writer.writerow(map(_cell, (*outcome, *(_value(tissue, path) for path in columns.values()))))
    return text.getvalue()
