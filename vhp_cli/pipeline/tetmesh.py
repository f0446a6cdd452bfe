"""Mesh a model from end to end: check the surfaces, fill them with tetrahedra, write, measure, report."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path, PurePosixPath

from vhp_cli import formats
from vhp_cli.config import Settings
from vhp_cli.errors import UsageError
from vhp_cli.formats.atomic import make_directory
from vhp_cli.formats.volume import FORMS, write_volume
from vhp_cli.measures import Report
from vhp_cli.mesh import Mesh
from vhp_cli.model import Model
from vhp_cli.pipeline.check import Progress, available_cores, check_model
from vhp_cli.pipeline.journal import engine_versions
from vhp_cli.pipeline.output import REPORT, refuse_overlap, sole_writer
from vhp_cli.pipeline.tetmesh_input import read_tissues, relations_of
from vhp_cli.pipeline.tetmesh_report import MeshedPart, tetmesh_report
from vhp_cli.pipeline.tetmesh_surfaces import Apart, SetApart, set_apart
from vhp_cli.processes import CallFailed
from vhp_cli.stages.tetmesh.keep_surface import installed_engine
from vhp_cli.stages.tetmesh.modelling import Meshed, in_threads, mesh_model
from vhp_cli.stages.tetmesh.options import ANY_ENGINE, TetmeshOptions
from vhp_cli.stages.tetmesh.surfaces import tissue_surfaces
from vhp_cli.stages.tetmesh.tissues import Relations, Tissue

WHOLE = "model"
SURFACES = "surfaces"
# Gaps are measured at least so far: the envelope depends on the smallest one.
_GAP_SEARCH_MM = 1.0
# And so many envelopes.
_GAP_SEARCH = 3.0


@dataclass(frozen=True, slots=True)
class Job:
    """What is to be made of a model.

    Parameters
    ----------
    options
        How to mesh.
    options_of
        The same for a tissue of this name.
    forms
        Keys of `vhp_cli.formats.volume.FORMS`.
    per_tissue
        One mesh for each tissue, instead of one of all.
    surfaces
        Whether the boundaries of the labels are written too.
    apart
        How these are healed and set apart; None: as they are.
    """

    options: TetmeshOptions
    options_of: Callable[[str], TetmeshOptions]
    forms: tuple[str, ...] = ("vtu",)
    per_tissue: bool = False
    surfaces: bool = False
    apart: Apart | None = None

    def as_dict(self) -> dict[str, object]:
        """Return everything, as the report stores it."""
        own = {"format": list(self.forms), "per-tissue": self.per_tissue, "surfaces": self.surfaces}
        gap = {"surface-gap": self.apart.gap_mm} if self.apart else {}
        return {**self.options.as_dict(), **own, **gap}


@dataclass(frozen=True, slots=True)
class Done:
    """The report, whether a tissue could not be processed, and what became of surfaces that were set apart."""

    report: Report
    failed: bool
    surfaces: SetApart | None = None


def planned_files(model: Model, job: Job) -> dict[str, list[str]]:
    """Return the mesh files to be written below the output directory, by tissue; ``""`` for all together.

    Raises
    ------
    UsageError
        If two would have the same name.
    """
    stems = {"": WHOLE} if not job.per_tissue else {tissue.name: _below(tissue.name) for tissue in model.tissues}
    files: dict[str, list[str]] = {}
    for name, stem in stems.items():
        files[name] = []
        for form in job.forms:
            file = f"{stem}{FORMS[form].suffix}"
            files[name].append(f"{stem}-{form}{FORMS[form].suffix}" if file in files[name] else file)
    planned = [file for found in files.values() for file in found]
    planned += [f"{SURFACES}/{_below(tissue.name)}.stl" for tissue in model.tissues if job.surfaces]
    seen: dict[str, str] = {}
    for file in planned:
        # Some file systems take names that differ in case only for the same.
        if file.casefold() in seen:
            raise UsageError(f"{file} would be written for two tissues", hint="rename one of the tissues")
        seen[file.casefold()] = file
    return files


def prepare_output(model: Model, out: Path, *, paths: Sequence[Path], overwrite: bool) -> None:
    """Make sure that the output directory can be written to; nothing is changed.

    Raises
    ------
    UsageError
        If it holds anything and may not be written over, or the model lies in it.
    """
    refuse_overlap(out, model, paths)
    try:
        occupied = out.exists() and any(out.iterdir())
    except OSError as error:
        raise UsageError(f"{out}: can't be used as the output directory: {error.strerror or error}") from error
    if occupied and not overwrite:
        raise UsageError(f"{out} is not empty", hint="give another directory, or --overwrite")


def run_tetmesh(
    model: Model,
    out: Path,
    job: Job,
    settings: Settings,
    *,
    paths: Sequence[Path],
    jobs: int | None = None,
    overwrite: bool = False,
    cache_directory: Path | None = None,
    progress: Progress | None = None,
) -> Done:
    """Mesh a model, write the meshes, and report on them.

    Parameters
    ----------
    model
        The tissues, from `vhp_cli.model.find_model`.
    out
        The directory to write to; made if it does not exist.
    job
        What to make.
    settings
        How files are read and judged.
    paths
        The model as named by the user.
    jobs
        Threads; None: one per available core.
    overwrite
        Whether the directory may hold something; what an earlier run wrote there is removed.
    cache_directory
        Where measures of surfaces are kept between runs; None: nowhere.
    progress
        Called with step, number done and number in all.

    Raises
    ------
    UsageError
        If the output directory can't be used, or no tissue can be read.
    NoRoomError
        If the disk is full.
    """
    prepare_output(model, out, paths=paths, overwrite=overwrite)
    files = planned_files(model, job)
    if job.options.air is not None and job.per_tissue:
        raise UsageError("with-air is for one mesh of all tissues, not for one mesh each")
    if job.options.keep_surface is not None:
        installed_engine(None if job.options.keep_surface == ANY_ENGINE else job.options.keep_surface)
    threads = jobs or available_cores()
    # Whether envelopes could close a gap between tissues has to be known.
    search = max(settings.gap_search_mm or 0.0, _GAP_SEARCH_MM, _GAP_SEARCH * (job.options.epsilon_mm or 0.0))
    before = check_model(
        model,
        replace(settings, gap_search_mm=search),
        paths=paths,
        jobs=jobs,
        cache_directory=cache_directory,
        progress=None if progress is None else lambda step, done, total: progress(f"input: {step}", done, total),
    )
    make_directory(out)
    with sole_writer(out):
        _clear(out)
        tissues = read_tissues(model, before.report, settings, job.options_of, job.options.edge_length)
        started = time.perf_counter()
        if job.per_tissue:
            parts = _one_by_one(tissues, out, job, files, threads, progress)
        else:
            parts = [_one(tissues, relations_of(before.report), out, job, "", files[""], threads, progress)]
        surfaces = _apart(parts, out, job, jobs, cache_directory, progress)
        seconds = time.perf_counter() - started
        report, failed = tetmesh_report(before.report, parts, settings, job.as_dict(), per_tissue=job.per_tissue)
    steps = before.report["run"]["seconds"]
    assert isinstance(steps, dict)
    times = {f"input {step}": value for step, value in steps.items() if step != "total"}
    times["tetmesh"] = round(seconds, 4)
    report["run"] = {
        **before.report["run"],
        "seconds": {**times, "total": round(sum(times.values()), 4)},
        "tetmesh_seconds": {part.name or WHOLE: part.seconds for part in parts},
        "engines": {name: version for name, version in engine_versions().items() if version},
        **_peak_memory(),
    }
    return Done(report, failed or before.failed or bool(surfaces and surfaces.failed), surfaces)


def _peak_memory() -> dict[str, object]:
    """Return the most memory that this process has held, and the largest of its children."""
    if sys.platform == "win32":
        return {}
    import resource

    unit = 2**20 if sys.platform == "darwin" else 2**10
    who = {"peak_memory_mb": resource.RUSAGE_SELF, "engine_peak_memory_mb": resource.RUSAGE_CHILDREN}
    return {key: round(resource.getrusage(process).ru_maxrss / unit, 1) for key, process in who.items()}


def _one_by_one(
    tissues: Sequence[Tissue],
    out: Path,
    job: Job,
    files: Mapping[str, list[str]],
    threads: int,
    progress: Progress | None,
) -> list[MeshedPart]:
    """Mesh each tissue by itself, several at a time, the largest first."""
    calls = []
    for tissue in tissues:
        own = replace(job, options=job.options_of(tissue.name))
        # Its edge length is that of its whole mesh.
        alone = [replace(tissue, edge_length=None)]
        calls.append(partial(_one, alone, Relations(), out, own, tissue.name, files[tissue.name], 1, None))
    sizes = [len(tissue.mesh.faces) for tissue in tissues]
    return in_threads(calls, sizes, threads, None if progress is None else partial(progress, "tetmesh"))


def _one(
    tissues: Sequence[Tissue],
    relations: Relations,
    out: Path,
    job: Job,
    name: str,
    files: Sequence[str],
    threads: int,
    progress: Progress | None,
) -> MeshedPart:
    """Make one mesh and write it; what fails is told, not raised."""
    started = time.perf_counter()
    written: list[str] = []
    meshed: Meshed | None = None
    failures: dict[tuple[str, ...], str] = {}
    seconds: dict[str, float] = {}
    surface_files: dict[str, str] = {}
    shared: dict[str, Mesh] = {}
    notes: list[str] = []
    try:
        if not tissues:
            raise CallFailed("error", "no tissue of the model can be meshed")
        meshed = mesh_model(tissues, relations, job.options, threads=threads, progress=progress)
        seconds, failures = dict(meshed.seconds), meshed.failures
    except CallFailed as error:
        failures[tuple(tissue.name for tissue in tissues)] = f"{error.reason}: {error.detail}"
    if meshed is not None and meshed.mesh is not None and len(meshed.mesh.tetrahedra):
        moment = time.perf_counter()
        for file, form in zip(files, job.forms, strict=True):
            make_directory((out / file).parent)
            renamed = write_volume(out / file, meshed.mesh, form)
            notes += [f"{file}: {label} is called {valid} there" for label, valid in renamed.items()]
            written.append(file)
        if job.surfaces:
            for tissue, mesh in tissue_surfaces(meshed.mesh, relations.containers).items():
                file = f"{SURFACES}/{_below(tissue)}.stl"
                surface_files[tissue] = file
                if job.apart is not None:
                    shared[tissue] = mesh
                    continue
                make_directory((out / file).parent)
                formats.write_mesh(out / file, mesh)
        seconds["write"] = round(time.perf_counter() - moment, 4)
    seconds["total"] = round(time.perf_counter() - started, 4)
    return MeshedPart(name, meshed, failures, written, surface_files, notes, seconds, shared)


def _apart(
    parts: Sequence[MeshedPart],
    out: Path,
    job: Job,
    jobs: int | None,
    cache_directory: Path | None,
    progress: Progress | None,
) -> SetApart | None:
    """Write the surfaces set apart, if that was asked for, and say in the notes what they are like."""
    surfaces = {name: mesh for part in parts for name, mesh in part.shared_surfaces.items()}
    if job.apart is None or not surfaces:
        return None
    files = {name: file.removeprefix(f"{SURFACES}/") for part in parts for name, file in part.surface_files.items()}
    made = set_apart(
        surfaces, files, out / SURFACES, job.apart, jobs=jobs, cache_directory=cache_directory, progress=progress
    )
    counts = ", ".join(f"{code} {count}" for code, count in made.report["summary"]["counts"].items())
    verdict = "pass the gate" if made.passed else f"do not pass the gate ({counts})"
    parts[0].notes.append(f"{SURFACES}: healed and set apart by {job.apart.gap_mm:g} mm, they {verdict}")
    return made


def _below(name: str) -> str:
    """Return a tissue's name as a path below the output directory."""
    path = PurePosixPath(name)
    return "/".join(part for part in path.parts if part not in (path.anchor, ".", ".."))


def _clear(out: Path) -> None:
    """Remove the report of an earlier run, and the files that it names."""
    try:
        found = json.loads((out / REPORT).read_bytes())
        files = [str(file) for file in found["tetmesh"]["files"]]
    except (OSError, ValueError, KeyError, TypeError):
        files = []
    # The report goes first: while it is missing, what is there is not complete.
    (out / REPORT).unlink(missing_ok=True)
    for file in files:
        path = PurePosixPath(file)
        if not path.is_absolute() and ".." not in path.parts and (out / file).is_file():
            (out / file).unlink()
