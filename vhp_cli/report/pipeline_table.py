"""The stages of a pipeline as a table on a terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from vhp_cli.measures import Report
from vhp_cli.report import text
from vhp_cli.report.verdict import stage_tissues

if TYPE_CHECKING:
    from rich.console import Console

_STYLE = {"passed": "green", "errors": "yellow", "failed": "bold red", "refused": "bold red", "not run": "dim"}


def print_pipeline(report: Report, console: Console) -> None:
    """Print what came of each stage, and which tissues it left alone."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    section = report["pipeline"]
    seconds = report["run"].get("seconds")
    reused = report["run"].get("reused")
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0), show_edge=False)
    for heading in ("Stage", "Outcome", "Tissues"):
        table.add_column(heading, overflow="fold")
    for heading in ("Triangles", "Errors", "Seconds"):
        table.add_column(heading, justify="right", no_wrap=True)
    for stage in section["stages"]:
        summary = stage["summary"]
        time = seconds.get(stage["directory"]) if isinstance(seconds, dict) else None
        kept = isinstance(reused, list) and stage["directory"] in reused
        table.add_row(
            stage["directory"],
            Text(stage["outcome"] + (", as before" if kept else ""), style=_STYLE[stage["outcome"]]),
            stage_tissues(stage),
            f"{summary['triangles']:,}" if summary else "-",
            f"{summary['errors']:,}" if summary else "-",
            "-" if time is None else f"{time:.1f}",
        )
    console.print(table)
    console.print()
    for stage in section["stages"]:
        for tissue in stage["left_alone"]:
            words = f"{stage['directory']}: {tissue['name']} {tissue['status']}: {tissue['reason']}"
            console.print(Text(text.visible(words)), soft_wrap=True)
    if any(stage["left_alone"] for stage in section["stages"]):
        console.print()
