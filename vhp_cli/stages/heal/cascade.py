"""Heal one tissue: the least invasive repair that gives a sound solid, then well shaped triangles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from vhp_cli.inspection.deviation import LostPart, deviation, lost_parts
from vhp_cli.measures import Action
from vhp_cli.mesh import Mesh
from vhp_cli.processes import CallFailed
from vhp_cli.stages.heal.candidate import Candidate, diagonal, face_areas, judge
from vhp_cli.stages.heal.clean import clean
from vhp_cli.stages.heal.crossings import cut_and_fill, untangle
from vhp_cli.stages.heal.holes import fill_holes
from vhp_cli.stages.heal.junctions import join_cracks
from vhp_cli.stages.heal.manifold import make_manifold
from vhp_cli.stages.heal.openings import defects, drop_shards, parts
from vhp_cli.stages.heal.options import HealOptions
from vhp_cli.stages.heal.orientation import orient
from vhp_cli.stages.heal.quality import improve, is_good, shortfall
from vhp_cli.stages.heal.rebuild import envelope, refill, wrap
from vhp_cli.stages.heal.separation import separate
from vhp_cli.stages.heal.thicken import thicken
from vhp_cli.stages.heal.union import unite
from vhp_cli.stages.heal.walls import join_walls
from vhp_cli.stages.outcome import Outcome

Actions = list[Action]
Step = Callable[[Mesh], tuple[Mesh, Actions]]

# Separating, rounding and welding can bring new flaws, which the next round treats.
_MOST_ROUNDS = 3
# Share of the diagonal by which a cut and its filling may differ if nothing gentler gives a sound solid.
DEEP_CUT = 0.05
# A repair that leaves more than this share of the input's surface outside is none.
MOST_LOST = 0.1


class Refused(Exception):
    """The surface is no solid, or no repair made it one."""


@dataclass(frozen=True, slots=True, eq=False)
class _Repaired:
    """A sound mesh, how it came about, and what of the input's surface it left outside."""

    candidate: Candidate
    actions: Actions
    lost: list[LostPart]

    @property
    def lost_mm2(self) -> float:
        """Area of the input's surface that lies outside, farther away than allowed."""
        return sum(part.area_mm2 * part.share_outside for part in self.lost)


def heal(mesh: Mesh, options: HealOptions) -> Outcome:
    """Make one tissue a sound solid of well shaped triangles.

    Parameters
    ----------
    mesh
        The surface as read from its file, in mm.
    options
        Limits and wishes.

    Returns
    -------
    Outcome
        ``changed`` with the healed mesh, whose coordinates are float32 values; ``unchanged`` if there was nothing
        to do; ``refused``, with the reason, if the surface is no solid, no repair made it one, or its triangles can't
        be made better.
    """
    healed, actions = judge(mesh, may_be_open=not options.cap_openings), Actions()
    is_whole = healed.sound and (options.cap_openings or not defects(healed.mesh))
    if is_whole and (options.only_topology or is_good(healed, options)):
        return Outcome(None, "unchanged")
    if not is_whole:
        try:
            repaired = _repair(mesh, options)
        except Refused as refused:
            return Outcome(None, "refused", str(refused))
        healed, actions = repaired.candidate, repaired.actions
    if not options.only_topology:
        healed, done = improve(healed, mesh, options)
        actions = actions + done
    reason = "" if options.only_topology else shortfall(healed, mesh, options)
    if not actions:
        return Outcome(None, "refused" if reason else "unchanged", reason)
    apart = deviation(mesh, healed.mesh, lost_limit_mm=lost_limit(mesh))
    return Outcome(healed.mesh, "changed", reason, actions, apart)


def lost_limit(mesh: Mesh) -> float:
    """Return the distance in mm beyond which material counts as lost: 0.2 mm, or 0.2 % of the diagonal if more."""
    return max(0.2, 2e-3 * diagonal(mesh))


def _repair(mesh: Mesh, options: HealOptions) -> _Repaired:
    """Return the first sound result that lost nothing, else the one that lost least.

    Raises
    ------
    Refused
        If there is none.
    """
    timeout, memory = options.engine_timeout_s, options.engine_memory_gb
    search = _Search(mesh, options)
    closed = search.add("topology", *_closed(mesh, options))
    untangled = search.run("untangling", untangle, closed)
    search.run("cutting and filling", cut_and_fill, untangled)
    if not options.cap_openings:
        # The rest needs a closed surface, or makes one.
        return search.result()
    united = search.run("union", partial(unite, timeout_s=timeout, memory_gb=memory), untangled)
    search.run("cutting after the union", cut_and_fill, united)
    search.run("union of either sign", partial(unite, either_sign=True, timeout_s=timeout, memory_gb=memory), untangled)
    if search.best is None:
        search.run("deep cutting", partial(cut_and_fill, reach_mm=DEEP_CUT * diagonal(mesh)), untangled)
    for name, rebuild in (("refilling", refill), ("wrapping", wrap), ("envelope", envelope)):
        # They replace the whole surface, and may close a lumen: not to win back a part that was lost.
        if search.best is None:
            search.run(name, partial(rebuild, timeout_s=timeout, memory_gb=memory), closed)
    return search.result()


@dataclass(frozen=True, slots=True, eq=False)
class _Made:
    """What some steps made of the input, all that they did, and whether it is sound."""

    mesh: Mesh
    actions: Actions
    sound: bool


class _Search:
    """Repairs tried one after the other; those after one that lost nothing are skipped."""

    def __init__(self, given: Mesh, options: HealOptions) -> None:
        self.given = given
        self.options = options
        self.best: _Repaired | None = None
        self.failures: list[str] = []
        self._limit = lost_limit(given)

    def run(self, name: str, step: Step, on: _Made | None) -> _Made | None:
        """Run a step on what others made, unless that is sound already."""
        if on is None or on.sound or (self.best is not None and not self.best.lost_mm2):
            return None
        try:
            mesh, actions = step(on.mesh)
        except CallFailed as failed:
            self.failures.append(f"{name}: {failed.detail}")
            return None
        return self.add(name, mesh, on.actions + actions) if mesh is not on.mesh else on

    def add(self, name: str, mesh: Mesh, actions: Actions) -> _Made:
        """Judge a result."""
        candidate = judge(mesh, may_be_open=not self.options.cap_openings)
        if candidate.sound:
            lost = lost_parts(self.given, candidate.mesh, limit_mm=self._limit)
            found = _Repaired(candidate, actions, lost)
            share = found.lost_mm2 / max(float(face_areas(self.given).sum()), 1e-300)
            if share > MOST_LOST:
                self.failures.append(f"{name}: {100 * share:.0f} % of the surface lost")
            elif self.best is None or found.lost_mm2 < self.best.lost_mm2:
                self.best = found
        else:
            self.failures.append(f"{name}: {', '.join(candidate.flaws)}")
        return _Made(candidate.mesh, actions, candidate.sound)

    def result(self) -> _Repaired:
        """Return the best result.

        Raises
        ------
        Refused
            If there is none.
        """
        if self.best is None:
            raise Refused("no repair gave a sound solid; " + "; ".join(self.failures))
        return self.best


def _closed(mesh: Mesh, options: HealOptions) -> tuple[Mesh, Actions]:
    """Make a mesh closed, manifold and oriented as far as that goes without moving its surface.

    Raises
    ------
    Refused
        If it is no solid.
    """
    actions = Actions()
    for _ in range(_MOST_ROUNDS):
        for step in _closing_steps(options):
            mesh, done = step(mesh)
            actions += done
        candidate = judge(mesh, may_be_open=not options.cap_openings)
        mesh = candidate.mesh
        if all("intersecting" in flaw for flaw in candidate.flaws):
            break
    return mesh, actions


def _closing_steps(options: HealOptions) -> list[Step]:
    start: list[Step] = [partial(clean, min_component=options.min_component_mm), join_cracks, make_manifold, orient]
    if options.cap_openings:
        fill: list[Step] = [join_walls, partial(_solid_parts, options=options), lambda mesh: fill_holes(mesh)[:2]]
    else:
        fill = [lambda mesh: fill_holes(mesh, defects(mesh))[:2]]
    return [*start, *fill, make_manifold, orient, separate]


def _solid_parts(mesh: Mesh, options: HealOptions) -> tuple[Mesh, Actions]:
    """Take out shards; make a sheet a solid if that is asked for, else refuse it."""
    left, actions, refusal = drop_shards(mesh)
    if not refusal:
        return left, actions
    if options.thicken_mm is None:
        raise Refused(f"{refusal}; --thicken would make it a plate")
    sheets = [part.faces for part in parts(mesh) if part.flaw]
    return thicken(mesh, np.logical_or.reduce(sheets), options.thicken_mm)
