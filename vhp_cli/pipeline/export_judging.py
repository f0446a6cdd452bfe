"""Read again what an export wrote, to see if it is what was meant, and if it passes the gate."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from vhp_cli import formats
from vhp_cli.config import Settings
from vhp_cli.errors import VhpError
from vhp_cli.formats.ply import ply_bytes
from vhp_cli.formats.surfaces import NamedSurface, nastran
from vhp_cli.mesh import Mesh
from vhp_cli.model import Model, TissueFile
from vhp_cli.pipeline.check import Checked
from vhp_cli.pipeline.export_job import Job
from vhp_cli.pipeline.export_plan import Planned

# Formats that the gate reads. The first of them that is written is judged, all are compared with what was meant.
_READABLE = ("stl", "ply", "obj")
_NASTRAN = ("bdf", "nas")

# Checks a model by settings; the directory and the step are for the report and the progress.
Check = Callable[[Model, Settings, Sequence[Path], str], Checked]


def judged(
    plan: Sequence[Planned],
    surfaces: Sequence[NamedSurface],
    names: Sequence[str],
    out: Path,
    job: Job,
    settings: Settings,
    check: Check,
) -> tuple[Checked, list[str]]:
    """Return the check of the coordinates that exact formats hold, and what is wrong with those rounded as text.

    Parameters
    ----------
    plan
        What was written.
    surfaces
        What was meant, one for each tissue.
    names
        The tissues.
    out
        The output directory.
    job, settings, check
        How to judge.

    Raises
    ------
    VhpError
        If a file does not hold what it should.
    """
    settings = replace(settings, units=job.unit, weld_tolerance_mm=0.0)
    readable = [form for form in _READABLE if form in job.forms]
    for planned in plan:
        if planned.form in readable:
            _compare(planned, [formats.read_mesh(out / planned.file).mesh], surfaces)
    if readable:
        files = {planned.tissues[0]: planned.file for planned in plan if planned.form == readable[0]}
        tissues = tuple(TissueFile(name, out / files[place], files[place]) for place, name in enumerate(names))
        after = check(Model(tissues), settings, [out], "result")
    else:
        after = _check_meshes([surface.mesh for surface in surfaces], names, out, settings, check, "result")
    worse = []
    for planned in plan:
        if planned.form not in _NASTRAN:
            continue
        meshes = nastran.parse(formats.read_bytes(out / planned.file))
        if all(np.array_equal(mesh.vertices, mine.mesh.vertices) for mesh, mine in zip(meshes, surfaces, strict=True)):
            _compare(planned, meshes, surfaces)
            continue
        # Text of 16 characters a coordinate is not exact.
        again = _check_meshes(meshes, names, out, settings, check, planned.form)
        if after.report["summary"]["passed"] and (again.failed or not again.report["summary"]["passed"]):
            worse += [
                f"{planned.file}, rounded to its columns: {item['rule']} {' '.join(item['tissues'])}: {item['message']}"
                for item in again.report["findings"]
                if item["level"] == "error"
            ]
    return after, worse


def _compare(planned: Planned, found: Sequence[Mesh], surfaces: Sequence[NamedSurface]) -> None:
    for mesh, place in zip(found, planned.tissues, strict=True):
        meant = surfaces[place].mesh
        if not np.array_equal(mesh.vertices[mesh.faces], meant.vertices[meant.faces]):
            raise VhpError(f"{planned.file} does not hold what was written to it", hint="check the disk")


def _check_meshes(
    meshes: Sequence[Mesh], names: Sequence[str], out: Path, settings: Settings, check: Check, step: str
) -> Checked:
    """Check meshes that stand in no file that the gate reads."""
    with tempfile.TemporaryDirectory(prefix="vhp-export-") as scratch:
        tissues = []
        for number, (name, mesh) in enumerate(zip(names, meshes, strict=True)):
            path = Path(scratch, f"{number}.ply")
            path.write_bytes(ply_bytes(mesh))
            tissues.append(TissueFile(name, path, path.name))
        return check(Model(tuple(tissues)), settings, [out], step)
