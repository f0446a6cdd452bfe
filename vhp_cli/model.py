"""The tissues of a model: which files make it up and what they are called."""

from __future__ import annotations

import os
import re
import unicodedata
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from vhp_cli.errors import UsageError

SUFFIXES = (".stl", ".ply", ".obj")
# Surfaces that a user may take for part of the model, though nothing here reads them.
OTHER_SUFFIXES = (
    ".3mf", ".amf", ".bdf", ".ctm", ".dae", ".fbx", ".gii", ".glb", ".gltf", ".iges", ".igs", ".inp", ".mesh", ".msh",
    ".nas", ".off", ".step", ".stp", ".vtk", ".vtp", ".vtu", ".wrl", ".x3d", ".zip",
    *(suffix + packed for suffix in SUFFIXES for packed in (".gz", ".bz2", ".xz")),
)  # fmt: skip

_DIGITS = re.compile(r"(\d+)")


@dataclass(frozen=True, slots=True)
class TissueFile:
    """One tissue of a model.

    Parameters
    ----------
    name
        The file's stem, or `file` where stems are equal; unique in the model.
    path
        Where to read it.
    file
        The path as it stands in reports, unique in the model, with forward slashes: relative to the model
        directory; of several, it begins with the directory's name, or its path where names are equal.
    clashes
        Files whose names a solver can't tell from this one (case and punctuation aside).
    """

    name: str
    path: Path
    file: str
    clashes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Model:
    """The tissues of a model in natural order, and what lies beside them and is left out."""

    tissues: tuple[TissueFile, ...]
    unread: tuple[str, ...] = ()


def natural_key(text: str) -> tuple[list[int | str], str]:
    """Sort key that puts ``rib_2`` before ``rib_10``."""
    parts: list[int | str] = []
    for index, part in enumerate(_DIGITS.split(text.casefold())):
        parts.append(int(part) if index % 2 else part)
    return parts, text


def object_name(name: str) -> str:
    """Return the name as solvers keep it: letters, digits and underscores, case ignored."""
    # Marks are parts of letters: without them many Indian words would look alike.
    kept = (
        char if char.isalnum() or unicodedata.category(char).startswith("M") else " "
        for char in unicodedata.normalize("NFC", name.casefold())
    )
    return "_".join("".join(kept).split())


def find_model(paths: Sequence[Path], *, recursive: bool = False) -> Model:
    """Return the tissues of a model in natural order of their files.

    A file that several of the paths lead to counts once. Within one directory a link to a file is a tissue of
    its own, as a solver would load both.

    Parameters
    ----------
    paths
        One directory, or any number of mesh files and directories.
    recursive
        Search directories to any depth, linked ones too, each once.

    Raises
    ------
    UsageError
        If a path does not exist, a directory can't be read, or no mesh file is found.
    """
    given: dict[str, Path] = {}
    for path in paths:
        if not path.exists():
            raise UsageError(f"{path}: no such file or directory")
        given.setdefault(os.path.realpath(path), path)
    directories = Counter(path.name for path in given.values() if path.is_dir())

    found: dict[Path, str] = {}  # the path to read, and how reports call it
    left_out: dict[Path, str] = {}
    # Several paths can lead to one file, one path can't: directories are entered once.
    target = os.path.realpath if len(given) > 1 else os.fspath
    seen: set[str] = set()
    for path in given.values():
        if path.is_dir():
            prefix = _prefix(path, directories) if len(given) > 1 else ""
            entries = [
                (file, prefix + file.relative_to(path).as_posix(), read) for file, read in _mesh_files(path, recursive)
            ]
        else:
            entries = [(path, path.as_posix(), True)]
        new = [entry for entry in entries if target(entry[0]) not in seen]
        found.update((file, label) for file, label, is_read in new if is_read)
        left_out.update((file, label) for file, label, is_read in new if not is_read)
        seen.update(target(file) for file, _, is_read in new if is_read)
    if not found:
        raise UsageError(
            f"no mesh file ({', '.join(SUFFIXES)}) in {', '.join(map(str, paths))}",
            hint="use --recursive to search subdirectories" if not recursive else "",
        )
    unread = {label for file, label in left_out.items() if target(file) not in seen}
    return Model(tuple(_named(found)), tuple(sorted(unread, key=natural_key)))


def _prefix(directory: Path, names: Counter[str]) -> str:
    """Return what the files of one directory among several begin with: its name, if that tells it from the others."""
    if directory.name not in ("", "..") and names[directory.name] == 1:
        return f"{directory.name}/"
    text = directory.as_posix()
    return "" if text == "." else text.rstrip("/") + "/"


def _mesh_files(directory: Path, recursive: bool) -> Iterator[tuple[Path, bool]]:
    """Yield the mesh files below a directory, each with whether it belongs to the model.

    Linked directories come after real ones, so that a file is called by its real path where it has one here.
    No directory is entered twice, which ends cycles.
    """
    visited = {_identity(directory)}
    pending = [directory]
    for start in pending:  # grows as links are found
        if start is not directory:
            identity = _identity(start)
            if identity in visited:
                continue
            visited.add(identity)
        for folder, subfolders, names in os.walk(start, onerror=_refuse):
            real = []
            for name in sorted(subfolders):
                path = Path(folder, name)
                if name.startswith("."):
                    continue
                if _is_link(path):
                    pending.append(path)
                elif (identity := _identity(path)) not in visited:
                    visited.add(identity)
                    real.append(name)
            subfolders[:] = real
            searched = recursive or Path(folder) == directory
            for name in sorted(names):
                # Dot files are editors' and macOS' companions of real files.
                if name.startswith("."):
                    continue
                if name.lower().endswith(SUFFIXES):
                    yield Path(folder, name), searched
                elif searched and name.lower().endswith(OTHER_SUFFIXES):
                    yield Path(folder, name), False


def _is_link(path: Path) -> bool:
    # Junctions are Windows' other kind of link; Python knows them from 3.12 on.
    is_junction = getattr(os.path, "isjunction", None)
    return path.is_symlink() or (is_junction is not None and bool(is_junction(path)))


def _identity(directory: Path) -> tuple[int, int]:
    try:
        facts = directory.stat()
    except OSError as error:
        _refuse(error)
    return facts.st_dev, facts.st_ino


def _refuse(error: OSError) -> NoReturn:
    """Refuse a model of which a directory can't be read: what is in it would pass unchecked."""
    raise UsageError(
        f"{error.filename}: can't read the directory: {error.strerror or error}",
        hint="check its permissions, or name the files to check",
    ) from error


def _named(found: dict[Path, str]) -> Iterator[TissueFile]:
    """Yield the files in natural order, with names."""
    labels = _distinct(list(found.values()), [path.as_posix() for path in found])
    files = sorted(zip(labels, found, strict=True), key=lambda item: natural_key(item[0]))
    names = _distinct([path.stem for _, path in files], [file for file, _ in files])
    objects: dict[str, list[str]] = {}
    for file, path in files:
        objects.setdefault(object_name(path.stem), []).append(file)
    for (file, path), name in zip(files, names, strict=True):
        clashes = tuple(other for other in objects[object_name(path.stem)] if other != file)
        yield TissueFile(name, path, file, clashes)


def _distinct(short: Sequence[str], long: Sequence[str]) -> list[str]:
    """Return the short texts, and the long ones, all different, in place of those that equal another."""
    chosen = list(short)
    while True:
        counts = Counter(chosen)
        equal = [index for index, text in enumerate(chosen) if counts[text] > 1 and text != long[index]]
        if not equal:
            return chosen
        for index in equal:
            chosen[index] = long[index]
