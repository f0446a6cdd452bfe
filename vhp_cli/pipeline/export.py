"""Export a model from end to end: the gate, the files, the same gate on what was written, scripts, and the manifest."""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vhp_cli import formats
from vhp_cli.config import UNITS, Settings
from vhp_cli.errors import VhpError
from vhp_cli.formats.atomic import make_directory, write_atomically
from vhp_cli.formats.stl import parse_stl, stl_bytes
from vhp_cli.formats.surfaces import FORMS, NamedSurface, write_surfaces
from vhp_cli.measures import Export, ExportFile, ExportTissue, Report
from vhp_cli.model import Model
from vhp_cli.pipeline.check import Checked, Progress, check_model
from vhp_cli.pipeline.export_job import Job, tissue_rows
from vhp_cli.pipeline.export_judging import Check, judged
from vhp_cli.pipeline.export_manifest import MANIFEST, manifest_bytes, materials_csv
from vhp_cli.pipeline.export_plan import (
    MATERIALS,
    NEEDS,
    Planned,
    gate_settings,
    plan,
    refuse_size,
    script_files,
    script_keys,
)
from vhp_cli.pipeline.journal import JOURNAL, Entry, Head, Journal, head_of, read_journal
from vhp_cli.pipeline.measuring import scaled
from vhp_cli.pipeline.output import REPORT, clear, earlier_run, refuse_overlap, sha256_of, sole_writer
from vhp_cli.stages.export import scripts
from vhp_cli.stages.export.materials import Properties, properties_of
from vhp_cli.stages.export.targets import TARGETS, object_names

COMMAND = "export"


@dataclass(frozen=True, slots=True)
class Exported:
    """The report; whether a tissue could not be processed; how many files an earlier run had finished."""

    report: Report
    failed: bool
    reused: int = 0


def export_model(
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
) -> Exported:
    """Export a model that passes the gate; of one that fails, nothing is written unless it is forced.

    All files of an export hold the same coordinates: rounded to float32 if one of the formats does so. What was
    written is read again and judged by the same gate.

    Parameters
    ----------
    model
        The tissues, from `vhp_cli.model.find_model`.
    out
        The directory to write to; made if it does not exist. An interrupted export of the same settings is taken up.
    job
        What to export.
    settings
        How files are read and judged.
    paths
        The model as named by the user.
    jobs
        Threads; None: one per available core.
    overwrite
        Whether the directory may hold something else; what an earlier run wrote there is removed.
    cache_directory
        Where measures of surfaces are kept between runs; None: nowhere.
    progress
        Called with step, number done and number in all.

    Raises
    ------
    UsageError
        If the output directory can't be used, no tissue can be read, or the model is too large for the unit.
    NoRoomError
        If the disk is full; what is finished is kept.
    """
    settings = gate_settings(settings, job)
    head = head_of(COMMAND, {**settings.as_dict(), COMMAND: job.as_dict()})
    refuse_overlap(out, model, paths)
    _forget_refusal(out)
    earlier_run(out, head, overwrite=overwrite)

    def check(found: Model, how: Settings, at: Sequence[Path], step: str) -> Checked:
        return check_model(
            found, how, paths=at, jobs=jobs, cache_directory=cache_directory, progress=_named(progress, step)
        )

    before = check(model, settings, paths, "input")
    refuse_size(before.report, job)
    make_directory(out)
    with sole_writer(out):
        run = _Run(model, out, job, settings, head, before, check, progress)
        return run.refused(before) if run.is_refused(before) else run.export(overwrite=overwrite)


class _Run:
    """One export into one directory."""

    def __init__(
        self,
        model: Model,
        out: Path,
        job: Job,
        settings: Settings,
        head: Head,
        before: Checked,
        check: Check,
        progress: Progress | None,
    ) -> None:
        self._out, self._job, self._settings, self._head = out, job, settings, head
        self._before, self._check, self._progress = before, check, progress
        # What can't be read, or has no face, can't be written; it failed the gate.
        kept = [
            place for place, record in enumerate(before.report["tissues"]) if record["format"] and record["triangles"]
        ]
        self._left_out = [
            record["name"] for place, record in enumerate(before.report["tissues"]) if place not in set(kept)
        ]
        self._sources = [model.tissues[place] for place in kept]
        self._records = [before.report["tissues"][place] for place in kept]
        self._objects = object_names(source.name for source in self._sources)
        self._plan = plan(self._objects, job.forms)
        self._texts = [*script_files(job), MATERIALS, MANIFEST]
        self._journal: Journal | None = None

    def is_refused(self, checked: Checked) -> bool:
        return not self._sources or (
            not self._job.force and (checked.failed or not checked.report["summary"]["passed"])
        )

    def refused(self, checked: Checked) -> Exported:
        """Leave nothing in the directory but what was there before any export."""
        recorded = read_journal(self._out)
        if recorded and recorded.head.command == COMMAND:
            clear(self._out, [])
            (self._out / JOURNAL).unlink(missing_ok=True)
        for folder in {Path(planned.file).parent for planned in self._plan} - {Path()}:
            _remove_empty(self._out / folder)
        export = self._section(checked.report, files=[], refused=True, rounding={}, notes=[])
        report: Report = {**self._of_the_model(checked.report), "export": export}
        return Exported(report, checked.failed)

    def export(self, *, overwrite: bool) -> Exported:
        started = time.perf_counter()
        recorded = earlier_run(self._out, self._head, overwrite=overwrite)
        entries = dict(recorded.entries) if recorded else {}
        clear(self._out, [planned.file for planned in self._plan] + self._texts)
        # Whoever finds a manifest finds everything that it names.
        (self._out / MANIFEST).unlink(missing_ok=True)
        surfaces, rounding = self._surfaces()
        reused = self._write(surfaces, entries)
        after, worse = judged(
            self._plan,
            surfaces,
            [source.name for source in self._sources],
            self._out,
            self._job,
            self._settings,
            self._check,
        )
        if self.is_refused(after) or (worse and not self._job.force):
            result = self.refused(after)
            note = "the model passes, and what was written of it, rounded, does not: nothing is kept"
            result.report["export"]["notes"] += [note, *worse]
            result.report["summary"]["passed"] = False
            return result
        return self._finish(after, rounding, worse, reused, time.perf_counter() - started)

    def _surfaces(self) -> tuple[list[NamedSurface], dict[str, float]]:
        """Return the meshes as all files hold them, and by how far (mm) coordinates were rounded for that."""
        unit, mine = UNITS[self._job.unit], UNITS[self._settings.units]
        single = any(FORMS[form].single for form in self._job.forms)
        surfaces, rounding = [], {}
        for source, record, name in zip(self._sources, self._records, self._objects, strict=True):
            data = formats.read_bytes(source.path)
            if formats.sha256(data) != record["sha256"]:
                raise VhpError(f"{source.file} was changed during the run", hint="run the command again")
            mesh = formats.parse_mesh(source.path, data, weld_tolerance=self._settings.weld_tolerance_mm / mine).mesh
            exact = mesh.vertices
            if mine != unit:
                mesh = scaled(mesh, mine / unit)
            written = mesh.vertices
            if single:
                written = mesh.vertices.astype(np.float32).astype(np.float64)
                # Vertices that fall together are one, as every reader of STL will see it.
                mesh = parse_stl(source.path, stl_bytes(mesh)).mesh
            rounding[source.name] = float(np.abs(written * unit - exact * mine).max(initial=0.0))
            surfaces.append(NamedSurface(name, mesh))
        return surfaces, rounding

    def _write(self, surfaces: Sequence[NamedSurface], entries: Mapping[str, Entry]) -> int:
        """Write the files of meshes that an earlier run has not, and return how many it had."""
        kept = {}
        for planned in self._plan:
            entry = entries.get(planned.file)
            if (
                entry
                and entry.source == self._identity(planned)
                and sha256_of(self._out / planned.file) == entry.output
            ):
                kept[planned.file] = entry
        reused = len(kept)
        # Scripts and tables are written anew, yet stay ours until then.
        kept |= {name: entries[name] for name in self._texts if name in entries}
        self._journal = Journal(self._out, self._head, kept, {})
        for done, planned in enumerate(self._plan):
            if self._progress:
                self._progress("files", done, len(self._plan))
            if planned.file in kept:
                continue
            started = time.perf_counter()
            path = self._out / planned.file
            path.parent.mkdir(exist_ok=True)
            write_surfaces(path, [surfaces[place] for place in planned.tissues], planned.form, self._job.unit)
            self._note(planned.file, self._identity(planned), time.perf_counter() - started)
        if self._progress:
            self._progress("files", len(self._plan), len(self._plan))
        return reused

    def _write_text(self, name: str, data: bytes) -> None:
        write_atomically(self._out / name, data)
        self._note(name, "", 0.0)

    def _note(self, file: str, source: str, seconds: float) -> None:
        """Note that a file is finished: a later run may take it over, or remove it."""
        assert self._journal is not None
        self._journal.add(Entry(file, source, sha256_of(self._out / file), "changed", "", [], None, round(seconds, 4)))

    def _identity(self, planned: Planned) -> str:
        sources = [f"{self._objects[place]} {self._records[place]['sha256']}" for place in planned.tissues]
        return formats.sha256("\n".join([planned.form, *sources]).encode("utf-8", "surrogatepass"))

    def _finish(
        self, after: Checked, rounding: Mapping[str, float], worse: Sequence[str], reused: int, seconds: float
    ) -> Exported:
        notes = [*worse]
        if self._left_out:
            notes.append(f"left out, as there is nothing in them to write: {', '.join(self._left_out)}")
        properties = self._properties([source.name for source in self._sources])
        if self._job.frequency_hz is None and any(found.material and not found.known for found in properties):
            notes.append("no --frequency: materials have no permittivity and conductivity")
        texts = scripts.write(self._scene(after.report, properties), script_keys(self._job))
        missing = [script for script in TARGETS[self._job.target].scripts if script not in script_keys(self._job)]
        notes += [f"no script {scripts.SCRIPTS[name][0]}: it needs the format {NEEDS[name]}" for name in missing]
        texts[MATERIALS] = materials_csv(self._tissues(after.report, rounding))
        for name, text in texts.items():
            self._write_text(name, text.encode())
        files = [self._file(planned.file, planned.form, planned.tissues) for planned in self._plan]
        files += [self._file(name, Path(name).suffix.removeprefix("."), ()) for name in texts]
        forced = self._job.force and not (self._before.report["summary"]["passed"] and not after.failed)
        export = self._section(after.report, files=files, refused=False, rounding=rounding, notes=notes)
        export["forced"] = forced or not after.report["summary"]["passed"] or bool(worse)
        report: Report = {
            **self._of_the_model(after.report),
            "export": export,
            "run": self._run_facts(after.report, reused, seconds),
        }
        if not self._before.report["summary"]["passed"] or worse:
            report["summary"] = {**report["summary"], "passed": False}
        export["passed"] = report["summary"]["passed"]
        self._write_text(MANIFEST, manifest_bytes(report))
        return Exported(report, after.failed or self._before.failed, reused)

    def _of_the_model(self, report: Report) -> Report:
        """Return a check as one of the files that were given: what is found is to be mended there."""
        records = {record["name"]: record for record in self._before.report["tissues"]}
        return {
            **report,
            "command": COMMAND,
            "settings": {**self._before.report["settings"], COMMAND: self._job.as_dict()},
            "model": self._before.report["model"],
            "tissues": [
                {
                    **record,
                    "file": records[record["name"]]["file"],
                    "sha256": records[record["name"]]["sha256"],
                    "format": records[record["name"]]["format"],
                }
                for record in report["tissues"]
            ],
        }

    def _properties(self, names: Sequence[str]) -> tuple[Properties, ...]:
        return properties_of(names, self._settings, self._job.materials, self._job.frequency_hz)

    def _scene(self, report: Report, properties: Sequence[Properties]) -> scripts.Scene:
        object_of = {source.name: name for source, name in zip(self._sources, self._objects, strict=True)}
        form = "mat" if self._job.target == "matlab" else "stl"
        parts = tuple(
            scripts.Part(
                name,
                f"{form}/{name}{FORMS[form].suffix}",
                found,
                object_of.get(report["nesting"].get(found.tissue) or "", ""),
            )
            for name, found in zip(self._objects, properties, strict=True)
        )
        paths = self._before.report["model"]["paths"]
        assert isinstance(paths, list)
        title = Path(paths[0]).name if len(paths) == 1 else "a model"
        return scripts.Scene(title, self._job.unit, self._job.frequency_hz, parts)

    def _tissues(self, report: Report, rounding: Mapping[str, float]) -> list[ExportTissue]:
        objects = {source.name: name for source, name in zip(self._sources, self._objects, strict=True)}
        return tissue_rows(
            report, self._settings, self._job, sources=self._before.report, objects=objects, rounding=rounding
        )

    def _section(
        self,
        report: Report,
        *,
        files: list[ExportFile],
        refused: bool,
        rounding: Mapping[str, float],
        notes: list[str],
    ) -> Export:
        tissues = self._tissues(report, rounding)
        masses = [tissue["mass_kg"] for tissue in tissues if tissue["mass_kg"] is not None]
        return {
            "target": self._job.target,
            "passed": report["summary"]["passed"],
            "refused": refused,
            "forced": False,
            "unit": self._job.unit,
            "mm_per_unit": UNITS[self._job.unit],
            "frequency_hz": self._job.frequency_hz,
            "files": files,
            "tissues": tissues,
            "without_material": [tissue["name"] for tissue in tissues if not tissue["material"]],
            "without_density": [tissue["name"] for tissue in tissues if tissue["density"] is None],
            "mass_kg": sum(masses),
            "left_out": self._left_out,
            "notes": notes,
        }

    def _file(self, name: str, form: str, tissues: Sequence[int]) -> ExportFile:
        path = self._out / name
        return {
            "file": name,
            "format": form,
            "bytes": path.stat().st_size,
            "sha256": sha256_of(path),
            "tissues": [self._sources[place].name for place in tissues],
        }

    def _run_facts(self, after: Report, reused: int, seconds: float) -> dict[str, object]:
        steps: dict[str, float] = {}
        for prefix, report in (("input", self._before.report), ("result", after)):
            found = report["run"]["seconds"]
            assert isinstance(found, dict)
            steps |= {f"{prefix} {step}": value for step, value in found.items() if step != "total"}
        steps[COMMAND] = round(max(seconds - sum(v for k, v in steps.items() if k.startswith("result")), 0.0), 4)
        return {
            **after["run"],
            "started": self._before.report["run"]["started"],
            "seconds": {**steps, "total": round(sum(steps.values()), 4)},
            "reused": reused,
        }


def _named(progress: Progress | None, name: str) -> Progress | None:
    if progress is None:
        return None
    return lambda step, done, total: progress(f"{name}: {step}", done, total)


def _forget_refusal(out: Path) -> None:
    """Remove the report of an export that was refused, if nothing else is there: the way is free for the next one."""
    with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
        if [path.name for path in out.iterdir()] == [REPORT]:
            report = json.loads((out / REPORT).read_bytes())
            if report["command"] == COMMAND and report["export"]["refused"]:
                (out / REPORT).unlink()


def _remove_empty(folder: Path) -> None:
    # Not there, or it holds something of the user's.
    with contextlib.suppress(OSError):
        folder.rmdir()
