"""Load the compiled kernels; ctypes releases the GIL for the length of every call."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vhp_cli.errors import KernelError

if TYPE_CHECKING:
    import numpy as np

HERE = Path(__file__).resolve().parent
# As in build.py, which costs 15 ms to import. What else lies here may be of another platform.
SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
LIBRARY = HERE / f"_kernels{SUFFIX}"

pointer = ctypes.c_void_p
i32 = ctypes.c_int32
i64 = ctypes.c_int64
f64 = ctypes.c_double


def _load() -> ctypes.CDLL:
    """Load the library, ``$VHP_KERNELS`` if set; in a source checkout only if it was built from these sources."""
    path = Path(os.environ.get("VHP_KERNELS") or LIBRARY)
    try:
        library = ctypes.CDLL(str(path))
    except OSError as error:
        raise KernelError(
            f"the compiled kernels can't be loaded: {error}",
            hint="reinstall the package, or run `make kernels` in a source checkout",
        ) from error
    if next(HERE.glob("*.c"), None) is not None:
        # Only in a checkout: a wheel has no sources, and its users do not wait for the import.
        from vhp_cli.kernels.build import fingerprint

        if _sources_of(library) != fingerprint():
            raise KernelError(
                f"the compiled kernels are older than their C sources: {path}",
                hint="run `make kernels`, or without a C compiler `pip install -e .`",
            )
    return library


def _sources_of(library: ctypes.CDLL) -> str:
    try:
        found = library.vhp_sources
    except AttributeError:
        return ""
    found.restype = ctypes.c_char_p
    found.argtypes = []
    return bytes(found()).decode()


_kernels = _load()


def function(name: str, result: Any, arguments: Sequence[Any]) -> Any:
    """Return C function `name` with its signature set."""
    found = getattr(_kernels, name)
    found.restype = result
    found.argtypes = list(arguments)
    return found


def address(array: np.ndarray) -> int:
    """Return the address of a C-contiguous array (the caller keeps the array alive)."""
    assert array.flags.c_contiguous
    return int(array.ctypes.data)


def check_allocation(status: int) -> None:
    """Raise for the status -1, by which a kernel says that memory ran out."""
    if status == -1:
        raise KernelError("out of memory in a compiled kernel", hint="check fewer tissues at a time, or use --jobs 1")
