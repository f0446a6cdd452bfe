"""What a worker does with one tissue: read it, run the stage, and let the result stand only if it is no worse."""

from __future__ import annotations

import importlib
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from vhp_cli import formats
from vhp_cli.config import UNITS, Settings
from vhp_cli.errors import UnreadableFileError, VhpError
from vhp_cli.formats.reading import Reading
from vhp_cli.measures import Action, Deviation, Distance, Introduced, SmoothingStep
from vhp_cli.mesh import Mesh
from vhp_cli.model import TissueFile
from vhp_cli.pipeline.face_errors import FaceErrors, read_face_errors
from vhp_cli.pipeline.measuring import issues_of, measure, parse_in_mm, scaled, shape_limits, unreadable
from vhp_cli.pipeline.regressions import Measured, regressions
from vhp_cli.rounding import file_unit
from vhp_cli.stages.outcome import Outcome, Status

# What is wrong with a file though its surface may be in order; writing it anew mends that.
_MENDED_BY_WRITING = ("F003", "F004", "F009", "F010")


@dataclass(frozen=True, slots=True)
class Task:
    """One tissue, and what to do with it.

    Parameters
    ----------
    source
        The tissue; its path is absolute.
    target
        The stage, as ``"package.module:function"``: takes a mesh in mm and the options, returns an `Outcome`.
    options
        Of the stage.
    settings
        How files are read and judged.
    level
        How much more gently to go about it than `options` say, by their method ``gentler``.
    never_worse
        Whether a result that is worse than the input is thrown away; else what is worse is told.
    face_errors
        Where the errors of the faces are, which the stage takes as a third argument; None: it takes none.
    """

    source: TissueFile
    target: str
    options: object
    settings: Settings
    level: int = 0
    never_worse: bool = True
    face_errors: FaceErrors | None = None


@dataclass(frozen=True, slots=True)
class Result:
    """What became of one tissue.

    Parameters
    ----------
    status, reason, actions, deviation, history
        As of `Outcome`.
    introduced
        What is worse than in the input, where that is allowed.
    sha256
        Of the bytes that were read; empty if they could not be.
    data
        The file to write; None: a copy of the input.
    """

    status: Status
    reason: str = ""
    actions: list[Action] = field(default_factory=list)
    deviation: Deviation | None = None
    sha256: str = ""
    data: bytes | None = None
    history: list[SmoothingStep] = field(default_factory=list)
    introduced: list[Introduced] = field(default_factory=list)


def process(task: Task) -> Result:
    """Run a stage on one tissue; nothing is written."""
    path = task.source.path
    sha256 = ""
    try:
        data = formats.read_bytes(path)
        sha256 = formats.sha256(data)
        reading = parse_in_mm(path, data, task.settings)
    except UnreadableFileError as error:
        return Result("failed", f"F001: {unreadable(error).detail}", sha256=sha256)
    before = _measured(reading, task)
    if reason := _incomplete(reading, before, data):
        return Result("refused", reason, sha256=sha256)
    options: Any = task.options
    if task.level:
        span = np.ptp(reading.mesh.vertices, axis=0)
        options = options.gentler(task.level, float(np.linalg.norm(span)))
    module, _, name = task.target.partition(":")
    arguments: list[Any] = [reading.mesh, options]
    if task.face_errors is not None:
        try:
            arguments.append(read_face_errors(task.face_errors, task.source, data, reading))
        except VhpError as error:
            return Result("failed", error.message + (f"; {error.hint}" if error.hint else ""), sha256=sha256)
    with file_unit(UNITS[task.settings.units]):
        outcome: Outcome = getattr(importlib.import_module(module), name)(*arguments)
    return replace(_accepted(task, reading, before, data, outcome), sha256=sha256)


def _incomplete(reading: Reading, before: Measured, data: bytes) -> str:
    """Return why a surface is not what was meant, so that nothing should be made of it; empty if nothing says so."""
    if not len(reading.mesh.faces):
        return "F005: no triangle in the file"
    for issue in reading.issues:
        if issue.rule == "F002":
            return f"F002: {issue.detail}; a shape that is incomplete is not healed"
        if issue.rule == "F003" and reading.format == "stl-binary" and not before.measures["closed"]:
            announced = int.from_bytes(data[80:84], "little")
            if announced > reading.n_facets_stored:
                return f"F003: {issue.detail}, and the surface is open; a shape that is incomplete is not healed"
    return ""


def _accepted(task: Task, reading: Reading, before: Measured, data: bytes, outcome: Outcome) -> Result:
    """Turn an outcome into a file, read that back, and compare it with the input."""
    mended = [issue for issue in reading.issues if issue.rule in _MENDED_BY_WRITING]
    actions = list(outcome.actions)
    if outcome.status == "changed" and outcome.mesh is not None:
        mesh, deviation = outcome.mesh, outcome.deviation
    elif outcome.status == "unchanged" and mended:
        mesh, deviation = reading.mesh, _rounding(reading)
    elif outcome.status == "changed":
        return Result("failed", "the stage reported a change and gave no surface")
    else:
        return Result(outcome.status, outcome.reason, actions, history=outcome.history)
    notes: list[Action] = [
        {"step": "write", "message": f"{issue.rule}: {issue.detail}", "count": issue.count, "places": []}
        for issue in mended
    ]
    path = task.source.path
    written = formats.mesh_bytes(path, _in_file_units(mesh, task.settings))
    if written == data:
        return Result("unchanged", history=outcome.history)
    after = _measured(parse_in_mm(path, written, task.settings), task)
    worse = regressions(task.source.name, before, after, task.settings)
    if worse and task.never_worse:
        return Result("failed", f"the result was worse than the input: {', '.join(one['message'] for one in worse)}")
    return Result(
        "changed", outcome.reason, notes + actions, deviation, data=written, history=outcome.history, introduced=worse
    )


def _measured(reading: Reading, task: Task) -> Measured:
    measures, defects, _ = measure(reading, shape_limits(task.settings, task.source.name))
    return Measured(measures, defects, issues_of(reading))


def _in_file_units(mesh: Mesh, settings: Settings) -> Mesh:
    scale = UNITS[settings.units]
    return mesh if scale == 1.0 else scaled(mesh, 1.0 / scale)


def _rounding(reading: Reading) -> Deviation:
    """Return how far an unchanged surface moves by being written: an ASCII STL file may hold more digits."""
    vertices = reading.mesh.vertices
    farthest = mean = 0.0
    if reading.format == "stl-ascii":
        moved = np.linalg.norm(vertices - vertices.astype(np.float32), axis=1)
        farthest, mean = float(moved.max(initial=0.0)), float(moved.mean()) if len(moved) else 0.0
    way: Distance = {"max": farthest, "mean": mean, "xyz_mm": None}
    return {
        "max": farthest,
        "mean": mean,
        "to_output": way,
        "to_input": way.copy(),
        "lost_area_mm2": 0.0,
        "lost_outside_mm2": 0.0,
        "lost_limit_mm": farthest,
        "lost_places": [],
    }
