"""The model while its motions are being found: where every tissue is at a time, and how near others are."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vhp_cli.inspection.proximity import near_pairs
from vhp_cli.kernels.spatial import Tree, gap, overlap_volume, pair_hits
from vhp_cli.stages.breathe.rest import is_worse, shared_loss
from vhp_cli.stages.breathe.sequence import Motion
from vhp_cli.stages.breathe.tissue import Tissue

Array = NDArray[np.float64]

# A contact is worse than any lack of gap by at least this, in mm; more faces in contact are worse.
_CONTACT_MM = 5.0
_MM_PER_FACE = 0.01
# Gaps are no better known than this, in mm.
_ROUNDING_MM = 1e-9


@dataclass(frozen=True, slots=True)
class Shortfall:
    """Where a gap is too small, or two tissues cross.

    Parameters
    ----------
    tissue, other
        The two tissues.
    t
        When.
    missing_mm
        How much is missing; of a contact more than any gap could miss.
    xyz_mm
        Where, on the second tissue.
    crossing
        Whether they are in contact.
    """

    tissue: str
    other: str
    t: float
    missing_mm: float
    xyz_mm: tuple[float, float, float]
    crossing: bool


class Scene:
    """Tissues, the motions found so far, and the gaps that must be kept.

    Parameters
    ----------
    tissues
        The model at rest.
    gap_mm
        The gap to keep, or that at rest where it is smaller.
    steps
        N.

    Attributes
    ----------
    motions
        By tissue; tissues without one stay.
    times
        Values of the sweep variable at which the fit looks; between them tissues move almost straight.
    in_contact
        Pairs in contact at rest, which have no gap to keep; what they have in common must not grow.
    """

    def __init__(self, tissues: Sequence[Tissue], gap_mm: float, steps: int) -> None:
        self.tissues = {tissue.name: tissue for tissue in tissues}
        self.gap_mm = gap_mm
        self.steps = steps
        self.times = (float(steps), 0.5 * steps)
        self.motions: dict[str, Motion] = {}
        self._trees: dict[tuple[str, float], tuple[Motion, Tree]] = {}
        self._needed: dict[frozenset[str], float] = {}
        self.in_contact: set[frozenset[str]] = set()
        self._common: dict[frozenset[str], float] = {}
        self._rest_gaps: dict[tuple[frozenset[str], float], float] = {}
        order = list(tissues)
        lower, upper = (np.array([corner(t) for t in order]) for corner in (_lower, _upper))
        for i, j in near_pairs(lower, upper, gap_mm):
            found = gap(order[i].tree, order[j].tree, gap_mm)
            pair = frozenset((order[i].name, order[j].name))
            if found is not None and found.contact_kind:
                self.in_contact.add(pair)
            elif found is not None:
                self._needed[pair] = found.distance

    def needed(self, a: str, b: str) -> float:
        """Return the gap that a pair must keep, in mm."""
        return self._needed.get(frozenset((a, b)), self.gap_mm)

    def room(self, a: str, b: str, most_mm: float) -> float:
        """Return the gap of a pair at rest, or `most_mm` where it is larger; 0 in contact."""
        key = (frozenset((a, b)), most_mm)
        if key not in self._rest_gaps:
            found = gap(self.tissues[a].tree, self.tissues[b].tree, most_mm)
            self._rest_gaps[key] = most_mm if found is None else found.distance
        return self._rest_gaps[key]

    def common(self, a: str, b: str) -> float:
        """Return the volume that a pair has in common at rest, in mm3; NaN where it can't be told."""
        pair = frozenset((a, b))
        if pair not in self._common:
            self._common[pair] = float(overlap_volume(self.tissues[a].tree, self.tissues[b].tree))
        return self._common[pair]

    def touching(self, name: str) -> bool:
        """Tell if a tissue is in contact with any other at rest."""
        return any(name in pair for pair in self.in_contact)

    def set(self, name: str, motion: Motion | None) -> None:
        """Give a tissue its motion; None: it stays."""
        if motion is None or not (motion.operations or motion.fields):
            self.motions.pop(name, None)
        else:
            self.motions[name] = motion

    def tree(self, name: str, t: float) -> Tree:
        """Return the search tree of a tissue at a time."""
        motion = self.motions.get(name)
        if motion is None or t == 0.0:
            return self.tissues[name].tree
        kept = self._trees.get((name, t))
        if kept is None or kept[0] is not motion:
            kept = (motion, self.moved(name, motion, t))
            self._trees[name, t] = kept
        return kept[1]

    def moved(self, name: str, motion: Motion | None, t: float) -> Tree:
        """Return the search tree that a tissue would have with another motion."""
        tissue = self.tissues[name]
        if motion is None or t == 0.0 or not (motion.operations or motion.fields):
            return tissue.tree
        return Tree(motion.apply(tissue.mesh.vertices, t), tissue.mesh.faces)

    def shortfalls(
        self,
        name: str,
        motion: Motion | None,
        others: Iterable[str],
        times: Sequence[float],
        *,
        all_of: bool = False,
        contacts: bool = False,
    ) -> list[Shortfall]:
        """Return where a tissue with this motion would come too near to others: the worst, or all of them.

        Parameters
        ----------
        name, motion
            The tissue, and how it would move.
        others
            What must be cleared.
        times
            When.
        all_of
            All shortfalls instead of the worst one.
        contacts
            Whether what is in contact at rest counts, if it would have more volume in common.
        """
        found: list[Shortfall] = []
        others = list(others)
        for t in times:
            tree = self.moved(name, motion, t)
            for other in others:
                if other == name:
                    continue
                if frozenset((name, other)) in self.in_contact:
                    shortfall = self._grown(name, motion, tree, other, t) if contacts else None
                else:
                    loss = shared_loss(motion, self.motions.get(other), t)
                    shortfall = self._one(name, tree, other, t, loss)
                if shortfall is not None:
                    found.append(shortfall)
        found.sort(key=lambda item: -item.missing_mm)
        return found if all_of else found[:1]

    def badness(
        self,
        name: str,
        motion: Motion | None,
        others: Iterable[str],
        times: Sequence[float],
        *,
        contacts: bool = False,
    ) -> float:
        """Return how much gap is missing in all, in mm; 0: the motion is fine."""
        found = self.shortfalls(name, motion, others, times, all_of=True, contacts=contacts)
        return sum(item.missing_mm for item in found)

    def _grown(self, name: str, motion: Motion | None, tree: Tree, other: str, t: float) -> Shortfall | None:
        """Return a shortfall if a pair in contact at rest has more volume in common."""
        theirs = self.motions.get(other)
        together = motion is not None and theirs is not None and motion.operations == theirs.operations
        if (motion is None and theirs is None) or (together and not (motion and motion.fields)):
            return None
        found = gap(tree, self.tree(other, t), 0.0)
        if found is None:
            return None
        now = float(overlap_volume(tree, self.tree(other, t)))
        before = self.common(name, other)
        if not is_worse(before, now):
            return None
        place = (float(found.points[1][0]), float(found.points[1][1]), float(found.points[1][2]))
        more = 1.0 if np.isnan(now - before) else (now - before) ** (1.0 / 3.0)
        return Shortfall(name, other, t, more, place, True)

    def _one(self, name: str, tree: Tree, other: str, t: float, loss: float) -> Shortfall | None:
        needed, against = self.needed(name, other), self.tree(other, t)
        if loss:
            needed = min(self.gap_mm, self.room(name, other, 2.0 * self.gap_mm) * (1.0 - loss))
        if (tree.lower - needed > against.upper).any() or (against.lower - needed > tree.upper).any():
            return None
        found = gap(tree, against, needed)
        if found is None:
            return None
        place = (float(found.points[1][0]), float(found.points[1][1]), float(found.points[1][2]))
        if found.contact_kind:
            hits = pair_hits(tree, against, limit=1)
            size = needed + _CONTACT_MM + _MM_PER_FACE * (hits.faces_a + hits.faces_b)
            return Shortfall(name, other, t, size, place, True)
        missing = needed - found.distance
        return Shortfall(name, other, t, missing, place, False) if missing > _ROUNDING_MM else None


def _lower(tissue: Tissue) -> Array:
    return tissue.lower


def _upper(tissue: Tissue) -> Array:
    return tissue.upper


def near(scene: Scene, name: str, names: Iterable[str], within_mm: float) -> list[str]:
    """Return those of `names` whose boxes at rest come within a distance of a tissue's."""
    own = scene.tissues[name]
    found = []
    for other in names:
        box = scene.tissues[other]
        apart = (own.lower - within_mm > box.upper).any() or (box.lower - within_mm > own.upper).any()
        if other != name and not apart:
            found.append(other)
    return found


def by_part(tissues: Mapping[str, Tissue]) -> dict[str, list[str]]:
    """Return the names of the tissues of each part."""
    parts: dict[str, list[str]] = {}
    for name, tissue in tissues.items():
        parts.setdefault(tissue.role.part, []).append(name)
    return parts
