"""Prove that no two tissues cross: exactly on the frames as written, and at every moment between them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from vhp_cli.inspection.proximity import near_pairs
from vhp_cli.kernels.spatial import KIND_CROSSING, Tree, gap, overlap_volume, pair_hits
from vhp_cli.stages.breathe.nesting import lies_inside
from vhp_cli.stages.breathe.sequence import Motion
from vhp_cli.stages.breathe.tissue import Tissue

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]

# Intervals are halved at most so often before they count as unproven.
DEPTH = 12
# A pair in contact at rest gets worse if its volume in common grows by more than this share, or by this much.
WORSE_SHARE, WORSE_MM3 = 0.01, 0.01
# Gaps are measured and reported up to this, in mm, or up to the limit if that is more.
SEARCH_MM = 5.0
# Gaps computed from coordinates are good to far less than this, in mm.
_ROUNDING_MM = 1e-6


@dataclass(frozen=True, slots=True)
class Contact:
    """Two tissues that cross or touch in a frame, though they did not at rest, or more than they did.

    Parameters
    ----------
    a, b
        The tissues.
    x
        Sweep variable of the frame.
    faces
        Faces of both in contact; 0 where one lies within the other.
    overlap_mm3
        Volume in common; NaN where it is not defined.
    xyz_mm
        Where.
    crossing
        False if they only touch.
    worse_than_rest
        Whether they were in contact at rest, too, and are more so now.
    """

    a: str
    b: str
    x: float
    faces: int
    overlap_mm3: float
    xyz_mm: tuple[float, float, float]
    crossing: bool = True
    worse_than_rest: bool = False


@dataclass(frozen=True, slots=True)
class Narrow:
    """Two tissues whose gap is below the limit in a frame."""

    a: str
    b: str
    x: float
    gap_mm: float
    needed_mm: float
    xyz_mm: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class FrameCheck:
    """What was found in one frame.

    Parameters
    ----------
    x
        Its sweep variable.
    contacts, narrow
        What is wrong.
    min_gap_mm
        The smallest gap of any pair that is apart at rest; None if all exceed the search limit.
    min_gap_pair
        Whose.
    """

    x: float
    contacts: tuple[Contact, ...]
    narrow: tuple[Narrow, ...]
    min_gap_mm: float | None
    min_gap_pair: tuple[str, str] | None


@dataclass(frozen=True, slots=True)
class Unproven:
    """A pair that could meet between two moments, as far as the bounds tell."""

    a: str
    b: str
    start: float
    end: float
    reach_mm: float
    gaps_mm: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Proof:
    """What is proven of all moments from t = 0 to N.

    Parameters
    ----------
    pairs
        Pairs of which at least one tissue moves.
    far
        Those that are further apart than both ever travel.
    intervals
        Intervals of the other pairs that were proven free of contact.
    least_gap_mm
        A lower bound of every gap at every moment, over the pairs that are apart at rest; None: all are far apart.
    excused
        Pairs in contact at rest: nothing is proven of them.
    unproven
        What could not be proven.
    """

    pairs: int
    far: int
    intervals: int
    least_gap_mm: float | None
    excused: tuple[tuple[str, str], ...]
    unproven: tuple[Unproven, ...]


@dataclass(frozen=True, slots=True)
class RestContact:
    """Two tissues in contact at rest."""

    a: str
    b: str
    overlap_mm3: float
    faces: int


@dataclass(frozen=True, slots=True, eq=False)
class Rest:
    """How the tissues lie to each other at rest.

    Parameters
    ----------
    tissues
        By name.
    contacts
        Pairs in contact, by the two names in the order of the model.
    nested
        Pairs (inner, outer).
    gaps_mm
        Gaps up to the search limit, by the two names in the order of the model.
    search_mm
        That limit.
    """

    tissues: Mapping[str, Tissue]
    contacts: Mapping[tuple[str, str], RestContact]
    nested: frozenset[tuple[str, str]]
    gaps_mm: Mapping[tuple[str, str], float] = field(default_factory=dict)
    search_mm: float = SEARCH_MM


def shared_loss(first: Motion | None, second: Motion | None, t: float) -> float:
    """Return the share of their gap that two tissues may lose by following one field; 0 if they don't.

    A field that bends changes the distance of two points by up to its slope, however small the distance is: nested
    shells can't be bent without it.
    """
    if first is None or second is None or not first.fields or first.fields != second.fields:
        return 0.0
    slope = sum(abs(float(field.amplitude.curve(t))) * field.steepness() for field in first.fields)
    return min(slope, 1.0)


def at_rest(tissues: Sequence[Tissue], gap_mm: float) -> Rest:
    """Return contacts, small gaps and nesting at rest.

    Parameters
    ----------
    tissues
        In the order of the model.
    gap_mm
        The gap to keep.
    """
    search = max(gap_mm, SEARCH_MM)
    lower, upper = (np.array([getattr(tissue, side) for tissue in tissues]) for side in ("lower", "upper"))
    contacts: dict[tuple[str, str], RestContact] = {}
    gaps: dict[tuple[str, str], float] = {}
    nested: set[tuple[str, str]] = set()
    for i, j in near_pairs(lower, upper, search):
        a, b = tissues[i], tissues[j]
        found = gap(a.tree, b.tree, search)
        if found is not None and found.contact_kind:
            hits = pair_hits(a.tree, b.tree, limit=1)
            contacts[a.name, b.name] = RestContact(
                a.name, b.name, _overlap(a.tree, b.tree), hits.faces_a + hits.faces_b
            )
            continue
        if found is not None:
            gaps[a.name, b.name] = found.distance
        if lies_inside(a, b):
            nested.add((a.name, b.name))
        elif lies_inside(b, a):
            nested.add((b.name, a.name))
    return Rest({tissue.name: tissue for tissue in tissues}, contacts, frozenset(nested), gaps, search)


def _overlap(a: Tree, b: Tree) -> float:
    return float(overlap_volume(a, b))


# ---------------------------------------------------------------- frames


def check_frame(
    rest: Rest,
    vertices: Mapping[str, Array],
    x: float,
    gap_mm: float,
    executor: ThreadPoolExecutor | None = None,
    motions: Mapping[str, Motion] | None = None,
) -> FrameCheck:
    """Test every pair of a frame exactly.

    Parameters
    ----------
    rest
        The model at rest.
    vertices
        Coordinates of the tissues that are not at rest, as they are written.
    x
        Sweep variable of the frame.
    gap_mm
        The gap to keep, or that at rest where it is smaller.
    executor
        To share the pairs among threads.
    motions
        By which they got there: two that follow one field may lose `shared_loss` of their gap at rest.
    """
    known = motions or {}
    names = list(rest.tissues)
    trees = {name: _tree(rest.tissues[name], vertices.get(name)) for name in names}
    lower, upper = (np.array([getattr(trees[name], side) for name in names]) for side in ("lower", "upper"))
    close = {(int(i), int(j)) for i, j in near_pairs(lower, upper, rest.search_mm)}
    # What lay within another may be far outside of it now.
    place = {name: index for index, name in enumerate(names)}
    close |= {(min(place[a], place[b]), max(place[a], place[b])) for a, b in rest.nested}
    pairs = [(names[i], names[j]) for i, j in sorted(close) if names[i] in vertices or names[j] in vertices]

    def one(pair: tuple[str, str]) -> tuple[Contact | None, Narrow | None, float | None]:
        loss = shared_loss(known.get(pair[0]), known.get(pair[1]), x)
        return _check_pair(rest, trees, vertices, pair, x, gap_mm, loss)

    results = list(executor.map(one, pairs)) if executor else [one(pair) for pair in pairs]
    contacts = tuple(contact for contact, _, _ in results if contact is not None)
    narrow = tuple(item for _, item, _ in results if item is not None)
    gaps = [(distance, pair) for pair, (_, _, distance) in zip(pairs, results, strict=True) if distance is not None]
    # What does not move keeps its gaps.
    gaps += [
        (distance, pair)
        for pair, distance in rest.gaps_mm.items()
        if pair[0] not in vertices and pair[1] not in vertices
    ]
    least = min(gaps, default=None)
    return FrameCheck(x, contacts, narrow, least[0] if least else None, least[1] if least else None)


def _tree(tissue: Tissue, vertices: Array | None) -> Tree:
    return tissue.tree if vertices is None else Tree(vertices, tissue.mesh.faces)


def _check_pair(
    rest: Rest,
    trees: Mapping[str, Tree],
    vertices: Mapping[str, Array],
    pair: tuple[str, str],
    x: float,
    gap_mm: float,
    loss: float,
) -> tuple[Contact | None, Narrow | None, float | None]:
    a, b = pair
    before = rest.contacts.get(pair)
    found = gap(trees[a], trees[b], rest.search_mm)
    if found is not None and found.contact_kind:
        hits = pair_hits(trees[a], trees[b], limit=1)
        overlap = _overlap(trees[a], trees[b])
        place = _place(found.points[0])
        crossing = bool(hits.counts[KIND_CROSSING]) or not hits.complete
        if before is not None and not is_worse(before.overlap_mm3, overlap):
            return None, None, None
        return Contact(a, b, x, hits.faces_a + hits.faces_b, overlap, place, crossing, before is not None), None, None
    inside = _inside(rest, trees, vertices, a, b), _inside(rest, trees, vertices, b, a)
    expected = (a, b) in rest.nested, (b, a) in rest.nested
    if before is None and inside != expected:
        place = _place(_vertices(rest, vertices, a)[0])
        return Contact(a, b, x, 0, _overlap(trees[a], trees[b]), place), None, None
    if found is None or before is not None:
        return None, None, None
    at_start = rest.gaps_mm.get(pair)
    needed = gap_mm if at_start is None else min(gap_mm, at_start * (1.0 - loss))
    if found.distance < needed - _ROUNDING_MM - _written_rounding(trees[a], trees[b]):
        return None, Narrow(a, b, x, found.distance, needed, _place(found.points[0])), found.distance
    return None, None, found.distance


def is_worse(before_mm3: float, overlap_mm3: float) -> bool:
    """Tell if a pair in contact at rest has more volume in common now; what is not defined counts as worse."""
    if np.isnan(overlap_mm3) or np.isnan(before_mm3):
        return True
    return overlap_mm3 > max(before_mm3 * (1.0 + WORSE_SHARE), before_mm3 + WORSE_MM3)


def _inside(rest: Rest, trees: Mapping[str, Tree], vertices: Mapping[str, Array], inner: str, outer: str) -> bool:
    """Tell if a part of one tissue lies within the other, which it does not touch."""
    tissue, around = rest.tissues[inner], trees[outer]
    if not rest.tissues[outer].closed:
        return False
    points = _vertices(rest, vertices, inner)[tissue.representatives]
    possible = ((points >= around.lower) & (points <= around.upper)).all(axis=1)
    return bool(possible.any()) and bool((around.inside(points[possible]) == 1).any())


def _vertices(rest: Rest, vertices: Mapping[str, Array], name: str) -> Array:
    found = vertices.get(name)
    return rest.tissues[name].mesh.vertices if found is None else found


def _written_rounding(a: Tree, b: Tree) -> float:
    """Return how far rounding to float32 may bring two surfaces together, in mm."""
    size = max(float(np.abs(corner).max()) for corner in (a.lower, a.upper, b.lower, b.upper))
    return 4.0 * size * float(np.finfo(np.float32).eps)


def _place(point: Array) -> tuple[float, float, float]:
    return (float(point[0]), float(point[1]), float(point[2]))


# ---------------------------------------------------------------- between the frames


def prove(
    rest: Rest,
    motions: Mapping[str, Motion],
    steps: int,
    *,
    depth: int = DEPTH,
    jobs: int = 1,
    progress: Progress | None = None,
    moved_at_rest: bool = False,
) -> Proof:
    """Prove that no two tissues come into contact at any moment from t = 0 to N.

    On [t1, t2] two surfaces can't meet if the sum of their gaps at t1 and t2 exceeds the lengths of path of their
    points together: to meet at a moment between, they would have to cover the first gap, and then the second. Where
    that does not hold, the interval is halved. As surfaces that never meet keep inside and outside, this covers
    tissues within each other.

    Parameters
    ----------
    rest
        The model at rest.
    motions
        By name; tissues without one stay.
    steps
        N.
    depth
        How often an interval of one step is halved at most.
    jobs
        Threads.
    moved_at_rest
        Whether the motions may not be the identity at t = 0, as in a sequence with errors.
    """
    prover = _Prover(rest, motions, steps, depth, moved_at_rest)
    names = list(rest.tissues)
    reach = np.array([prover.travel_in_all(name) for name in names])
    lower = np.array([prover.tree(name, 0.0).lower for name in names]) - reach[:, None]
    upper = np.array([prover.tree(name, 0.0).upper for name in names]) + reach[:, None]
    moving = [name in motions for name in names]
    n_moving = sum(moving)
    total = len(names) * (len(names) - 1) // 2 - (len(names) - n_moving) * (len(names) - n_moving - 1) // 2
    close = [(names[i], names[j]) for i, j in near_pairs(lower, upper, 0.0) if moving[i] or moving[j]]
    excused = tuple(pair for pair in close if pair in rest.contacts)
    todo = [pair for pair in close if pair not in rest.contacts]
    with ThreadPoolExecutor(jobs, thread_name_prefix="vhp") as executor:
        results = []
        for done, result in enumerate(executor.map(prover.pair, todo), start=1):
            results.append(result)
            if progress:
                progress("proof", done, len(todo))
    least = min((result.least_mm for result in results if result.least_mm is not None), default=None)
    return Proof(
        pairs=total,
        far=total - len(close) + sum(result.intervals == 0 and not result.unproven for result in results),
        intervals=sum(result.intervals for result in results),
        least_gap_mm=least,
        excused=excused,
        unproven=tuple(item for result in results for item in result.unproven),
    )


@dataclass(frozen=True, slots=True)
class _PairProof:
    intervals: int
    least_mm: float | None
    unproven: tuple[Unproven, ...]


class _Prover:
    def __init__(self, rest: Rest, motions: Mapping[str, Motion], steps: int, depth: int, moved_at_rest: bool) -> None:
        self.rest, self.motions, self.steps, self.depth = rest, motions, steps, depth
        self.moved_at_rest = moved_at_rest
        self._points: dict[str, Array] = {}
        self._trees: dict[tuple[str, float], Tree] = {}
        self._travels: dict[tuple[str, float, float], float] = {}
        self._grid = np.arange(steps + 1, dtype=np.float64)
        for name, motion in motions.items():
            bounds = motion.travel_bounds(self._hull(name), self._grid)
            for t, bound in enumerate(bounds.tolist()):
                self._travels[name, float(t), float(t + 1)] = bound

    def _hull(self, name: str) -> Array:
        """Return points whose convex hull holds the tissue; with a field, its vertices, between which it is linear."""
        points = self._points.get(name)
        if points is None:
            tissue, motion = self.rest.tissues[name], self.motions[name]
            if motion.fields:
                points = tissue.mesh.vertices
            else:
                sides = np.stack([tissue.lower, tissue.upper])
                points = np.array(
                    [[sides[i, 0], sides[j, 1], sides[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)]
                )
            self._points[name] = points
        return points

    def travel(self, name: str, start: float, end: float) -> float:
        if name not in self.motions:
            return 0.0
        key = (name, start, end)
        found = self._travels.get(key)
        if found is None:
            found = self.motions[name].travel_bound(self._hull(name), start, end)
            self._travels[key] = found
        return found

    def travel_in_all(self, name: str) -> float:
        return sum(self.travel(name, t, t + 1.0) for t in self._grid[:-1].tolist())

    def tree(self, name: str, t: float) -> Tree:
        tissue, motion = self.rest.tissues[name], self.motions.get(name)
        if motion is None or (t == 0.0 and not self.moved_at_rest):
            return tissue.tree
        key = (name, t)
        found = self._trees.get(key)
        if found is None:
            found = Tree(motion.apply(tissue.mesh.vertices, t), tissue.mesh.faces)
            if t == int(t):
                # Every pair needs these; those between are few.
                self._trees[key] = found
        return found

    def pair(self, pair: tuple[str, str]) -> _PairProof:
        a, b = pair
        whole = self.travel_in_all(a) + self.travel_in_all(b)
        at_start = self._gap(a, b, 0.0, whole)
        if at_start > whole:
            return _PairProof(0, None, ())
        times = self._grid.tolist()
        reaches = [self.travel(a, t, t + 1.0) + self.travel(b, t, t + 1.0) for t in times[:-1]]
        gaps = []
        for index, t in enumerate(times):
            # A gap of this or more proves the intervals on both sides whatever the next one is.
            enough = max(reaches[max(index - 1, 0)], reaches[min(index, len(reaches) - 1)])
            gaps.append(self._gap(a, b, t, enough + _ROUNDING_MM))
        proven, least, unproven = 0, np.inf, []
        for index in range(len(reaches)):
            count, bound, missing = self._interval(
                a, b, times[index], times[index + 1], gaps[index], gaps[index + 1], reaches[index], 0
            )
            proven, least = proven + count, min(least, bound)
            unproven += missing
        return _PairProof(proven, float(least), tuple(unproven))

    def _gap(self, a: str, b: str, t: float, limit: float) -> float:
        """Return the gap, or somewhat more than the limit where it is larger; 0 on contact."""
        found = gap(self.tree(a, t), self.tree(b, t), limit)
        return float(np.nextafter(limit, np.inf)) if found is None else found.distance

    def _interval(
        self, a: str, b: str, start: float, end: float, first: float, last: float, reach: float, level: int
    ) -> tuple[int, float, list[Unproven]]:
        slack = 0.5 * (first + last - reach) - _ROUNDING_MM
        if slack > 0.0:
            return 1, min(slack, first, last), []
        if level >= self.depth or min(first, last) <= 0.0:
            return 0, 0.0, [Unproven(a, b, start, end, reach, (first, last))]
        middle = 0.5 * (start + end)
        halves = [self.travel(a, s, e) + self.travel(b, s, e) for s, e in ((start, middle), (middle, end))]
        between = self._gap(a, b, middle, max(halves) + _ROUNDING_MM)
        left = self._interval(a, b, start, middle, first, between, halves[0], level + 1)
        right = self._interval(a, b, middle, end, between, last, halves[1], level + 1)
        return left[0] + right[0], min(left[1], right[1]), left[2] + right[2]
