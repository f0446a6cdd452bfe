"""The stage: surfaces in, one conforming, labelled tetrahedral mesh out."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vhp_cli import engines
from vhp_cli.kernels.spatial import Tree
from vhp_cli.measures import TetmeshAttempt
from vhp_cli.mesh import Mesh
from vhp_cli.processes import CallFailed
from vhp_cli.stages.tetmesh.components import Component, components_of, expected_parts
from vhp_cli.stages.tetmesh.fitting import fit_to_surfaces
from vhp_cli.stages.tetmesh.keep_surface import installed_engine, keep_surface
from vhp_cli.stages.tetmesh.labelling import enclosed_volume, in_box, label_tetrahedra, precedence, smallest_containers
from vhp_cli.stages.tetmesh.measuring import Measured, Truth, measure_mesh, truths
from vhp_cli.stages.tetmesh.options import ANY_ENGINE, TetmeshOptions, absolute_length
from vhp_cli.stages.tetmesh.relaxing import Floor, relax
from vhp_cli.stages.tetmesh.sizing import SizingField, envelope, sizing_field
from vhp_cli.stages.tetmesh.tidying import tidy
from vhp_cli.stages.tetmesh.tissues import Box, Relations, Tissue, bounds, box_surface, diagonal, soup, trees
from vhp_cli.stages.tetmesh.watching import Progress, Watch
from vhp_cli.volume import BACKGROUND, Points, Tetrahedra, VolumeMesh, volumes

ENVELOPE_ENGINE: engines.VolumeName = "tetwild-volume"
# What is asked of the engine when it ran out of time or memory.
_DRAFT_ENERGY = 30.0
_DRAFT_ITERATIONS = 20
_DRAFT_EDGE = 1.5
# And when its mesh was not good enough; below 7 it may not end.
_FINE_ENERGY = 8.0
# How long it may take to better a mesh, in times that the mesh took.
_PATIENCE = 2.0
_LEAST_PATIENCE_S = 30.0
# Of the number of tetrahedra allowed, how many are aimed at.
_AIM = 0.9
# Around a box of air; no tissue can be called so, as a name is part of a path.
_AROUND = "\0"
# The angle that is asked for is exceeded by so much, where tetrahedra can be bettered.
_ABOVE_TARGET_DEG = 2.0


@dataclass(frozen=True, slots=True)
class Request:
    """What is asked of the engine: the options that change from one attempt to the next."""

    edge_length_mm: float
    epsilon_mm: float
    stop_energy: float
    iterations: int
    coarsen: bool


@dataclass(frozen=True, slots=True, eq=False)
class Meshed:
    """A mesh of a model.

    Parameters
    ----------
    mesh
        The mesh, air only where it was asked for.
    measured
        What was measured on it.
    request
        What it was made with.
    engine
        Key of `vhp_cli.engines.ENGINES`.
    epsilon_reason
        What decided on the envelope.
    attempts
        All attempts, in order.
    order
        Names of the tissues in the order in which they were laid over each other.
    seconds
        How long each step took, all attempts together.
    shortfalls
        Limits that the mesh does not keep.
    notes
        What the engine's route has to tell.
    """

    mesh: VolumeMesh
    measured: Measured
    request: Request
    engine: engines.VolumeName
    epsilon_reason: str
    attempts: list[TetmeshAttempt]
    order: tuple[str, ...]
    seconds: dict[str, float]
    shortfalls: tuple[str, ...]
    notes: tuple[str, ...]


class NotMeshed(CallFailed):
    """No attempt came to a mesh; `attempts` tells why."""

    def __init__(self, failed: CallFailed, attempts: list[TetmeshAttempt], seconds: dict[str, float]) -> None:
        super().__init__(failed.reason, failed.detail)
        self.attempts = attempts
        self.seconds = seconds


def mesh_tissues(
    tissues: Sequence[Tissue],
    relations: Relations,
    options: TetmeshOptions,
    *,
    threads: int = 1,
    progress: Progress | None = None,
) -> Meshed:
    """Mesh the tissues of a model together.

    Parameters
    ----------
    tissues
        The tissues; at least one has faces.
    relations
        How they lie to each other.
    options
        How to mesh.
    threads
        How many to use.
    progress
        Called with step, number done and number in all.

    Raises
    ------
    NotMeshed
        If the engine gave no mesh in any attempt.
    VhpError
        If there is nothing to mesh, or the box of air does not hold the model.
    """
    work = _Work(tissues, relations, options, threads, progress)
    attempts: list[TetmeshAttempt] = []
    best: _Made | None = None
    failed: CallFailed | None = None
    request: Request | None = work.first_request()
    while request is not None and len(attempts) < options.attempts:
        record = _attempt(tissues, request)
        attempts.append(record)
        try:
            made = work.one_mesh(request, _limit(work, options, best))
        except CallFailed as failure:
            record["failure"] = f"{failure.reason}: {failure.detail}"
            failed = failure
            request = _after_failure(request, failure)
            continue
        record["tets"] = made.tets
        if made.measured.quality is not None:
            record["min_dihedral_deg"] = made.measured.quality["min_dihedral_deg"]
            record["radius_ratio_p01"] = made.measured.quality["radius_ratio_p01"]
        if best is None or made.rank(options) > best.rank(options):
            best = made
            for earlier in attempts:
                earlier["chosen"] = earlier is record
        request = None if work.keeps_surface else _after_mesh(made, options)
    if best is None:
        assert failed is not None
        raise NotMeshed(failed, attempts, work.seconds)
    too_many = f"{best.tets:,} tetrahedra, at most {options.max_tets:,} asked" if best.exceeds(options) else ""
    return Meshed(
        best.mesh,
        best.measured,
        best.request,
        work.engine,
        work.epsilon_reason,
        attempts,
        tuple(tissues[index].name for index in work.order),
        work.seconds,
        (too_many,) if too_many else (),
        best.notes,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Filled:
    """What an engine made: tetrahedra, their regions if these are known, and what is to be told of it."""

    points: Points
    tetrahedra: Tetrahedra
    regions: NDArray[np.int32] | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class _Made:
    """One attempt that came to a mesh."""

    mesh: VolumeMesh
    measured: Measured
    request: Request
    notes: tuple[str, ...]

    @property
    def tets(self) -> int:
        """Number of tetrahedra, air left out."""
        return int((self.mesh.labels != BACKGROUND).sum())

    def exceeds(self, options: TetmeshOptions) -> bool:
        """Tell if there are more tetrahedra than allowed."""
        return options.max_tets is not None and self.tets > options.max_tets

    def targets_met(self, options: TetmeshOptions) -> int:
        """Return how many of the two targets are met."""
        quality = self.measured.quality
        if quality is None:
            return 0
        angle, ratio = quality["min_dihedral_deg"], quality["radius_ratio_p01"]
        return (angle >= options.min_dihedral_deg) + (ratio >= options.radius_ratio)

    def rank(self, options: TetmeshOptions) -> tuple[float, ...]:
        """Return what tells the better of two: tissues kept, limits kept, targets met, then the worst angle."""
        tissues = sum(label["tets"] > 0 for label in self.measured.labels)
        excess = -float(self.tets) if self.exceeds(options) else 0.0
        angle = self.measured.quality["min_dihedral_deg"] if self.measured.quality else 0.0
        return (tissues, excess, self.targets_met(options), angle)


class _Work:
    """What all attempts at a mesh have in common."""

    def __init__(
        self,
        tissues: Sequence[Tissue],
        relations: Relations,
        options: TetmeshOptions,
        threads: int,
        progress: Progress | None,
    ) -> None:
        self._tissues = tissues
        self._options = options
        self._threads = threads
        self._progress = progress
        self.seconds: dict[str, float] = {}
        started = time.perf_counter()
        self._trees: list[Tree] = trees(tissues)
        sizes = [enclosed_volume(tissue, tree) for tissue, tree in zip(tissues, self._trees, strict=True)]
        self.order = precedence(tissues, sizes, relations.containers)
        self._parents = smallest_containers(tissues, sizes, relations.containers)
        self._components: list[Component] = components_of(tissues)
        parts = expected_parts(tissues, self._components, self.order)
        self._truths: list[Truth] = truths(tissues, sizes, relations, self.order, parts)
        self._box: Box | None = options.air_box(*bounds(tissues))
        self._soup: Mesh = soup(tissues, self._box)
        self._diagonal = diagonal(tissues)
        self._asked_length = absolute_length(options.edge_length, self._diagonal)
        self._overlap = next(iter(relations.overlaps_mm3), ())
        self.keeps_surface = options.keep_surface is not None
        self.engine: engines.VolumeName = ENVELOPE_ENGINE
        if options.keep_surface is not None:
            self.engine = installed_engine(None if options.keep_surface == ANY_ENGINE else options.keep_surface)
        self.epsilon_reason = "as asked"
        self._epsilon = options.epsilon_mm or 0.0
        if self.keeps_surface:
            self._epsilon, self.epsilon_reason = 0.0, "the surfaces are kept as they are"
        elif options.epsilon_mm is None:
            self._epsilon, self.epsilon_reason = envelope(
                tissues, self._trees, relations.smallest_gap_mm, self._diagonal
            )
        self._lap("prepare", started)

    def _lap(self, step: str, started: float) -> None:
        self.seconds[step] = round(self.seconds.get(step, 0.0) + time.perf_counter() - started, 4)

    def first_request(self) -> Request:
        options = self._options
        return Request(self._asked_length, self._epsilon, options.stop_energy, options.iterations, options.coarsen)

    def one_mesh(self, request: Request, time_limit_s: float) -> _Made:
        """Make one attempt; `CallFailed` if the engine gives no mesh."""
        started = time.perf_counter()
        try:
            filled = (
                self._kept_surfaces(time_limit_s)
                if self.keeps_surface
                else self._within_envelope(request, time_limit_s)
            )
        finally:
            self._lap("mesh", started)
        started = time.perf_counter()
        points, tetrahedra = filled.points, filled.tetrahedra
        found = label_tetrahedra(
            points,
            tetrahedra,
            self._trees,
            self.order,
            parents=self._parents,
            regions=filled.regions,
            threads=self._threads,
        )
        self._lap("label", started)
        kept = found.labels != BACKGROUND
        mesh = VolumeMesh(points, tetrahedra, found.labels, tuple(tissue.name for tissue in self._tissues))
        if not self.keeps_surface:
            mesh, kept = self._tidied_and_fitted(mesh, request)
        elif self._box is not None:
            kept |= in_box(points, tetrahedra, self._box)
        started = time.perf_counter()
        moved = np.bincount(mesh.labels[mesh.labels != found.labels], minlength=len(self._tissues) + 1)
        enclosed = found.enclosed(volumes(mesh.points, tetrahedra))
        mesh = _cut(mesh, kept)
        relabelled = {label: int(count) for label, count in enumerate(moved)}
        measured = measure_mesh(mesh, self._tissues, self._truths, enclosed, relabelled)
        self._lap("measure", started)
        return _Made(mesh, measured, request, filled.notes)

    def _within_envelope(self, request: Request, time_limit_s: float) -> _Filled:
        watch = Watch(self._progress, request.stop_energy)
        points, tetrahedra = engines.call_volume(
            ENVELOPE_ENGINE,
            self._soup,
            timeout_s=time_limit_s,
            memory_gb=self._options.memory_gb,
            on_output=watch.read if self._progress else None,
            envelope_mm=request.epsilon_mm,
            edge_length_mm=request.edge_length_mm,
            stop_energy=request.stop_energy,
            iterations=request.iterations,
            coarsen=request.coarsen,
            threads=self._threads,
            sizing=self._sizing(request),
        )
        if (volumes(points, tetrahedra) < 0).all():
            tetrahedra = tetrahedra[:, [0, 2, 1, 3]]
        return _Filled(points, tetrahedra)

    def _kept_surfaces(self, time_limit_s: float) -> _Filled:
        unfit = [tissue.name for tissue in self._tissues if tissue.defects or tissue.volume_mm3 is None]
        if unfit or self._overlap:
            raise CallFailed(
                "error",
                "surfaces can be kept only if they are closed, sound and do not cross: "
                f"{', '.join(unfit[:5]) or ' and '.join(self._overlap)} can't be; heal them, or let them move",
            )
        surfaces = [tissue.mesh for tissue in self._tissues]
        if self._box is not None:
            surfaces.append(box_surface(*self._box))
        made = keep_surface(
            surfaces,
            engine=self.engine,  # type: ignore[arg-type]
            edge_length_mm=self._asked_length,
            timeout_s=time_limit_s,
            memory_gb=self._options.memory_gb,
        )
        return _Filled(made.points, made.tetrahedra, made.regions, made.notes)

    def _tidied_and_fitted(self, raw: VolumeMesh, request: Request) -> tuple[VolumeMesh, NDArray[np.bool_]]:
        """Return a mesh with tidy labels and its interfaces on the surfaces, and which tetrahedra are kept."""
        started = time.perf_counter()
        mesh = tidy(raw, self._components, self._options.smallest_region).mesh
        self._lap("tidy", started)
        started = time.perf_counter()
        surfaces, kept = self._trees, mesh.labels != BACKGROUND
        if self._box is not None:
            # What is around the box is no air: an interface as any other.
            kept |= in_box(mesh.points, mesh.tetrahedra, self._box)
            labels = np.where(kept, mesh.labels, len(mesh.names) + 1).astype(np.int32)
            mesh = VolumeMesh(mesh.points, mesh.tetrahedra, labels, (*mesh.names, _AROUND))
            wall = box_surface(*self._box)
            surfaces = [*surfaces, Tree(wall.vertices, wall.faces)]
        floor = Floor(self._options.min_dihedral_deg + _ABOVE_TARGET_DEG, self._options.radius_ratio)
        mesh = relax(mesh, kept, floor, request.epsilon_mm / 2)
        self._lap("relax", started)
        started = time.perf_counter()
        if self._options.fit:
            mesh = fit_to_surfaces(mesh, surfaces, request.epsilon_mm, kept=kept, floor=floor, threads=self._threads)
        self._lap("fit", started)
        names = tuple(tissue.name for tissue in self._tissues)
        return VolumeMesh(mesh.points, mesh.tetrahedra, np.where(kept, mesh.labels, BACKGROUND), names), kept

    def _sizing(self, request: Request) -> SizingField | None:
        # Where edges had to become longer than asked, they do so in every tissue.
        factor = request.edge_length_mm / self._asked_length
        lengths = [
            None if tissue.edge_length is None else factor * absolute_length(tissue.edge_length, self._diagonal)
            for tissue in self._tissues
        ]
        lower, upper = self._box or bounds(self._tissues)
        return sizing_field(self._trees, self.order, lower, upper, lengths, request.edge_length_mm)


def _cut(mesh: VolumeMesh, kept: np.ndarray) -> VolumeMesh:
    """Return a mesh of some tetrahedra only, without the points that are left over."""
    used, index = np.unique(mesh.tetrahedra[kept], return_inverse=True)
    return VolumeMesh(mesh.points[used], index.reshape(-1, 4).astype(np.int32), mesh.labels[kept], mesh.names)


def _attempt(tissues: Sequence[Tissue], request: Request) -> TetmeshAttempt:
    return {
        "tissue": tissues[0].name if len(tissues) == 1 else "",
        "edge_length_mm": request.edge_length_mm,
        "epsilon_mm": request.epsilon_mm,
        "stop_energy": request.stop_energy,
        "iterations": request.iterations,
        "coarsen": request.coarsen,
        "tets": None,
        "min_dihedral_deg": None,
        "radius_ratio_p01": None,
        "failure": "",
        "chosen": False,
    }


def _limit(work: _Work, options: TetmeshOptions, best: _Made | None) -> float:
    """Return how long the next attempt may take: where there is a mesh, a better one may cost so much and no more."""
    if best is None:
        return options.time_limit_s
    return min(options.time_limit_s, _PATIENCE * work.seconds["mesh"] + _LEAST_PATIENCE_S)


def _after_mesh(made: _Made, options: TetmeshOptions) -> Request | None:
    """Return what to try after a mesh; None if it is as wanted, or nothing else is to be tried."""
    request = made.request
    if options.max_tets is not None and made.exceeds(options):
        longer = request.edge_length_mm * (made.tets / (_AIM * options.max_tets)) ** (1 / 3)
        return replace(request, edge_length_mm=longer, coarsen=True)
    if made.targets_met(options) == 2 or request.stop_energy >= _DRAFT_ENERGY:
        return None
    return replace(request, stop_energy=min(request.stop_energy, _FINE_ENERGY))


def _after_failure(request: Request, failed: CallFailed) -> Request | None:
    """Return what to try after a failure; None if it would come again."""
    if failed.reason == "error":
        return None
    if failed.reason == "crash":
        return request
    return replace(
        request,
        edge_length_mm=_DRAFT_EDGE * request.edge_length_mm,
        stop_energy=max(request.stop_energy, _DRAFT_ENERGY),
        iterations=min(request.iterations, _DRAFT_ITERATIONS),
    )
