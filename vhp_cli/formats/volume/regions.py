"""The labels of a mesh as files store them: a positive number and a name that the format takes."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vhp_cli.volume import BACKGROUND, VolumeMesh

AIR = "air"


class FormatLimit(ValueError):
    """A format can't hold a mesh."""


@dataclass(frozen=True, slots=True)
class Naming:
    """What a format takes as a name.

    Parameters
    ----------
    forbidden
        Regular expression of the characters that are replaced by ``_``.
    most_bytes
        Longest name, in bytes of UTF-8.
    letter_first
        Whether a name must begin with a letter.
    ignores_case
        Whether names that differ in case only are the same.
    """

    forbidden: str
    most_bytes: int
    letter_first: bool = False
    ignores_case: bool = False


@dataclass(frozen=True, slots=True)
class Region:
    """A label as a file stores it.

    Parameters
    ----------
    label
        In the mesh.
    number
        In the file: the label; for air the number after the last name.
    name
        In the mesh; ``"air"`` for air, or ``"air outside"`` where a tissue has that name.
    written
        In the file.
    count
        Number of tetrahedra.
    """

    label: int
    number: int
    name: str
    written: str
    count: int


def regions_of(mesh: VolumeMesh, naming: Naming) -> tuple[Region, ...]:
    """Return all labels of a mesh in order of their numbers, air last, those without tetrahedra included."""
    counts = np.bincount(mesh.labels, minlength=len(mesh.names) + 1).tolist()
    labels = list(range(1, len(mesh.names) + 1))
    names = list(mesh.names)
    if counts[BACKGROUND]:
        labels.append(BACKGROUND)
        names.append(_air_name(names))
    written = valid_names(names, naming)
    return tuple(
        Region(label, number, name, valid, counts[label])
        for number, (label, name, valid) in enumerate(zip(labels, names, written, strict=True), start=1)
    )


def _air_name(names: list[str]) -> str:
    taken = {name.casefold() for name in names}
    name = AIR
    while name.casefold() in taken:
        name += " outside"
    return name


def numbers_of(mesh: VolumeMesh) -> NDArray[np.int32]:
    """Return the number of each tetrahedron's region, (M,): its label, with that of air after the last name."""
    return np.where(mesh.labels == BACKGROUND, len(mesh.names) + 1, mesh.labels).astype(np.int32)


def by_number(mesh: VolumeMesh) -> NDArray[np.int64]:
    """Return the order that puts the tetrahedra of a region next to each other, otherwise as they are."""
    return np.argsort(numbers_of(mesh), kind="stable")


def valid_names(names: Iterable[str], naming: Naming) -> list[str]:
    """Return names that a format takes, each different from the others; a name that is taken as it is stays so."""
    names = list(names)

    def key(name: str) -> str:
        return name.casefold() if naming.ignores_case else name

    found = [_valid(name, naming) for name in names]
    taken = {key(name) for name, valid in zip(names, found, strict=True) if name == valid}
    used: set[str] = set()
    for index, (name, valid) in enumerate(zip(names, found, strict=True)):
        candidate, count = valid, 1
        # A name that the format takes has the first right to itself.
        while key(candidate) in used or (candidate != name and key(candidate) in taken):
            count += 1
            candidate = f"{_cut(valid, naming.most_bytes - len(f'_{count}'))}_{count}"
        used.add(key(candidate))
        found[index] = candidate
    return found


def _valid(name: str, naming: Naming) -> str:
    # A lone surrogate, of a file name that is no text, has no UTF-8.
    name = name.encode("utf-8", "replace").decode("utf-8")
    valid = re.sub(naming.forbidden, "_", name) or "_"
    if naming.letter_first and not re.match("[A-Za-z]", valid):
        valid = f"T{valid}"
    return _cut(valid, naming.most_bytes)


def _cut(name: str, most_bytes: int) -> str:
    return name.encode("utf-8")[:most_bytes].decode("utf-8", "ignore")
