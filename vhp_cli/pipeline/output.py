"""The directory that a stage writes to: which file goes where, and what may lie in it."""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path, PurePosixPath

from vhp_cli import formats
from vhp_cli.errors import UnreadableFileError, UsageError
from vhp_cli.model import Model
from vhp_cli.pipeline.journal import Head, Recorded, read_journal

REPORT = "report.json"
_LEFT_OVER = re.compile(r"\..+\.\d+-[0-9a-f]{8}\.tmp")


def output_files(model: Model, paths: Sequence[Path]) -> list[str]:
    """Return where each tissue goes below the output directory, with forward slashes.

    That is the path by which its directory knows it; the name alone for a file that was named by itself.

    Raises
    ------
    UsageError
        If two tissues would go to the same place.
    """
    single = {os.path.abspath(path) for path in paths if not path.is_dir()}  # noqa: PTH100 - links stay as they are
    places: dict[str, str] = {}
    for tissue in model.tissues:
        if os.path.abspath(tissue.path) in single:  # noqa: PTH100
            place = tissue.path.name
        else:
            path = PurePosixPath(tissue.file)
            place = "/".join(part for part in path.parts if part not in (path.anchor, ".", ".."))
        if place in places:
            raise UsageError(
                f"{places[place]} and {tissue.file} would both be written to {place}",
                hint="give their directories instead of the files, or run the command on each",
            )
        places[place] = tissue.file
    return list(places)


def refuse_overlap(out: Path, model: Model, paths: Sequence[Path]) -> None:
    """Make sure that nothing of the model lies where the output goes, or the other way round.

    Raises
    ------
    UsageError
        If one lies in the other.
    """
    target = Path(os.path.realpath(out))
    directories = [Path(os.path.realpath(path)) for path in paths if path.is_dir()]
    for directory in directories:
        if target == directory or directory in target.parents or target in directory.parents:
            raise UsageError(
                f"the output directory {out} and the model {directory} overlap",
                hint="inputs are never written to; give a directory beside the model",
            )
    for tissue in model.tissues:
        if target in Path(os.path.realpath(tissue.path)).parents:
            raise UsageError(f"{tissue.file} lies in the output directory {out}", hint="inputs are never written to")


def earlier_run(out: Path, head: Head, *, overwrite: bool) -> Recorded | None:
    """Return what an earlier run left in the output directory that was the same run as this one.

    Raises
    ------
    UsageError
        If the directory holds anything else and may not be written over.
    """
    try:
        occupied = any(not _LEFT_OVER.fullmatch(path.name) for path in out.iterdir())
    except FileNotFoundError:
        return None
    except OSError as error:
        raise UsageError(f"{out}: can't be used as the output directory: {error.strerror or error}") from error
    found = read_journal(out)
    if overwrite or not occupied:
        return None
    if found is None:
        raise UsageError(f"{out} is not empty", hint="give another directory, or --overwrite")
    if (found.head.command, found.head.settings) != (head.command, head.settings):
        raise UsageError(
            f"{out} holds the results of vhp {found.head.command} with other settings",
            hint="give another directory, or --overwrite",
        )
    return found if found.head.code == head.code else None


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file; empty if it can't be read."""
    try:
        return formats.sha256(formats.read_bytes(path))
    except UnreadableFileError:
        return ""


def clear(out: Path, files: Sequence[str]) -> None:
    """Remove what earlier runs left and this one will not write: half-written files, old reports, old tissues."""
    found = read_journal(out)
    for file, entry in (found.entries if found else {}).items():
        # What was changed by hand since is not ours any more.
        if file not in files and _is_below(file) and entry.output and sha256_of(out / file) == entry.output:
            (out / file).unlink(missing_ok=True)
    (out / REPORT).unlink(missing_ok=True)
    for folder in {out, *(parent for file in files for parent in (out / file).parents if out in parent.parents)}:
        with contextlib.suppress(OSError):
            for path in folder.iterdir():
                if _LEFT_OVER.fullmatch(path.name):
                    path.unlink(missing_ok=True)


def _is_below(file: str) -> bool:
    path = PurePosixPath(file)
    return not path.is_absolute() and ".." not in path.parts


def foreign_meshes(out: Path, files: Sequence[str]) -> list[str]:
    """Return the mesh files in the output directory that no tissue was written to."""
    own = set(files)
    found = (path.relative_to(out).as_posix() for path in out.rglob("*") if not path.name.startswith("."))
    return sorted(file for file in found if file.lower().endswith(formats.SUFFIXES) and file not in own)


@contextlib.contextmanager
def sole_writer(out: Path) -> Iterator[None]:
    """Keep a second run away from the output directory, where the system has locks.

    Raises
    ------
    UsageError
        If another run writes to it.
    """
    try:
        import fcntl
    except ImportError:
        yield
        return
    descriptor = os.open(out, os.O_RDONLY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise UsageError(f"another run is writing to {out}", hint="wait until it has ended") from None
        except OSError:
            pass  # some network file systems have no locks
        yield
    finally:
        os.close(descriptor)
