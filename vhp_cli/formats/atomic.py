"""Write files whole or not at all: a reader never sees half a file under its final name."""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from vhp_cli.errors import NoRoomError, VhpError

_NO_ROOM = {errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", errno.ENOSPC)}


def write_atomically(path: Path, data: bytes | Callable[[BinaryIO], None]) -> None:
    """Write a file under a temporary name beside it, flush it to the disk, and rename it.

    Parameters
    ----------
    path
        Final name; an existing file is replaced.
    data
        The contents, or a function that writes them to the open file.

    Raises
    ------
    NoRoomError
        If the disk is full.
    VhpError
        If the file system refuses for another reason (no such directory, no permission). In both cases the temporary
        file is removed and an existing file under the final name is left as it was.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.name[:100]}.{os.getpid()}-{secrets.token_hex(4)}.tmp")
    try:
        try:
            descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o666)
            with os.fdopen(descriptor, "wb") as file:
                if callable(data):
                    data(file)
                else:
                    file.write(data)
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(path)
        except BaseException:
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)
            raise
        _sync_directory(path.parent)
    except OSError as error:
        raise refused(path, error) from error


def refused(path: Path, error: OSError) -> VhpError:
    """Return what to raise where the file system refuses to write a file."""
    message = f"can't write {path}: {error.strerror or error}"
    if error.errno in _NO_ROOM:
        return NoRoomError(message, hint="make room, and run the command again; what is finished is kept")
    return VhpError(message, hint="check that the directory exists, may be written to, and has room")


def make_directory(directory: Path) -> None:
    """Make a directory and those above it; nothing happens if it is there.

    Raises
    ------
    VhpError
        If the file system refuses; `NoRoomError` if the disk is full.
    """
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise refused(directory, error) from error


def _sync_directory(directory: Path) -> None:
    """Make the rename last; some systems can't open or flush a directory, and lose nothing else by that."""
    if os.name == "nt":
        return
    with contextlib.suppress(OSError):
        descriptor = os.open(directory, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def atomic_write_bytes(path: Path, data: bytes) -> None:
    """Write bytes to a file; see `write_atomically`."""
    write_atomically(path, data)


def atomic_write_text(path: Path, text: str) -> None:
    """Write text to a file as UTF-8, with line ends as they are; see `write_atomically`."""
    write_atomically(path, text.encode("utf-8"))
