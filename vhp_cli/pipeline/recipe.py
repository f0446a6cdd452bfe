"""The file that describes a pipeline: which commands run one after the other, with which options."""

from __future__ import annotations

import difflib
import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal, get_args

from vhp_cli.errors import UsageError

OnError = Literal["stop", "continue"]

# Commands whose results are surfaces: the next stage works on them.
SURFACES = ("heal", "separate", "smooth", "decimate")
# Commands that judge surfaces, or make something else of them.
RESULTS = ("check", "tetmesh", "breathe", "export")
COMMANDS = (*SURFACES, *RESULTS)
PRESETS = ("base", "smooth", "coarse", "accurate")

_OWN_KEYS = ("command", "name", "on-error")
_NAME = re.compile(r"[a-z0-9][a-z0-9_-]*")


@dataclass(frozen=True, slots=True)
class StageTable:
    """One ``[[stage]]`` of a pipeline file.

    Parameters
    ----------
    command
        One of `COMMANDS`.
    name
        What its directory is called, after its number.
    on_error
        Whether the pipeline ends if the stage finds errors or fails.
    options
        The options of the command by their long names, not yet checked.
    where
        What messages call it.
    """

    command: str
    name: str
    on_error: OnError
    options: Mapping[str, object]
    where: str


@dataclass(frozen=True, slots=True)
class Recipe:
    """A pipeline as described by its file.

    Parameters
    ----------
    name
        What reports call it: the file, or the preset.
    directory
        To which paths in it are relative.
    options
        Those that every stage gets whose command has them.
    stages
        In order.
    """

    name: str
    directory: Path
    options: Mapping[str, object]
    stages: tuple[StageTable, ...]


def read_recipe(path: Path) -> Recipe:
    """Read a pipeline file.

    Raises
    ------
    UsageError
        If it can't be read or is not a pipeline.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise UsageError(f"{path}: can't read the pipeline: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise UsageError(f"{path}: not a text file in UTF-8: {error}") from error
    return parse_recipe(text, path.as_posix(), path.parent)


def preset_text(name: str) -> str:
    """Return the pipeline file of a preset.

    Raises
    ------
    UsageError
        If there is no such preset.
    """
    if name not in PRESETS:
        raise UsageError(f"no preset {name!r}", hint=_near(name, PRESETS, "presets"))
    return files("vhp_cli").joinpath(f"data/presets/{name}.toml").read_text(encoding="utf-8")


def read_preset(name: str) -> Recipe:
    """Return the pipeline of a preset; errors as of `preset_text`."""
    return parse_recipe(preset_text(name), f"preset {name}", Path())


def parse_recipe(text: str, where: str, directory: Path) -> Recipe:
    """Parse the text of a pipeline file.

    Parameters
    ----------
    text
        In TOML.
    where
        What messages call it.
    directory
        To which paths in it are relative.

    Raises
    ------
    UsageError
        If it is not a pipeline.
    """
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise UsageError(f"{where}: not valid TOML: {error}") from error
    for key in table:
        if key not in ("options", "stage"):
            raise UsageError(f"{where}: unknown key {key!r}", hint=_near(key, ("options", "stage"), "keys"))
    options, stages = table.get("options", {}), table.get("stage", [])
    if not isinstance(options, dict):
        raise UsageError(f"{where}: [options] must be a table")
    if not isinstance(stages, list) or not all(isinstance(stage, dict) for stage in stages):
        raise UsageError(f"{where}: stages are tables: [[stage]]")
    if not stages:
        raise UsageError(f"{where}: no stage", hint='a stage is [[stage]] with command = "heal", for example')
    return Recipe(
        where, directory, options, tuple(_stage(stage, where, no) for no, stage in enumerate(stages, start=1))
    )


def _stage(table: Mapping[str, Any], where: str, number: int) -> StageTable:
    place = f"{where}: stage {number}"
    command = table.get("command")
    if not isinstance(command, str):
        raise UsageError(f"{place}: which command?", hint=f"command = one of {', '.join(COMMANDS)}")
    if command not in COMMANDS:
        raise UsageError(f"{place}: no stage can be {command!r}", hint=_near(command, COMMANDS, "commands"))
    name = table.get("name", command)
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise UsageError(f"{place}: name must be made of a-z, 0-9, - and _, not {name!r}")
    # Later stages may cure what surfaces have left; a result that is wrong stays so.
    on_error = table.get("on-error", "continue" if command in SURFACES else "stop")
    if on_error not in get_args(OnError):
        raise UsageError(f'{place}: on-error must be "stop" or "continue", not {on_error!r}')
    own = {key: value for key, value in table.items() if key not in _OWN_KEYS}
    return StageTable(command, name, on_error, own, f"{place} ({command})")


def _near(word: str, known: Iterable[str], what: str) -> str:
    known = list(known)
    near = difflib.get_close_matches(word, known, n=1)
    return f"did you mean {near[0]!r}?" if near else f"{what}: {', '.join(known)}"
