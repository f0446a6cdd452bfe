"""The stage: surfaces in, one conforming, labelled tetrahedral mesh out."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vhp_cli import engines
from vhp_cli.kernels.spatial import Tree
from vhp_cli.measures import TetmeshAttempt
from vhp_cli.mesh import Mesh
from vhp_cli.processes import CallFailed
from vhp_cli.stages.tetmesh.attempts import Made, Request, after_failure, after_mesh, limit_s, record_of
from vhp_cli.stages.tetmesh.components import Component, components_of, expected_parts
from vhp_cli.stages.tetmesh.finishing import Finish, Finished, finish, without_rest
from vhp_cli.stages.tetmesh.keep_surface import installed_engine, keep_surface
from vhp_cli.stages.tetmesh.labelling import (
    Labelling,
    enclosed_volume,
    in_box,
    label_tetrahedra,
    precedence,
    smallest_containers,
)
from vhp_cli.stages.tetmesh.lightening import SHARE, lightened
from vhp_cli.stages.tetmesh.measuring import Measured, Truth, measure_mesh, truths
from vhp_cli.stages.tetmesh.options import ANY_ENGINE, TetmeshOptions, absolute_length
from vhp_cli.stages.tetmesh.relaxing import Floor
from vhp_cli.stages.tetmesh.sizing import SizingField, envelope, sizing_field
from vhp_cli.stages.tetmesh.tissues import Box, Relations, Tissue, bounds, box_surface, diagonal, soup, trees
from vhp_cli.stages.tetmesh.watching import Progress, Watch
from vhp_cli.volume import BACKGROUND, Points, Tetrahedra, VolumeMesh, volumes

ENVELOPE_ENGINE: engines.VolumeName = "tetwild-volume"
# What is asked for is exceeded by so much, where tetrahedra can be bettered.
_ABOVE_TARGET_DEG, _ABOVE_TARGET = 2.0, 1.03


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
    best: Made | None = None
    failed: CallFailed | None = None
    request: Request | None = work.first_request()
    while request is not None and len(attempts) < options.attempts:
        record = record_of(tissues, request)
        attempts.append(record)
        try:
            made = work.one_mesh(request, limit_s(options, work.seconds, best is not None))
        except CallFailed as failure:
            record["failure"] = f"{failure.reason}: {failure.detail}"
            failed = failure
            request = after_failure(request, failure)
            continue
        record["tets"] = made.tets
        if made.measured.quality is not None:
            record["min_dihedral_deg"] = made.measured.quality["min_dihedral_deg"]
            record["radius_ratio_p01"] = made.measured.quality["radius_ratio_p01"]
        if best is None or made.rank(options) > best.rank(options):
            best = made
            for earlier in attempts:
                earlier["chosen"] = earlier is record
        request = None if work.keeps_surface else after_mesh(made, options)
    if best is None:
        assert failed is not None
        raise NotMeshed(failed, attempts, work.seconds)
    too_many = f"{best.tets:,} tetrahedra, at most {options.max_tets:,} asked" if best.exceeds(options) else ""
    return Meshed(
        best.mesh,
        best.measured,
        best.request,
        work.engine,
        work.reason_of(best.request),
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
        self._goals = _goals(tissues, sizes, relations)
        self._box: Box | None = options.air_box(*bounds(tissues))
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
                tissues, self._trees, relations.smallest_gap_mm, self._diagonal, relations.smallest_distance_mm
            )
        # Part of the envelope that the surfaces given to the mesher have used up.
        self._taken = 0.0
        self._soup = Mesh(np.empty((0, 3)), np.empty((0, 3), np.int32))
        if not self.keeps_surface:
            lighter = lightened(tissues, SHARE * self._epsilon, threads=threads)
            if any(one is not other for one, other in zip(lighter, tissues, strict=True)):
                self._taken = SHARE * self._epsilon
            self._soup = soup(lighter, self._box)
        self._lap("prepare", started)

    def _lap(self, step: str, started: float) -> None:
        self.seconds[step] = round(self.seconds.get(step, 0.0) + time.perf_counter() - started, 4)

    def first_request(self) -> Request:
        options = self._options
        return Request(self._asked_length, self._epsilon, options.stop_energy, options.iterations, options.coarsen)

    def reason_of(self, request: Request) -> str:
        """Return what decided on the envelope of a request."""
        first = self.first_request().epsilon_mm
        finer = f"; 1/{first / request.epsilon_mm:g} of that, as volumes were off" if request.epsilon_mm < first else ""
        return self.epsilon_reason + finer

    def one_mesh(self, request: Request, time_limit_s: float) -> Made:
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
            solid=[tissue.volume_mm3 is not None for tissue in self._tissues],
            threads=self._threads,
        )
        self._lap("label", started)
        raw = VolumeMesh(points, tetrahedra, found.labels, tuple(tissue.name for tissue in self._tissues))
        made = self._kept(raw, found) if self.keeps_surface else finish(raw, found, self._finish(request), self._lap)
        started = time.perf_counter()
        measured = measure_mesh(made.mesh, self._tissues, self._truths, made.enclosed_mm3, made.relabelled)
        self._lap("measure", started)
        return Made(made.mesh, measured, request, filled.notes)

    def _within_envelope(self, request: Request, time_limit_s: float) -> _Filled:
        watch = Watch(self._progress, request.stop_energy)
        points, tetrahedra = engines.call_volume(
            ENVELOPE_ENGINE,
            self._soup,
            timeout_s=time_limit_s,
            memory_gb=self._options.memory_gb,
            on_output=watch.read if self._progress else None,
            envelope_mm=request.epsilon_mm - self._taken,
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

    def _kept(self, raw: VolumeMesh, found: Labelling) -> Finished:
        """Return a mesh as it is, without what lies outside of all."""
        kept = raw.labels != BACKGROUND
        if self._box is not None:
            kept |= in_box(raw.points, raw.tetrahedra, self._box)
        return Finished(without_rest(raw, kept), found.enclosed(volumes(raw.points, raw.tetrahedra)), {})

    def _finish(self, request: Request) -> Finish:
        options = self._options
        return Finish(
            self._trees,
            self._components,
            self._goals,
            self._box,
            Floor(options.min_dihedral_deg + _ABOVE_TARGET_DEG, _ABOVE_TARGET * options.radius_ratio),
            request.epsilon_mm,
            options.smallest_region,
            options.fit,
            self._threads,
        )

    def _sizing(self, request: Request) -> SizingField | None:
        # Where edges had to become longer than asked, they do so in every tissue.
        factor = request.edge_length_mm / self._asked_length
        lengths = [
            None if tissue.edge_length is None else factor * absolute_length(tissue.edge_length, self._diagonal)
            for tissue in self._tissues
        ]
        lower, upper = self._box or bounds(self._tissues)
        return sizing_field(self._trees, self.order, lower, upper, lengths, request.edge_length_mm)


def _goals(tissues: Sequence[Tissue], sizes_mm3: Sequence[float], relations: Relations) -> dict[frozenset[int], float]:
    """Return the volumes within surfaces, by the labels that lie there, where nothing else claims a part of them."""
    in_overlap = {name for pair in relations.overlaps_mm3 for name in pair}
    label = {tissue.name: number for number, tissue in enumerate(tissues, start=1)}
    found = {}
    for tissue, size in zip(tissues, sizes_mm3, strict=True):
        if tissue.volume_mm3 is None or tissue.name in in_overlap:
            continue
        inner = (other for other, around in relations.containers.items() if tissue.name in around and other in label)
        found[frozenset((label[tissue.name], *(label[other] for other in inner)))] = size
    return found
