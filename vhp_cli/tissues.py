"""Tissue types, guessed from names."""

from __future__ import annotations

import re
import tomllib
from functools import cache
from pathlib import Path

UNKNOWN = "tissue"

_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|[0-9]+|[^\W\d_A-Za-z]+")


def words(name: str) -> list[str]:
    """Return the words of a name in lower case: ``Rib_left3`` and ``ribLeft-3`` both give ``rib left 3``."""
    return [word.lower() for word in _WORD.findall(name)]


@cache
def _types() -> tuple[tuple[str, tuple[str, ...]], ...]:
    table = tomllib.loads(Path(__file__).with_name("data").joinpath("tissue_types.toml").read_text(encoding="utf-8"))
    return tuple((row["name"], tuple(row["phrases"])) for row in table["type"])


def type_names() -> tuple[str, ...]:
    """Return the names of the known tissue types."""
    return (*(name for name, _ in _types()), UNKNOWN)


def guess_type(name: str) -> str:
    """Return the tissue type that `name` suggests, ``"tissue"`` if none does."""
    text = f" {' '.join(words(name))} "
    for kind, phrases in _types():
        if any(f" {phrase[:-1]}" in text if phrase.endswith("*") else f" {phrase} " in text for phrase in phrases):
            return kind
    return UNKNOWN
