"""The tetrahedral mesh on a terminal: a row for each tissue, and what holds for all of them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from vhp_cli.measures import Report, Tetmesh, TetmeshLabel
from vhp_cli.report import text
from vhp_cli.report.verdict import Verdict

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

_LONG_MODEL = 40  # above so many tissues, only those with findings are listed


def print_tetmesh(report: Report, verdicts: list[Verdict], console: Console, *, verbose: bool) -> int:
    """Print the table of tissues; return how many that passed were left out.

    Parameters
    ----------
    report
        The report; it has a mesh.
    verdicts
        On each tissue, in order.
    console
        Where to print.
    verbose
        All tissues, however many.
    """
    from rich.text import Text

    mesh = report["tetmesh"]
    labels = {label["name"]: label for label in mesh["labels"]}
    table = _columns()
    short = not verbose and len(verdicts) > _LONG_MODEL
    hidden = 0
    for no, (tissue, verdict) in enumerate(zip(report["tissues"], verdicts, strict=True), start=1):
        if short and verdict.passed and not verdict.warnings and tissue.get("status") != "failed":
            hidden += 1
            continue
        style = "red" if not verdict.passed else "yellow" if verdict.warnings else "green"
        cells = _cells(labels.get(tissue["name"]))
        table.add_row(str(no), Text(text.visible(tissue["name"])), *cells, Text(verdict.words, style=style))
    if table.row_count:
        console.print(table)
    return hidden


def tetmesh_lines(mesh: Tetmesh) -> list[str]:
    """Return in words what holds for the mesh as a whole."""
    what = "meshes" if mesh["per_tissue"] else "mesh"
    lines = [f"{what} of {mesh['tets']:,} tetrahedra, {mesh['points']:,} points"]
    if mesh["air"]:
        lines[0] += f", and {mesh['air']['tets']:,} tetrahedra of air"
    if (length := mesh["edge_length_mm"]) and (epsilon := mesh["epsilon_mm"]):
        lines.append(
            f"edges of {text.number(length)} mm asked; within {text.number(epsilon)} mm of the surfaces "
            f"({text.visible(mesh['epsilon_reason'])})"
        )
    if len(clusters := mesh.get("clusters", [])) > 1 and not mesh["per_tissue"]:
        failed = sum(bool(cluster["failure"]) for cluster in clusters)
        lines.append(
            f"{len(clusters)} clusters that stand apart, each meshed by itself"
            + (f"; {failed} failed" if failed else "")
        )
    if quality := mesh["quality"]:
        lines.append(
            f"dihedral angles {text.number(quality['min_dihedral_deg'])} to "
            f"{text.number(quality['max_dihedral_deg'])} deg; radius ratio at least "
            f"{text.number(quality['radius_ratio_min'])}, 99 % above {text.number(quality['radius_ratio_p01'])}; "
            f"scaled Jacobian at least {text.number(quality['scaled_jacobian_min'])}"
        )
    if mesh["tets"]:
        lines.append("conforming" if mesh["conforming"] else "not conforming")
    given = mesh["input"]
    if not given["passed"]:
        counts = ", ".join(f"{code} {count}" for code, count in given["counts"].items())
        lines.append(f"the surfaces do not pass the gate ({counts})")
    lines += [text.visible(note) for note in mesh["notes"]]
    if not mesh["reproducible"]:
        lines.append(f"made by {mesh['engine']}, which gives a slightly different mesh each time")
    return lines


def _columns() -> Table:
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0), show_edge=False)
    table.add_column("No", justify="right", no_wrap=True)
    table.add_column("Tissue", overflow="fold", min_width=10)
    for heading in ("Tetrahedra", "Volume\n(ml)", "Off\n(%)", "Min.\nangle", "Radius\nratio 1 %"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("Verdict", overflow="fold", min_width=12)
    return table


def _cells(label: TetmeshLabel | None) -> list[str]:
    if label is None or not label["quality"]:
        return ["0", "-", "-", "-", "-"]
    error = label["volume_error"]
    return [
        f"{label['tets']:,}",
        text.number(label["volume_mm3"] / 1000),
        "-" if error is None else f"{round(100 * error, 2) + 0.0:+.2f}",
        text.number(label["quality"]["min_dihedral_deg"]),
        text.number(label["quality"]["radius_ratio_p01"]),
    ]
