"""The report on a terminal: the table of tissues (thesis Table 4.3), the findings by rule, the verdict."""

from __future__ import annotations

from collections import Counter, defaultdict
from typing import TYPE_CHECKING

from vhp_cli.measures import Finding, Level, PairRecord, Report
from vhp_cli.report import text
from vhp_cli.report.pipeline_table import print_pipeline
from vhp_cli.report.tetmesh_table import print_tetmesh, tetmesh_lines
from vhp_cli.report.verdict import (
    Verdict,
    all_findings,
    by_rule,
    closing_line,
    deviation,
    is_staged,
    left_alone,
    rule_name,
    stage_words,
    tissue_verdicts,
)
from vhp_cli.rules import RULES

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table
    from rich.tree import Tree

_LONG_MODEL = 40  # above so many tissues, only those with findings are listed
_LINES_PER_RULE = 5
_STYLE: dict[Level, str] = {"error": "bold red", "warning": "yellow", "note": "cyan"}
_CROSSES = ("crossing", "identical")
_STATUS_STYLE = {"changed": "green", "unchanged": "dim", "refused": "yellow", "failed": "bold red"}


def print_table(report: Report, console: Console, *, verbose: bool = False, nesting: bool = False) -> None:
    """Print a report for a person.

    Parameters
    ----------
    report
        The report.
    console
        Where to print; its width is respected down to about 60 columns.
    verbose
        All tissues, findings, places and pairs instead of the worst, and the nesting.
    nesting
        The tree of tissues within tissues.
    """
    verdicts = tissue_verdicts(report)
    if "pipeline" in report:
        print_pipeline(report, console)
    if report["tissues"]:
        _print_tissues(report, verdicts, console, verbose=verbose)
        _print_stage(report, console, verbose=verbose)
    for code, findings in by_rule(all_findings(report)):
        _print_rule(code, findings, console, verbose=verbose)
    if report["pairs"]:
        _print_pairs(report["pairs"], console, verbose=verbose)
    if (verbose or nesting) and report["nesting"]:
        console.print(nesting_tree(report["nesting"]))
        console.print()
    style = "bold green" if report["summary"]["passed"] else _STYLE["error"]
    _print_words(console, closing_line(report), style)


def _print_words(console: Console, words: str, style: str = "", *, indent: int = 0) -> None:
    """Print words as they are (no markup), continuation lines indented with the first."""
    from rich.text import Text

    lines = Text(words, style=style).wrap(console, max(console.width - indent, 1), overflow="fold")
    for line in lines:
        line.rstrip()
        console.print(Text(" " * indent).append_text(line), soft_wrap=True)


def _columns(console: Console, *, staged: bool) -> Table:
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0), show_edge=False)
    narrow = console.width < (126 if staged else 100)
    tight = narrow and staged  # no room for the type
    table.add_column("No", justify="right", no_wrap=True)
    table.add_column("Tissue", overflow="fold", min_width=10 if tight else 12)
    table.add_column("Triangles", justify="right", no_wrap=True)
    table.add_column("Mesh\nquality" if narrow else "Mesh quality", justify="right", no_wrap=True)
    table.add_column("Min. edge\n(mm)" if narrow else "Min. edge length (mm)", justify="right", no_wrap=True)
    if staged:
        table.add_column("Status", no_wrap=True)
        table.add_column("Off\n(mm)" if narrow else "Deviation (mm)", justify="right", no_wrap=True)
    if not tight:
        table.add_column("Tissue\ntype" if narrow else "Tissue type", overflow="fold")
    table.add_column("Verdict", overflow="fold", min_width=12 if tight else 10)
    return table


def _print_tissues(report: Report, verdicts: list[Verdict], console: Console, *, verbose: bool) -> None:
    from rich.text import Text

    if "tetmesh" in report:
        _print_mesh(report, verdicts, console, verbose=verbose)
        return
    staged = is_staged(report)
    table = _columns(console, staged=staged)
    short = not verbose and len(verdicts) > _LONG_MODEL
    hidden = 0
    for no, (tissue, verdict) in enumerate(zip(report["tissues"], verdicts, strict=True), start=1):
        status = tissue.get("status", "")
        if short and verdict.passed and not verdict.warnings and status not in ("refused", "failed"):
            hidden += 1
            continue
        quality, edge = tissue["quality"], tissue["edge_mm"]
        style = "red" if not verdict.passed else "yellow" if verdict.warnings else "green"
        cells: list[str | Text] = [
            str(no),
            Text(text.visible(tissue["name"])),
            f"{tissue['triangles']:,}",
            text.number(quality["min"] if quality else None),
            text.number(edge["min"] if edge else None),
        ]
        if staged:
            cells += [Text(status, style=_STATUS_STYLE.get(status, "")), deviation(tissue)]
        if len(cells) + 2 == len(table.columns):
            cells.append(Text(text.visible(tissue["tissue_type"])))
        table.add_row(*cells, Text(verdict.words, style=style))
    if table.row_count:
        console.print(table)
    if hidden:
        others = "other " if table.row_count else ""
        _print_words(console, f"{text.plural(hidden, f'{others}tissue')} passed (all are listed with --verbose)", "dim")
    console.print()


def _print_mesh(report: Report, verdicts: list[Verdict], console: Console, *, verbose: bool) -> None:
    if hidden := print_tetmesh(report, verdicts, console, verbose=verbose):
        _print_words(console, f"{text.plural(hidden, 'tissue')} passed (all are listed with --verbose)", "dim")
    console.print()
    for line in tetmesh_lines(report["tetmesh"]):
        _print_words(console, line)
    console.print()


def _print_stage(report: Report, console: Console, *, verbose: bool) -> None:
    """Print why tissues were left alone; with `verbose` also what was done to the others."""
    tissues = left_alone(report)
    if verbose and "tetmesh" not in report:
        tissues += [tissue for tissue in report["tissues"] if tissue.get("status") == "changed"]
    for tissue in tissues:
        _print_words(console, f"{text.visible(tissue['name'])}: {stage_words(tissue)}")
    if tissues:
        console.print()


def _print_rule(code: str, findings: list[Finding], console: Console, *, verbose: bool) -> None:
    worst = findings[0]
    known = bool(worst.get("known"))
    title = f"{worst['level']} {rule_name(code)}, {text.plural(len(findings), 'finding')}{', all known' * known}"
    if code in RULES:
        title += f": {RULES[code].summary}"
    _print_words(console, title, "dim" if known else _STYLE[worst["level"]])
    shown = findings if verbose else findings[: _LINES_PER_RULE if len(findings) <= _LINES_PER_RULE else 4]
    for finding in shown:
        _print_finding(finding, console, verbose=verbose)
    if len(findings) > len(shown):
        _print_words(console, f"... and {len(findings) - len(shown):,} more (--verbose)", "dim", indent=2)
    hint = next((finding["hint"] for finding in findings if finding["hint"]), "")
    if hint:
        _print_words(console, f"fix: {text.visible(hint)}", "dim", indent=2)
    console.print()


def _print_finding(finding: Finding, console: Console, *, verbose: bool) -> None:
    words = f"{text.headline(finding)}{' (known)' if finding.get('known') else ''}"
    places = finding["places"]
    if places and not verbose:
        words += f", at {text.place(places[0], value=False)}"
    _print_words(console, words, "dim" if finding.get("known") else "", indent=2)
    if verbose:
        for spot in places:
            _print_words(console, f"at {text.place(spot)}", indent=4)


def _print_pairs(pairs: list[PairRecord], console: Console, *, verbose: bool) -> None:
    relations = Counter(pair["relation"] for pair in pairs)
    parts = [f"{count:,} {relation.replace('_', ' ')}" for relation, count in sorted(relations.items())]
    words = f"{text.plural(len(pairs), 'near pair')}: {', '.join(parts)}"
    apart = [(pair["min_gap_mm"], pair) for pair in pairs if pair["min_gap_mm"] and pair["relation"] not in _CROSSES]
    if apart:
        gap, pair = min(apart, key=lambda item: item[0] or 0.0)
        words += f"; smallest gap {text.number(gap)} mm, {text.visible(pair['a'])} - {text.visible(pair['b'])}"
    _print_words(console, words)
    if verbose:
        console.print(_pair_table(pairs))
    console.print()


def _pair_table(pairs: list[PairRecord]) -> Table:
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0), show_edge=False)
    table.add_column("a", overflow="fold", min_width=8)
    table.add_column("b", overflow="fold", min_width=8)
    table.add_column("Relation", overflow="fold")
    for heading in ("Gap (mm)", "Crossing\nfaces", "Overlap\n(mm3)"):
        table.add_column(heading, justify="right", no_wrap=True)
    for pair in pairs:
        table.add_row(
            Text(text.visible(pair["a"])),
            Text(text.visible(pair["b"])),
            pair["relation"].replace("_", " "),
            text.number(pair["min_gap_mm"]),
            f"{pair['crossing_faces']:,}",
            text.number(pair["overlap_mm3"]),
        )
    return table


def nesting_tree(nesting: dict[str, str | None]) -> Tree:
    """Return the tissues as a tree; a tissue whose chain of parents does not end is a root."""
    from rich.text import Text
    from rich.tree import Tree

    children: dict[str | None, list[str]] = defaultdict(list)
    for name, parent in nesting.items():
        children[parent if parent in nesting else None].append(name)
    root = Tree("Nesting")
    placed: set[str] = set()
    for name in (*children[None], *nesting):
        stack = [(root, name)]
        while stack:
            branch, inner = stack.pop()
            if inner in placed:
                continue
            placed.add(inner)
            node = branch.add(Text(text.visible(inner)))
            stack += [(node, child) for child in reversed(children[inner])]
    return root
