"""Well shaped triangles: guarded remeshing to a sizing field, and a wider envelope for what remains."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vhp_cli.inspection.deviation import deviation
from vhp_cli.kernels.measuring import closest
from vhp_cli.kernels.remeshing import Remesher
from vhp_cli.kernels.spatial import Tree
from vhp_cli.measures import Action, Place
from vhp_cli.mesh import Mesh
from vhp_cli.stages.heal.candidate import Candidate, diagonal, face_quality, judge
from vhp_cli.stages.heal.options import HealOptions
from vhp_cli.stages.heal.sizing import Limits, propose_limits, sizes_around, sizing, walls

# The quality phase works on triangles below this q, so that what it leaves lies well above the target.
_WORK_BELOW = 0.45
MEAN_QUALITY = 0.85
_BAD = 0.2
# Faces with a q below this have next to no area; they may be removed if that moves the surface by less than this share
# of the diagonal.
_FLAT = 1e-5
_FLAT_WAY = 1e-4
# Shares of the allowed deviation: of the first pass, and of the rescues that follow if it does not suffice.
_FIRST_SHARE = 0.5
_RESCUE_SHARES = (0.65, 0.8)
# Shares of the deviation for refining around what is still bad; added to those before, they stay below 1.
_LOCAL_SHARES = (0.15, 0.2)
# The same for what is really bad after that, round after round; where no limit was asked for, the last ones go beyond
# the deviation, up to this many times as far.
_LAST_SHARES = (0.2, 0.2, 0.2, 1.0, 1.0)
_WIDEST = 3.0
# The rounds end when there are this many times as many bad faces as before, and a few more.
_SPREADING, _FEW_FACES = 2, 8
# ... and no edge is asked for that is shorter than this many of the shortest that is allowed.
_LEAST_EDGES = 2
# Where the guards promised too much, the remesher runs again with this part of the deviation.
_CAREFUL = 0.6
# A second attempt has edges shorter by this factor: what is curved or thin then has room for good triangles.
_FINER = 0.7
# Bound on the time for one tissue: boxes and triangles looked at, some 3e7 in a second.
_MOST_WORK = 600_000_000
# ... and at least for each refinement around bad faces, which are few.
_LOCAL_WORK = 60_000_000
# Where no wish is met that was not before: so much must q have gained, for the surface to be touched at all.
_GAIN = 0.01
# Logarithm of the mean edge length over the wanted one, up to which an edge length counts as met.
_NEAR_LENGTH = 0.25
# A mesh may grow by this factor over its input, and to this number in any case.
_GROWTH = 2.5
_FEW_TRIANGLES = 2_000


def is_good(candidate: Candidate, options: HealOptions) -> bool:
    """Tell whether the triangles of a mesh need nothing."""
    return _suffices(_rank(candidate, options))


def shortfall(candidate: Candidate, given: Mesh, options: HealOptions) -> str:
    """Return which wishes the best mesh found misses, in one clause; empty if none, or if its mean q alone is low."""
    edge, count = candidate.measures["edge_mm"], candidate.measures["triangles"]
    met = _rank(candidate, options)
    missed = {
        f"{count} triangles, at most {options.max_triangles} asked": met[0],
        f"edges of {edge['mean'] if edge else 0:.3g} mm in the mean, {options.edge_length_mm} mm asked": met[1],
        f"shortest edge {candidate.min_edge:.3g} mm, {options.min_edge_mm:g} mm asked": met[2],
        f"least q {candidate.min_quality:.3g}, {options.target_quality:g} asked": met[4],
    }
    words = "; ".join(words for words, kept in missed.items() if not kept)
    return f"no better triangles were found within {deviation_limit(given, options):.3g} mm: {words}" if words else ""


def deviation_limit(mesh: Mesh, options: HealOptions) -> float:
    """Return how far the healed surface may lie from its input in mm: 0.1 % of the diagonal, at most 0.1 mm."""
    return options.max_deviation_mm or min(1e-3 * diagonal(mesh), 0.1)


def improve(solid: Candidate, given: Mesh, options: HealOptions) -> tuple[Candidate, list[Action]]:
    """Bring the triangles of a sound solid into shape.

    Local operations on bad triangles come first; the surface is remeshed as a whole only if they do not suffice, or
    an edge length or number of triangles is asked for.

    Parameters
    ----------
    solid
        A sound candidate.
    given
        The tissue as it was read: its size sets the limits.
    options
        Limits and wishes.

    Returns
    -------
    candidate, actions
        The best of all attempts, sound as well; `solid` itself and no action if none is better.
    """
    if is_good(solid, options):
        return solid, []
    attempts = _Attempts(solid, given, options)
    if options.edge_length_mm is None and options.max_triangles is None and solid.mean_quality >= MEAN_QUALITY:
        attempts.touch_up()
    for factor in (1.0, _FINER):
        if attempts.done:
            break
        attempts.remesh(factor)
        for share in _LOCAL_SHARES:
            if not attempts.bad_faces:
                break
            attempts.refine(share)
    attempts.refine_the_rest()
    if not _is_worth_it(solid, attempts.best, options):
        return solid, []
    return attempts.best, attempts.actions()


def remove_flat(mesh: Mesh) -> tuple[Mesh, list[Action]]:
    """Remove faces without area, and nearly so, by collapsing or flipping an edge.

    Parameters
    ----------
    mesh
        Manifold, with float32 values as coordinates; it may cross itself.
    """
    size = diagonal(mesh)
    flat = int((face_quality(mesh) < _FLAT).sum())
    if not flat or not size:
        return mesh, []
    remesher = Remesher(
        mesh.vertices,
        mesh.faces,
        sizes=_FLAT_WAY * size,
        deviation=_FLAT_WAY * size,
        target_quality=_FLAT,
        floor=0.0,
        min_edge=0.0,
    )
    remesher.improve()
    made = Mesh(*remesher.result())
    left = int((face_quality(made) < _FLAT).sum())
    if left >= flat:
        return mesh, []
    message = f"{flat - left} faces with next to no area removed"
    return made, [{"step": "flat", "message": message, "count": flat - left, "places": []}]


@dataclass(frozen=True, slots=True, eq=False)
class _Field:
    """The sizing field of one attempt."""

    limits: Limits
    vertex: np.ndarray
    estimate: int


class _Attempts:
    """Attempts to improve one solid; the best is kept."""

    def __init__(self, solid: Candidate, given: Mesh, options: HealOptions) -> None:
        self.solid = solid
        self.options = options
        self.allowed = deviation_limit(given, options)
        self.given_triangles = len(given.faces)
        self.best = solid
        self.step = ""
        self._work_left = _MOST_WORK
        self._walls = walls(solid.mesh)

    @property
    def done(self) -> bool:
        """Whether the best attempt needs nothing more."""
        return self._work_left <= 1 or (self.best is not self.solid and _suffices(_rank(self.best, self.options)))

    def touch_up(self) -> None:
        """Repair bad triangles where they are; the rest of the mesh stays as it is."""
        self._attempt(self._field(1.0), 0, bulk=False, step="bad triangles reshaped")

    def remesh(self, factor: float) -> None:
        """Remesh to the sizing field, its lengths multiplied by a factor."""
        field = self._field(factor)
        self._attempt(field, 5, bulk=True, step=f"remeshed to edges of {field.limits.longest_mm:.2g} mm")

    @property
    def bad_faces(self) -> int:
        """Number of faces of the best attempt below the wanted quality, if it is an attempt."""
        if self.best is self.solid or self._work_left <= 1:
            return 0
        return int((face_quality(self.best.mesh) < self.options.target_quality).sum())

    def refine(self, share: float) -> None:
        """Remesh with shorter edges around the bad faces of the best attempt, which becomes the reference."""
        self._take_best([self._refined(self.best.mesh, share)], self.step)

    def refine_the_rest(self) -> None:
        """Go on around really bad faces, each round from the last one, whether that was better as a whole or not."""
        if self.best is self.solid or self.best.min_quality >= self._bad:
            return
        mesh, before = self.best.mesh, self._bad_count(self.best)
        widening = _WIDEST if self.options.max_deviation_mm is None else 1.0
        for share in _LAST_SHARES:
            found = self._refined(mesh, share)
            count = self._bad_count(found)
            if not found.sound or count > _SPREADING * before + _FEW_FACES:
                break
            self._take_best([found], self.step, widening)
            if not count:
                break
            mesh, before = found.mesh, count

    @property
    def _bad(self) -> float:
        return min(_BAD, self.options.target_quality)

    def _bad_count(self, candidate: Candidate) -> int:
        return int((face_quality(candidate.mesh) < self._bad).sum())

    def _refined(self, mesh: Mesh, share: float) -> Candidate:
        bad = face_quality(mesh) < self.options.target_quality
        sizes = np.maximum(sizes_around(mesh, bad), _LEAST_EDGES * self.options.min_edge_mm)
        remesher = Remesher(
            mesh.vertices,
            mesh.faces,
            sizes=sizes,
            deviation=share * self.allowed,
            target_quality=max(_WORK_BELOW, self.options.target_quality),
            floor=max(0.35, self.options.target_quality),
            min_edge=max(self.options.min_edge_mm, 0.25 * float(sizes.min())),
            edge_floor=self.options.min_edge_mm,
            max_triangles=self.options.max_triangles or 2 * len(mesh.faces) + 1000,
            max_work=max(self._work_left, _LOCAL_WORK),
        )
        return self._result(remesher, 3, bulk=True)

    def _attempt(self, field: _Field, iterations: int, *, bulk: bool, step: str) -> None:
        """Run the remesher, and again with wider envelopes where it does not suffice; take the best result."""
        found = [self._run(self.solid.mesh, field, _FIRST_SHARE, iterations, bulk=bulk)]
        for share in _RESCUE_SHARES:
            if not found[-1].sound or _suffices(_rank(found[-1], self.options)):
                break
            found.append(self._run(found[-1].mesh, field, share, 0, bulk=False))
        if self._take_best(found, step) or not any(self._is_better(candidate) for candidate in found):
            return
        self._take_best([self._run(self.solid.mesh, field, _CAREFUL * _FIRST_SHARE, iterations, bulk=bulk)], step)

    def _take_best(self, found: list[Candidate], step: str, widening: float = 1.0) -> bool:
        for candidate in sorted(found, key=lambda one: _rank(one, self.options), reverse=True):
            if self._is_better(candidate) and self._keeps_shape(candidate, widening):
                self.best, self.step = candidate, step
                return True
        return False

    def _is_better(self, candidate: Candidate) -> bool:
        return candidate.sound and _rank(candidate, self.options) > _rank(self.best, self.options)

    def _run(self, mesh: Mesh, field: _Field, share: float, iterations: int, *, bulk: bool) -> Candidate:
        return self._result(self._remesher(mesh, field, share), iterations, bulk=bulk)

    def _result(self, remesher: Remesher, iterations: int, *, bulk: bool) -> Candidate:
        remesher.run(iterations, bulk=bulk)
        remesher.restore_volume()
        self._work_left = max(1, self._work_left - remesher.counts.work)
        return judge(Mesh(*remesher.result()), may_be_open=not self.options.cap_openings)

    def actions(self) -> list[Action]:
        """Say what was done, in one action."""
        if self.best is self.solid:
            return []
        first, last = self.solid, self.best
        message = (
            f"{self.step}: {first.measures['triangles']} -> {last.measures['triangles']} triangles, "
            f"min q {first.min_quality:.2g} -> {last.min_quality:.2g}, "
            f"mean q {first.mean_quality:.2f} -> {last.mean_quality:.2f}, "
            f"min edge {first.min_edge:.2g} -> {last.min_edge:.2g} mm"
        )
        actions: list[Action] = [
            {"step": "remesh", "message": message, "count": last.measures["triangles"], "places": []}
        ]
        apart = deviation(first.mesh, last.mesh, lost_limit_mm=self.allowed)
        if apart["max"] > self.allowed:
            farthest = max(apart["to_output"], apart["to_input"], key=lambda way: way["max"])
            message = f"slivers rounded off: there the surface moved by up to {apart['max']:.2g} mm"
            places: list[Place] = []
            if farthest["xyz_mm"] is not None:
                places = [{"xyz_mm": farthest["xyz_mm"], "face": None, "value": apart["max"]}]
            actions.append({"step": "round off", "message": message, "count": 1, "places": places})
        return actions

    def _keeps_shape(self, found: Candidate, widening: float) -> bool:
        """Measure what the guards promise: they look at a few points of each triangle only."""
        measured = deviation(self.solid.mesh, found.mesh, lost_limit_mm=self.allowed)
        return measured["max"] <= widening * self.allowed

    def _field(self, factor: float) -> _Field:
        mesh, options = self.solid.mesh, self.options
        limits = propose_limits(
            mesh,
            deviation_mm=_FIRST_SHARE * self.allowed,
            longest_mm=options.edge_length_mm,
            input_triangles=self.given_triangles,
            wall_thickness=self._walls,
        )
        budget = max(_GROWTH * min(len(mesh.faces), 2 * self.given_triangles), _FEW_TRIANGLES)
        if options.max_triangles is not None:
            budget = min(budget, 0.8 * options.max_triangles)
        sizes = sizing(
            mesh,
            deviation_mm=limits.deviation_mm,
            longest_mm=factor * limits.longest_mm,
            shortest_mm=factor * limits.shortest_mm,
            budget_triangles=int(budget / factor**2),
            wall_thickness=self._walls,
        )
        return _Field(limits, sizes.vertex, sizes.estimate)

    def _remesher(self, mesh: Mesh, field: _Field, share: float) -> Remesher:
        reference = self.solid.mesh
        sizes = field.vertex
        if mesh is not reference:
            nearest = closest(Tree(reference.vertices, reference.faces), mesh.vertices).faces
            sizes = field.vertex[reference.faces[nearest]].mean(axis=1)
        deviation = min(share * self.allowed, field.limits.deviation_mm * share / _FIRST_SHARE)
        return Remesher(
            mesh.vertices,
            mesh.faces,
            sizes=sizes,
            reference=(reference.vertices, reference.faces),
            reference_sizes=field.vertex,
            deviation=deviation,
            target_quality=max(_WORK_BELOW, self.options.target_quality),
            floor=max(0.35, self.options.target_quality),
            min_edge=max(self.options.min_edge_mm, 0.25 * field.limits.shortest_mm),
            edge_floor=self.options.min_edge_mm,
            max_triangles=self.options.max_triangles or 3 * max(field.estimate, len(mesh.faces)),
            max_work=self._work_left,
        )


# In this order: few enough triangles; edges as long as asked; no edge too short; no triangle really bad; min q and mean
# q as wanted; and how far they go beyond.
_Rank = tuple[bool, bool, bool, bool, bool, bool, float, float]


def _is_worth_it(before: Candidate, after: Candidate, options: HealOptions) -> bool:
    """Tell if a mesh meets a wish that the one before did not, or is clearly nearer to it."""
    old, new = _rank(before, options), _rank(after, options)
    if new[:-2] != old[:-2]:
        return new > old
    return new[-2] > min(2 * old[-2], old[-2] + _GAIN) or new[-1] > old[-1] + _GAIN


def _rank(candidate: Candidate, options: HealOptions) -> _Rank:
    edge = candidate.measures["edge_mm"]
    wanted = options.edge_length_mm
    return (
        options.max_triangles is None or candidate.measures["triangles"] <= options.max_triangles,
        wanted is None or (edge is not None and abs(np.log(edge["mean"] / wanted)) < _NEAR_LENGTH),
        candidate.min_edge >= options.min_edge_mm,
        candidate.min_quality >= min(_BAD, options.target_quality),
        candidate.min_quality >= options.target_quality,
        candidate.mean_quality >= MEAN_QUALITY,
        min(candidate.min_quality, _WORK_BELOW),
        candidate.mean_quality,
    )


def _suffices(rank: _Rank) -> bool:
    return all(rank[:6])
