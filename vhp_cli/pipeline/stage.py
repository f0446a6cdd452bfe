"""Run a stage over a model: each tissue in a bounded child process, results written whole, in any order."""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, replace
from pathlib import Path

from vhp_cli.config import Settings
from vhp_cli.formats.atomic import make_directory
from vhp_cli.measures import Action
from vhp_cli.model import Model, TissueFile
from vhp_cli.pipeline.check import Progress, available_cores
from vhp_cli.pipeline.delivery import deliver
from vhp_cli.pipeline.face_errors import FaceErrors
from vhp_cli.pipeline.journal import Entry, Journal, head_of
from vhp_cli.pipeline.output import clear, earlier_run, output_files, refuse_overlap, sha256_of, sole_writer
from vhp_cli.pipeline.task import Result, Task
from vhp_cli.processes import CallFailed, Child, stop_all

_WORK = "vhp_cli.pipeline.task:process"
_NOTE = "moved less far than asked, as it would have come too near to a neighbour"
_GIVEN_UP = "it would come too near to a neighbour"
_REASONS = {"timeout": "time limit", "memory": "memory limit", "crash": "crash", "error": "internal error"}


@dataclass(frozen=True, slots=True)
class Stage:
    """A stage and its options.

    Parameters
    ----------
    command
        What the user calls it.
    target
        The function, as ``"package.module:function"``; see `vhp_cli.pipeline.task.Task`.
    options
        Returns the options for a tissue of this name.
    described
        The options in full, as the report stores them.
    most_gentle
        How many more attempts to make at a tissue that meets a neighbour, each more gently (`Task.level`).
    gives_up
        The last of these attempts is to leave the tissue as it is.
    never_worse
        Whether a result that is worse than the input is thrown away (`Task.never_worse`).
    face_errors
        Returns where the errors of the faces of the tissue of this name are (`Task.face_errors`); None: nowhere.
    """

    command: str
    target: str
    options: Callable[[str], object]
    described: Mapping[str, object]
    most_gentle: int = 0
    gives_up: bool = False
    never_worse: bool = True
    face_errors: Callable[[str], FaceErrors | None] | None = None


@dataclass(frozen=True, slots=True)
class Limits:
    """What a worker may take for one tissue; files with more than so many bytes per second may take longer."""

    timeout_s: float = 120.0
    memory_gb: float = 4.0
    bytes_per_second: float | None = None

    def timeout_for(self, size: int) -> float:
        """Return the seconds that a file of this size in bytes may take."""
        if self.bytes_per_second is None:
            return self.timeout_s
        return max(self.timeout_s, size / self.bytes_per_second)


@dataclass(frozen=True, slots=True)
class StageRun:
    """What a stage made of a model.

    Parameters
    ----------
    entries
        What became of each tissue, in the order of the model.
    written
        The model that was written.
    reused
        Tissues that an earlier run had finished.
    """

    entries: tuple[Entry, ...]
    written: Model
    reused: int


@dataclass(frozen=True, slots=True)
class Plan:
    """What there is to do.

    Parameters
    ----------
    files
        Where each tissue of the model goes below the output directory.
    kept
        What an earlier run found out on the same inputs, by file.
    done
        Those of them that are final and in place.
    levels
        How gently tissues are to be treated, where not as asked.
    """

    files: tuple[str, ...]
    kept: Mapping[str, Entry]
    done: Mapping[str, Entry]
    levels: Mapping[str, int]


def plan_stage(
    model: Model, out: Path, stage: Stage, settings: Settings, *, paths: Sequence[Path], overwrite: bool = False
) -> Plan:
    """Return what a run would do; nothing is written.

    Raises
    ------
    UsageError
        If the output directory can't be used.
    """
    refuse_overlap(out, model, paths)
    files = output_files(model, paths)
    found = earlier_run(out, head_of(stage.command, _identity(stage, settings)), overwrite=overwrite)
    if found is None:
        return Plan(tuple(files), {}, {}, {})
    kept = {}
    for source, file in zip(model.tissues, files, strict=True):
        entry, sha256 = found.entries.get(file), sha256_of(source.path)
        # What failed is tried again.
        if entry is not None and entry.status != "failed" and sha256 and entry.source == sha256:
            kept[file] = entry
    # Levels were decided on when all tissues were done: they hold for these tissues only.
    levels = found.levels if kept.keys() == set(files) == found.entries.keys() else {}
    done = {
        file: entry
        for file, entry in kept.items()
        if entry.level == levels.get(file, 0) and sha256_of(out / file) == entry.output
    }
    return Plan(tuple(files), kept, done, levels)


def run_stage(
    model: Model,
    out: Path,
    stage: Stage,
    settings: Settings,
    *,
    paths: Sequence[Path],
    jobs: int | None = None,
    limits: Limits | None = None,
    overwrite: bool = False,
    soften: Collection[str] = (),
    progress: Progress | None = None,
) -> StageRun:
    """Run a stage on every tissue of a model and write the results under the names of the inputs.

    Each file is written whole or not at all, and noted as finished; a run that was stopped at any moment is taken up
    where it was. What can't be processed, and what the stage leaves alone, is copied. The files do not depend on the
    number of workers.

    Parameters
    ----------
    model
        The tissues, from `vhp_cli.model.find_model`.
    out
        The directory to write to; made if it does not exist.
    stage
        What to do with each tissue.
    settings
        How files are read and judged.
    paths
        The model as named by the user.
    jobs
        Workers; None: one per available core.
    limits
        Of each worker.
    overwrite
        Do everything anew, whatever the directory holds.
    soften
        Files of a finished run whose tissues are to be treated anew, more gently.
    progress
        Called with step, number done and number in all.

    Raises
    ------
    UsageError
        If the output directory can't be used.
    NoRoomError
        If the disk is full; what is finished is kept.
    """
    plan_stage(model, out, stage, settings, paths=paths, overwrite=overwrite)
    make_directory(out)
    with sole_writer(out):
        # Another run may have ended since.
        plan = plan_stage(model, out, stage, settings, paths=paths, overwrite=overwrite)
        clear(out, plan.files)
        levels = {**plan.levels, **{file: plan.levels.get(file, 0) + 1 for file in soften}}
        journal = Journal(out, head_of(stage.command, _identity(stage, settings)), plan.kept, levels)
        for file in plan.files:
            make_directory((out / file).parent)
        jobs = jobs or available_cores()
        runner = _Runner(out, stage, settings, journal, limits or Limits(), levels)
        todo = [
            (source, file)
            for source, file in zip(model.tissues, plan.files, strict=True)
            if file not in plan.done or file in soften
        ]
        # The largest first, so that no long task is left for the end.
        todo.sort(key=lambda item: -_size(item[0].path))
        runner.run(todo, jobs, progress)
    entries = tuple(journal.entries[file] for file in plan.files)
    written = tuple(
        replace(source, path=out / file, file=file) for source, file in zip(model.tissues, plan.files, strict=True)
    )
    return StageRun(entries, Model(written, model.unread), len(plan.files) - len(todo))


class _Runner:
    """Does the tissues of one run, several at a time."""

    def __init__(
        self,
        out: Path,
        stage: Stage,
        settings: Settings,
        journal: Journal,
        limits: Limits,
        levels: Mapping[str, int],
    ) -> None:
        self._out = out
        self._stage = stage
        self._settings = settings
        self._journal = journal
        self._limits = limits
        self._levels = levels
        self._children: queue.SimpleQueue[Child] = queue.SimpleQueue()
        self._stopping = threading.Event()

    def run(self, todo: Sequence[tuple[TissueFile, str]], jobs: int, progress: Progress | None) -> None:
        with self._workers(min(jobs, len(todo))), ThreadPoolExecutor(max(jobs, 1)) as executor:
            try:
                futures = [executor.submit(self._one, source, file) for source, file in todo]
                for done, future in enumerate(as_completed(futures), start=1):
                    future.result()
                    if progress:
                        progress(self._stage.command, done, len(futures))
            except KeyboardInterrupt:
                self._stopping.set()
                executor.shutdown(wait=False, cancel_futures=True)
                stop_all()
                raise
            except BaseException:
                self._stopping.set()
                executor.shutdown(wait=False, cancel_futures=True)
                raise

    @contextlib.contextmanager
    def _workers(self, number: int) -> Iterator[None]:
        children = [Child(memory_gb=self._limits.memory_gb, name="the worker") for _ in range(number)]
        for child in children:
            self._children.put(child)
        try:
            yield
        finally:
            for child in children:
                child.close()

    def _one(self, source: TissueFile, file: str) -> None:
        if self._stopping.is_set():
            return
        started = time.perf_counter()
        level = self._levels.get(file, 0)
        result = self._processed(source, level)
        if self._stopping.is_set():
            return
        deliver(result, source, self._out, file, self._journal, started=started, level=level)

    def _processed(self, source: TissueFile, level: int) -> Result:
        """Return the gentlest result that changes something, else that of the options as they are."""
        if self._stage.gives_up and level == self._stage.most_gentle > 0:
            return Result("refused", _GIVEN_UP)
        while level:
            result = self._attempt(source, level)
            if result.status == "changed":
                note: Action = {"step": "contacts", "message": _NOTE, "count": level, "places": []}
                return replace(result, actions=[*result.actions, note])
            level -= 1
        return self._attempt(source, 0)

    def _attempt(self, source: TissueFile, level: int) -> Result:
        task = Task(
            replace(source, path=source.path.absolute()),
            self._stage.target,
            self._stage.options(source.name),
            self._settings,
            level,
            self._stage.never_worse,
            self._stage.face_errors(source.name) if self._stage.face_errors else None,
        )
        child = self._children.get()
        try:
            result: Result = child.call(_WORK, task, timeout_s=self._limits.timeout_s)
            return result
        except CallFailed as error:
            return Result("failed", f"{_REASONS[error.reason]}: {error.detail}")
        finally:
            self._children.put(child)


def _identity(stage: Stage, settings: Settings) -> dict[str, object]:
    """Return everything but the inputs and the code that decides what comes out."""
    return {"stage": stage.target, "options": dict(stage.described), "settings": settings.as_dict()}


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return 0
