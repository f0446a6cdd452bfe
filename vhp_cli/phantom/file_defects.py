"""Defects of files: they are made in the binary STL files that were written."""

from __future__ import annotations

import struct
from collections.abc import Callable, Collection
from pathlib import Path

import numpy as np

from vhp_cli.formats.atomic import atomic_write_bytes
from vhp_cli.phantom.sites import Planted

HEADER, RECORD = 84, 50


def _truncated(data: bytes) -> tuple[bytes, str]:
    facets = 3 * ((len(data) - HEADER) // RECORD) // 4
    return data[: HEADER + RECORD * facets + 21], f"cut the file off in the middle of facet {facets}"


def _wrong_count(data: bytes) -> tuple[bytes, str]:
    count = (len(data) - HEADER) // RECORD
    return data[:80] + struct.pack("<I", count + 12) + data[HEADER:], "the header announces 12 facets too many"


def _not_finite(data: bytes) -> tuple[bytes, str]:
    facet = (len(data) - HEADER) // RECORD // 2
    at = HEADER + RECORD * facet + 12
    return data[:at] + struct.pack("<f", float("nan")) + data[at + 4 :], f"made a coordinate of facet {facet} NaN"


def _empty(data: bytes) -> tuple[bytes, str]:
    return data[:80] + struct.pack("<I", 0), "removed all facets"


FILE_PLANTS: dict[str, Callable[[bytes], tuple[bytes, str]]] = {
    "F002": _truncated,
    "F003": _wrong_count,
    "F004": _not_finite,
    "F005": _empty,
}


def plant_file_defects(
    directory: Path, seed: int, avoid: Collection[str] = (), kinds: Collection[str] = tuple(FILE_PLANTS)
) -> list[Planted]:
    """Spoil one or two of the binary STL files of a directory.

    Parameters
    ----------
    directory
        Where the phantom was written.
    seed
        Decides which files and how.
    avoid
        Tissues that have a defect already.
    kinds
        The rules that may be broken.

    Returns
    -------
    list of Planted
        Without a place, since the files as a whole are spoilt.
    """
    random = np.random.default_rng([seed, 1])
    paths = [path for path in sorted(Path(directory).glob("*.stl")) if path.stem not in avoid]
    rules = random.permutation([rule for rule in FILE_PLANTS if rule in kinds])[
        : min(int(random.integers(1, 3)), len(paths))
    ]
    planted = []
    for rule, i in zip(rules, random.permutation(len(paths)), strict=False):
        data, note = FILE_PLANTS[str(rule)](paths[i].read_bytes())
        atomic_write_bytes(paths[i], data)
        planted.append(Planted(str(rule), (paths[i].stem,), None, note))
    return planted
