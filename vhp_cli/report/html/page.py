"""The report as one page for a browser, with nothing to load beside it."""

from __future__ import annotations

from importlib.resources import files

from vhp_cli.measures import Finding, Report
from vhp_cli.report.html.colours import opacities, tissue_colours
from vhp_cli.report.html.figures import model_figures
from vhp_cli.report.html.findings import findings_section, rule_counts
from vhp_cli.report.html.markup import facts, script_json, tree, words
from vhp_cli.report.html.pairs import pairs_section
from vhp_cli.report.html.scene import Scene, build_scene
from vhp_cli.report.html.shown import Shown, Surfaces
from vhp_cli.report.html.stages import stage_sections
from vhp_cli.report.html.tissues import card, tissue_table
from vhp_cli.report.text import number, plural
from vhp_cli.report.verdict import Verdict, all_findings, by_rule, closing_line, tissue_verdicts

_MOST_FINDINGS = 4000  # on the page; above, some of each rule
_OPAQUE = 0.5


def html_page(report: Report, surfaces: Surfaces | None = None) -> str:
    """Return the page: verdict, viewer, findings, tissues, pairs, what the stage added, settings.

    Parameters
    ----------
    report
        The report.
    surfaces
        Gives the surface of a tissue, or says why there is none; without it the page has no viewer and no pictures.

    Returns
    -------
    str
        HTML 5, encodable in UTF-8. Its bytes depend on the report and the surfaces alone.
    """
    groups, left_out = _listed(report)
    findings = [finding for _, group in groups for _, finding in group]
    verdicts = tissue_verdicts(report)
    found = {
        tissue["name"]: surfaces(tissue) if surfaces else "the surface was not given" for tissue in report["tissues"]
    }
    shown = {name: surface for name, surface in found.items() if isinstance(surface, Shown)}
    scene = build_scene(report, findings, verdicts, shown)
    colours = tissue_colours([tissue["tissue_type"] for tissue in report["tissues"]])
    named: dict[str, list[tuple[int, Finding]]] = {tissue["name"]: [] for tissue in report["tissues"]}
    for _, group in groups:
        for index, finding in group:
            for name in dict.fromkeys(finding["tissues"]):
                named.get(name, []).append((index, finding))
    cards = [
        card(index, tissue, verdict, colour, found[tissue["name"]], named[tissue["name"]])
        for index, (tissue, verdict, colour) in enumerate(zip(report["tissues"], verdicts, colours, strict=True))
    ]
    worst_first = sorted(range(len(cards)), key=lambda index: (-verdicts[index].errors, -verdicts[index].warnings))
    gallery = "\n".join(cards[index] for index in worst_first)
    sections = [
        ("summary", "Summary", _summary(report)),
        ("findings", "Findings", findings_section(groups, left_out)),
        ("tissues", "Tissues", _filter() + tissue_table(report, verdicts, colours)),
        (
            "pictures",
            "Pictures and measures",
            f'<div class="cards">{gallery}</div>',
        ),
        ("pairs", "Pairs", pairs_section(report["pairs"], [tissue["name"] for tissue in report["tissues"]])),
        *stage_sections(report),
        ("about", "Settings and versions", _about(report)),
    ]
    return _page(report, sections, scene, _fallback(report, shown), bool(shown), verdicts)


def _listed(report: Report) -> tuple[list[tuple[str, list[tuple[int, Finding]]]], int]:
    """Return the findings of the page by rule, numbered through, and how many were left out."""
    groups = by_rule(all_findings(report))
    total = sum(len(findings) for _, findings in groups)
    most = _MOST_FINDINGS if total <= _MOST_FINDINGS else max(_MOST_FINDINGS // len(groups), 1)
    made, index = [], 0
    for code, findings in groups:
        made.append((code, list(enumerate(findings[:most], start=index))))
        index += len(made[-1][1])
    return made, total - index


def _summary(report: Report) -> str:
    summary = report["summary"]
    known = [tissue["quality"]["min"] for tissue in report["tissues"] if tissue["quality"]]
    edges = [tissue["edge_mm"]["min"] for tissue in report["tissues"] if tissue["edge_mm"]]
    tiles = [
        (f"{summary['tissues']:,}", "tissues", ""),
        (f"{summary['triangles']:,}", "triangles", ""),
        (f"{summary['errors']:,}", "errors", "error" if summary["errors"] else ""),
        (f"{summary['warnings']:,}", "warnings", "warning" if summary["warnings"] else ""),
        (f"{summary['notes']:,}", "notes", ""),
        (number(min(known, default=None)), "least q", ""),
        (number(min(edges, default=None)), "shortest edge, mm", ""),
    ]
    tiles += [(f"{count:,}", words(status), "") for status, count in sorted(summary.get("status", {}).items()) if count]
    made = "".join(f'<div class="tile {kind}"><b>{value}</b><span>{title}</span></div>' for value, title, kind in tiles)
    counts = {code: (len(group), group[0]["level"]) for code, group in by_rule(all_findings(report))}
    return f'<div class="tiles">{made}</div>{rule_counts(counts)}'


def _filter() -> str:
    return (
        '<form class="filter" role="search"><input type="search" id="filter" placeholder="Filter by name, type or '
        'rule" aria-label="Filter tissues"><select id="verdict" aria-label="Verdict"><option value="">all</option>'
        '<option value="error">failed</option><option value="warning">warnings</option><option value="pass">passed'
        '</option></select><output id="match-count"></output></form>'
    )


def _about(report: Report) -> str:
    run = {key: value for key, value in report["run"].items() if key != "seconds"}
    known = [
        ("command", words(report["command"])),
        ("tool", tree(report["tool"])),
        ("schema", words(report["schema"])),
        ("model", tree(report["model"])),
        ("settings", tree(report["settings"])),
        ("run", tree(run)),
        ("seconds", tree(report["run"].get("seconds", {}))),
    ]
    return facts(known)


def _fallback(report: Report, shown: dict[str, Shown]) -> str:
    """Return pictures of the model for browsers that can't show it in three dimensions."""
    colours = tissue_colours([tissue["tissue_type"] for tissue in report["tissues"]])
    every = [
        (shown[tissue["name"]], colour, opacity)
        for tissue, colour, opacity in zip(report["tissues"], colours, opacities(report), strict=True)
        if tissue["name"] in shown and len(shown[tissue["name"]].mesh.faces)
    ]
    if not every:
        return ""
    # What holds other tissues would hide them all.
    chosen = [entry for entry in every if entry[2] > _OPAQUE] or every
    hidden = len(every) - len(chosen)
    note = f"<p>{plural(hidden, 'tissue')} that hold others are left out.</p>" if hidden else ""
    return model_figures([entry[0] for entry in chosen], [entry[1] for entry in chosen]) + note


def _title(report: Report) -> str:
    paths = report["model"].get("paths")
    first = str(paths[0]) if isinstance(paths, list) and paths else ""
    more = f" and {len(paths) - 1} more" if isinstance(paths, list) and len(paths) > 1 else ""
    return first.rstrip("/").rsplit("/", 1)[-1] + more


def _page(
    report: Report,
    sections: list[tuple[str, str, str]],
    scene: Scene,
    fallback: str,
    has_surfaces: bool,
    verdicts: list[Verdict],
) -> str:
    passed = report["summary"]["passed"]
    title = words(_title(report))
    links = "".join(f'<a href="#{key}">{name}</a>' for key, name, _ in sections)
    body = "\n".join(f'<section id="{key}"><h2>{name}</h2>\n{contents}\n</section>' for key, name, contents in sections)
    failed = sum(not verdict.passed for verdict in verdicts)
    verdict = f"{'passed' if passed else 'failed'}"
    said = f"{failed:,} of {plural(len(verdicts), 'tissue')} failed" if failed else closing_line(report).split(";")[0]
    viewer = _asset("viewer.html") if has_surfaces else ""
    if scene.triangles < scene.of_triangles:
        thinned = (
            f"{scene.triangles:,} of {scene.of_triangles:,} triangles: thinned for viewing, except around findings"
        )
    else:
        thinned = f"all {plural(scene.triangles, 'triangle')}"
    viewer = viewer.replace("@FALLBACK@", fallback).replace("@THINNED@", thinned)
    data = ""
    if has_surfaces:
        data = (
            f'<script type="application/json" id="scene">{script_json(scene.data)}</script>\n'
            f'<script type="text/plain" id="geometry">{scene.geometry}</script>\n'
            f"<script>\n{_asset('viewer.js')}</script>\n"
        )
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; img-src data:; '
        "style-src 'unsafe-inline'; script-src 'unsafe-inline'\">\n"
        f"<title>{'✓' if passed else '✗'} vhp {words(report['command'])}: {title}</title>\n"
        f"<style>\n{_asset('page.css')}</style>\n<script>\n{_asset('theme.js')}</script></head>\n"
        f'<body class="{"with-viewer" if has_surfaces else ""}">\n<header class="top">'
        f'<span class="verdict {"pass" if passed else "error"}">{verdict}</span>'
        f"<h1>{title or words(report['command'])}</h1>"
        f'<span class="dim">vhp {words(report["command"])} &middot; {words(said)}</span>'
        '<button type="button" id="theme" aria-label="Light or dark" title="Light or dark">&#9680;</button></header>\n'
        f'<main><div class="report"><nav aria-label="Sections">{links}</nav>\n{body}\n</div>\n{viewer}</main>\n'
        f"{data}<script>\n{_asset('page.js')}</script>\n</body></html>\n"
    )


def _asset(name: str) -> str:
    return files("vhp_cli.report.html").joinpath(name).read_text(encoding="utf-8")
