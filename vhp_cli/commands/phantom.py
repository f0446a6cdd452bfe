"""``vhp phantom``: write a synthetic torso, sound or with known defects."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from vhp_cli.commands.options import comma_list
from vhp_cli.errors import UsageError, VhpError

if TYPE_CHECKING:
    from vhp_cli.phantom import Planted

PLANTED_FILE = "planted.json"


@click.command("phantom")
@click.argument("out", type=click.Path(path_type=Path, file_okay=False))
@click.option(
    "--triangles",
    type=click.IntRange(min=1),
    default=100_000,
    show_default=True,
    help="Triangles of all tissues together, met within 10 %.",
)
@click.option("--tissues", type=click.IntRange(min=1), help="Number of tissues, the most important ones first.")
@click.option(
    "--defects",
    type=click.IntRange(min=0),
    metavar="SEED",
    help=f"Plant defects, chosen by this seed, and list them in OUT/{PLANTED_FILE}.",
)
@click.option(
    "--defect-rules",
    callback=comma_list,
    metavar="RULES",
    help="Plant defects of these rules only, by code or beginning of a code: T,X,Q,F003. [default: all kinds]",
)
@click.option(
    "--format",
    "form",
    type=click.Choice(("stl", "ply", "obj")),
    default="stl",
    show_default=True,
    help="Format of the tissues. Defects of the files themselves are planted in STL only.",
)
@click.option("--overwrite", is_flag=True, help="Write into a directory that is not empty.")
@click.pass_context
def phantom(
    ctx: click.Context,
    out: Path,
    triangles: int,
    tissues: int | None,
    defects: int | None,
    defect_rules: list[str],
    form: str,
    overwrite: bool,
) -> None:
    """Write a synthetic torso into the directory OUT, one file for each tissue.

    All tissues are closed surfaces in mm (LPS) that keep 1.02 mm from each other, so that `vhp check OUT` finds
    nothing but what --defects planted. The same options give the same files.
    """
    from vhp_cli.formats import write_mesh
    from vhp_cli.phantom import generate, plant_defects, plant_file_defects

    kinds = _kinds(defect_rules, defects)
    _prepare(out, overwrite)
    model = generate(triangles, tissues)
    planted: list[Planted] = []
    if defects is not None:
        model, planted = plant_defects(model, defects, kinds=kinds)
    quiet = bool((ctx.obj or {}).get("quiet"))
    for name, mesh in model.items():
        write_mesh(out / f"{name}.{form}", mesh)
    if defects is not None:
        if form == "stl":
            planted += plant_file_defects(out, defects, {name for one in planted for name in one.tissues}, kinds)
        _write_list(out / PLANTED_FILE, defects, planted)
        for one in planted:
            place = "" if one.xyz_mm is None else " at " + ", ".join(f"{value:.1f}" for value in one.xyz_mm) + " mm"
            click.echo(f"{one.rule}  {' + '.join(one.tissues)}{place}: {one.note}")
    if not quiet:
        number = sum(len(mesh.faces) for mesh in model.values())
        click.echo(f"wrote {len(model)} tissues with {number:,} triangles to {out}", err=True)


def _kinds(chosen: list[str], seed: int | None) -> list[str]:
    """Return the rules that may be broken."""
    from vhp_cli.phantom import PLANTED_RULES

    if chosen and seed is None:
        raise UsageError("--defect-rules says which defects, and --defects is missing")
    for text in chosen:
        if not any(rule.startswith(text.upper()) for rule in PLANTED_RULES):
            raise UsageError(f"--defect-rules: no defect {text!r} can be planted", hint=" ".join(PLANTED_RULES))
    prefixes = tuple(text.upper() for text in chosen) or ("",)
    return [rule for rule in PLANTED_RULES if rule.startswith(prefixes)]


def _prepare(out: Path, overwrite: bool) -> None:
    """Make the directory; refuse one with anything in it unless told otherwise."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        occupied = any(out.iterdir())
    except OSError as error:
        raise VhpError(f"can't use {out}: {error.strerror or error}") from error
    if occupied and not overwrite:
        raise UsageError(f"{out} is not empty", hint="give another directory, or --overwrite")


def _write_list(path: Path, seed: int, planted: list[Planted]) -> None:
    import json

    from vhp_cli.formats.atomic import atomic_write_text

    rows = [
        {
            "rule": one.rule,
            "tissues": list(one.tissues),
            "xyz_mm": None if one.xyz_mm is None else list(one.xyz_mm),
            "note": one.note,
        }
        for one in planted
    ]
    atomic_write_text(path, json.dumps({"seed": seed, "planted": rows}, indent=2) + "\n")
