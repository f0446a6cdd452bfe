"""Arrays in NumPy's NPY format, as solvers' scripts write one value for each triangle."""

from __future__ import annotations

import io
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vhp_cli.errors import UnreadableFileError

_HINT = "write it with numpy.save, one number for each triangle of the mesh file in its order"


def parse_values(path: Path, data: bytes) -> NDArray[np.float64]:
    """Read a list of numbers from the bytes of an NPY file.

    Parameters
    ----------
    path
        For the messages.
    data
        The whole file.

    Returns
    -------
    (N,) float64
        Any values.

    Raises
    ------
    UnreadableFileError
        If the file holds anything but a list of real numbers.
    """
    try:
        values = _values(data)
    # Of a damaged header, numpy lets through whatever Python's tokenizer and parser raise.
    except Exception as error:
        raise UnreadableFileError(path, f"not a whole NPY file: {error}", hint=_HINT) from error
    if values.ndim != 1 or values.dtype.kind not in "fiu":
        kind = f"an array of {values.dtype} with shape {values.shape}"
        raise UnreadableFileError(path, f"{kind}, not of numbers with shape (F,)", hint=_HINT)
    return values.astype(np.float64)


def _values(data: bytes) -> NDArray[Any]:
    """Return the array, or an empty one where it holds Python objects, which are never loaded."""
    stream = io.BytesIO(data)
    version = np.lib.format.read_magic(stream)
    reader = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = reader(stream)
    if dtype.hasobject:
        return np.empty((0, *shape[1:]), dtype)
    # The header may announce anything: memory is taken only for what is there.
    return np.frombuffer(data, dtype=dtype, count=math.prod(shape), offset=stream.tell()).reshape(shape)
