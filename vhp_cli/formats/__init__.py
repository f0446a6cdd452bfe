"""Mesh files: one module per format, behind a registry by suffix."""

from __future__ import annotations

import hashlib
import math
import os
import stat
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np

from vhp_cli.errors import UnreadableFileError, VhpError
from vhp_cli.formats.atomic import write_atomically
from vhp_cli.formats.obj import obj_bytes, parse_obj
from vhp_cli.formats.ply import parse_ply, ply_bytes
from vhp_cli.formats.reading import LARGEST, FileIssue, Reading
from vhp_cli.formats.stl import parse_stl, stl_bytes
from vhp_cli.mesh import Mesh

__all__ = [
    "READERS",
    "SUFFIXES",
    "WRITERS",
    "FileIssue",
    "Reading",
    "mesh_bytes",
    "parse_mesh",
    "read_bytes",
    "read_mesh",
    "sha256",
    "write_mesh",
]


class Reader(Protocol):
    """Turns the bytes of a file into a mesh."""

    def __call__(self, path: Path, data: bytes, *, weld_tolerance: float = 0.0) -> Reading: ...


READERS: dict[str, Reader] = {".stl": parse_stl, ".ply": parse_ply, ".obj": parse_obj}
WRITERS: dict[str, Callable[[Mesh], bytes]] = {".stl": stl_bytes, ".ply": ply_bytes, ".obj": obj_bytes}
SUFFIXES = tuple(READERS)

# Non-blocking, or opening a pipe without a writer would wait for ever; binary, or Windows would alter line ends.
_OPEN = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)


def read_bytes(path: Path) -> bytes:
    """Return the contents of a file.

    Raises
    ------
    UnreadableFileError
        If the system refuses, the path is that of a directory, device or pipe, or the file exceeds the memory.
    """
    try:
        descriptor = os.open(path, _OPEN)
        try:
            # The checks are made on the open file: nothing can take its place before it is read.
            facts = os.fstat(descriptor)
            if not stat.S_ISREG(facts.st_mode):
                kind = "a directory, " if stat.S_ISDIR(facts.st_mode) else ""
                raise UnreadableFileError(Path(path), f"{kind}not a regular file")
            if facts.st_size > (memory := _physical_memory()):
                raise UnreadableFileError(
                    Path(path),
                    f"the file is larger than the memory: {facts.st_size / 2**30:.1f} of {memory / 2**30:.1f} GiB",
                )
            with os.fdopen(descriptor, "rb", buffering=0, closefd=False) as file:
                return file.read()
        finally:
            os.close(descriptor)
    except OSError as error:
        raise UnreadableFileError(
            Path(path), f"can't read the file: {error.strerror or error}", hint="check its name and permissions"
        ) from error


def _physical_memory() -> float:
    """Return the bytes of memory in the machine; infinite where the system does not tell."""
    try:
        size = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):
        return math.inf
    return size if size > 0 else math.inf


def sha256(data: bytes) -> str:
    """Return the hexadecimal SHA-256 of the bytes."""
    return hashlib.sha256(data).hexdigest()


def parse_mesh(path: Path, data: bytes, *, weld_tolerance: float = 0.0) -> Reading:
    """Read a mesh from the bytes of a file, in the format that its suffix names.

    Parameters
    ----------
    path
        For the suffix and the messages.
    data
        The whole file.
    weld_tolerance
        0: vertices are welded where they are equal; above: also where they are joined by steps not longer than this,
        in mm.

    Returns
    -------
    Reading
        Without `sha256`.

    Raises
    ------
    UnreadableFileError
        If nothing in the file can be checked.
    """
    path = Path(path)
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise UnreadableFileError(
            path, f"no reader for {path.suffix or 'files without a suffix'}", hint=f"known: {', '.join(SUFFIXES)}"
        )
    return reader(path, data, weld_tolerance=weld_tolerance)


def read_mesh(path: Path, *, weld_tolerance: float = 0.0) -> Reading:
    """Read a mesh from a file, which is read once: the hash is that of the bytes that were parsed.

    Parameters and errors are those of `read_bytes` and `parse_mesh`.
    """
    data = read_bytes(path)
    return replace(parse_mesh(path, data, weld_tolerance=weld_tolerance), sha256=sha256(data))


def write_mesh(path: Path, mesh: Mesh) -> None:
    """Write a mesh, in the format that the suffix names: binary STL, binary PLY or OBJ.

    The file appears whole or not at all. STL rounds to float32; PLY and OBJ keep the coordinates exactly.

    Raises
    ------
    VhpError
        If there is no writer for the suffix, a coordinate is not finite or beyond 1e30, or the file system refuses.
    """
    write_atomically(path, mesh_bytes(path, mesh))


def mesh_bytes(path: Path, mesh: Mesh) -> bytes:
    """Return the contents of a mesh file, in the format that the suffix of its path names; see `write_mesh`."""
    path = Path(path)
    writer = WRITERS.get(path.suffix.lower())
    if writer is None:
        raise VhpError(f"no writer for {path.suffix or 'files without a suffix'}", hint=f"known: {', '.join(WRITERS)}")
    wild = ~(np.abs(mesh.vertices) <= LARGEST).all(axis=1)
    if wild.any():
        vertex = int(np.flatnonzero(wild)[0])
        raise VhpError(f"can't write {path}: vertex {vertex} is not finite or beyond 1e30 mm")
    return writer(mesh)
