"""The options of a stage of a pipeline, turned into the command line of its command and checked."""

from __future__ import annotations

import contextlib
import difflib
import importlib
import io
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from vhp_cli.errors import UsageError, VhpError

# Where a pipeline itself decides: where results and reports go.
_DECIDED = ("output", "overwrite", "dry_run", "form", "list_materials")
# What must be the same for all stages, as the surfaces of one are read by the next.
OF_ALL = ("recursive", "units", "weld-tolerance")
# How fast a stage runs, not what comes out.
SPEED = ("jobs", "cache")
# What a worker may take for a tissue: one that breaks a limit fails, and is tried again in any case.
LIMITS = {"timeout", "memory"}
# Commands that can be asked what they would do, so that everything they find wrong is found.
_WITH_DRY_RUN = ("check", "heal", "separate", "smooth", "decimate", "tetmesh", "export")


@dataclass(frozen=True, slots=True)
class Arguments:
    """A stage's options on the command line.

    Parameters
    ----------
    deciding
        Those that decide what comes out.
    speed
        All others.
    files
        Paths among the values.
    """

    deciding: tuple[str, ...]
    speed: tuple[str, ...]
    files: tuple[Path, ...]


def find_command(name: str) -> tuple[click.Command, tuple[str, ...]]:
    """Return the command of a stage, and the words that call it."""
    module = importlib.import_module(f"vhp_cli.commands.{name}")
    command: click.Command = getattr(module, name)
    if isinstance(command, click.Group):
        # `vhp breathe MODEL` is short for the group's default.
        words = (name, module.DEFAULT)
        return command.commands[module.DEFAULT], words
    return command, (name,)


def option_names(command: click.Command) -> dict[str, tuple[click.Option, bool]]:
    """Return the options that a pipeline may set, by long name, each with whether the name means yes."""
    names: dict[str, tuple[click.Option, bool]] = {}
    for parameter in command.params:
        if not isinstance(parameter, click.Option) or parameter.name in _DECIDED or parameter.is_eager:
            continue
        if any(name.startswith("--report") for name in parameter.opts):
            continue
        names |= {name[2:]: (parameter, True) for name in parameter.opts if name.startswith("--")}
        names |= {name[2:]: (parameter, False) for name in parameter.secondary_opts if name.startswith("--")}
    return names


def arguments_of(command: click.Command, values: Mapping[str, object], directory: Path, where: str) -> Arguments:
    """Turn a table of options into arguments.

    Parameters
    ----------
    command
        The command.
    values
        Options by long name.
    directory
        To which paths are relative.
    where
        What messages call the table.

    Raises
    ------
    UsageError
        If there is no such option, or it takes no such value.
    """
    names = option_names(command)
    deciding: list[str] = []
    speed: list[str] = []
    found_files: list[Path] = []
    for name, value in values.items():
        refuse_unknown(name, names, where)
        option, yes = names[name]
        words, paths = _words(option, name, yes, value, directory, where)
        (speed if name in SPEED or (name in LIMITS and names.keys() >= LIMITS) else deciding).extend(words)
        found_files += paths
    return Arguments(tuple(deciding), tuple(speed), tuple(found_files))


def refuse_unknown(name: str, known: Mapping[str, object], where: str) -> None:
    """Refuse an option that is not known, and name the nearest one.

    Raises
    ------
    UsageError
        If it is not known.
    """
    if name in known:
        return
    if name in ("output", "overwrite", "dry-run", "format", "list-materials") or name.startswith("report"):
        raise UsageError(f"{where}: {name} is decided by `vhp run`, not by a stage")
    near = difflib.get_close_matches(name, known, n=1)
    hint = f"did you mean {near[0]!r}?" if near else f"options: {', '.join(sorted(known))}"
    raise UsageError(f"{where}: no option {name!r}", hint=hint)


def _words(
    option: click.Option, name: str, yes: bool, value: object, directory: Path, where: str
) -> tuple[list[str], list[Path]]:
    """Return the arguments for one option, and the paths in them."""
    place = f"{where}: {name}"
    if option.is_flag:
        if not isinstance(value, bool):
            raise UsageError(f"{place}: expected true or false, not {value!r}")
        names = option.opts if value is yes else option.secondary_opts
        return [word for word in names if word.startswith("--")][:1], []
    long = f"--{name}"
    if isinstance(value, bool):
        if value and getattr(option, "_flag_needs_value", False):
            return [long], []
        raise UsageError(f"{place}: expected a value, not {str(value).lower()}")
    items = value if isinstance(value, list) else [value]
    if not all(isinstance(item, (str, int, float)) and not isinstance(item, bool) for item in items):
        raise UsageError(f"{place}: expected a number, a text or a list of them")
    texts, paths = [], []
    for item in items:
        text = item if isinstance(item, str) else repr(item)
        path = _as_path(option, text, directory)
        if path is not None:
            paths.append(path)
            text = os.fspath(path)
        texts.append(text)
    if option.multiple:
        return [f"{long}={text}" for text in texts], paths
    return [f"{long}={','.join(texts)}"], paths


def _as_path(option: click.Option, text: str, directory: Path) -> Path | None:
    """Return a value that names a file, relative to the pipeline file."""
    if isinstance(option.type, click.Path):
        return directory / text
    # Options that take a file or the name of something that vhp knows.
    if any(word in (option.metavar or "") for word in ("FILE", "PATH")) and (directory / text).exists():
        return directory / text
    return None


def check_arguments(
    words: Sequence[str], command: click.Command, arguments: Sequence[str], model: Sequence[str], out: Path, where: str
) -> None:
    """Let a command judge its options, on the model itself, without doing anything.

    Parameters
    ----------
    words
        What calls the command.
    command, arguments
        The command and its options.
    model
        The model as named by the user.
    out
        A directory that does not exist, in the output directory.
    where
        What messages call the stage.

    Raises
    ------
    UsageError
        If it refuses them.
    """
    asked = list(arguments)
    if words[0] in _WITH_DRY_RUN:
        asked.append("--dry-run")
    if words[0] == "decimate":
        asked = _without_sharing(asked)
    output = ["-o", os.fspath(out)] if any(parameter.name == "output" for parameter in command.params) else []
    try:
        with command.make_context(" ".join(words), [*model, *output, *asked], obj={"quiet": True}) as context:
            if "--dry-run" in asked:
                with contextlib.redirect_stdout(io.StringIO()):
                    command.invoke(context)
            elif words[0] == "breathe":
                _check_breathe(context.params)
    except click.exceptions.Exit:
        return
    except click.ClickException as error:
        raise UsageError(f"{where}: {error.format_message()}") from error
    except VhpError as error:
        raise UsageError(f"{where}: {error.message}", hint=error.hint) from error


def _without_sharing(arguments: Sequence[str]) -> list[str]:
    """Ask for a ratio in place of a number for the whole model, which is shared out only when its turn comes."""
    targets = [word for word in arguments if word.startswith(("--ratio=", "--edge-length="))]
    if targets:
        return list(arguments)
    return ["--ratio=0.5" if word.startswith("--triangles=") else word for word in arguments]


def _check_breathe(given: Mapping[str, Any]) -> None:
    from vhp_cli.commands.breathe import load_sequence
    from vhp_cli.config import load_settings
    from vhp_cli.stages.breathe.options import KEYS, BreatheOptions

    settings = load_settings(config=given["config"], model=given["model"], units=given["units"])
    flags = {key: given.get(key.replace("-", "_")) for key in KEYS}
    options = BreatheOptions().changed(settings.stages.get("breathe", {}), "breathe")
    options.changed({key: value for key, value in flags.items() if value is not None}, "command line")
    if given["sequence"] is not None:
        load_sequence(given["sequence"], as_printed=given["as_printed"])


def flags_of(command: click.Command, given: Mapping[str, Any]) -> Iterator[tuple[str, object]]:
    """Yield the options of `vhp run` that were given, by long name and as a pipeline file would have them."""
    for name, (option, yes) in option_names(command).items():
        value = given.get(option.name or "")
        if option.is_flag:
            # What is not said is no choice, and leaves it to the pipeline.
            if value is (option.default is True):
                continue
        elif value in (None, (), []):
            continue
        if yes:
            yield name, list(value) if isinstance(value, (list, tuple)) else value
