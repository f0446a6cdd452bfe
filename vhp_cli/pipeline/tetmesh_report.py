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
    TetmeshCluster,
    TetmeshInput,
    TetmeshLabel,
    TetmeshOverlap,
    TetrahedronShape,
    TissueRecord,
)
from vhp_cli.mesh import Mesh
from vhp_cli.pipeline.check import with_findings
from vhp_cli.stages.tetmesh.measuring import shape
from vhp_cli.stages.tetmesh.meshing import ENVELOPE_ENGINE
from vhp_cli.stages.tetmesh.modelling import Meshed
from vhp_cli.volume import BACKGROUND, Labels

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
        The mesh, as far as there is one; None: nothing could be tried.
    failures
        Why tissues have no mesh, by their names.
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
    failures: Mapping[tuple[str, ...], str]
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
        for concerned, failure in part.failures.items():
            # What is wrong with all of them is a finding on the model.
            listed = [] if not part.name and len(part.failures) == 1 and not _has_mesh(part) else list(concerned)
            findings += findings_of(settings, listed, [("F012", 1, f"no mesh: {failure}", [])])
    reasons = _reasons(before, parts)
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
    tried = [(part, part.meshed) for part in parts if part.meshed is not None]
    made = [
        (part, meshed, meshed.mesh, meshed.measured)
        for part, meshed in tried
        if meshed.mesh is not None and meshed.measured is not None
    ]
    labels: list[TetmeshLabel] = []
    places: dict[str, Places] = {}
    nonconforming: Counter[str] = Counter()
    for part, _, _, measured in made:
        for label in measured.labels:
            places[label["name"]] = measured.places[label["label"]]
            record = label.copy()
            if per_tissue and part.files:
                record["file"] = part.files[0]
            if label["name"] in part.surface_files:
                record["surface_file"] = part.surface_files[label["name"]]
            labels.append(record)
        nonconforming.update(measured.nonconforming)
    clusters: list[TetmeshCluster] = []
    attempts: list[TetmeshAttempt] = []
    for _, meshed in tried:
        attempts += [{**attempt, "cluster": len(clusters) + attempt["cluster"]} for attempt in meshed.attempts]
        clusters += meshed.clusters
    with_mesh = [cluster for cluster in clusters if not cluster["failure"]]
    widest = max(with_mesh, key=lambda cluster: cluster["epsilon_mm"], default=None)
    engine = ENGINES[tried[0][1].engine if tried else ENVELOPE_ENGINE]
    mesh: Tetmesh = {
        "engine": f"{engine.distribution} {engine.version}",
        "reproducible": engine.deterministic,
        "per_tissue": per_tissue,
        "tets": sum(label["tets"] for label in labels),
        "points": sum(len(mesh.points) for _, _, mesh, _ in made),
        "edge_length_mm": max((cluster["edge_length_mm"] for cluster in with_mesh), default=None),
        "epsilon_mm": widest["epsilon_mm"] if widest else None,
        "epsilon_reason": widest["epsilon_reason"] if widest else "",
        "clusters": clusters,
        "labels": labels,
        "air": made[0][3].air if made else None,
        "quality": _shape([measured.tetrahedra for *_, measured in made], [mesh.labels for _, _, mesh, _ in made]),
        "conforming": bool(made) and not nonconforming,
        "nonconforming": dict(nonconforming),
        "interfaces": [face for *_, measured in made for face in measured.interfaces],
        "attempts": attempts,
        "overlaps": _overlaps(before, made[0][1].order) if made and not per_tissue else [],
        "notes": [
            *(f"{part.name}: {note}".removeprefix(": ") for part, meshed in tried for note in meshed.notes),
            *(note for part in parts for note in part.notes),
        ],
        "relaxed": _relaxed(clusters, attempts, [note for _, meshed in tried for note in meshed.shortfalls]),
        "files": [file for part in parts for file in (*part.files, *part.surface_files.values())],
        "input": _input(before),
    }
    return mesh, places


def _shape(found: Sequence[TetrahedronQuality], labels: Sequence[Labels]) -> TetrahedronShape | None:
    """Return the shape of the tetrahedra of all meshes that belong to a tissue."""
    if not found:
        return None
    columns = TetrahedronQuality.__dataclass_fields__
    joined = TetrahedronQuality(*(np.concatenate([getattr(one, column) for one in found]) for column in columns))
    return shape(joined, np.concatenate(labels) != BACKGROUND)


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


def _relaxed(
    clusters: Sequence[TetmeshCluster], attempts: Sequence[TetmeshAttempt], shortfalls: Sequence[str]
) -> list[str]:
    """Return how the chosen meshes were made otherwise than asked for."""
    told = []
    for number, cluster in enumerate(clusters, start=1):
        if cluster["failure"]:
            continue
        names = cluster["tissues"]
        more = f" and {len(names) - 1} more" if len(names) > 1 else ""
        prefix = f"{names[0]}{more}: " if len(clusters) > 1 else ""
        own = [attempt for attempt in attempts if attempt["cluster"] == number]
        asked, chosen = own[0], next(attempt for attempt in own if attempt["chosen"])
        if chosen["edge_length_mm"] > asked["edge_length_mm"]:
            told.append(f"{prefix}edges of {chosen['edge_length_mm']:.4g} mm, not {asked['edge_length_mm']:.4g}")
        if chosen["stop_energy"] > asked["stop_energy"]:
            told.append(f"{prefix}stop energy {chosen['stop_energy']:g}, not {asked['stop_energy']:g}")
    return told + list(shortfalls)


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


def _reasons(before: Report, parts: Sequence[MeshedPart]) -> dict[str, str]:
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
        for names, failure in part.failures.items():
            for name in names:
                reasons.setdefault(name, failure)
    return reasons


def _has_mesh(part: MeshedPart) -> bool:
    return part.meshed is not None and part.meshed.mesh is not None
