"""The tissues: the table of them (thesis Table 4.3), and a card for each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vhp_cli.measures import Finding, Report, TissueMeasures, TissueRecord
from vhp_cli.report.html.figures import close_up, marks_of, tissue_figure
from vhp_cli.report.html.markup import facts, name_words, table, words
from vhp_cli.report.html.plots import histogram, history_plot, sparkline
from vhp_cli.report.html.shown import Shown
from vhp_cli.report.pictures.portraits import Colour
from vhp_cli.report.text import number, plural, visible
from vhp_cli.report.verdict import Verdict, deviation, is_staged

_EDGE_BINS = 24
_CSS_LEVEL = {"changed": "pass", "unchanged": "known", "refused": "warning", "failed": "error"}


def level_of(verdict: Verdict) -> str:
    """Return the class of a verdict: error, warning, or pass."""
    return "error" if not verdict.passed else "warning" if verdict.warnings else "pass"


def tissue_table(report: Report, verdicts: Sequence[Verdict], colours: Sequence[Colour]) -> str:
    """Return the table: number, name, triangles, mesh quality, shortest edge, type, verdict; for a stage its status."""
    staged = is_staged(report)
    headings = [("No", True), ("Tissue", False), ("Triangles", True), ("Mesh quality", True), ("q", False)]
    headings += [("Min. edge (mm)", True), ("Tissue type", False)]
    headings += [("Status", False), ("Deviation (mm)", True)] if staged else []
    headings.append(("Verdict", False))
    rows = []
    for index, (tissue, verdict, colour) in enumerate(zip(report["tissues"], verdicts, colours, strict=True)):
        quality, edge = tissue["quality"], tissue["edge_mm"]
        row: list[tuple[str, float | str | None]] = [
            (str(index + 1), index + 1),
            (
                f'<button type="button" class="name" data-tissue="{index}">{swatch(colour)}'
                f"<span>{name_words(tissue['name'])}</span></button>",
                visible(tissue["name"]).casefold(),
            ),
            (f"{tissue['triangles']:,}", tissue["triangles"]),
            (number(quality["min"] if quality else None), quality["min"] if quality else None),
            (sparkline(quality["histogram"]) if quality else "", quality["mean"] if quality else None),
            (number(edge["min"] if edge else None), edge["min"] if edge else None),
            (words(tissue["tissue_type"]), visible(tissue["tissue_type"])),
        ]
        if staged:
            status = tissue.get("status", "")
            off = tissue.get("deviation_mm")
            row.append((f'<span class="{_CSS_LEVEL.get(status, "")}">{words(status)}</span>', status))
            row.append((deviation(tissue), off["max"] if off else None))
        order = (3 if verdict.errors else 2 if verdict.warnings else 1, verdict.errors, verdict.warnings)
        row.append(
            (f'<span class="{level_of(verdict)}">{words(verdict.words)}</span>', order[0] * 1e9 + sum(order[1:]))
        )
        rows.append(row)
    return table(headings, rows, kind="tissues")


def swatch(colour: Colour) -> str:
    """Return a patch of a colour."""
    red, green, blue = (round(255 * part) for part in colour)
    return f'<i class="swatch" style="background:rgb({red},{green},{blue})"></i>'


def card(
    index: int,
    tissue: TissueRecord,
    verdict: Verdict,
    colour: Colour,
    surface: Shown | str,
    findings: Sequence[tuple[int, Finding]],
) -> str:
    """Return the picture of a tissue and everything measured on it.

    Parameters
    ----------
    index
        Number of the tissue, from 0.
    tissue, verdict, colour
        What is known of it.
    surface
        Its surface, or why there is none.
    findings
        Those that name it, each with its number on the page.
    """
    name = words(tissue["name"])
    close = ""
    if isinstance(surface, str) or not len(surface.mesh.faces):
        said = surface if isinstance(surface, str) else "no triangles"
        picture = f'<div class="nopicture">{words(said)}</div>'
    else:
        marks = marks_of(tissue["name"], findings)
        picture = tissue_figure(surface, colour, marks)
        with_face = next((mark for mark in marks if mark[2]["face"] is not None), None)
        drawn = close_up(surface, colour, with_face) if with_face else ""
        if drawn and with_face:
            close = f"<figure>{drawn}<figcaption>{words(with_face[1]['rule'])} close by</figcaption></figure>"
    return (
        f'<article class="card {level_of(verdict)}" id="tissue-{index}" '
        f'data-verdict="{level_of(verdict)}"><button type="button" class="face" data-tissue="{index}" '
        f'title="show {name}">{picture}</button><h3>{swatch(colour)}{name_words(tissue["name"])}</h3>'
        f'<p class="{level_of(verdict)}">{words(verdict.words)}</p>'
        f'<details><summary>Details</summary><div class="more-of">{close}{_plots(tissue, surface)}'
        f"{_facts(tissue)}{_stage(tissue)}</div></details></article>"
    )


def _plots(tissue: TissueRecord, surface: Shown | str) -> str:
    made = []
    before = tissue.get("before")
    if quality := tissue["quality"]:
        old = before["quality"] if before else None
        made.append(
            histogram("q of triangles", quality["histogram"], 0.0, 1.0, before=old["histogram"] if old else None)
        )
    if isinstance(surface, Shown) and len(surface.mesh.faces):
        made.append(_edge_plot(surface))
    if history := tissue.get("history"):
        made.append(history_plot(history))
    return "".join(f"<figure>{plot}</figure>" for plot in made)


def _edge_plot(surface: Shown) -> str:
    """Return the lengths of the edges; each inner edge of a closed surface counts twice."""
    corners = surface.mesh.vertices[surface.mesh.faces]
    lengths = np.linalg.norm(corners - corners[:, [1, 2, 0]], axis=2).ravel()
    high = float(np.partition(lengths, int(0.995 * (len(lengths) - 1)))[int(0.995 * (len(lengths) - 1))]) or 1.0
    bins = np.minimum((lengths / high * _EDGE_BINS).astype(np.int64), _EDGE_BINS - 1)
    counts = np.bincount(bins, minlength=_EDGE_BINS).tolist()
    return histogram("edges of triangles in mm", counts, 0.0, high, open_end=True)


def _facts(tissue: TissueRecord) -> str:
    quality, edge, size, bounds = tissue["quality"], tissue["edge_mm"], tissue["size_mm"], tissue["bounds_mm"]
    known: list[tuple[str, str]] = [
        ("file", words(tissue["file"])),
        ("triangles, vertices", f"{tissue['triangles']:,}, {tissue['vertices']:,}"),
        ("parts, genus", f"{tissue['components']:,}, {'-' if tissue['genus'] is None else tissue['genus']}"),
        ("closed, manifold", f"{_yes(tissue['closed'])}, {_yes(tissue['manifold'])}"),
        ("oriented, outward", f"{_yes(tissue['oriented'])}, {_yes(tissue['outward'])}"),
        ("volume", f"{number(tissue['volume_mm3'])} mm&sup3;"),
        ("area", f"{number(tissue['area_mm2'])} mm&sup2;"),
    ]
    if quality:
        known.append(("q least, 1 %, mean", " / ".join(number(quality[key]) for key in ("min", "p01", "mean"))))
    for title, spread in (("edges", edge), ("size r_out", size)):
        if spread:
            values = " / ".join(number(spread[key]) for key in ("min", "mean", "max"))
            known.append((f"{title} least, mean, greatest", f"{values} mm"))
    known.append(("sharpest fold", f"{number(tissue['min_dihedral_deg'])}&deg;"))
    hits = tissue["self_intersections"]
    known.append(("self-intersections", f"{'' if hits['complete'] else 'at least '}{plural(hits['pairs'], 'pair')}"))
    if bounds:
        spans = " &times; ".join(number(high - low) for low, high in zip(bounds["min"], bounds["max"], strict=True))
        known.append(("extent", f"{spans} mm"))
    known.append(("SHA-256", f"<code>{words(tissue['sha256'][:16])}</code>"))
    return facts(known)


def _yes(value: bool) -> str:
    return "yes" if value else '<b class="error">no</b>'


def _stage(tissue: TissueRecord) -> str:
    """Return what a stage did to the tissue, with its measures before and after."""
    if "status" not in tissue:
        return ""
    status = tissue["status"]
    parts = [
        f'<p><span class="{_CSS_LEVEL.get(status, "")}">{words(status)}</span> {words(tissue.get("reason", ""))}</p>'
    ]
    if before := tissue.get("before"):
        parts.append(_before_after(before, tissue))
    off, change = tissue.get("deviation_mm"), tissue.get("volume_change")
    moved = []
    if off:
        moved.append(("deviation greatest, mean", f"{number(off['max'])} / {number(off['mean'])} mm"))
        if off["lost_area_mm2"]:
            moved.append(("area that is gone", f"{number(off['lost_area_mm2'])} mm&sup2;"))
    if change is not None:
        moved.append(("change of volume", f"{100 * change + 0.0:+.3g} %"))
    parts.append(facts(moved) if moved else "")
    if actions := tissue.get("actions"):
        items = "".join(f"<li><b>{words(action['step'])}</b> {words(action['message'])}</li>" for action in actions)
        parts.append(f"<ul>{items}</ul>")
    if introduced := tissue.get("introduced"):
        items = "".join(
            f"<li>{words(item['rule'])} {words(item['message'])}: {item['before']:,} before, {item['after']:,} after"
            "</li>"
            for item in introduced
        )
        parts.append(f'<p class="error">New defects</p><ul>{items}</ul>')
    return "".join(parts)


def _before_after(before: TissueMeasures, after: TissueMeasures) -> str:
    rows = "".join(
        f"<tr><td>{title}</td><td class=n>{old}</td><td class=n>{new}</td></tr>"
        for (title, old), (_, new) in zip(_compared(before), _compared(after), strict=True)
    )
    return (
        "<table><thead><tr><th></th><th class=n>before</th><th class=n>after</th></tr></thead>"
        f"<tbody>{rows}</tbody></table>"
    )


def _compared(record: TissueMeasures) -> list[tuple[str, str]]:
    quality, edge = record["quality"], record["edge_mm"]
    return [
        ("triangles", f"{record['triangles']:,}"),
        ("volume (mm3)", number(record["volume_mm3"])),
        ("q least", number(quality["min"] if quality else None)),
        ("q mean", number(quality["mean"] if quality else None)),
        ("shortest edge (mm)", number(edge["min"] if edge else None)),
        ("open edges", f"{record['topology']['boundary_edges']:,}"),
        ("self-intersections", f"{record['self_intersections']['pairs']:,}"),
    ]
