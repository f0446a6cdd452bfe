"""How the tissues lie to each other at rest, and what they may not lose of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from vhp_cli.inspection.proximity import near_pairs
from vhp_cli.kernels.spatial import gap, overlap_volume, pair_hits
from vhp_cli.stages.breathe.nesting import lies_inside
from vhp_cli.stages.breathe.sequence import Motion
from vhp_cli.stages.breathe.tissue import Tissue

# A pair in contact at rest gets worse if its volume in common grows by more than this share, or by this much.
WORSE_SHARE, WORSE_MM3 = 0.01, 0.01
# Gaps are measured and reported up to this, in mm, or up to the limit if that is more.
SEARCH_MM = 5.0


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
    return min(sum(field.loss(t) for field in first.fields), 1.0)


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
                a.name, b.name, overlap_volume(a.tree, b.tree), hits.faces_a + hits.faces_b
            )
            continue
        if found is not None:
            gaps[a.name, b.name] = found.distance
        if lies_inside(a, b):
            nested.add((a.name, b.name))
        elif lies_inside(b, a):
            nested.add((b.name, a.name))
    return Rest({tissue.name: tissue for tissue in tissues}, contacts, frozenset(nested), gaps, search)


def most_in_common(before_mm3: float) -> float:
    """Return the volume in mm3 that a pair in contact at rest may have in common."""
    return max(before_mm3 * (1.0 + WORSE_SHARE), before_mm3 + WORSE_MM3)


def is_worse(before_mm3: float, overlap_mm3: float) -> bool:
    """Tell if a pair in contact at rest has more volume in common now; what is not defined counts as worse."""
    return not overlap_mm3 <= most_in_common(before_mm3)
