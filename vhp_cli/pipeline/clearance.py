"""Take the tissues of a model apart, as one: every tissue is brought into its room, whatever becomes of the others.

Rooms follow from the given surfaces alone, so that the order of files and the number of workers play no part. Only
what lies inside another tissue waits for that one, level by level, as it has to keep its distance from the final
surface. What is still too close after all were done is done anew from its given surface, more finely.
"""

from __future__ import annotations

import queue
import time
from collections.abc import Collection, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from pathlib import Path

from vhp_cli import formats
from vhp_cli.config import Settings
from vhp_cli.formats.atomic import make_directory
from vhp_cli.measures import Action
from vhp_cli.mesh import Mesh
from vhp_cli.model import Model, TissueFile
from vhp_cli.pipeline.check import Checked, Progress, available_cores, check_model
from vhp_cli.pipeline.clearance_plan import Neighbour, Plan, looking_farther, make_plan
from vhp_cli.pipeline.clearance_report import clearance_report
from vhp_cli.pipeline.clearance_rounds import held_back, too_close
from vhp_cli.pipeline.delivery import deliver
from vhp_cli.pipeline.journal import Entry, Head, Journal, Recorded, head_of
from vhp_cli.pipeline.measuring import parse_in_mm
from vhp_cli.pipeline.output import clear, earlier_run, output_files, refuse_overlap, sha256_of, sole_writer
from vhp_cli.pipeline.stage import Limits
from vhp_cli.pipeline.stage import Plan as StagePlan
from vhp_cli.pipeline.stage_report import stage_report
from vhp_cli.pipeline.staged import Staged, run_facts
from vhp_cli.pipeline.task import Result, Task
from vhp_cli.processes import CallFailed, Child
from vhp_cli.stages.clearance.attempt import Attempt
from vhp_cli.stages.clearance.cell import Bound, Cell
from vhp_cli.stages.clearance.cutting import SQUEEZED
from vhp_cli.stages.clearance.distance import SignedDistance
from vhp_cli.stages.clearance.options import ClearanceOptions
from vhp_cli.stages.clearance.separation import separate
from vhp_cli.stages.outcome import Outcome

COMMAND = "separate"
TARGET = "vhp_cli.pipeline.clearance:separate_tissue"
_WORK = "vhp_cli.pipeline.task:process"
_REASONS = {"timeout": "time limit", "memory": "memory limit", "crash": "crash", "error": "internal error"}
# How `vhp_cli.pipeline.task.process` begins to say that a result breaks a rule that the input kept.
_WORSE = "the result was worse"


@dataclass(frozen=True, slots=True)
class TissueTask:
    """What a worker is told besides the tissue itself.

    Parameters
    ----------
    neighbours
        What bounds its room, and where to read each.
    options, settings
        Of the run.
    level
        How finely it is done.
    may_shrink
        Whether it loses much of its volume to another one.
    rigid
        Whether it gives way to other rigid ones only, and no farther than it must.
    """

    neighbours: tuple[tuple[Neighbour, Path], ...]
    options: ClearanceOptions
    settings: Settings
    level: int
    may_shrink: bool
    rigid: bool = False


def separate_tissue(mesh: Mesh, task: TissueTask) -> Outcome:
    """Read the neighbours of a tissue and bring it into its room."""
    bounds = []
    for neighbour, path in task.neighbours:
        found = parse_in_mm(path, formats.read_bytes(path), task.settings).mesh
        bounds.append(Bound(neighbour.kind, SignedDistance(found), neighbour.gap_mm, neighbour.share))
    cell = Cell(SignedDistance(mesh), bounds)
    return separate(mesh, cell, task.options, Attempt(task.level), may_shrink=task.may_shrink, shrinks_only=task.rigid)


def plan_separation(
    model: Model,
    out: Path,
    options: ClearanceOptions,
    settings: Settings,
    *,
    paths: Sequence[Path],
    overwrite: bool = False,
) -> StagePlan:
    """Return what `separate_model` would do; nothing is written.

    Raises
    ------
    UsageError
        If the output directory can't be used.
    """
    settings = looking_farther(settings, [tissue.name for tissue in model.tissues])
    refuse_overlap(out, model, paths)
    files = output_files(model, paths)
    found = earlier_run(out, head_of(COMMAND, _identity(model, options, settings)), overwrite=overwrite)
    if found is None:
        return StagePlan(tuple(files), {}, {}, {})
    kept, _ = _taken_over(found, out, {tissue.name: tissue for tissue in model.tissues}, _named(model, files))
    done = {file: entry for file, entry in kept.items() if entry.level == found.levels.get(file, 0)}
    return StagePlan(tuple(files), kept, done, found.levels)


def separate_model(
    model: Model,
    out: Path,
    options: ClearanceOptions,
    settings: Settings,
    *,
    paths: Sequence[Path],
    jobs: int | None = None,
    limits: Limits | None = None,
    overwrite: bool = False,
    cache_directory: Path | None = None,
    progress: Progress | None = None,
) -> Staged:
    """Take the tissues of a model apart, write them, and report on them.

    Parameters
    ----------
    model, out, settings, paths, jobs, limits, overwrite, cache_directory, progress
        As of `vhp_cli.pipeline.staged.run_and_check`.
    options
        Of the run.

    Raises
    ------
    UsageError
        If the output directory can't be used, or not one file could be read.
    NoRoomError
        If the disk is full; what is finished is kept.
    """
    settings = looking_farther(settings, [tissue.name for tissue in model.tissues])
    limits = limits or Limits()
    refuse_overlap(out, model, paths)
    files = output_files(model, paths)
    head = head_of(COMMAND, _identity(model, options, settings))
    earlier_run(out, head, overwrite=overwrite)

    def check(of: Model, name: str, where: Sequence[Path]) -> Checked:
        named = None if progress is None else lambda step, done, total: progress(f"{name}: {step}", done, total)
        return check_model(of, settings, paths=where, jobs=jobs, cache_directory=cache_directory, progress=named)

    before = check(model, "input", paths)
    plan = make_plan(before.report, settings, options)
    make_directory(out)
    with sole_writer(out):
        run = _Run(model, out, files, plan, options, settings, head, limits, overwrite=overwrite)
        started, checking = time.perf_counter(), 0.0
        while True:
            if any(run.levels.values()):
                # From the second round on, others give way for those that did not.
                run.plan = make_plan(before.report, settings, options, *held_back(run.by_tissue))
            run.round(jobs or available_cores(), progress)
            clock = time.perf_counter()
            after = check(run.written, "result", [out])
            checking += time.perf_counter() - clock
            renewed = make_plan(before.report, settings, options, *held_back(run.by_tissue))
            again = too_close(renewed, after.report, run.by_tissue, options)
            if not again:
                break
            run.refine(again)
        seconds = time.perf_counter() - started - checking
    described = {**options.as_dict(), "gap": settings.rules["P005"].limit}
    report = stage_report(before.report, after.report, run.entries, command=COMMAND, options=described)
    report["clearance"] = clearance_report(before.report, report, run.plan.pairings, plan.stiffness, run.entries)
    report["run"] = run_facts(before.report, after.report, run.entries, COMMAND, seconds, run.reused, limits)
    failed = after.failed or any(entry.status == "failed" for entry in run.entries)
    return Staged(report, failed, run.reused)


class _Run:
    """The tissues of one run, round after round."""

    def __init__(
        self,
        model: Model,
        out: Path,
        files: Sequence[str],
        plan: Plan,
        options: ClearanceOptions,
        settings: Settings,
        head: Head,
        limits: Limits,
        *,
        overwrite: bool,
    ) -> None:
        self._out, self.plan, self._options, self._settings = out, plan, options, settings
        self._head, self._limits = head, limits
        self._files = _named(model, files)
        self._sources = {tissue.name: tissue for tissue in model.tissues}
        found = earlier_run(out, head, overwrite=overwrite)
        kept, self.levels = _taken_over(found, out, self._sources, self._files)
        clear(out, files)
        self._journal = Journal(out, head, kept, self._by_file())
        for file in files:
            make_directory((out / file).parent)
        self.reused = len(kept)
        self.written = Model(
            tuple(replace(tissue, path=out / self._files[tissue.name], file=self._files[tissue.name])
                  for tissue in model.tissues),
            model.unread,
        )  # fmt: skip

    @property
    def entries(self) -> tuple[Entry, ...]:
        """What became of each tissue, in the order of the model."""
        return tuple(self._journal.entries[file] for file in self._files.values())

    @property
    def by_tissue(self) -> dict[str, Entry]:
        """What became of the tissues that were done so far."""
        entries = self._journal.entries
        return {name: entries[file] for name, file in self._files.items() if file in entries}

    def round(self, jobs: int, progress: Progress | None) -> None:
        """Do every tissue that is not done, those within others after them."""
        todo = [
            name
            for name, file in self._files.items()
            if file not in self._journal.entries or self._journal.entries[file].level != self.levels[name]
        ]
        done = 0
        children: queue.SimpleQueue[Child] = queue.SimpleQueue()
        kept = [Child(memory_gb=self._limits.memory_gb, name="the worker") for _ in range(min(jobs, len(todo)))]
        for child in kept:
            children.put(child)
        executor = ThreadPoolExecutor(max(jobs, 1))
        try:
            waits = self._order(todo)
            running: dict[Future[None], str] = {}
            while waits or running:
                ready = sorted(
                    (name for name, before in waits.items() if not before),
                    key=lambda name: (-_size(self._sources[name].path), name),
                )
                for name in ready[: max(jobs, 1) - len(running)]:
                    del waits[name]
                    running[executor.submit(self._one, name, children)] = name
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    name = running.pop(future)
                    future.result()
                    for before in waits.values():
                        before.discard(name)
                    done += 1
                    if progress:
                        progress(COMMAND, done, len(todo))
        finally:
            executor.shutdown(wait=False, cancel_futures=True)
            for child in kept:
                child.close()

    def _order(self, todo: Collection[str]) -> dict[str, set[str]]:
        """Return for each tissue that is to be done those that come before it: around it, and to be done, too."""
        depth = {name: level for level, wave in enumerate(self.plan.waves(list(self._files))) for name in wave}
        return {
            name: {parent for parent in self.plan.parents(name) if parent in todo and depth[parent] < depth[name]}
            for name in todo
        }

    def refine(self, names: Sequence[str]) -> None:
        """Have some tissues done anew, more finely."""
        for name in names:
            self.levels[name] += 1
        self._journal = Journal(self._out, self._head, self._journal.entries, self._by_file())

    def _by_file(self) -> dict[str, int]:
        return {self._files[name]: level for name, level in self.levels.items() if level}

    def _one(self, name: str, children: queue.SimpleQueue[Child]) -> None:
        source, file = self._sources[name], self._files[name]
        started = time.perf_counter()
        result = self._processed(name, children)
        earlier = self._journal.entries.get(file)
        if result.status in ("failed", "refused") and earlier is not None and earlier.status == "changed":
            # What was coarser is better than nothing.
            note: Action = {
                "step": SQUEEZED,
                "message": f"done no more finely: {result.reason}",
                "count": 1,
                "places": [],
            }
            actions = [*earlier.actions, note]
            self._journal.add(replace(earlier, level=self.levels[name], actions=actions))
            return
        deliver(result, source, self._out, file, self._journal, started=started, level=self.levels[name])

    def _processed(self, name: str, children: queue.SimpleQueue[Child]) -> Result:
        """Return the first result that is no worse than the input: as asked, by cutting alone, or more finely."""
        neighbours = self.plan.neighbours(name)
        changed_parent = any(self._changed(parent) for parent in self.plan.parents(name))
        if not neighbours or not (self.plan.has_to_change(name) or changed_parent):
            return Result("unchanged")
        level = self.levels[name]
        tries = [(self._options, level)]
        if self._options.method == "auto":
            tries += [(replace(self._options, method="cut"), level), (self._options, level + 1)]
        for options, at_level in tries:
            result = self._attempt(name, neighbours, options, at_level, children)
            if result.status != "failed" or not result.reason.startswith(_WORSE):
                return result
        return replace(result, status="refused")

    def _attempt(
        self,
        name: str,
        neighbours: Sequence[Neighbour],
        options: ClearanceOptions,
        level: int,
        children: queue.SimpleQueue[Child],
    ) -> Result:
        source = self._sources[name]
        places = tuple((neighbour, self._surface_of(neighbour).absolute()) for neighbour in neighbours)
        told = TissueTask(
            places, options, self._settings, level, self.plan.may_shrink(name), self.plan.stiffness[name].rigid
        )
        task = Task(replace(source, path=source.path.absolute()), TARGET, told, self._settings)
        child = children.get()
        try:
            result: Result = child.call(_WORK, task, timeout_s=self._limits.timeout_for(_size(source.path)))
            return result
        except CallFailed as error:
            return Result("failed", f"{_REASONS[error.reason]}: {error.detail}")
        finally:
            children.put(child)

    def _surface_of(self, neighbour: Neighbour) -> Path:
        """Return where the surface is that bounds a room: the final one of a parent, else the given one."""
        if neighbour.kind == "parent":
            return self._out / self._files[neighbour.name]
        return self._sources[neighbour.name].path

    def _changed(self, name: str) -> bool:
        entry = self._journal.entries.get(self._files[name])
        return entry is not None and entry.status == "changed"


def _identity(model: Model, options: ClearanceOptions, settings: Settings) -> dict[str, object]:
    """Return everything but the code that decides what comes out: for each tissue that is the whole model."""
    return {
        "options": options.as_dict(),
        "settings": settings.as_dict(),
        "inputs": {tissue.name: sha256_of(tissue.path) for tissue in model.tissues},
    }


def _named(model: Model, files: Sequence[str]) -> dict[str, str]:
    return {tissue.name: file for tissue, file in zip(model.tissues, files, strict=True)}


def _taken_over(
    found: Recorded | None, out: Path, sources: Mapping[str, TissueFile], files: Mapping[str, str]
) -> tuple[dict[str, Entry], dict[str, int]]:
    """Return what an earlier run on the same inputs finished, and how finely each tissue is to be done."""
    nothing: dict[str, int] = dict.fromkeys(files, 0)
    if found is None:
        return {}, nothing
    levels = {name: found.levels.get(file, 0) for name, file in files.items()}
    kept = {}
    for name, file in files.items():
        entry = found.entries.get(file)
        whole = entry is not None and entry.status != "failed" and sha256_of(out / file) == entry.output
        # A tissue was done with the final surfaces of those around it: all before it have to be kept, too.
        if entry is not None and whole and entry.source == sha256_of(sources[name].path):
            kept[file] = entry
    complete = len(kept) == len(files)
    return kept, levels if complete or any(levels.values()) else nothing


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return 0
