"""What is known of the stages of a pipeline from earlier runs: a small file for each in the output directory."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Literal

from vhp_cli import formats
from vhp_cli.errors import UsageError
from vhp_cli.formats.atomic import refused, write_atomically
from vhp_cli.model import find_model
from vhp_cli.pipeline.journal import JOURNAL
from vhp_cli.pipeline.output import REPORT, sha256_of

RECORDS = ".vhp-run"
_VERSION = 1
# Of these two the contents depend on time, or on how often a run was taken up.
_PASSING = (REPORT, JOURNAL)


@dataclass(frozen=True, slots=True)
class Record:
    """A stage as it was last run.

    Parameters
    ----------
    settings
        Hash of the command, its options and the files they name.
    inputs
        Hash of the surfaces it was given.
    code
        The code that ran it.
    state
        `clearing`: its directory is being emptied; `started`; `ended`.
    exit_code
        Of the command, once it has ended.
    files
        SHA-256 of what it has written, by path in its directory.
    """

    settings: str
    inputs: str
    code: str
    state: Literal["clearing", "started", "ended"]
    exit_code: int = 0
    files: Mapping[str, str] = field(default_factory=dict)


def read_record(out: Path, directory: str) -> Record | None:
    """Return what is known of a stage; None if nothing is, or it can't be read."""
    try:
        found = json.loads((out / RECORDS / f"{directory}.json").read_bytes())
        if found.pop("vhp-run") != _VERSION:
            return None
        return Record(**found)
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return None


def write_record(out: Path, directory: str, record: Record) -> None:
    """Keep what is known of a stage; on the disk when this returns."""
    body = json.dumps({"vhp-run": _VERSION, **asdict(record)}, indent=1, sort_keys=True)
    write_atomically(out / RECORDS / f"{directory}.json", body.encode() + b"\n")


def recorded_directories(out: Path) -> list[str]:
    """Return the directories of all stages that are known."""
    return sorted(path.stem for path in (out / RECORDS).glob("*.json"))


def files_in(directory: Path) -> dict[str, str]:
    """Return the SHA-256 of the files in a directory, but for those that differ from run to run."""
    found = {}
    for path in sorted(path for path in directory.rglob("*") if path.is_file()):
        name = path.relative_to(directory).as_posix()
        if name not in _PASSING:
            found[name] = sha256_of(path)
    return found


def hash_of(value: object) -> str:
    """Return the SHA-256 of a JSON value."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()


def model_hash(paths: Sequence[Path], *, recursive: bool) -> str:
    """Return the hash of the surfaces of a model, and of their names."""
    model = find_model(paths, recursive=recursive)
    tissues = [[tissue.name, tissue.file, sha256_of(tissue.path)] for tissue in model.tissues]
    return hash_of([tissues, list(model.unread)])


def content_hash(path: Path) -> str:
    """Return the hash of a file, or of all files in a directory.

    Raises
    ------
    UsageError
        If there is none.
    """
    if path.is_dir():
        return hash_of(files_in(path))
    if not path.is_file():
        raise UsageError(f"{path}: no such file or directory")
    return formats.sha256(path.read_bytes())


def empty(out: Path, directory: str, record: Record) -> None:
    """Remove what earlier runs of a stage left; a run that is killed here goes on with it."""
    write_record(out, directory, Record(record.settings, record.inputs, record.code, "clearing"))
    # The second is where `vhp heal --clearance` keeps what it has healed.
    for path in (out / directory, out / f".{directory}.healed"):
        try:
            shutil.rmtree(path)
        except FileNotFoundError:
            continue
        except OSError as error:
            raise refused(path, error) from error
