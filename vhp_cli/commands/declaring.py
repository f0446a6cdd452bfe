"""``--declare FILE``: which tissues may touch, and which lie inside others, in a file of its own."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from vhp_cli.errors import UsageError

if TYPE_CHECKING:
    from vhp_cli.config import PairPattern, Settings

CONFIG = "vhp.toml"
_TABLES = ("may-touch", "nested")
# Tells a file of settings with declared pairs, written by a run, from one that somebody else put there.
_MARK = "# Declared with --declare when these tissues were taken apart:"

declare_option = click.option(
    "--declare",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="TOML file with [[may-touch]] and [[nested]] tables, as in vhp.toml, added to those of the settings.",
)


@dataclass(frozen=True, slots=True)
class Declared:
    """Pairs of tissues that a file of their own declares."""

    nested: tuple[PairPattern, ...] = ()
    may_touch: tuple[PairPattern, ...] = ()

    def added_to(self, settings: Settings) -> Settings:
        """Return the settings with these pairs added."""
        return replace(
            settings, nested=(*settings.nested, *self.nested), may_touch=(*settings.may_touch, *self.may_touch)
        )

    def as_toml(self) -> str:
        """Return the pairs as tables of a settings file; empty if there are none."""
        tables = [
            *(_table("nested", ("inner", "outer"), pattern) for pattern in self.nested),
            *(_table("may-touch", ("a", "b"), pattern) for pattern in self.may_touch),
        ]
        return "\n".join([_MARK, *tables]) if tables else ""


def read_declared(path: Path | None) -> Declared:
    """Read the pairs that a file declares; none if there is no file.

    Raises
    ------
    UsageError
        If the file can't be read, or holds anything but pairs.
    """
    if path is None:
        return Declared()
    import tomllib

    from vhp_cli.config import load_settings

    found = load_settings(config=path)
    others = sorted(set(tomllib.loads(path.read_text(encoding="utf-8-sig"))) - set(_TABLES))
    if others:
        raise UsageError(
            f"{path}: {others[0]!r} is no declaration", hint="[[may-touch]] and [[nested]]; settings go to --config"
        )
    return Declared(found.nested, found.may_touch)


def hand_on_settings(config: Path | None, model: Sequence[Path], output: Path, declared: Declared) -> str:
    """Write the settings of the model and what was declared beside a result, so that a check judges by the same.

    Settings from elsewhere (`config`) are not copied: whoever gave them can give them again.

    Returns
    -------
    str
        What a later check has to be told, as that could not be written down; else empty.
    """
    from vhp_cli.formats.atomic import write_atomically

    target, tables = output / CONFIG, declared.as_toml()
    given = model[0] / CONFIG if config is None and len(model) == 1 else None
    if given is not None and not given.is_file():
        given = None
    if given is not None and not tables:
        write_atomically(target, given.read_bytes())
        return ""
    text = "" if given is None else given.read_text(encoding="utf-8-sig").rstrip("\n") + "\n\n"
    if tables and config is None and _is_toml(text + tables):
        write_atomically(target, (text + tables).encode())
        return ""
    if target.is_file() and _MARK in target.read_text(encoding="utf-8", errors="replace"):
        # What an earlier run declared.
        target.unlink()
    if given is not None:
        write_atomically(target, given.read_bytes())
    return "give --declare to vhp check, too" if tables else ""


def _table(name: str, keys: tuple[str, str], pattern: PairPattern) -> str:
    # Strings of JSON are strings of TOML.
    first, second = (json.dumps(value, ensure_ascii=False) for value in (pattern.first, pattern.second))
    return f"[[{name}]]\n{keys[0]} = {first}\n{keys[1]} = {second}\n"


def _is_toml(text: str) -> bool:
    """Tell whether tables could be added to what was there: an array in brackets takes none."""
    import tomllib

    try:
        tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return False
    return True
