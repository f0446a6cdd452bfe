"""``--declare FILE``: which tissues may touch, and which lie inside others, in a file of its own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from vhp_cli.errors import UsageError

if TYPE_CHECKING:
    from vhp_cli.config import Settings

_TABLES = ("may-touch", "nested")

declare_option = click.option(
    "--declare",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="TOML file with [[may-touch]] and [[nested]] tables, as in vhp.toml, added to those of the settings.",
)


def with_declared(settings: Settings, path: Path | None) -> Settings:
    """Return the settings with the pairs that a file declares added.

    Raises
    ------
    UsageError
        If the file can't be read, or holds anything but pairs.
    """
    if path is None:
        return settings
    import tomllib

    from vhp_cli.config import load_settings

    found = load_settings(config=path)
    others = sorted(set(tomllib.loads(path.read_text(encoding="utf-8-sig"))) - set(_TABLES))
    if others:
        raise UsageError(
            f"{path}: {others[0]!r} is no declaration", hint="[[may-touch]] and [[nested]]; settings go to --config"
        )
    return replace(
        settings, nested=(*settings.nested, *found.nested), may_touch=(*settings.may_touch, *found.may_touch)
    )
