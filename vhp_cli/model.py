"""The tissues of a model: which files make it up and what they are called."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from vhp_cli.errors import UsageError

SUFFIXES = (".stl", ".ply", ".obj")
# Surfaces that a user may take for part of the model, though nothing here reads them.
OTHER_SUFFIXES = (
    ".3mf", ".amf", ".ctm", ".dae", ".fbx", ".glb", ".gltf", ".iges", ".igs", ".nas", ".off", ".stp", ".step",
    ".vtk", ".vtp", ".vtu", ".wrl", ".x3d", ".gii", ".stl.gz", ".ply.gz", ".obj.gz",
)  # fmt: skip

_DIGITS = re.compile(r"(\d+)")
_NOT_IN_NAMES = re.compile(r"[^0-9A-Za-z]+")


@dataclass(frozen=True, slots=True)
class TissueFile:
    """One tissue of a model.

    Parameters
    ----------
    name
        The file's stem, or the relative path where stems clash; unique in the model.
    path
        Where to read it.
    file
        The path as it stands in reports: relative to the model directory, with forward slashes.
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
    return _NOT_IN_NAMES.sub("_", name).strip("_").casefold()


def find_model(paths: Sequence[Path], *, recursive: bool = False) -> Model:
    """Return the tissues of a model in natural order of their files.

    Parameters
    ----------
    paths
        One directory, or any number of mesh files and directories.
    recursive
        Search directories to any depth.

    Raises
    ------
    UsageError
        If a path does not exist, or no mesh file is found.
    """
    found: dict[Path, str] = {}
    unread: list[str] = []
    for path in paths:
        if path.is_dir():
            prefix = f"{path.name}/" if len(paths) > 1 else ""
            for file, is_read in _mesh_files(path, recursive):
                name = prefix + file.relative_to(path).as_posix()
                if is_read:
                    found.setdefault(file, name)
                else:
                    unread.append(name)
        elif path.exists():
            found.setdefault(path, path.as_posix())
        else:
            raise UsageError(f"{path}: no such file or directory")
    if not found:
        raise UsageError(
            f"no mesh file ({', '.join(SUFFIXES)}) in {', '.join(map(str, paths))}",
            hint="use --recursive to search subdirectories" if not recursive else "",
        )
    ordered = sorted(found.items(), key=lambda item: natural_key(item[1]))
    return Model(tuple(_named(ordered)), tuple(sorted(unread, key=natural_key)))


def _mesh_files(directory: Path, recursive: bool) -> Iterator[tuple[Path, bool]]:
    """Yield the mesh files below a directory, each with whether it belongs to the model."""
    # os.walk does not follow links to directories, so a link cycle can't trap it.
    for folder, subfolders, names in os.walk(directory):
        subfolders[:] = sorted(name for name in subfolders if not name.startswith("."))
        searched = recursive or Path(folder) == directory
        for name in sorted(names):
            # Dot files are editors' and macOS' companions of real files.
            if name.startswith("."):
                continue
            if name.lower().endswith(SUFFIXES):
                yield Path(folder, name), searched
            elif searched and name.lower().endswith(OTHER_SUFFIXES):
                yield Path(folder, name), False


def _named(files: Iterable[tuple[Path, str]]) -> Iterator[TissueFile]:
    files = list(files)
    by_object: dict[str, list[str]] = {}
    by_stem: dict[str, int] = {}
    for path, file in files:
        by_object.setdefault(object_name(path.stem), []).append(file)
        by_stem[path.stem] = by_stem.get(path.stem, 0) + 1
    for path, file in files:
        clashes = tuple(other for other in by_object[object_name(path.stem)] if other != file)
        yield TissueFile(path.stem if by_stem[path.stem] == 1 else file, path, file, clashes)
