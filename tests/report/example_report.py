"""A small made-up report that has a bit of everything, and ways to vary it."""

from __future__ import annotations

import copy

from vhp_cli.measures import Finding, PairRecord, Report, TissueRecord, Topology
from vhp_cli.rules import RULES

SOUND: Topology = {
    "boundary_edges": 0,
    "boundary_loops": 0,
    "nonmanifold_edges": 0,
    "nonmanifold_vertices": 0,
    "inconsistent_edges": 0,
    "inward_components": 0,
    "duplicate_faces": 0,
    "degenerate_faces": 0,
    "collapsed_faces": 0,
    "unreferenced_vertices": 0,
}


def finding(rule: str, tissues: list[str], count: int = 1, message: str = "", **more: object) -> Finding:
    made = {
        "rule": rule,
        "level": RULES[rule].level or "warning",
        "tissues": tissues,
        "count": count,
        "message": message or RULES[rule].summary,
        "places": [],
        "hint": RULES[rule].fix,
        **more,
    }
    return made  # type: ignore[return-value]


def tissue(name: str, file: str, kind: str, triangles: int, q_min: float, edge_min: float) -> TissueRecord:
    return {
        "name": name,
        "file": file,
        "sha256": f"{triangles:064x}",
        "format": "stl-binary",
        "tissue_type": kind,
        "triangles": triangles,
        "vertices": triangles // 2 + 2,
        "components": 1,
        "euler": 2,
        "genus": 0,
        "closed": True,
        "manifold": True,
        "oriented": True,
        "outward": True,
        "volume_mm3": 1234.5,
        "area_mm2": 678.25,
        "bounds_mm": {"min": [-1.5, 0.0, 10.0], "max": [20.25, 30.0, 40.0]},
        "centroid_mm": [9.0, 15.0, 25.0],
        "topology": SOUND.copy(),
        "quality": {
            "min": q_min,
            "p01": 0.3,
            "p05": 0.5,
            "p50": 0.9,
            "mean": 0.85,
            "histogram": [0] * 19 + [triangles],
        },
        "size_mm": {"min": 0.5, "mean": 1.25, "max": 2.0},
        "edge_mm": {"min": edge_min, "mean": 2.0, "max": 3.5},
        "min_dihedral_deg": 41.5,
        "self_intersections": {
            "faces": 0,
            "pairs": 0,
            "crossing": 0,
            "coplanar": 0,
            "folded": 0,
            "duplicate": 0,
            "touching": 0,
            "complete": True,
        },
        "findings": [],
    }


def unreadable(name: str, file: str) -> TissueRecord:
    record = tissue(name, file, "other", 0, 0.0, 0.0)
    record.update(vertices=0, components=0, euler=0, genus=None, closed=False, manifold=False, oriented=False)
    record.update(outward=False, volume_mm3=0.0, area_mm2=0.0, bounds_mm=None, centroid_mm=None, quality=None)
    record.update(size_mm=None, edge_mm=None, min_dihedral_deg=None, sha256="")
    return record


def pair(a: str, b: str, relation: str, gap: float | None, **more: object) -> PairRecord:
    made = {
        "a": a,
        "b": b,
        "relation": relation,
        "inside": "",
        "min_gap_mm": gap,
        "points_mm": [[1.0, 2.0, 3.0], [1.0, 2.0, 3.5]],
        "faces": [4, 17],
        "crossing_faces": 0,
        "contact_faces": 0,
        "coplanar_faces": 0,
        "overlap_mm3": 0.0,
        "undecided": False,
        **more,
    }
    return made  # type: ignore[return-value]


def build(tissues: list[TissueRecord], pairs: list[PairRecord], findings: list[Finding], nesting: object) -> Report:
    levels = [item["level"] for item in findings]
    broken = {item["rule"] for item in findings}
    for record in tissues:
        record["findings"] = [item for item in findings if item["tissues"] == [record["name"]]]
    return {
        "schema": "vhp-report/1",
        "tool": {"name": "vhp", "version": "0.1.0"},
        "command": "check",
        "settings": {"profile": "strict", "units": "mm"},
        "model": {"paths": ["model"], "units": "mm"},
        "summary": {
            "passed": not any(item["level"] == "error" and not item.get("known") for item in findings),
            "tissues": len(tissues),
            "triangles": sum(record["triangles"] for record in tissues),
            "pairs": len(pairs),
            "errors": levels.count("error"),
            "warnings": levels.count("warning"),
            "notes": levels.count("note"),
            "counts": {code: sum(item["rule"] == code for item in findings) for code in sorted(broken)},
        },
        "tissues": tissues,
        "pairs": pairs,
        "nesting": nesting,  # type: ignore[typeddict-item]
        "findings": findings,
        "run": {
            "started": "2024-05-06T07:08:09+00:00",
            "seconds": {"read": 0.25, "pairs": 1.0},
            "peak_memory_mb": 120.5,
            "host": {"system": "Linux"},
            "jobs": 2,
        },
    }


def example() -> Report:
    """Return five tissues: sound, two defective, one with a warning, one unreadable; crossing and near pairs."""
    liver = tissue("Liver", "Liver.stl", "organ", 3312, 0.561483603, 1.304314414)
    nerve = tissue("VHP Median Nerve left", "nerves/VHP Median Nerve left.stl", "nerve", 520, 7.14e-7, 0.000393)
    nerve.update(closed=False, genus=None, min_dihedral_deg=0.02)
    nerve["topology"].update(boundary_edges=6, boundary_loops=2)
    skin = tissue("Haut|Fettgewebe (äußeres)", "Haut|Fettgewebe (äußeres).ply", "skin", 703804, 0.145005, 1.220145)
    bone = tissue("Ulna_Radius_left", "Ulna_Radius_left.stl", "bone", 2020, 0.029373, 1.193387)
    broken = unreadable("=cut off", "=cut off.stl")
    nerve_places = [
        {"xyz_mm": [12.3456, -7.8, 1023.0], "face": 17},
        {"xyz_mm": [12.5, -7.9, 1024.0], "face": 18, "value": 0.393e-3},
    ]
    findings = [
        finding("F001", ["=cut off"], message="the file ends at byte 83"),
        finding("T001", ["VHP Median Nerve left"], 6, "6 open edges: 2 holes", places=nerve_places),
        finding(
            "Q001",
            ["VHP Median Nerve left"],
            41,
            "41 badly shaped triangles below 0.01, the worst 7.14e-07",
            places=[{"xyz_mm": [12.0, 1e9, -0.00001], "face": 3, "value": 7.14e-7}],
            known=True,
        ),
        finding(
            "P001",
            ["Liver", "Haut|Fettgewebe (äußeres)"],
            14,
            "14 faces of either cross, common volume 3.5 mm3",
            places=[
                {"xyz_mm": [1.0, 2.0, 3.0], "face": 4, "tissue": "Liver"},
                {"xyz_mm": [1.0, 2.0, 3.5], "face": 17, "tissue": "Haut|Fettgewebe (äußeres)"},
            ],
        ),
        finding("F010", ["Ulna_Radius_left"], 12, "12 bytes"),
        finding("Q006", [], 709656, "709,656 triangles in all, at most 400,000 asked"),
        finding("T007", ["Liver"], 2, "2 separate parts, 1 expected"),
    ]
    pairs = [
        pair("Liver", "Haut|Fettgewebe (äußeres)", "crossing", 0.0, crossing_faces=14, overlap_mm3=3.5),
        pair("Liver", "Ulna_Radius_left", "disjoint", 0.5),
        pair("Ulna_Radius_left", "Haut|Fettgewebe (äußeres)", "a_inside_b", 2.25, inside="a"),
    ]
    nesting = {
        "Liver": None,
        "VHP Median Nerve left": "Haut|Fettgewebe (äußeres)",
        "Haut|Fettgewebe (äußeres)": None,
        "Ulna_Radius_left": "Haut|Fettgewebe (äußeres)",
    }
    return copy.deepcopy(build([liver, nerve, skin, bone, broken], pairs, findings, nesting))


def sound() -> Report:
    """Return a report of one tissue without findings."""
    return build([tissue("Liver", "Liver.stl", "organ", 3312, 0.5, 1.25)], [], [], {"Liver": None})


def healed() -> Report:
    """Return the example as the report of a stage, with every status."""
    report = example()
    report["command"] = "heal"
    places = [{"xyz_mm": [12.3456, -7.8, 1023.0], "face": None, "value": 1.5}]
    off = {"max": 0.0213, "mean": 0.0015, "xyz_mm": [12.0, -7.0, 1023.0]}
    deviation = {
        "max": 0.0213, "mean": 0.0015, "to_output": off, "to_input": {"max": 0.0, "mean": 0.0, "xyz_mm": None},
        "lost_area_mm2": 0.0, "lost_outside_mm2": 0.0, "lost_limit_mm": 0.1, "lost_places": [],
    }  # fmt: skip
    none = {**deviation, "max": 0.0, "mean": 0.0, "to_output": deviation["to_input"]}
    actions = [
        {"step": "holes", "message": "closed 2 holes", "count": 2, "places": places, "area_mm2": 3.5},
        {"step": "remesh", "message": "41 triangles | improved", "count": 41, "places": []},
    ]
    contact = {"rule": "P001", "before": 0, "after": 3, "message": "cross", "tissues": [report["tissues"][1]["name"]]}
    for record, (status, reason) in zip(
        report["tissues"],
        (
            ("unchanged", ""),
            ("changed", ""),
            ("refused", "holds 0.01 mm of [sheet]; thicken it"),
            ("changed", ""),
            ("failed", "time limit: the worker took more than 120 s"),
        ),
        strict=True,
    ):
        made = status == "changed"
        before = {key: value for key, value in record.items() if key not in ("name", "tissue_type")}
        record.update(  # type: ignore[call-arg]
            status=status,
            reason=reason,
            deviation_mm=deviation if made else none if record["sha256"] else None,
            volume_change=-0.00025 if record["name"] == "Ulna_Radius_left" else None,
            actions=actions if made else [],
            introduced=[contact] if record["name"].startswith("VHP") else [],
            before=before,
        )
    report["summary"]["status"] = {"changed": 2, "unchanged": 1, "refused": 1, "failed": 1}
    return copy.deepcopy(report)


def empty() -> Report:
    """Return a report of no tissue at all."""
    return build([], [], [], {})


def renamed(first: str, second: str) -> Report:
    """Return the example with two tissues, their files and everything that names them called otherwise."""
    names = {"Liver": first, "Haut|Fettgewebe (äußeres)": second}

    def rename(value: object) -> object:
        if isinstance(value, str):
            return names.get(value, value)
        if isinstance(value, list):
            return [rename(item) for item in value]
        if isinstance(value, dict):
            return {names.get(key, key): rename(item) for key, item in value.items()}
        return value

    report = example()
    for record in report["tissues"]:
        if record["name"] in names:
            record["file"] = f"{names[record['name']]}.stl"
    changed: Report = rename(report)  # type: ignore[assignment]
    changed["findings"][3]["message"] = f"crosses {second}"
    return changed


def many(count: int) -> Report:
    """Return a report of many tissues, every tenth with an open edge and an edge with its neighbour."""
    tissues = [tissue(f"Tissue {no:03d}", f"t{no:03d}.stl", "organ", 1000 + no, 0.5, 1.0) for no in range(count)]
    findings = [finding("T001", [f"Tissue {no:03d}"], no + 1, f"{no + 1} open edges") for no in range(0, count, 10)]
    pairs = [pair(f"Tissue {no:03d}", f"Tissue {no + 1:03d}", "disjoint", 1.0 + no) for no in range(count - 1)]
    return build(tissues, pairs, findings, {record["name"]: None for record in tissues})
