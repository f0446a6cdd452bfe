"""The stage: the tissues of a model in, one conforming, labelled tetrahedral mesh out, cluster by cluster."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

import numpy as np

from vhp_cli import engines
from vhp_cli.measures import TetmeshAttempt, TetmeshCluster, TetmeshLabel
from vhp_cli.processes import stop_all
from vhp_cli.stages.tetmesh.clusters import Cluster, Group, clusters_of, meeting, union
from vhp_cli.stages.tetmesh.measuring import Measured, Truth, measure_mesh
from vhp_cli.stages.tetmesh.meshing import Frame, Meshing
from vhp_cli.stages.tetmesh.options import TetmeshOptions, absolute_length
from vhp_cli.stages.tetmesh.sizing import wall_thickness
from vhp_cli.stages.tetmesh.tissues import Relations, Tissue, diagonal, without_flat_faces
from vhp_cli.stages.tetmesh.watching import Progress
from vhp_cli.volume import VolumeMesh

# In a cluster no edge is asked to be longer than so much of its diagonal: the engine fills a box that reaches beyond
# the surfaces by one edge, and betters all of it.
_LONGEST_EDGE = 0.15

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True, eq=False)
class Meshed:
    """What became of a model.

    Parameters
    ----------
    mesh, measured
        The mesh of all clusters that could be meshed, air only where it was asked for; None: there is none.
    engine
        Key of `vhp_cli.engines.ENGINES`.
    clusters
        What was meshed together, in the order of the first tissues.
    attempts
        All attempts, cluster by cluster.
    order
        Names of the tissues that have been meshed, in the order in which they were laid over each other.
    failures
        Why tissues could not be meshed, by their names.
    seconds
        How long each step took, all clusters together.
    shortfalls
        Limits that the mesh does not keep.
    notes
        What there is to tell.
    """

    mesh: VolumeMesh | None
    measured: Measured | None
    engine: engines.VolumeName
    clusters: list[TetmeshCluster]
    attempts: list[TetmeshAttempt]
    order: tuple[str, ...]
    failures: dict[tuple[str, ...], str]
    seconds: dict[str, float]
    shortfalls: tuple[str, ...]
    notes: tuple[str, ...]


@dataclass(slots=True, eq=False)
class _Part:
    """A cluster on its way."""

    cluster: Cluster
    meshing: Meshing
    # What was made of its tissues before, and met others.
    replaced: list[_Part]

    @property
    def meshings(self) -> list[Meshing]:
        """All that was done, the last one last."""
        return [*(earlier for part in self.replaced for earlier in part.meshings), self.meshing]

    def record(self, tissues: Sequence[Tissue]) -> TetmeshCluster:
        """Return what the report says of the cluster."""
        best, failed = self.meshing.best, self.meshing.failed
        asked = best.request if best else self.meshing.first_request
        return {
            "tissues": [tissues[index].name for index in self.cluster.tissues],
            "tets": best.tets if best else 0,
            "edge_length_mm": asked.edge_length_mm,
            "epsilon_mm": asked.epsilon_mm,
            "epsilon_reason": self.meshing.epsilon_reason,
            "failure": f"{failed.reason}: {failed.detail}" if failed and not best else "",
        }


def mesh_model(
    tissues: Sequence[Tissue],
    relations: Relations,
    options: TetmeshOptions,
    *,
    threads: int = 1,
    progress: Progress | None = None,
) -> Meshed:
    """Mesh the tissues of a model: those that stand apart by themselves, several at a time.

    That no two clusters meet is proved on the result; those that do are meshed together.

    Parameters
    ----------
    tissues
        The tissues; at least one has an area.
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
    VhpError
        If there is nothing to mesh, or the box of air does not hold the model.
    """
    model = _Model(tissues, relations, options, threads, progress)
    model.mesh_clusters()
    while met := model.meeting():
        model.keep_apart(met)
        model.mesh_clusters()
    return model.joined()


class _Model:
    """A model on its way: how it is parted into clusters, and what has become of each."""

    def __init__(
        self,
        tissues: Sequence[Tissue],
        relations: Relations,
        options: TetmeshOptions,
        threads: int,
        progress: Progress | None,
    ) -> None:
        self._tissues = tissues
        self._relations = relations
        self._options = options
        self._threads = threads
        self._progress = progress
        self._diagonal = diagonal(tissues)
        self._length = absolute_length(options.edge_length, self._diagonal)
        with ThreadPoolExecutor(threads) as executor:
            self._walls = list(executor.map(wall_thickness, tissues))
        self._together = _never_apart(tissues, options)
        self._careful: list[Group] = []
        self._parts: list[_Part] = []
        self._seconds: dict[str, float] = {}
        self._notes = _too_wide(tissues, self._walls, options)

    def mesh_clusters(self) -> None:
        """Part the model, and mesh those clusters that are new, the largest first."""
        clusters = clusters_of(
            self._tissues,
            self._relations,
            self._walls,
            asked_mm=self._options.epsilon_mm,
            careful=self._careful,
            together=self._together,
        )
        known = {part.cluster: part for part in self._parts}
        new = [cluster for cluster in clusters if cluster not in known]
        alone = len(clusters) == 1
        threads = max(self._threads // max(len(new), 1), 1)
        made = in_threads(
            [partial(self._meshed, cluster, alone, threads) for cluster in new],
            [sum(len(self._tissues[index].mesh.faces) for index in cluster.tissues) for cluster in new],
            self._threads,
            None if alone or self._progress is None else partial(self._progress, "clusters"),
        )
        for cluster, meshing in zip(new, made, strict=True):
            replaced = [known.pop(other) for other in list(known) if set(other.tissues) <= set(cluster.tissues)]
            known[cluster] = _Part(cluster, meshing, replaced)
        self._parts = [known[cluster] for cluster in clusters]
        if self._options.max_tets is not None:
            _within_limit(self._parts, self._options.max_tets, self._threads)

    def _meshed(self, cluster: Cluster, alone: bool, threads: int) -> Meshing:
        chosen = [self._tissues[index] for index in cluster.tissues]
        length = self._length if alone else min(self._length, _LONGEST_EDGE * diagonal(chosen))
        meshing = Meshing(
            chosen,
            self._relations.among({tissue.name for tissue in chosen}),
            self._options,
            Frame(self._diagonal, length, cluster.envelope),
            threads=threads,
            progress=self._progress if alone else None,
        )
        meshing.to_first_mesh()
        # With a limit on all of them, nothing is bettered before it is known what each takes.
        if self._options.max_tets is None:
            meshing.to_best_mesh(None)
        return meshing

    def meeting(self) -> list[tuple[_Part, _Part]]:
        """Return the clusters whose meshes meet."""
        started = time.perf_counter()
        found = [(part, part.meshing.best.mesh) for part in self._parts if part.meshing.best is not None]
        met = meeting([mesh for _, mesh in found]) if len(found) > 1 else []
        self._seconds["prove"] = round(self._seconds.get("prove", 0.0) + time.perf_counter() - started, 4)
        return [(found[a][0], found[b][0]) for a, b in met]

    def keep_apart(self, met: Sequence[tuple[_Part, _Part]]) -> None:
        """See to it that clusters that met do not meet again: by their envelopes first, then by being one."""
        for parts in met:
            both = tuple(index for part in parts for index in part.cluster.tissues)
            first, second = (self._tissues[part.cluster.tissues[0]].name for part in parts)
            how = "as one" if both in self._careful else "with envelopes that can't close the gap"
            self._notes.append(f"the meshes with {first} and {second} met each other: made again, {how}")
            (self._together if both in self._careful else self._careful).append(both)

    def joined(self) -> Meshed:
        """Put the meshes of clusters together, and measure them as one."""
        clusters: list[TetmeshCluster] = []
        attempts: list[TetmeshAttempt] = []
        failures: dict[tuple[str, ...], str] = {}
        for number, part in enumerate(self._parts, start=1):
            record = part.record(self._tissues)
            clusters.append(record)
            if record["failure"]:
                failures[tuple(record["tissues"])] = record["failure"]
            elif part.meshing.best is not None:
                self._notes += part.meshing.best.notes
            for meshing in part.meshings:
                for attempt in meshing.attempts:
                    chosen = attempt["chosen"] and meshing is part.meshing
                    attempts.append({**attempt, "cluster": number, "chosen": chosen})
                for step, value in meshing.seconds.items():
                    self._seconds[step] = round(self._seconds.get(step, 0.0) + value, 4)
        mesh, measured = self._union()
        tets, most = sum(cluster["tets"] for cluster in clusters), self._options.max_tets
        return Meshed(
            mesh,
            measured,
            self._parts[0].meshing.engine,
            clusters,
            attempts,
            tuple(name for part in self._parts if part.meshing.best for name in part.meshing.order),
            failures,
            self._seconds,
            (f"{tets:,} tetrahedra, at most {most:,} asked",) if most is not None and tets > most else (),
            tuple(self._notes),
        )

    def _union(self) -> tuple[VolumeMesh | None, Measured | None]:
        """Return the meshes of all clusters as one, and its measures; None if there is no mesh."""
        done = [(part, part.meshing.best) for part in self._parts if part.meshing.best is not None]
        if len(self._parts) == 1 or not done:
            return (done[0][1].mesh, done[0][1].measured) if done else (None, None)
        started = time.perf_counter()
        known: dict[int, tuple[Truth, TetmeshLabel]] = {}
        for part, best in done:
            known |= zip(part.cluster.tissues, zip(part.meshing.truths, best.measured.labels, strict=True), strict=True)
        kept = sorted(known)
        label_of = {index: label for label, index in enumerate(kept, start=1)}
        mesh = union(
            [best.mesh for _, best in done],
            [[label_of[index] for index in part.cluster.tissues] for part, _ in done],
            tuple(self._tissues[index].name for index in kept),
        )
        measured = measure_mesh(
            mesh,
            [self._tissues[index] for index in kept],
            [known[index][0] for index in kept],
            np.array([known[index][1]["enclosed_mm3"] for index in kept]),
            {label_of[index]: known[index][1]["relabelled_tets"] for index in kept},
        )
        self._seconds["measure"] = round(self._seconds.get("measure", 0.0) + time.perf_counter() - started, 4)
        return mesh, measured


def _too_wide(tissues: Sequence[Tissue], walls_mm: Sequence[float | None], options: TetmeshOptions) -> list[str]:
    """Say which tissues an envelope that was asked for can close: both sides of a wall may move by as much."""
    asked = options.epsilon_mm
    if asked is None or options.keep_surface is not None:
        return []
    thin = [(wall, tissue.name) for tissue, wall in zip(tissues, walls_mm, strict=True) if wall and wall < 2 * asked]
    if not thin:
        return []
    wall, name = min(thin)
    others = f" and {len(thin) - 1} more" if len(thin) > 1 else ""
    return [f"the walls of {name}{others} are thinner than twice the envelope, {wall:.3g} mm: it may close them"]


def _never_apart(tissues: Sequence[Tissue], options: TetmeshOptions) -> list[Group]:
    """Return the tissues that are meshed together wherever they lie."""
    if options.air is not None or options.keep_surface is not None:
        return [tuple(range(len(tissues)))]
    # What has no area is lost in any mesh, and there is none of it alone.
    has_area = [len(without_flat_faces(tissue.mesh).faces) > 0 for tissue in tissues]
    if all(has_area) or not any(has_area):
        return []
    return [(has_area.index(True), *(index for index, solid in enumerate(has_area) if not solid))]


def _within_limit(parts: Sequence[_Part], max_tets: int, threads: int) -> None:
    """Share out the tetrahedra that are allowed, by what each cluster took, and better the meshes within that."""
    tets = [part.meshing.best.tets if part.meshing.best else 0 for part in parts]
    whole = sum(tets)
    going_on = [index for index, count in enumerate(tets) if count]
    in_threads(
        [partial(parts[index].meshing.to_best_mesh, max_tets * tets[index] // whole) for index in going_on],
        [tets[index] for index in going_on],
        threads,
    )


def in_threads(
    calls: Sequence[Callable[[], _T]],
    sizes: Sequence[int],
    threads: int,
    done: Callable[[int, int], None] | None = None,
) -> list[_T]:
    """Return the results of calls in their order; the largest begin first, several at a time.

    Parameters
    ----------
    calls
        What to call. Where one raises, the others are stopped, together with all child processes.
    sizes
        How large each is, compared with the others.
    threads
        How many go at a time.
    done
        Called with how many are done, and how many there are.
    """
    if len(calls) == 1:
        return [calls[0]()]
    results: dict[int, _T] = {}
    with ThreadPoolExecutor(threads) as executor:
        try:
            order = sorted(range(len(calls)), key=lambda index: -sizes[index])
            futures = {executor.submit(calls[index]): index for index in order}
            for count, future in enumerate(as_completed(futures), start=1):
                results[futures[future]] = future.result()
                if done:
                    done(count, len(calls))
        except BaseException:
            executor.shutdown(wait=False, cancel_futures=True)
            stop_all()
            raise
    return [results[index] for index in range(len(calls))]
