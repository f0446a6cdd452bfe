"""What a run has finished so far, so that a later one does only what is missing.

A text file in the output directory: one line on the run, then one line for each finished tissue, added after its
mesh is in place. A line that was cut short counts as missing.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import threading
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, get_args

import numpy as np

from vhp_cli import __version__
from vhp_cli.engines import ENGINES, Name
from vhp_cli.formats.atomic import refused, write_atomically
from vhp_cli.measures import Action, Deviation, Introduced, SmoothingStep
from vhp_cli.stages.outcome import Status

JOURNAL = ".vhp-run.jsonl"
_VERSION = 1


@dataclass(frozen=True, slots=True)
class Entry:
    """One finished tissue.

    Parameters
    ----------
    file
        Path of the output below the output directory, with forward slashes.
    source, output
        SHA-256 of input and output; empty where there was nothing to read or copy.
    status, reason, actions, deviation
        What became of it.
    seconds
        How long that took.
    level
        How much more gently than asked it was treated, so that it meets no neighbour.
    history, introduced
        As of `pipeline.task.Result`.
    """

    file: str
    source: str
    output: str
    status: Status
    reason: str
    actions: list[Action]
    deviation: Deviation | None
    seconds: float
    level: int = 0
    history: list[SmoothingStep] = field(default_factory=list)
    introduced: list[Introduced] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Head:
    """What makes a run the same run: the command, the hash of its settings, and the code that does it."""

    command: str
    settings: str
    code: str


def head_of(command: str, settings: Mapping[str, object]) -> Head:
    """Return the head for a command with these settings and the code of this installation."""
    text = json.dumps(settings, sort_keys=True)
    return Head(command, hashlib.sha256(text.encode()).hexdigest(), _code_stamp())


def _code_stamp() -> str:
    """Identify the code by version and contents, as files differ within a version in a checkout."""
    package = Path(__file__).resolve().parents[1]
    suffixes = (".py", ".so", ".dylib", ".dll")
    digest = hashlib.sha256()
    for path in sorted(path for path in package.rglob("*") if path.suffix in suffixes):
        if path.relative_to(package).parts[0] in ("commands", "report", "phantom"):
            continue
        digest.update(f"{path.relative_to(package).as_posix()}\n".encode())
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    digest.update(json.dumps([np.__version__, engine_versions()]).encode())
    return f"{__version__} {digest.hexdigest()[:16]}"


@dataclass(frozen=True, slots=True)
class Recorded:
    """What a journal holds: the run, its finished tissues by file, and the levels decided on after all were done."""

    head: Head
    entries: Mapping[str, Entry]
    levels: Mapping[str, int]


def read_journal(directory: Path) -> Recorded | None:
    """Return what the journal in a directory holds; None if there is none that can be read."""
    try:
        lines = (directory / JOURNAL).read_bytes().split(b"\n")
    except OSError:
        return None
    first = _parsed(lines[0])
    if first is None or first.pop("vhp-run", None) != _VERSION:
        return None
    entries: dict[str, Entry] = {}
    try:
        levels = first.pop("levels")
        head = Head(**first)
        for line in lines[1:]:
            found = _parsed(line)
            if found is not None:
                entries[found["file"]] = Entry(**found)
    except (TypeError, KeyError):
        return None
    return Recorded(head, entries, levels)


def _parsed(line: bytes) -> dict[str, Any] | None:
    """Return the object on a line; None if the line is no whole one."""
    body, _, digest = line.rpartition(b"\t")
    if not body or hashlib.sha256(body).hexdigest()[:16].encode() != digest:
        return None
    found: dict[str, Any] = json.loads(body)
    return found


def _line(value: Mapping[str, object]) -> bytes:
    body = json.dumps(value, allow_nan=False, separators=(",", ":")).encode()
    return body + b"\t" + hashlib.sha256(body).hexdigest()[:16].encode() + b"\n"


def engine_versions() -> dict[str, str]:
    """Return the versions of the engines that make surfaces; empty for one that isn't installed."""
    engines = (ENGINES[name] for name in get_args(Name))
    return {engine.distribution: engine.version for engine in engines}


class Journal:
    """The journal of a run that is going on."""

    def __init__(self, directory: Path, head: Head, entries: Mapping[str, Entry], levels: Mapping[str, int]) -> None:
        self._path = directory / JOURNAL
        self._lock = threading.Lock()
        self.entries = dict(entries)
        lines = [
            _line({"vhp-run": _VERSION, "levels": dict(levels), **asdict(head)}),
            *(_line(asdict(entry)) for entry in entries.values()),
        ]
        write_atomically(self._path, b"".join(lines))

    def add(self, entry: Entry) -> None:
        """Note a finished tissue; on the disk when this returns.

        Raises
        ------
        VhpError
            As of `write_atomically`; the journal is left as it was.
        """
        with self._lock:
            try:
                with self._path.open("r+b", buffering=0) as file:
                    end = file.seek(0, os.SEEK_END)
                    try:
                        line = memoryview(_line(asdict(entry)))
                        while line:
                            line = line[file.write(line) :]
                        os.fsync(file.fileno())
                    except BaseException:
                        with contextlib.suppress(OSError):
                            file.truncate(end)
                        raise
            except OSError as error:
                raise refused(self._path, error) from error
            self.entries[entry.file] = entry
