"""Prove what holds at every moment: no two tissues meet, and what is in contact at rest gets no tighter."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from vhp_cli.inspection.proximity import near_pairs
from vhp_cli.stages.breathe.bodies import Body
from vhp_cli.stages.breathe.contact_proof import ContactProof, prove_contact
from vhp_cli.stages.breathe.gap_proof import DEPTH, PairProof, Unproven, prove_apart
from vhp_cli.stages.breathe.rest import Rest
from vhp_cli.stages.breathe.sequence import Motion

Progress = Callable[[str, int, int], None]


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
    joined
        Pairs in contact at rest whose contact is carried along unchanged.
    bounded
        Pairs in contact at rest that never have more volume in common than a frame may.
    excused
        Pairs in contact at rest of which nothing is proven.
    unproven
        What could not be proven, and contacts at rest that were found to get tighter.
    """

    pairs: int
    far: int
    intervals: int
    least_gap_mm: float | None
    joined: tuple[tuple[str, str], ...]
    bounded: tuple[tuple[str, str], ...]
    excused: tuple[tuple[str, str], ...]
    unproven: tuple[Unproven, ...]


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
    tissues within each other. Of pairs in contact at rest see `contact_proof`.

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
    names = list(rest.tissues)
    bodies = {
        name: Body.of(tissue, motions.get(name), steps, moved_at_rest=moved_at_rest)
        for name, tissue in rest.tissues.items()
    }
    reach = np.array([bodies[name].whole_travel() for name in names])
    lower = np.array([bodies[name].tree(0.0).lower for name in names]) - reach[:, None]
    upper = np.array([bodies[name].tree(0.0).upper for name in names]) + reach[:, None]
    moving = [name in motions for name in names]
    n_moving = sum(moving)
    total = len(names) * (len(names) - 1) // 2 - (len(names) - n_moving) * (len(names) - n_moving - 1) // 2
    close = [(names[i], names[j]) for i, j in near_pairs(lower, upper, 0.0) if moving[i] or moving[j]]

    def one(pair: tuple[str, str]) -> PairProof | ContactProof:
        first, second = bodies[pair[0]], bodies[pair[1]]
        if pair in rest.contacts:
            return prove_contact(first, second, pair, rest.contacts[pair].overlap_mm3, depth)
        return prove_apart(first, second, pair, depth)

    with ThreadPoolExecutor(jobs, thread_name_prefix="vhp") as executor:
        results: list[PairProof | ContactProof] = []
        for done, result in enumerate(executor.map(one, close), start=1):
            results.append(result)
            if progress:
                progress("proof", done, len(close))
    apart = [result for result in results if isinstance(result, PairProof)]
    contacts = [result for result in results if isinstance(result, ContactProof)]
    least = min((result.least_mm for result in apart if result.least_mm is not None), default=None)
    return Proof(
        pairs=total,
        far=total - len(close) + sum(result.intervals == 0 and not result.unproven for result in apart),
        intervals=sum(result.intervals for result in apart),
        least_gap_mm=least,
        joined=tuple(result.pair for result in contacts if result.verdict == "joined"),
        bounded=tuple(result.pair for result in contacts if result.verdict == "bounded"),
        excused=tuple(result.pair for result in contacts if result.verdict == "excused"),
        unproven=(
            *(item for result in apart for item in result.unproven),
            *(
                Unproven(*result.pair, t, t, 0.0, (0.0, 0.0))
                for result in contacts
                if (t := result.worse_at) is not None
            ),
        ),
    )
