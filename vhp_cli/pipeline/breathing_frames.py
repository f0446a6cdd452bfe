"""The frames of a breath: written, read back as a solver would, and tested before they count."""

from __future__ import annotations

import contextlib
import csv
import io
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vhp_cli import formats
from vhp_cli.errors import UsageError, VhpError
from vhp_cli.formats.atomic import refused
from vhp_cli.kernels import surface
from vhp_cli.kernels.spatial import Tree
from vhp_cli.measures import BreathTissueFrame
from vhp_cli.mesh import Mesh
from vhp_cli.pipeline.breathing_model import BreathingModel
from vhp_cli.pipeline.output import REPORT
from vhp_cli.stages.breathe.frame_check import FrameCheck, check_frame
from vhp_cli.stages.breathe.mass import MassModel
from vhp_cli.stages.breathe.rest import Rest
from vhp_cli.stages.breathe.sequence import Motion
from vhp_cli.stages.breathe.time import Moment
from vhp_cli.stages.breathe.tissue import Tissue, volume

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]

FRAMES, REJECTED, INDEX = "frames", "rejected", "index.csv"
SEQUENCE = "sequence.toml"
SCRIPTS = "scripts"
CURVES, PAGE, PICTURE = "curves.svg", "animation.html", "animation.gif"
SCRIPT_FILES = ("aedt_pyaedt.py", "aedt_native.py", "cst_breathe.bas", "breathe_apply.m", "breathe_frame.m")
# What a run writes beside its frames.
RESULTS = (
    REPORT,
    SEQUENCE,
    CURVES,
    PAGE,
    PICTURE,
    *(f"{SCRIPTS}/{name}" for name in SCRIPT_FILES),
)

# Parts that keep their shape.
RIGID = ("rib", "sternum", "vertebra", "bone")
# By so much of its length an edge of theirs may change.
EDGE_CHANGE = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """The model at one value of the sweep variable, as written.

    Parameters
    ----------
    x
        The value.
    check
        What is wrong with it.
    volumes_mm3
        Of the closed tissues.
    mass_kg
        Of the whole model; None without densities.
    tissues
        What became of each tissue that moves.
    lowest_mm
        z of the lungs' lowest point.
    joined
        Tissues of which vertices fell together by rounding.
    bent
        Bones of which an edge changed its length, and by how much in mm beyond what rounding explains.
    moved
        Tissues that are not where they are at rest.
    tangled
        Tissues that cross themselves more than at rest, and in how many pairs of faces.
    """

    x: float
    check: FrameCheck
    volumes_mm3: Mapping[str, float]
    mass_kg: float
    tissues: Mapping[str, BreathTissueFrame]
    lowest_mm: float
    joined: tuple[str, ...]
    bent: Mapping[str, float]
    moved: tuple[str, ...]
    tangled: Mapping[str, int]


class FrameMaker:
    """Moves, encodes, reads back and tests the model at given values of the sweep variable.

    Parameters
    ----------
    model, rest, motions, mass
        The model, how it lies at rest, how it moves and what it weighs.
    gap_mm
        The gap to keep.
    executor
        Threads to share the work.
    """

    def __init__(
        self,
        model: BreathingModel,
        rest: Rest,
        motions: Mapping[str, Motion],
        mass: MassModel,
        gap_mm: float,
        executor: ThreadPoolExecutor,
    ) -> None:
        self.model, self.rest, self.motions, self.mass = model, rest, motions, mass
        self.gap_mm, self.executor = gap_mm, executor
        self._bones = {t.name: _edges(t.mesh) for t in model.tissues if t.name in motions and t.role.part in RIGID}
        self._still: dict[str, bytes] = {}
        # What follows an affine map crosses itself no more than at rest.
        bending = [t for t in model.tissues if t.name in motions and motions[t.name].fields]
        self._crossings = {
            t.name: count for t, count in zip(bending, executor.map(_self_crossings, bending), strict=True)
        }

    def make(self, x: float) -> tuple[State, dict[str, bytes]]:
        """Return the model at `x` and the contents of its files, by their places."""
        moving = [index for index, tissue in enumerate(self.model.tissues) if tissue.name in self.motions]

        def one(index: int) -> tuple[bytes, Array, bool]:
            tissue, source = self.model.tissues[index], self.model.sources[index]
            mesh = self.model.to_file(index, self.motions[tissue.name].apply(tissue.mesh.vertices, x))
            data = formats.mesh_bytes(Path(source.place), mesh)
            stored, joined = _stored(Path(source.place), data, mesh)
            return data, self.model.from_file(stored), joined

        made = dict(zip(moving, self.executor.map(one, moving), strict=True))
        contents = dict(self._contents_at_rest())
        vertices: dict[str, Array] = {}
        joined = []
        for index, (data, stored, is_joined) in made.items():
            tissue, source = self.model.tissues[index], self.model.sources[index]
            contents[source.place] = data
            if not np.array_equal(stored, tissue.mesh.vertices):
                vertices[tissue.name] = stored
            if is_joined:
                joined.append(tissue.name)
        return self._state(x, vertices, tuple(joined)), contents

    def _contents_at_rest(self) -> dict[str, bytes]:
        """Return the contents of the files of tissues that never move, encoded once."""
        if not self._still:
            self._still = {
                source.place: formats.mesh_bytes(Path(source.place), source.mesh)
                for source, tissue in zip(self.model.sources, self.model.tissues, strict=True)
                if tissue.name not in self.motions
            }
        return self._still

    def _state(self, x: float, vertices: Mapping[str, Array], joined: tuple[str, ...]) -> State:
        check = check_frame(self.rest, vertices, x, self.gap_mm, self.executor, self.motions)
        volumes = dict(self.mass.rest_mm3)
        tissues: dict[str, BreathTissueFrame] = {}
        lowest = np.inf
        for tissue in self.model.tissues:
            now = vertices.get(tissue.name, tissue.mesh.vertices)
            if tissue.role.part == "lung":
                lowest = min(lowest, float(now[tissue.mesh.faces.reshape(-1), 2].min()))
            if tissue.name not in self.motions:
                continue
            if tissue.name in volumes:
                volumes[tissue.name] = abs(volume(now, tissue.mesh.faces))
            moves = np.linalg.norm(now - tissue.mesh.vertices, axis=1)
            q = _quality(now, tissue.mesh)
            tissues[tissue.name] = {
                "displacement_mm": {"max": float(moves.max()), "mean": float(moves.mean())},
                "volume_mm3": volumes.get(tissue.name),
                "min_q": float(q.min()),
                "mean_q": float(q.mean()),
            }
        bent = {name: self._bent(name, vertices[name]) for name in self._bones if name in vertices}
        bent = {name: excess for name, excess in bent.items() if excess > 0.0}
        tangled = self._tangled(vertices)
        return State(x, check, volumes, self.mass.kg(volumes), tissues, lowest, joined, bent, tuple(vertices), tangled)

    def _tangled(self, vertices: Mapping[str, Array]) -> dict[str, int]:
        """Return the tissues that cross themselves more than at rest."""
        names = [name for name in self._crossings if name in vertices]

        def count(name: str) -> int:
            mesh = self.rest.tissues[name].mesh
            # What is turned inside out need not cross itself; all of its faces are wrong.
            if volume(vertices[name], mesh.faces) * volume(mesh.vertices, mesh.faces) < 0.0:
                return self._crossings[name] + len(mesh.faces)
            return Tree(vertices[name], mesh.faces).self_hits(limit=1).n_pairs

        found = zip(names, self.executor.map(count, names), strict=True)
        return {name: pairs for name, pairs in found if pairs > self._crossings[name]}

    def _bent(self, name: str, vertices: Array) -> float:
        """Return by how much an edge of a bone changed beyond 1e-6 of its length and the rounding of its ends."""
        edges = self._bones[name]
        mesh = self.rest.tissues[name].mesh
        before = np.linalg.norm(mesh.vertices[edges[:, 0]] - mesh.vertices[edges[:, 1]], axis=1)
        after = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
        rounding = 2.0 * np.sqrt(3.0) * float(np.spacing(np.float32(np.abs(vertices).max())))
        return float((np.abs(after - before) - EDGE_CHANGE * before).max() - rounding)


def _self_crossings(tissue: Tissue) -> int:
    return tissue.tree.self_hits(limit=1).n_pairs


def _edges(mesh: Mesh) -> NDArray[np.int32]:
    edges: NDArray[np.int32] = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    return edges


def _quality(vertices: Array, mesh: Mesh) -> Array:
    return surface.quality(vertices, mesh.faces, np.zeros(len(mesh.faces), dtype=np.int32), 1).q


def _stored(place: Path, data: bytes, mesh: Mesh) -> tuple[Mesh, bool]:
    """Return the mesh as its file holds it, vertices in their old order, and whether some are joined now."""
    if place.suffix.lower() != ".stl":
        return mesh, False
    rounded = mesh.vertices.astype(np.float32).astype(np.float64)
    read = formats.parse_mesh(place, data).mesh
    if not np.array_equal(read.vertices[read.faces], rounded[mesh.faces]):
        raise VhpError(
            f"{place}: what was written is not what was meant", hint="this is a bug in vhp; please report it"
        )
    return Mesh(rounded, mesh.faces), len(read.vertices) < len(np.unique(mesh.faces))


# ---------------------------------------------------------------- the directory


class FrameWriter:
    """Writes frames beside their final place, which they take when all are finished.

    Parameters
    ----------
    out
        The output directory.
    """

    def __init__(self, out: Path) -> None:
        self._out = out
        self._work = out / f".breathe-{os.getpid()}.tmp"
        self._folders: dict[str, list[tuple[Moment, str]]] = {FRAMES: [], REJECTED: []}

    def write(self, folder: str, moment: Moment, name: str, contents: Mapping[str, bytes]) -> None:
        """Write the files of one frame."""
        target = self._work / folder / name
        try:
            for place, data in contents.items():
                path = target / place
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(data)
        except OSError as error:
            raise refused(target, error) from error
        self._folders[folder].append((moment, name))

    def finish(self, period_s: float) -> None:
        """Put the frames in place of those of an earlier run."""
        try:
            for folder, entries in self._folders.items():
                old = self._out / folder
                if old.is_dir():
                    shutil.rmtree(old)
                if entries:
                    entries.sort(key=lambda entry: entry[0].index)
                    (self._work / folder / INDEX).write_text(_index(entries, period_s), encoding="utf-8", newline="")
                    (self._work / folder).replace(old)
        except OSError as error:
            raise refused(self._out, error) from error

    def remove(self) -> None:
        """Take away what is left of the work."""
        shutil.rmtree(self._work, ignore_errors=True)


def _index(entries: Sequence[tuple[Moment, str]], period_s: float) -> str:
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["frame", "x", "time_over_T", "time_s", "directory"])
    for moment, name in entries:
        share = moment.time_over_period
        table.writerow([moment.index, repr(moment.x), repr(share), repr(share * period_s), name])
    return text.getvalue()


def directory_names(moments: Sequence[Moment], period_s: float) -> list[str]:
    """Return a name for the directory of each frame: its time in seconds, with as many digits as tell them apart."""
    for digits in range(2, 10):
        names = [f"t{moment.time_over_period * period_s:0{digits + 3}.{digits}f}" for moment in moments]
        if len(set(names)) == len(names):
            return names
    width = len(str(len(moments)))
    return [f"f{moment.index:0{width}d}" for moment in moments]


def prepare(out: Path, *, overwrite: bool) -> None:
    """Make the output directory.

    Raises
    ------
    UsageError
        If it holds anything and may not be written over.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
        occupied = [path.name for path in out.iterdir() if not path.name.startswith(".breathe-")]
    except OSError as error:
        raise UsageError(f"{out}: can't be used as the output directory: {error.strerror or error}") from error
    if occupied and not overwrite:
        raise UsageError(f"{out} is not empty", hint="give another directory, or --overwrite")
    for path in out.glob(".breathe-*.tmp"):
        shutil.rmtree(path, ignore_errors=True)
    # Of an earlier run nothing may stay that does not belong to this one.
    for name in RESULTS:
        (out / name).unlink(missing_ok=True)
    for folder in (FRAMES, REJECTED):
        if (out / folder / INDEX).is_file():
            shutil.rmtree(out / folder, ignore_errors=True)


@contextlib.contextmanager
def frame_writer(out: Path) -> Iterator[FrameWriter]:
    """Give a writer of frames; what it has not finished goes away."""
    writer = FrameWriter(out)
    try:
        yield writer
    finally:
        writer.remove()
