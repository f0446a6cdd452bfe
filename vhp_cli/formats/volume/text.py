"""Rows of numbers as text, fast and in bounded memory."""

from __future__ import annotations

from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

_ROWS_AT_ONCE = 1 << 14


def write_rows(file: BinaryIO, template: str, *columns: NDArray[Any]) -> None:
    """Write a line, or several, for each row of some columns.

    Parameters
    ----------
    file
        Open for binary writing.
    template
        Of one row, with a conversion for each column in their order; ``%r`` gives the shortest decimal number that
        is read back exactly. Line ends are part of it.
    columns
        (N,) or (N, K) arrays.
    """
    single = [part for column in columns for part in (column.T if column.ndim == 2 else [column])]
    width, count = len(single), len(single[0])
    for start in range(0, count, _ROWS_AT_ONCE):
        stop = min(start + _ROWS_AT_ONCE, count)
        # One conversion of many values is several times faster than a loop over the rows.
        values: list[Any] = [None] * (width * (stop - start))
        for place, part in enumerate(single):
            values[place::width] = part[start:stop].tolist()
        file.write((template * (stop - start) % tuple(values)).encode("ascii"))


def counting(count: int, first: int = 1) -> NDArray[np.int64]:
    """Return the numbers of `count` things, 1 and so on."""
    return np.arange(first, first + count, dtype=np.int64)
