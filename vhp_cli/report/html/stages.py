"""What a stage adds to the report: tetrahedra, a breath, a clearance, and anything else by its names."""

from __future__ import annotations

from collections.abc import Sequence

from vhp_cli.measures import Breathe, Clearance, Report, SmoothingStep, Tetmesh, TissueRecord
from vhp_cli.report.curves import curves_svg
from vhp_cli.report.html.markup import facts, table, tree, words
from vhp_cli.report.html.plots import history_plot
from vhp_cli.report.tetmesh_table import tetmesh_lines
from vhp_cli.report.text import number

_PLAIN = (
    *("schema", "tool", "command", "settings", "model", "summary", "tissues", "pairs", "nesting", "findings", "run"),
    *("tetmesh", "breathe", "clearance"),
)

Cell = tuple[str, float | str | None]


def stage_sections(report: Report) -> list[tuple[str, str, str]]:
    """Return identifier, title and contents of each section that a stage added."""
    made = []
    if any("before" in tissue for tissue in report["tissues"]) and "tetmesh" not in report:
        made.append(("change", "Before and after", _change(report)))
    if "tetmesh" in report:
        made.append(("tetrahedra", "Tetrahedra", _tetmesh(report["tetmesh"])))
    if "breathe" in report:
        made.append(("breath", "Breath", _breathe(report["breathe"])))
    if "clearance" in report:
        made.append(("clearance", "Clearance", _clearance(report["clearance"])))
    made += [
        (f"extra-{index}", words(key[:1].upper() + key[1:].replace("_", " ")), tree(value))
        for index, (key, value) in enumerate(sorted(report.items()))
        if key not in _PLAIN
    ]
    return made


def _count(value: int) -> Cell:
    return f"{value:,}", value


def _number(value: float | None) -> Cell:
    return number(value), value


def _text(value: str) -> Cell:
    return words(value), words(value)


def _change(report: Report) -> str:
    """Return the whole model before and after a stage; means of q are over all triangles."""
    tissues = [tissue for tissue in report["tissues"] if "before" in tissue]
    rows = []
    for title, record in (("before", [tissue["before"] for tissue in tissues]), ("after", list(tissues))):
        good = [(tissue["quality"], tissue["triangles"]) for tissue in record if tissue["quality"]]
        triangles = sum(count for _, count in good)
        mean = sum(quality["mean"] * count for quality, count in good) / triangles if triangles else None
        broken = sum(not (tissue["closed"] and tissue["manifold"]) for tissue in record)
        row: tuple[Cell, ...] = (
            _text(title),
            _count(sum(tissue["triangles"] for tissue in record)),
            _number(min((quality["min"] for quality, _ in good), default=None)),
            _number(mean),
            _number(min((tissue["edge_mm"]["min"] for tissue in record if tissue["edge_mm"]), default=None)),
            _count(broken),
            _count(sum(tissue["self_intersections"]["pairs"] for tissue in record)),
        )
        rows.append(row)
    headings = [("", False), ("Triangles", True), ("Least q", True), ("Mean q", True), ("Shortest edge (mm)", True)]
    headings += [("Not closed or manifold", True), ("Self-intersections", True)]
    moved = [tissue for tissue in tissues if tissue.get("deviation_mm")]
    known = []
    if moved:
        far = max(moved, key=lambda tissue: _farthest(tissue))
        known.append(("greatest deviation", f"{number(_farthest(far))} mm, {words(far['name'])}"))
    changed = [tissue for tissue in tissues if tissue.get("volume_change") is not None]
    if changed:
        most = max(changed, key=lambda tissue: abs(tissue.get("volume_change") or 0.0))
        share = 100 * (most.get("volume_change") or 0.0)
        known.append(("greatest change of volume", f"{share + 0.0:+.3g} %, {words(most['name'])}"))
    histories = [(tissue["history"], tissue["triangles"]) for tissue in tissues if tissue.get("history")]
    plot = f'<figure class="history">{history_plot(_together(histories))}</figure>' if histories else ""
    return table(headings, rows) + facts(known) + plot


def _farthest(tissue: TissueRecord) -> float:
    off = tissue.get("deviation_mm")
    return off["max"] if off else 0.0


def _together(histories: Sequence[tuple[list[SmoothingStep], int]]) -> list[SmoothingStep]:
    """Return the history of all tissues as one: least q of all, mean q over triangles; who has ended stays so."""
    made: list[SmoothingStep] = []
    triangles = sum(count for _, count in histories)
    for iteration in range(max(history[-1]["iteration"] for history, _ in histories) + 1):
        now = [
            ([step for step in history if step["iteration"] <= iteration] or history[:1])[-1]
            for history, _ in histories
        ]
        mean = sum(step["mean_q"] * count for step, (_, count) in zip(now, histories, strict=True)) / max(triangles, 1)
        made.append(
            {
                "iteration": iteration,
                "step": "all tissues",
                "min_q": min(step["min_q"] for step in now),
                "mean_q": mean,
                "volume_mm3": sum(step["volume_mm3"] for step in now),
                "max_turn_deg": None,
                "flips": sum(step["flips"] for step in now),
                "moves": sum(step["moves"] for step in now),
                "held": sum(step["held"] for step in now),
            }
        )
    return made


def _tetmesh(mesh: Tetmesh) -> str:
    rows: list[Sequence[Cell]] = []
    for label in mesh["labels"]:
        error, quality = label["volume_error"], label["quality"]
        rows.append(
            (
                _text(label["name"]),
                _count(label["tets"]),
                _number(label["volume_mm3"] / 1000),
                _number(None if error is None else 100 * error),
                _number(quality["min_dihedral_deg"] if quality else None),
                _number(quality["radius_ratio_p01"] if quality else None),
            )
        )
    headings = [("Tissue", False), ("Tetrahedra", True), ("Volume (ml)", True), ("Off (%)", True)]
    headings += [("Min. angle", True), ("Radius ratio 1 %", True)]
    lines = "".join(f"<li>{words(line)}</li>" for line in tetmesh_lines(mesh))
    return f"<ul>{lines}</ul>" + table(headings, rows)


def _breathe(section: Breathe) -> str:
    rows: list[Sequence[Cell]] = []
    for frame in section["frames"]:
        rows.append(
            (
                _count(frame["index"]),
                _number(frame["time_over_T"]),
                _number(frame["lung_volume_l"]),
                _number(frame["diaphragm_travel_mm"]),
                _number(100 * frame["mass_change"]),
                _count(frame["crossings"]),
                _number(frame["min_gap_mm"]),
                _text("passed" if frame["passed"] else "rejected: " + ", ".join(frame["reasons"])),
            )
        )
    headings = [("Frame", True), ("t / T", True), ("Lungs (l)", True), ("Travel (mm)", True), ("Mass (%)", True)]
    headings += [("Crossings", True), ("Gap (mm)", True), ("Verdict", False)]
    proof = section["proof"]
    known = [
        ("pairs", f"{proof['pairs']:,}, of which {proof['far_pairs']:,} too far apart to meet"),
        ("least gap at every moment", f"{number(proof['least_gap_mm'])} mm"),
        ("intervals without proof", f"{len(proof['unproven']):,}"),
        ("excused, in contact at rest", f"{len(proof['excused']):,}"),
    ]
    curves = f'<div class="paper">{curves_svg(section)}</div>' if section["frames"] else ""
    notes = "".join(f"<li>{words(note)}</li>" for note in section["notes"])
    return curves + facts(known) + (f"<ul>{notes}</ul>" if notes else "") + table(headings, rows)


def _clearance(section: Clearance) -> str:
    rows: list[Sequence[Cell]] = []
    for pair in section["pairs"]:
        before, after = pair["before"], pair["after"]
        rows.append(
            (
                _text(pair["a"]),
                _text(pair["b"]),
                _text(before["relation"].replace("_", " ")),
                _text(after["relation"].replace("_", " ")),
                _number(before["min_gap_mm"]),
                _number(after["min_gap_mm"]),
                _number(pair["gap_mm"]),
                _text("reached" if pair["reached"] else pair["reason"] or "not reached"),
            )
        )
    headings = [("First", False), ("Second", False), ("Before", False), ("After", False), ("Gap before", True)]
    headings += [("Gap after", True), ("Asked", True), ("Outcome", False)]
    known = [
        ("crossing pairs", f"{section['crossing_before']:,} before, {section['crossing_after']:,} after"),
        ("pairs that are too close", f"{section['close_before']:,} before, {section['close_after']:,} after"),
    ]
    return facts(known) + table(headings, rows)
