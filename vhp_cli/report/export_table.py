"""What people read of an export: files, names, materials and masses."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from vhp_cli.measures import Export, ExportTissue
from vhp_cli.report.text import visible

if TYPE_CHECKING:
    from rich.console import Console

_SHOWN = 8


def closing_lines(export: Export, out: str) -> list[str]:
    """Return the lines below the table of an export."""
    if export["refused"]:
        return [f"Nothing was exported for {export['target']}; --force exports all the same."]
    meshes = [file for file in export["files"] if file["tissues"]]
    size = sum(file["bytes"] for file in export["files"])
    lines = [
        f"Exported for {export['target']} to {out}: {len(meshes)} files of meshes in {export['unit']}, "
        f"{len(export['files']) - len(meshes)} others, {size / 2**20:.1f} MiB."
    ]
    if export["forced"]:
        lines.append("The gate found errors: this export was forced.")
    if renamed := sum(tissue["object"] != tissue["name"] for tissue in export["tissues"]):
        lines.append(f"{renamed} tissues have other names there; manifest.json has both.")
    for key, what in (("without_material", "No material is known"), ("without_density", "No density is known")):
        names = export[key]  # type: ignore[literal-required]
        if names:
            more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
            lines.append(f"{what} for {', '.join(visible(name) for name in names[:_SHOWN])}{more}.")
    return lines


def print_materials(tissues: Sequence[ExportTissue], frequency: str, console: Console) -> None:
    """Print material, properties (at a frequency, in words) and mass of each tissue, and where the values are from."""
    from rich.table import Table
    from rich.text import Text

    sources: dict[str, int] = {}
    table = Table(box=None, header_style="bold", pad_edge=False)
    table.add_column("tissue", overflow="fold", min_width=12)
    table.add_column("material", overflow="fold", min_width=8)
    for title in ("eps_r", "S/m", "kg/m3", "own mm3", "mass g", "source"):
        table.add_column(title, justify="right", no_wrap=True)
    for tissue in tissues:
        mass = tissue["mass_kg"]
        numbers = [
            str(sources.setdefault(source, len(sources) + 1))
            for source in (tissue["dielectric_source"], tissue["density_source"])
            if source
        ]
        table.add_row(
            Text(visible(tissue["name"])),
            Text(visible(tissue["material"]) or "-"),
            _number(tissue["permittivity"], ".4g"),
            _number(tissue["conductivity"], ".3g"),
            _number(tissue["density"], ".4g"),
            _number(tissue["own_volume_mm3"], ",.0f"),
            _number(None if mass is None else mass * 1000, ",.1f"),
            ",".join(numbers) or "-",
        )
    console.print(table)
    for source, number in sources.items():
        console.print(f"{number:>3}  {visible(source)}", highlight=False, markup=False)
    known = [tissue["mass_kg"] for tissue in tissues if tissue["mass_kg"] is not None]
    unknown = [visible(tissue["name"]) for tissue in tissues if tissue["mass_kg"] is None]
    console.print(f"mass of {len(known)} of {len(tissues)} tissues: {sum(known):.4g} kg", highlight=False)
    if unknown:
        console.print(f"without a mass: {', '.join(unknown)}", highlight=False, markup=False)
    at = (
        f"permittivity and conductivity at {frequency}"
        if frequency
        else "permittivity and conductivity need --frequency"
    )
    console.print(at, highlight=False)


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)
