"""What the viewer shows: surfaces thin enough to turn, and where each finding is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vhp_cli.measures import Finding, Place, Report
from vhp_cli.report.html.colours import opacities, tissue_colours
from vhp_cli.report.html.packing import pack
from vhp_cli.report.html.shown import Shown, edge_length_near, normal_near
from vhp_cli.report.html.thinning import Thinned, shares, thin
from vhp_cli.report.text import visible
from vhp_cli.report.verdict import Verdict

BUDGET = 400_000  # triangles that even a browser without a graphics card can turn
_MOST_PLACES = 20_000  # of all findings; the first of each finding is always there
_WINDOW = 7.0  # mean edges from the middle of the picture to its upper end, when a place is shown
_NOTHING = Thinned(np.empty((0, 3)), np.empty((0, 3), np.int32), np.empty(0), True)


@dataclass(frozen=True, slots=True)
class Scene:
    """Contents of the viewer.

    Parameters
    ----------
    data
        A JSON value, which viewer.js describes by using it.
    geometry
        The surfaces; see `vhp_cli.report.html.packing.pack`.
    triangles, of_triangles
        How many are shown, and how many there are.
    """

    data: dict[str, object]
    geometry: str
    triangles: int
    of_triangles: int


def build_scene(
    report: Report, findings: Sequence[Finding], verdicts: Sequence[Verdict], surfaces: Mapping[str, Shown]
) -> Scene:
    """Return the contents of the viewer.

    Parameters
    ----------
    report
        The report.
    findings
        Those of the page, in its order.
    verdicts
        On each tissue.
    surfaces
        By the names of tissues; those that are missing are not shown.
    """
    names = [tissue["name"] for tissue in report["tissues"]]
    number = {name: index for index, name in enumerate(names)}
    shown = [surfaces.get(name) for name in names]
    budget = iter(shares([len(surface.mesh.faces) for surface in shown if surface], BUDGET))
    kept = _faces_of_findings(findings, surfaces)
    thinned = [
        thin(surface.mesh, next(budget), kept.get(name, np.empty(0, np.int64))) if surface else _NOTHING
        for name, surface in zip(names, shown, strict=True)
    ]
    packed = pack(thinned)
    tissues = [
        {
            "name": visible(record["name"]),
            "type": visible(record["tissue_type"]),
            "colour": list(colour),
            "opacity": opacity,
            "verdict": "error" if verdict.errors else "warning" if verdict.warnings else "pass",
            "words": verdict.words,
            "triangles": record["triangles"],
            "q": record["quality"]["min"] if record["quality"] else None,
            "whole": surface.is_whole,
            **where,
        }
        for record, colour, opacity, verdict, surface, where in zip(
            report["tissues"],
            tissue_colours([record["tissue_type"] for record in report["tissues"]]),
            opacities(report),
            verdicts,
            thinned,
            packed.tissues,
            strict=True,
        )
    ]
    room = max(_MOST_PLACES - len(findings), 0)
    listed = []
    for finding in findings:
        places = finding["places"][: 1 + room]
        room -= max(len(places) - 1, 0)
        listed.append(
            {
                "rule": finding["rule"],
                "level": finding["level"],
                "known": bool(finding.get("known")),
                "tissues": [number[name] for name in finding["tissues"] if name in number],
                "message": visible(finding["message"]),
                "places": [_place(place, finding, number, surfaces) for place in places],
            }
        )
    return Scene(
        {"tissues": tissues, "findings": listed},
        packed.text,
        sum(len(surface.faces) for surface in thinned),
        sum(len(surface.mesh.faces) for surface in shown if surface),
    )


def place_tissue(place: Place, finding: Finding) -> str:
    """Return the tissue that a place belongs to; empty if the finding names none."""
    return place["tissue"] if "tissue" in place else next(iter(finding["tissues"]), "")


def _faces_of_findings(findings: Sequence[Finding], surfaces: Mapping[str, Shown]) -> dict[str, NDArray[np.int64]]:
    found: dict[str, set[int]] = {}
    for finding in findings:
        for place in finding["places"]:
            name = place_tissue(place, finding)
            face = surfaces[name].face(place["face"]) if name in surfaces else None
            if face is not None:
                found.setdefault(name, set()).add(face)
    return {name: np.array(sorted(faces), dtype=np.int64) for name, faces in found.items()}


def _place(
    place: Place, finding: Finding, number: Mapping[str, int], surfaces: Mapping[str, Shown]
) -> dict[str, object]:
    """Return a place: ``at`` in mm, ``tissue``, ``face``, ``corners`` of the face from there, and how to look at it."""
    name = place_tissue(place, finding)
    made: dict[str, object] = {"at": place["xyz_mm"], "tissue": number.get(name), "face": place["face"]}
    surface = surfaces.get(name)
    face = surface.face(place["face"]) if surface else None
    if surface is None or face is None:
        return made
    corners = surface.mesh.vertices[surface.mesh.faces[face]]
    made["corners"] = [float(f"{value:.7g}") for value in (corners - place["xyz_mm"]).ravel()]
    normal = normal_near(surface, face)
    if normal is not None:
        made["normal"] = [round(float(value), 4) for value in normal]
    made["reach"] = float(f"{_WINDOW * edge_length_near(surface, face):.3g}")
    return made
