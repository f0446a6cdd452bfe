"""Tissue types, guessed from names."""

from __future__ import annotations

import re
import tomllib
from functools import cache
from pathlib import Path

UNKNOWN = "tissue"

_SEPARATORS = re.compile(r"[^0-9a-z]+")
_CAMEL_CASE = re.compile(r"(?<=[a-z])(?=[A-Z])")


def words(name: str) -> str:
    """Return `name` in lower case with every separator as one blank: ``Rib_left-3`` -> ``rib left 3``."""
    return _SEPARATORS.sub(" ", _CAMEL_CASE.sub(" ", name).lower()).strip()


@cache
def _types() -> tuple[tuple[str, re.Pattern[str]], ...]:
    table = tomllib.loads(Path(__file__).with_name("data").joinpath("tissue_types.toml").read_text(encoding="utf-8"))
    return tuple(
        (row["name"], re.compile(rf"\b(?:{'|'.join(row['patterns'])})\b")) for row in table["type"]
    )


def type_names() -> tuple[str, ...]:
    """Return the names of the known tissue types."""
    return (*(name for name, _ in _types()), UNKNOWN)


def guess_type(name: str) -> str:
    """Return the tissue type that `name` suggests, ``"tissue"`` if none does."""
    text = words(name)
    return next((kind for kind, pattern in _types() if pattern.search(text)), UNKNOWN)
