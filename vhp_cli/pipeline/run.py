"""Run a pipeline: one command after the other, each in a process of its own, only what is not done yet."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from vhp_cli.errors import UsageError
from vhp_cli.formats import sha256
from vhp_cli.formats.atomic import make_directory, write_atomically
from vhp_cli.measures import Report
from vhp_cli.model import find_model
from vhp_cli.pipeline.child_command import run_command
from vhp_cli.pipeline.journal import head_of
from vhp_cli.pipeline.output import REPORT, output_files, refuse_overlap, sole_writer
from vhp_cli.pipeline.recipe import SURFACES, OnError
from vhp_cli.pipeline.run_record import (
    RECORDS,
    Record,
    content_hash,
    empty,
    files_in,
    model_hash,
    read_record,
    recorded_directories,
    write_record,
)

FINAL = "surfaces"
CONFIG = "vhp.toml"
PASSED, ERRORS, USAGE, FAILED = 0, 1, 2, 3
# Exit codes after which the results of a command are complete.
_COMPLETE = (PASSED, ERRORS, FAILED)
_INTERRUPTED = (130, -2)


@dataclass(frozen=True, slots=True)
class Step:
    """One stage of a pipeline, ready to run.

    Parameters
    ----------
    directory
        Where its results go, below the output directory.
    words
        What calls the command.
    options
        Its options as given, for the report.
    arguments
        The same on the command line.
    where
        What messages call it.
    speed
        Arguments that do not decide what comes out.
    files
        What is named by its options.
    on_error
        Whether the pipeline ends if it finds errors or fails.
    """

    directory: str
    words: tuple[str, ...]
    options: Mapping[str, object]
    arguments: tuple[str, ...]
    where: str = ""
    speed: tuple[str, ...] = ()
    files: tuple[Path, ...] = ()
    on_error: OnError = "continue"

    @property
    def command(self) -> str:
        """The command."""
        return self.words[0]

    @property
    def makes_surfaces(self) -> bool:
        """Whether the next stage works on its results."""
        return self.command in SURFACES


@dataclass(frozen=True, slots=True)
class StageDone:
    """What came of a stage.

    Parameters
    ----------
    step
        The stage.
    given
        The directory below the output directory whose surfaces it was given; empty: the model.
    exit_code
        Of its command; None if it was not run, as the pipeline had ended.
    report
        Its report; None if there is none.
    reused
        Whether an earlier run had done it.
    seconds
        How long it took in this run.
    """

    step: Step
    given: str
    exit_code: int | None
    report: Report | None
    reused: bool = False
    seconds: float = 0.0


@dataclass(frozen=True, slots=True)
class PipelineDone:
    """What came of a pipeline.

    Parameters
    ----------
    stages
        All of them.
    surfaces
        The stage, by directory, whose surfaces are the final ones; None if a stage that makes surfaces gave none.
    left_over
        Directories of stages that the pipeline has no longer.
    """

    stages: tuple[StageDone, ...]
    surfaces: str | None
    left_over: tuple[str, ...]


def run_pipeline(
    steps: Sequence[Step],
    model: Sequence[Path],
    out: Path,
    *,
    recursive: bool,
    flags: Sequence[str] = (),
    overwrite: bool = False,
    config: Path | None = None,
    tell: Callable[[Step, str], None] | None = None,
    execute: Callable[[Sequence[str]], int] = run_command,
) -> PipelineDone:
    """Run the stages of a pipeline, and copy the final surfaces to ``OUT/surfaces``.

    A stage whose inputs, options and code are those of an earlier run is not run again, as long as its results are
    there. One that was stopped goes on where it was if its command can do that, else it is done anew.

    Parameters
    ----------
    steps
        The stages.
    model
        The model as named by the user.
    out
        The output directory; made if it does not exist.
    recursive
        Whether directories are searched to any depth.
    flags
        Arguments for vhp itself, such as ``--quiet``.
    overwrite
        Do everything anew.
    config
        The settings file that all stages read, if there is one.
    tell
        Called with a stage that is about to be run, and how: ``"reused"``, ``"taken up"`` or ``"run"``.
    execute
        Runs a command line and returns its exit code.

    Raises
    ------
    UsageError
        If the output directory can't be used.
    NoRoomError
        If the disk is full.
    KeyboardInterrupt
        If the run was interrupted; it can be taken up.
    """
    check_output(model, out, recursive=recursive)
    make_directory(out / RECORDS)
    with sole_writer(out):
        # While the report is missing, what is there is not complete.
        (out / REPORT).unlink(missing_ok=True)
        runner = _Runner(list(model), out, recursive, tuple(flags), overwrite, tell, execute)
        stages: list[StageDone] = []
        for step in steps:
            stages.append(runner.skip(step) if runner.ended else runner.one(step))
        if runner.surfaces_whole and runner.given:
            _publish(out, out / runner.given, config)
        else:
            # What lies there is of an earlier run, and would be taken for the result of this one.
            _unpublish(out)
        planned = {step.directory for step in steps}
    left_over = tuple(name for name in recorded_directories(out) if name not in {*planned, FINAL})
    return PipelineDone(tuple(stages), runner.given if runner.surfaces_whole else None, left_over)


def check_output(model: Sequence[Path], out: Path, *, recursive: bool) -> None:
    """Make sure that the output directory can be used; nothing is changed.

    Raises
    ------
    UsageError
        If it holds something else than an earlier run of a pipeline, or the model and it overlap.
    """
    refuse_overlap(out, find_model(model, recursive=recursive), model)
    try:
        occupied = out.exists() and any(out.iterdir())
    except OSError as error:
        raise UsageError(f"{out}: can't be used as the output directory: {error.strerror or error}") from error
    if occupied and not (out / RECORDS).is_dir():
        raise UsageError(f"{out} is not empty and holds no run of a pipeline", hint="give another directory")


class _Runner:
    """The stages of one run, one after the other."""

    def __init__(
        self,
        model: list[Path],
        out: Path,
        recursive: bool,
        flags: tuple[str, ...],
        overwrite: bool,
        tell: Callable[[Step, str], None] | None,
        execute: Callable[[Sequence[str]], int],
    ) -> None:
        self.model, self.given = model, ""
        self.ended, self.surfaces_whole = False, True
        self._out, self._recursive, self._flags = out, recursive, flags
        # Of several directories each has one of its own in the results.
        found = output_files(find_model(model, recursive=recursive), model)
        self._nested = any("/" in file for file in found)
        self._overwrite, self._tell, self._execute = overwrite, tell, execute

    def skip(self, step: Step) -> StageDone:
        """Leave out a stage, as the pipeline has ended."""
        if step.makes_surfaces:
            self.surfaces_whole = False
        return StageDone(step, self.given, None, None)

    def one(self, step: Step) -> StageDone:
        """Run a stage, or take over its results."""
        given, started = self.given, time.perf_counter()
        wanted = self._wanted(step)
        found = read_record(self._out, step.directory)
        reused = not self._overwrite and self._is_done(step, wanted, found)
        report = read_report(self._out / step.directory) if reused else None
        if report is None:
            reused = False
            code = self._run(step, wanted, found)
            report = read_report(self._out / step.directory) if code in _COMPLETE else None
        else:
            assert found is not None
            code = found.exit_code
            self._say(step, "reused")
        if code not in (*_COMPLETE, USAGE) or (report is None and code != USAGE):
            code = FAILED
        if step.makes_surfaces:
            if report is not None:
                self.model, self.given = [self._out / step.directory], step.directory
                self._recursive = self._recursive or self._nested
            else:
                self.surfaces_whole = False
        # Without surfaces there is nothing to go on with.
        if (code != PASSED and step.on_error == "stop") or (step.makes_surfaces and report is None):
            self.ended = True
        return StageDone(step, given, code, report, reused, time.perf_counter() - started)

    def _wanted(self, step: Step) -> Record:
        """Return the record that the stage would have now."""
        contents = [[os.fspath(path), content_hash(path)] for path in step.files]
        head = head_of("run", {"command": step.words, "arguments": step.arguments, "files": contents})
        return Record(head.settings, model_hash(self.model, recursive=self._recursive), head.code, "started")

    def _is_done(self, step: Step, wanted: Record, found: Record | None) -> bool:
        """Tell if an earlier run has done all of it; what could not be processed then is tried again."""
        return (
            found is not None
            and found.state == "ended"
            and found.exit_code in (PASSED, ERRORS)
            and replace(found, state="started", exit_code=0, files={}) == wanted
            and dict(found.files) == files_in(self._out / step.directory)
        )

    def _run(self, step: Step, wanted: Record, found: Record | None) -> int:
        place = self._out / step.directory
        goes_on = found is not None and not self._overwrite and _can_go_on(step, wanted, found)
        if not goes_on:
            if found is None and place.exists():
                raise UsageError(f"{place} was not made by this pipeline", hint="move it away")
            empty(self._out, step.directory, wanted)
        write_record(self._out, step.directory, wanted)
        self._say(step, "taken up" if goes_on and place.exists() else "run")
        (place / REPORT).unlink(missing_ok=True)
        model = [plain(path) for path in self.model]
        deeper = ["--recursive"] if self._recursive else []
        code = self._execute(
            [*self._flags, *step.words, *model, "-o", os.fspath(place), *deeper, *step.arguments, *step.speed]
        )
        if code in _INTERRUPTED:
            raise KeyboardInterrupt
        if code in _COMPLETE:
            write_record(
                self._out, step.directory, replace(wanted, state="ended", exit_code=code, files=files_in(place))
            )
        return code

    def _say(self, step: Step, how: str) -> None:
        if self._tell is not None:
            self._tell(step, how)


def _can_go_on(step: Step, wanted: Record, found: Record) -> bool:
    """Tell if a command finds its way in what it left: it keeps an account, and would refuse that of another run."""
    if not step.makes_surfaces or found.state == "clearing":
        return False
    if (found.settings, found.code) != (wanted.settings, wanted.code):
        return False
    # These two look at one tissue after the other; for the others the whole model decides on each.
    by_tissue = step.command in ("heal", "smooth") and not any(
        word.startswith("--clearance") for word in step.arguments
    )
    return by_tissue or found.inputs == wanted.inputs


def read_report(directory: Path) -> Report | None:
    """Return the report in the directory of a stage; None if there is none."""
    try:
        found: Any = json.loads((directory / REPORT).read_bytes())
    except (OSError, ValueError):
        return None
    if not isinstance(found, dict) or found.get("schema") != "vhp-report/1":
        return None
    report: Report = found  # type: ignore[assignment]
    return report


def plain(path: Path) -> str:
    """Return a path as an argument that can't be taken for an option."""
    text = os.fspath(path)
    return f"./{text}" if text.startswith("-") else text


def _publish(out: Path, source: Path, config: Path | None) -> None:
    """Copy the final surfaces, and the settings they were judged by, to where users look for them."""
    target = out / FINAL
    files = {tissue.file: tissue.path for tissue in find_model([source], recursive=True).tissues}
    # A stage that was told of pairs that may touch hands them on as settings of its own.
    if config is None and (source / CONFIG).is_file():
        config = source / CONFIG
    if config is not None:
        files[CONFIG] = config
    found = read_record(out, FINAL)
    if found is None and target.exists():
        raise UsageError(f"{target} was not made by this pipeline", hint="move it away")
    contents = {file: path.read_bytes() for file, path in sorted(files.items())}
    wanted = {file: sha256(data) for file, data in contents.items()}
    if found is not None and files_in(target) == wanted:
        return
    record = Record("", "", "", "started", files=wanted)
    empty(out, FINAL, record)
    for file, data in contents.items():
        make_directory((target / file).parent)
        write_atomically(target / file, data)
    write_record(out, FINAL, replace(record, state="ended"))


def _unpublish(out: Path) -> None:
    if read_record(out, FINAL) is not None:
        empty(out, FINAL, Record("", "", "", "started"))
