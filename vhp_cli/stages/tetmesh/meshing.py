"""Surfaces of tissues that are meshed together in, one conforming, labelled tetrahedral mesh out."""

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
from vhp_cli.stages.tetmesh.measuring import Truth, measure_mesh, truths
from vhp_cli.stages.tetmesh.options import ANY_ENGINE, TetmeshOptions, absolute_length
from vhp_cli.stages.tetmesh.relaxing import Floor
from vhp_cli.stages.tetmesh.sizing import Envelope, SizingField, sizing_field
from vhp_cli.stages.tetmesh.tissues import Box, Relations, Tissue, bounds, box_surface, soup, trees
from vhp_cli.stages.tetmesh.watching import Progress, Watch
from vhp_cli.volume import BACKGROUND, Points, Tetrahedra, VolumeMesh, volumes

ENVELOPE_ENGINE: engines.VolumeName = "tetwild-volume"
# What is asked for is exceeded by so much, where tetrahedra can be bettered.
_ABOVE_TARGET_DEG, _ABOVE_TARGET = 2.0, 1.03


@dataclass(frozen=True, slots=True)
class Frame:
    """What tissues that are meshed together have from their model.

    Parameters
    ----------
    diagonal_mm
        Of the model: lengths may be a part of it.
    edge_length_mm
        How long edges are to be.
    envelope
        How far the mesh may lie from the surfaces.
    """

    diagonal_mm: float
    edge_length_mm: float
    envelope: Envelope


class Meshing:
    """Attempts at one mesh of some tissues, one after the other.

    Parameters
    ----------
    tissues
        The tissues; at least one has faces.
    relations
        How they lie to each other.
    options
        How to mesh.
    frame
        What they have from their model.
    threads
        How many to use.
    progress
        Called with step, number done and number in all.

    Attributes
    ----------
    best
        The best mesh so far; None: there is none.
    failed
        Why the last attempt that failed did so.
    attempts, seconds
        All attempts in order, and how long each step of them took.

    Raises
    ------
    VhpError
        If there is nothing to mesh, or the box of air does not hold the model.
    """

    def __init__(
        self,
        tissues: Sequence[Tissue],
        relations: Relations,
        options: TetmeshOptions,
        frame: Frame,
        *,
        threads: int = 1,
        progress: Progress | None = None,
    ) -> None:
        self._tissues = tissues
        self._options = options
        self._work = _Work(tissues, relations, options, frame, threads, progress)
        self.best: Made | None = None
        self.failed: CallFailed | None = None
        self.attempts: list[TetmeshAttempt] = []
        self._last: tuple[Request, Made | CallFailed] | None = None
        self._calls = self._crashes = 0

    @property
    def seconds(self) -> dict[str, float]:
        """How long each step took, all attempts together."""
        return self._work.seconds

    @property
    def engine(self) -> engines.VolumeName:
        """Key of `vhp_cli.engines.ENGINES`."""
        return self._work.engine

    @property
    def order(self) -> tuple[str, ...]:
        """Names of the tissues in the order in which they are laid over each other."""
        return tuple(self._tissues[index].name for index in self._work.order)

    @property
    def truths(self) -> list[Truth]:
        """What the surfaces say of each tissue."""
        return self._work.truths

    @property
    def first_request(self) -> Request:
        """What is asked of the engine first."""
        return self._work.first_request()

    @property
    def epsilon_reason(self) -> str:
        """What decided on the envelope of the best mesh."""
        return self._work.reason_of(self.best.request if self.best else self.first_request)

    def to_first_mesh(self) -> None:
        """Try until there is a mesh, or no attempt is left."""
        while self.best is None and self._attempted(self._options):
            pass

    def to_best_mesh(self, max_tets: int | None) -> None:
        """Try until limits and targets hold, or no attempt is left.

        Parameters
        ----------
        max_tets
            Most tetrahedra, air left out.
        """
        options = replace(self._options, max_tets=max_tets)
        while self._attempted(options):
            pass

    def _attempted(self, options: TetmeshOptions) -> bool:
        """Make another attempt, if there is a use in it; crashes are not counted as such."""
        request = self._next(options)
        if request is None or self._calls >= options.attempts:
            return False
        record = record_of(self._tissues, request)
        self.attempts.append(record)
        self._calls += 1
        try:
            made = self._work.one_mesh(request, limit_s(options, self.seconds, self.best is not None))
        except CallFailed as failure:
            record["failure"] = f"{failure.reason}: {failure.detail}"
            if failure.reason == "crash":
                self._crashes += 1
                self._calls -= 1
            self.failed = failure
            self._last = request, failure
            return True
        record["tets"] = made.tets
        if made.measured.quality is not None:
            record["min_dihedral_deg"] = made.measured.quality["min_dihedral_deg"]
            record["radius_ratio_p01"] = made.measured.quality["radius_ratio_p01"]
        if self.best is None or made.rank(options) > self.best.rank(options):
            self.best = made
            for earlier in self.attempts:
                earlier["chosen"] = earlier is record
        self._last = request, made
        return True

    def _next(self, options: TetmeshOptions) -> Request | None:
        if self._last is None:
            return self.first_request
        request, outcome = self._last
        if isinstance(outcome, CallFailed):
            return after_failure(request, outcome, self._crashes)
        return None if self._work.keeps_surface else after_mesh(outcome, options)


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
        frame: Frame,
        threads: int,
        progress: Progress | None,
    ) -> None:
        self._tissues = tissues
        self._options = options
        self._frame = frame
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
        self.truths: list[Truth] = truths(tissues, sizes, relations, self.order, parts)
        self._goals = _goals(tissues, sizes, relations)
        self._box: Box | None = options.air_box(*bounds(tissues))
        self._overlap = next(iter(relations.overlaps_mm3), ())
        self.keeps_surface = options.keep_surface is not None
        self.engine: engines.VolumeName = ENVELOPE_ENGINE
        if options.keep_surface is not None:
            self.engine = installed_engine(None if options.keep_surface == ANY_ENGINE else options.keep_surface)
        self._epsilon = 0.0 if self.keeps_surface else frame.envelope.mm
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
        return Request(
            self._frame.edge_length_mm, self._epsilon, options.stop_energy, options.iterations, options.coarsen
        )

    def reason_of(self, request: Request) -> str:
        """Return what decided on the envelope of a request."""
        if self.keeps_surface:
            return "the surfaces are kept as they are"
        share = request.epsilon_mm / self._epsilon
        return self._frame.envelope.reason + (f"; {share:.2g} of that in a later attempt" if share < 1 else "")

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
        measured = measure_mesh(made.mesh, self._tissues, self.truths, made.enclosed_mm3, made.relabelled)
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
            edge_length_mm=self._frame.edge_length_mm,
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
        factor = request.edge_length_mm / self._frame.edge_length_mm
        lengths = [
            None
            if tissue.edge_length is None
            else factor * absolute_length(tissue.edge_length, self._frame.diagonal_mm)
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
