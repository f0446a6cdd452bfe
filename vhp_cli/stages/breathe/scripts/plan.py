"""What every script says, before it is put into the words of a program."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from vhp_cli.stages.breathe.curves import Curve, added
from vhp_cli.stages.breathe.operations import AXES, Axis, LocalFrame, Operation, Parameter, Rotate, Scale
from vhp_cli.stages.breathe.sequence import Motion, Sequence

# Lines of VBA and expressions of variables have a limit of length; longer sums are cut into several variables.
_LONGEST = 400

WARNING = (
    "Written by vhp breathe. The operations, read back from this text and applied, give the vertices of the frames;",
    "it was not run in the program itself. Compare the first import and one frame before a long run.",
)


@dataclass(frozen=True, slots=True)
class Part:
    """One tissue of the model.

    Parameters
    ----------
    name
        Of the tissue.
    file
        Name of its mesh file, the same in every frame.
    motion
        How it moves; None if it stays.
    """

    name: str
    file: str
    motion: Motion | None = None


@dataclass(frozen=True, slots=True)
class Model:
    """What a script is written for.

    Parameters
    ----------
    sequence
        The sequence, for the sweep variable and its range.
    parts
        All tissues, those that stay too.
    frames
        Value of the sweep variable and directory, seen from the script's, of the frames at t = 0, 1, ..., N.

    Raises
    ------
    ValueError
        If there are no frames or the first is not at t = 0.
    """

    sequence: Sequence
    parts: tuple[Part, ...]
    frames: tuple[tuple[float, str], ...]

    def __post_init__(self) -> None:
        if not self.frames or self.frames[0][0] != 0.0:
            raise ValueError("a script needs the frames, the first of them at t = 0")
        for text in (*(part.file for part in self.parts), *(directory for _, directory in self.frames)):
            if not text.isprintable() or '"' in text:
                raise ValueError(f"the file name {text!r} can't be said in a script")


@dataclass(frozen=True, slots=True)
class Variable:
    """A variable of the script: a number without unit, as a text in the sweep variable and variables before it."""

    name: str
    text: str


@dataclass(frozen=True, slots=True)
class Step:
    """One operation of the script.

    Parameters
    ----------
    target
        Name of the object.
    kind
        What is done.
    frame, frame_name
        The local coordinate system and a name of it.
    values
        Three texts, each a number or the name of a variable: factors, angles in degrees or lengths in mm along x, y
        and z. Of a rotation all but that about `axis` are ``"0"``.
    axis
        Of a rotation; None of others.
    """

    target: str
    kind: Literal["scale", "rotate", "move"]
    frame: LocalFrame
    frame_name: str
    values: tuple[str, str, str]
    axis: Axis | None = None

    @property
    def angle(self) -> str:
        """The text of the angle of a rotation."""
        assert self.axis is not None
        return self.values[AXES.index(self.axis)]


@dataclass(frozen=True, slots=True)
class Plan:
    """A script without its words.

    Parameters
    ----------
    model
        What it is for.
    objects
        Names of the objects and their mesh files, in the order of the parts; shells are not among them.
    shells
        The same for the tissues that are displaced by a field, which no affine operation can do.
    variables, steps
        In the order in which they are to be said.
    """

    model: Model
    objects: tuple[tuple[str, str], ...]
    shells: tuple[tuple[str, str], ...]
    variables: tuple[Variable, ...]
    steps: tuple[Step, ...]


def plan(model: Model) -> Plan:
    """Return what a script for `model` has to say."""
    names = object_names(part.name for part in model.parts)
    objects, shells = [], []
    variables: list[Variable] = []
    steps: list[Step] = []
    for part, name in zip(model.parts, names, strict=True):
        if part.motion is not None and part.motion.fields:
            shells.append((name, part.file))
            continue
        objects.append((name, part.file))
        for number, operation in enumerate(part.motion.operations if part.motion else (), start=1):
            steps.append(_step(operation, name, f"{name}_{number}", model.sequence.variable, variables))
    return Plan(model, tuple(objects), tuple(shells), tuple(variables), tuple(steps))


def title(model: Model) -> str:
    """Return the name of the sequence, fit for a comment in any language."""
    return re.sub(r"[^\w .,()+-]", "_", model.sequence.name)


def object_names(tissues: Iterable[str]) -> list[str]:
    """Return names for programs: letters, digits and _, a letter first, no two the same but for case."""
    taken: set[str] = set()
    names = []
    for tissue in tissues:
        base = re.sub(r"[^A-Za-z0-9]+", "_", tissue).strip("_")
        if not base or not base[0].isalpha():
            base = f"T_{base}".rstrip("_")
        name, number = base, 1
        while name.lower() in taken:
            number += 1
            name = f"{base}_n{number}"
        taken.add(name.lower())
        names.append(name)
    return names


def _step(operation: Operation, target: str, prefix: str, sweep: str, variables: list[Variable]) -> Step:
    if isinstance(operation, Rotate):
        angle = _value(operation.angle, f"{prefix}_angle", sweep, variables)
        x, y, z = (angle if axis == operation.axis else "0" for axis in AXES)
        return Step(target, "rotate", operation.frame, f"{prefix}_cs", (x, y, z), operation.axis)
    x, y, z = (
        _value(parameter, f"{prefix}_{axis}", sweep, variables) for axis, parameter in operation.parameters().items()
    )
    kind: Literal["scale", "move"] = "scale" if isinstance(operation, Scale) else "move"
    return Step(target, kind, operation.frame, f"{prefix}_cs", (x, y, z))


def _value(parameter: Parameter, name: str, sweep: str, variables: list[Variable]) -> str:
    """Return the text of a parameter: a number, or a variable that is added to `variables`."""
    if parameter.constant():
        return repr(float(parameter.curve(0.0)))
    chunks = _chunks(parameter.curve, sweep)
    if len(chunks) > 1:
        names = [f"{name}_{number}" for number in range(1, len(chunks) + 1)]
        variables += [Variable(part, chunk) for part, chunk in zip(names, chunks, strict=True)]
        chunks = [added(names)]
    variables.append(Variable(name, chunks[0]))
    return name


def _chunks(curve: Curve, sweep: str) -> list[str]:
    """Return sums of the terms of a curve, none much longer than the limit."""
    chunks: list[list[str]] = [[]]
    for term in curve.terms(sweep):
        if chunks[-1] and len(added([*chunks[-1], term])) > _LONGEST:
            chunks.append([])
        chunks[-1].append(term)
    return [added(chunk) for chunk in chunks]
