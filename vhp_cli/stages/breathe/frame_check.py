"""Test a frame as it is written: every pair of tissues, exactly."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vhp_cli.inspection.proximity import near_pairs
from vhp_cli.kernels.spatial import KIND_CROSSING, Tree, gap, overlap_volume, pair_hits
from vhp_cli.stages.breathe.rest import Rest, is_worse, shared_loss
from vhp_cli.stages.breathe.sequence import Motion
from vhp_cli.stages.breathe.tissue import Tissue

Array = NDArray[np.float64]

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
        overlap = overlap_volume(trees[a], trees[b])
        place = _place(found.points[0])
        crossing = bool(hits.counts[KIND_CROSSING]) or not hits.complete
        if before is not None and not is_worse(before.overlap_mm3, overlap):
            return None, None, None
        return Contact(a, b, x, hits.faces_a + hits.faces_b, overlap, place, crossing, before is not None), None, None
    inside = _inside(rest, trees, vertices, a, b), _inside(rest, trees, vertices, b, a)
    expected = (a, b) in rest.nested, (b, a) in rest.nested
    # What touched at rest may have gone through to the inside.
    wrong = any(inside) if before is not None else inside != expected
    if wrong:
        overlap = overlap_volume(trees[a], trees[b])
        if before is None or is_worse(before.overlap_mm3, overlap):
            return (
                Contact(a, b, x, 0, overlap, _place(_vertices(rest, vertices, a)[0]), True, before is not None),
                None,
                None,
            )
    if found is None or before is not None:
        return None, None, None
    at_start = rest.gaps_mm.get(pair)
    needed = gap_mm if at_start is None else min(gap_mm, at_start * (1.0 - loss))
    if found.distance < needed - _ROUNDING_MM - _written_rounding(trees[a], trees[b]):
        return None, Narrow(a, b, x, found.distance, needed, _place(found.points[0])), found.distance
    return None, None, found.distance


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
