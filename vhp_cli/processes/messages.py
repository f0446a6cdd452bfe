"""What goes through the pipes between a program and its child processes."""

from __future__ import annotations

import pickle
import struct
from collections.abc import Sequence
from typing import IO, Any

# A message is the number of its parts, their lengths, and the parts: the pickle, then the bytes of large arrays.
Part = bytes | bytearray | memoryview


def encode(value: Any) -> list[Part]:
    """Return a value as a message; large arrays are not copied."""
    buffers: list[pickle.PickleBuffer] = []
    body = pickle.dumps(value, protocol=5, buffer_callback=buffers.append)
    parts: list[Part] = [body, *(buffer.raw() for buffer in buffers)]
    header = struct.pack(f"<{1 + len(parts)}Q", len(parts), *(len(part) for part in parts))
    return [header, *parts]


def send(stream: IO[bytes], message: Sequence[Part]) -> None:
    """Write a message."""
    for part in message:
        stream.write(part)
    stream.flush()


def receive(stream: IO[bytes]) -> Any:
    """Return the value of the next message; `EOFError` if there is none."""
    (n_parts,) = struct.unpack("<Q", _read(stream, 8))
    lengths = struct.unpack(f"<{n_parts}Q", _read(stream, 8 * n_parts))
    body, *buffers = [_read(stream, length) for length in lengths]
    return pickle.loads(body, buffers=buffers)


def _read(stream: IO[bytes], length: int) -> bytearray:
    found = bytearray(length)
    view, done = memoryview(found), 0
    while done < length:
        count = stream.readinto(view[done:])  # type: ignore[attr-defined]
        if not count:
            raise EOFError
        done += count
    return found
