"""The part of each tissue in breathing, from its name."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

from vhp_cli.errors import UsageError
from vhp_cli.tissues import guess_type, words

Side = Literal["left", "right", ""]

SHELLS = ("skin", "fat", "body")  # from the outside in
BONE = "bone"
CARRIED = "carried"

_SIDES: dict[str, Side] = {"left": "left", "right": "right", "lt": "left", "rt": "right"}
_LETTERS: dict[str, Side] = {"l": "left", "r": "right"}
_NUMBERS = "first second third fourth fifth sixth seventh eighth ninth tenth eleventh twelfth"
_ORDINALS = {word: number for number, word in enumerate(_NUMBERS.split(" "), start=1)}
# Of these there is one on each side, so that a letter alone tells the side; "l 3" of a vertebra is the third lumbar.
_SIDED = {"rib", "cartilage", "lung", "pectoral", "abdominal", "erector", "kidney"}


@dataclass(frozen=True, slots=True)
class Role:
    """What a tissue does in breathing.

    Parameters
    ----------
    part
        One of `parts`.
    side
        Of the subject; empty if it has none or the name does not say.
    number
        Of a rib, cartilage or vertebra; None if the name does not say.
    """

    part: str
    side: Side = ""
    number: int | None = None

    def __str__(self) -> str:
        return " ".join(str(item) for item in (self.side, self.part, self.number) if item)


@cache
def _table() -> tuple[dict[str, Any], ...]:
    path = Path(__file__).parents[2] / "data" / "breathing_roles.toml"
    return tuple(tomllib.loads(path.read_text(encoding="utf-8"))["role"])


def parts() -> tuple[str, ...]:
    """Return the names of all parts, for settings."""
    return (*dict.fromkeys(row["name"] for row in _table()), BONE)


def guess_role(name: str, tissue_type: str | None = None) -> Role:
    """Return the role that a name suggests; what is neither driven nor a bone is carried along.

    Parameters
    ----------
    name
        Of the tissue.
    tissue_type
        As set by the user; None: guessed from the name.
    """
    found = _expanded(words(name))
    text = f" {' '.join(found)} "
    number = _number(found)
    part = next((row["name"] for row in _table() if _matches(row, text, number)), None)
    if part is None:
        part = BONE if (tissue_type or guess_type(name)) == "bone" else CARRIED
    side: Side = next((_SIDES[word] for word in found if word in _SIDES), "")
    if not side and part in _SIDED:
        side = next((_LETTERS[word] for word in found if word in _LETTERS), "")
    return Role(part, side, number if part in ("rib", "cartilage", "vertebra") else None)


def assign(
    names: Iterable[str],
    settings: Mapping[str, Mapping[str, object]] | None = None,
    types: Mapping[str, str] | None = None,
) -> dict[str, Role]:
    """Return the role of every tissue.

    Parameters
    ----------
    names
        The tissues.
    settings
        What the user says of a tissue, over what its name suggests: ``role``, ``side``, ``number``.
    types
        Tissue types set by the user.

    Raises
    ------
    UsageError
        If a setting is not understood.
    """
    roles: dict[str, Role] = {}
    for name in names:
        guessed = guess_role(name, (types or {}).get(name))
        said = (settings or {}).get(name, {})
        part, side, number = said.get("role", guessed.part), said.get("side", guessed.side), said.get("number")
        if part not in parts():
            raise UsageError(f"{name}: no breathing role {part!r}", hint=f"roles: {', '.join(sorted(parts()))}")
        if side not in ("left", "right", ""):
            raise UsageError(f"{name}: side must be left or right, not {side!r}")
        if number is None:
            number = guessed.number
        elif isinstance(number, bool) or not isinstance(number, int):
            raise UsageError(f"{name}: number must be a whole number, not {number!r}")
        roles[name] = Role(str(part), side, number)
    return roles


def _expanded(found: list[str]) -> list[str]:
    """Split words that letters and numbers run together in, such as "left7" or "T12"."""
    return [piece for word in found for piece in re.findall(r"[^\W\d]+|\d+", word)]


def _number(found: list[str]) -> int | None:
    for word in found:
        if word in _ORDINALS:
            return _ORDINALS[word]
        if word.isdecimal() and 1 <= int(word) <= 24:
            return int(word)
    return None


def _matches(row: Mapping[str, Any], text: str, number: int | None) -> bool:
    if row.get("numbered") and number is None:
        return False
    return _has(row["phrases"], text) and not _has(row.get("except", ()), text)


def _has(phrases: Iterable[str], text: str) -> bool:
    return any(f" {phrase[:-1]}" in text if phrase.endswith("*") else f" {phrase} " in text for phrase in phrases)
