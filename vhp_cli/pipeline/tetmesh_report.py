"""The report of a tetrahedral mesh: what the surfaces were, what came out, and what is wrong with it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from vhp_cli.config import Settings
from vhp_cli.engines import ENGINES
from vhp_cli.gate import findings_of, sort_findings
from vhp_cli.gate_tetmesh import Places, tetmesh_findings
from vhp_cli.inspection.tetrahedra import TetrahedronQuality
from vhp_cli.measures import (
    Finding,
    Report,
    Tetmesh,
    TetmeshAttempt,
    TetmeshInput,
    TetmeshLabel,
    TetmeshOverlap,
    TissueRecord,
)
from vhp_cli.mesh import Mesh
from vhp_cli.pipeline.check import with_findings
from vhp_cli.stages.tetmesh.measuring import shape
from vhp_cli.stages.tetmesh.meshing import ENVELOPE_ENGINE, Meshed
from vhp_cli.volume import BACKGROUND

# What a file that can't be read, or says too little, leaves of a tissue.
_UNREAD = ("F001", "F005", "F012")


@dataclass(frozen=True, slots=True, eq=False)
class MeshedPart:
    """What became of one mesh.

    Parameters
    ----------
    name
        The tissue; empty for all together.
    meshed
        The mesh; None: there is none.
    attempts
        All attempts at it.
    failure
        Why there is none.
    files
        What was written, below the output directory.
    surface_files
        The boundaries that were written, by tissue.
    notes
        On what was written.
    seconds
        How long each step took.
    shared_surfaces
        The boundaries that are still to be set apart, by tissue.
    """

    name: str
    meshed: Meshed | None
    attempts: list[TetmeshAttempt]
    failure: str
    files: list[str]
    surface_files: dict[str, str]
    notes: list[str]
    seconds: dict[str, float]
    shared_surfaces: dict[str, Mesh] = field(default_factory=dict)


def tetmesh_report(
    before: Report,
    parts: Sequence[MeshedPart],
    settings: Settings,
    options: Mapping[str, object],
    *,
    per_tissue: bool,
) -> tuple[Report, bool]:
    """Put the report together.

    Parameters
    ----------
    before
        The check of the surfaces.
    parts
        What became of each mesh.
    settings
        Levels and limits.
    options
        The options in full.
    per_tissue
        Whether there is a mesh for each tissue.

    Returns
    -------
    report, failed
        And whether a tissue could not be processed.
    """
    mesh, places = _tetmesh(before, parts, per_tissue=per_tissue)
    names = [record["name"] for record in before["tissues"]]
    findings = [finding for finding in before["findings"] if finding["rule"].startswith("F")]
    findings += tetmesh_findings(mesh, places, settings)
    for part in parts:
        if part.failure:
            concerned = [part.name] if part.name else []
            findings += findings_of(settings, concerned, [("F012", 1, f"no mesh: {part.failure}", [])])
    reasons = _reasons(before, parts, per_tissue=per_tissue)
    kept = {label["name"] for label in mesh["labels"] if label["tets"]}
    tissues: list[TissueRecord] = []
    for record in before["tissues"]:
        reason = reasons.get(record["name"], "")
        lost = "" if record["name"] in kept else "no tetrahedra"
        status: TissueRecord = {**record, "status": "failed" if reason else "changed", "reason": reason or lost}
        tissues.append(status)
    failed = sum(record["status"] == "failed" for record in tissues)
    report: Report = {
        **before,
        "command": "tetmesh",
        "settings": {**before["settings"], "tetmesh": dict(options)},
        "summary": {**before["summary"], "status": {"changed": len(tissues) - failed, "failed": failed}},
        "tissues": tissues,
        "tetmesh": mesh,
    }
    return with_findings(report, sort_findings(findings, names)), failed > 0


def _tetmesh(before: Report, parts: Sequence[MeshedPart], *, per_tissue: bool) -> tuple[Tetmesh, dict[str, Places]]:
    made = [(part, part.meshed) for part in parts if part.meshed is not None]
    labels: list[TetmeshLabel] = []
    places: dict[str, Places] = {}
    nonconforming: Counter[str] = Counter()
    for part, meshed in made:
        for label in meshed.measured.labels:
            places[label["name"]] = meshed.measured.places[label["label"]]
            record = label.copy()
            if per_tissue and part.files:
                record["file"] = part.files[0]
            if label["name"] in part.surface_files:
                record["surface_file"] = part.surface_files[label["name"]]
            labels.append(record)
        nonconforming.update(meshed.measured.nonconforming)
    first = made[0][1] if made else None
    engine = ENGINES[first.engine if first else ENVELOPE_ENGINE]
    mesh: Tetmesh = {
        "engine": f"{engine.distribution} {engine.version}",
        "reproducible": engine.deterministic,
        "per_tissue": per_tissue,
        "tets": sum(label["tets"] for label in labels),
        "points": sum(len(meshed.mesh.points) for _, meshed in made),
        "edge_length_mm": first.request.edge_length_mm if first else None,
        "epsilon_mm": first.request.epsilon_mm if first else None,
        "epsilon_reason": first.epsilon_reason if first else "",
        "labels": labels,
        "air": first.measured.air if first else None,
        "quality": shape(*_all_tetrahedra([meshed for _, meshed in made])) if made else None,
        "conforming": bool(made) and not nonconforming,
        "nonconforming": dict(nonconforming),
        "interfaces": [face for _, meshed in made for face in meshed.measured.interfaces],
        "attempts": [attempt for part in parts for attempt in part.attempts],
        "overlaps": _overlaps(before, first.order if first else ()) if not per_tissue else [],
        "notes": [
            *(f"{part.name}: {note}".removeprefix(": ") for part, meshed in made for note in meshed.notes),
            *(note for part in parts for note in part.notes),
        ],
        "relaxed": _relaxed(parts),
        "files": [file for part in parts for file in (*part.files, *part.surface_files.values())],
        "input": _input(before),
    }
    return mesh, places


def _all_tetrahedra(meshes: Sequence[Meshed]) -> tuple[TetrahedronQuality, np.ndarray]:
    """Return the measures of the tetrahedra of all meshes, and which of them belong to a tissue."""
    found = [meshed.measured.tetrahedra for meshed in meshes]
    columns = TetrahedronQuality.__dataclass_fields__
    joined = TetrahedronQuality(*(np.concatenate([getattr(one, column) for one in found]) for column in columns))
    return joined, np.concatenate([meshed.mesh.labels != BACKGROUND for meshed in meshes])


def _overlaps(before: Report, order: Sequence[str]) -> list[TetmeshOverlap]:
    rank = {name: position for position, name in enumerate(order)}
    return [
        {
            "a": pair["a"],
            "b": pair["b"],
            "overlap_mm3": pair["overlap_mm3"],
            "winner": max(pair["a"], pair["b"], key=lambda name: rank[name]),
        }
        for pair in before["pairs"]
        if pair["relation"] in ("crossing", "identical") and pair["a"] in rank and pair["b"] in rank
    ]


def _relaxed(parts: Sequence[MeshedPart]) -> list[str]:
    """Return how the chosen meshes were made otherwise than asked for."""
    told = []
    for part in parts:
        if not part.attempts or part.meshed is None:
            continue
        prefix = f"{part.name}: " if part.name else ""
        asked, chosen = part.attempts[0], next(attempt for attempt in part.attempts if attempt["chosen"])
        if chosen["edge_length_mm"] > asked["edge_length_mm"]:
            told.append(f"{prefix}edges of {chosen['edge_length_mm']:.4g} mm, not {asked['edge_length_mm']:.4g}")
        if chosen["stop_energy"] > asked["stop_energy"]:
            told.append(f"{prefix}stop energy {chosen['stop_energy']:g}, not {asked['stop_energy']:g}")
        told += [f"{prefix}{short}" for short in part.meshed.shortfalls]
    return told


def _input(before: Report) -> TetmeshInput:
    """Return what the gate says of the surfaces, files aside."""
    findings: list[Finding] = [finding for finding in before["findings"] if not finding["rule"].startswith("F")]
    levels = Counter(finding["level"] for finding in findings)
    return {
        "passed": before["summary"]["passed"],
        "errors": levels["error"],
        "warnings": levels["warning"],
        "notes": levels["note"],
        "counts": dict(sorted(Counter(finding["rule"] for finding in findings).items())),
        "findings": findings,
    }


def _reasons(before: Report, parts: Sequence[MeshedPart], *, per_tissue: bool) -> dict[str, str]:
    """Return why tissues were not processed."""
    reasons = {}
    for finding in before["findings"]:
        if finding["rule"] in _UNREAD and len(finding["tissues"]) == 1:
            reasons[finding["tissues"][0]] = f"{finding['rule']}: {finding['message']}"
    for record in before["tissues"]:
        if not record["bounds_mm"]:
            # Whatever the rules say of it.
            reasons.setdefault(record["name"], "no triangle to mesh from")
    for part in parts:
        if part.failure:
            concerned = [part.name] if per_tissue else [record["name"] for record in before["tissues"]]
            reasons |= {name: part.failure for name in concerned if name not in reasons}
    return reasons
