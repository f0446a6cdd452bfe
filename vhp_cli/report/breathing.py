"""What a breathing model came to, on a terminal: one line per frame, the findings, the verdict."""

from __future__ import annotations

from typing import TYPE_CHECKING

from vhp_cli.measures import Breathe, Report
from vhp_cli.report.text import number, plural, visible
from vhp_cli.rules import RULES

if TYPE_CHECKING:
    from rich.console import Console

_STYLE = {"error": "bold red", "warning": "yellow", "note": "cyan"}
_LINES_PER_RULE = 5


def print_breathing(report: Report, console: Console, *, verbose: bool = False) -> None:
    """Print the report of `breathe` for a person.

    Parameters
    ----------
    report
        The report.
    console
        Where to print.
    verbose
        All findings and all roles.
    """
    section = report["breathe"]
    if verbose:
        _print_roles(section, console)
    _print_frames(section, console)
    by_rule: dict[str, list[str]] = {}
    levels: dict[str, str] = {}
    for finding in report["findings"]:
        names = " + ".join(visible(name) for name in finding["tissues"])
        by_rule.setdefault(finding["rule"], []).append(
            f"{names}: {finding['message']}" if names else finding["message"]
        )
        levels[finding["rule"]] = finding["level"]
    for code, lines in by_rule.items():
        console.print(f"{code} {RULES[code].name} ({plural(len(lines), levels[code])})", style=_STYLE[levels[code]])
        shown = lines if verbose else lines[:_LINES_PER_RULE]
        for line in shown:
            console.print(f"  {line}", markup=False, highlight=False)
        if len(shown) < len(lines):
            console.print(f"  and {len(lines) - len(shown)} more", markup=False, highlight=False)
    for note in section["notes"]:
        console.print(f"note: {note}", markup=False, highlight=False)
    console.print(_closing(report), style="bold green" if section["passed"] else "bold red", highlight=False)


def _print_roles(section: Breathe, console: Console) -> None:
    from rich.table import Table

    table = Table("tissue", "role", "motion", box=None, pad_edge=False)
    for name, role in section["roles"].items():
        table.add_row(visible(name), role, section["motions"].get(name, "stays"))
    console.print(table)
    console.print()


def _print_frames(section: Breathe, console: Console) -> None:
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for heading in ("frame", "x", "t/T", "lungs l", "travel mm", "mass change %", "crossings", "least gap mm", ""):
        table.add_column(heading, justify="right" if heading else "left")
    for frame in section["frames"]:
        gap = frame["min_gap_mm"]
        table.add_row(
            str(frame["index"]),
            f"{frame['x']:.4g}",
            f"{frame['time_over_T']:.4f}",
            f"{frame['lung_volume_l']:.4f}",
            f"{frame['diaphragm_travel_mm'] + 0.0:.2f}",
            f"{100 * frame['mass_change']:+.4f}",
            str(frame["crossings"]),
            "far" if gap is None else f"{gap:.3f}",
            "" if frame["passed"] else "rejected: " + ", ".join(frame["reasons"]),
        )
    console.print(table)
    console.print()


def _closing(report: Report) -> str:
    section = report["breathe"]
    proof, frames = section["proof"], section["frames"]
    failed = sum(not frame["passed"] for frame in frames)
    verdict = "passed" if section["passed"] else "failed"
    text = f"{verdict}: {plural(len(frames), 'frame')}" + (f", {failed} rejected" if failed else "")
    text += f"; lungs {section['lungs']['volume_change_l']:+.4f} l, travel {section['lungs']['travel_mm']:.2f} mm"
    if proof["unproven"]:
        return f"{text}; {plural(len(proof['unproven']), 'interval')} without proof"
    contacts = len(proof["joined"]) + len(proof["bounded"]) + len(proof["excused"])
    apart = proof["pairs"] - contacts
    text += f"; {plural(apart, 'pair')} proven apart at every moment"
    if proof["least_gap_mm"] is not None:
        text += f" (gaps above {number(proof['least_gap_mm'])} mm)"
    if contacts:
        text += f"; of {contacts} in contact at rest {contacts - len(proof['excused'])} proven to get no tighter"
    return text
