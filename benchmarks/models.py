"""The models of the benchmark: made once, kept in ``build/bench``.

numpy is imported only in functions that `check.py` runs in a process of their own: what a process has used
before it starts another counts towards the peak memory that the system reports for the other.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
CACHE = REPOSITORY / "build" / "bench"
REAL_DATA = REPOSITORY.parent / "shared" / "data"
REAL_CORPORA = ("abdomen_ct", "head_bp3d", "head_shells", "thorax_r3", "vhf_organs", "bones")

# Above this the phantom is put side by side several times.
LARGEST_PHANTOM = 1_000_000
COPY_STEP_MM = 1000.0


class ModelMissing(Exception):
    """A model that can't be had here."""


def environment() -> dict[str, str]:
    """Return the environment in which ``python -m vhp_cli`` is this checkout."""
    paths = [str(REPOSITORY), *filter(None, [os.environ.get("PYTHONPATH")])]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}


def phantom(triangles: int, tissues: int | None = None) -> Path:
    """Return a phantom with about so many triangles; beyond `LARGEST_PHANTOM` as copies side by side."""
    copies = -(-triangles // LARGEST_PHANTOM)
    if copies > 1:
        one = phantom(triangles // copies, tissues)
        return _made(f"{one.name}-x{copies}", [sys.executable, __file__, "copies", str(one), str(copies)])
    wanted = [] if tissues is None else ["--tissues", str(tissues)]
    command = [sys.executable, "-m", "vhp_cli", "-q", "phantom"]
    return _made(f"phantom-{triangles}-{tissues or 'all'}", command, "--triangles", str(triangles), *wanted)


def real() -> Path:
    """Return a directory with links to all example meshes but the deliberately broken ones."""
    sources = [file for corpus in REAL_CORPORA for file in sorted((REAL_DATA / corpus).rglob("*.stl"))]
    if not sources:
        raise ModelMissing(f"no meshes in {REAL_DATA}")
    directory = CACHE / "real"
    shutil.rmtree(directory, ignore_errors=True)
    directory.mkdir(parents=True)
    for source in sources:
        path = source.relative_to(REAL_DATA)
        (directory / "__".join(path.parts)).symlink_to(source)
    return directory


def link(model: Path, directory: Path) -> None:
    """Fill a directory with links to the files of a model."""
    directory.mkdir()
    for file in stl_files(model):
        (directory / file.name).symlink_to(file.resolve())


def stl_files(model: Path) -> list[Path]:
    """Return the STL files of a model, the largest first."""
    return sorted(model.glob("*.stl"), key=lambda file: (-file.stat().st_size, file.name))


def triangle_count(model: Path) -> int:
    """Return the number of triangles of a model of binary STL files, from their sizes."""
    return sum((file.stat().st_size - 84) // 50 for file in stl_files(model))


def _made(name: str, command: list[str], *options: str) -> Path:
    """Run a command that writes a model to a directory, unless it has done so before."""
    directory, fresh = CACHE / name, CACHE / f"{name}.new"
    if not directory.is_dir():
        CACHE.mkdir(parents=True, exist_ok=True)
        shutil.rmtree(fresh, ignore_errors=True)
        done = subprocess.run([*command, str(fresh), *options], capture_output=True, text=True, env=environment())
        if done.returncode or not fresh.is_dir():
            raise ModelMissing(f"{' '.join(command[1:])}: {done.stderr.strip()[-500:]}")
        fresh.rename(directory)
    return directory


def write_copies(model: Path, number: int, target: Path) -> None:
    """Write a model several times side by side."""
    target.mkdir()
    for file in stl_files(model):
        for copy in range(number):
            write_moved(file, target / f"{file.stem}_{copy}.stl", (copy * COPY_STEP_MM, 0.0, 0.0))


def write_moved(source: Path, target: Path, by: tuple[float, float, float]) -> None:
    """Write a binary STL file shifted by a vector in mm."""
    import numpy as np

    data = bytearray(source.read_bytes())
    facet = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    facets = np.frombuffer(data, facet, offset=84)
    facets["corners"] += np.array(by, dtype="<f4")
    # A link in a model must not be written through.
    target.unlink(missing_ok=True)
    target.write_bytes(data)


def main() -> int:
    """Write a changed model in a process of its own."""
    parser = argparse.ArgumentParser(description="Write copies of a model, or a moved tissue.")
    commands = parser.add_subparsers(dest="command", required=True)
    copies = commands.add_parser("copies")
    copies.add_argument("model", type=Path)
    copies.add_argument("number", type=int)
    copies.add_argument("target", type=Path)
    moved = commands.add_parser("moved")
    moved.add_argument("source", type=Path)
    moved.add_argument("target", type=Path)
    moved.add_argument("by", type=float, nargs=3)
    arguments = parser.parse_args()
    if arguments.command == "copies":
        write_copies(arguments.model, arguments.number, arguments.target)
    else:
        write_moved(arguments.source, arguments.target, tuple(arguments.by))
    return 0


if __name__ == "__main__":
    sys.exit(main())
