"""What a breath breaks: limits and facts in, rejected frames and findings out."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

from vhp_cli.config import Settings
from vhp_cli.gate import findings_of
from vhp_cli.inspection.places import MAX_PLACES, point
from vhp_cli.measures import BreathFrame, Finding, Place
from vhp_cli.pipeline.breathing_frames import State
from vhp_cli.pipeline.breathing_model import BreathingModel
from vhp_cli.stages.breathe.fitting.fit import Fit
from vhp_cli.stages.breathe.frame_check import Contact, Narrow
from vhp_cli.stages.breathe.mass import Density, MassModel
from vhp_cli.stages.breathe.options import BreatheOptions
from vhp_cli.stages.breathe.proof import Proof
from vhp_cli.stages.breathe.rest import Rest
from vhp_cli.stages.breathe.sequence import Motion
from vhp_cli.stages.breathe.sequence import Sequence as Breath

LITRE = 1e6  # mm3
Item = TypeVar("Item", Contact, Narrow)

VOLUME_TOLERANCE_L = 1e-3
TRAVEL_TOLERANCE_MM = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class BreathFacts:
    """Everything that the report is made of.

    Parameters
    ----------
    model, sequence, motions, fitted, rest, proof, mass, densities, options
        The model, what was played (fitted, if `fitted` is not None), and what was found.
    frames
        Records of the frames, in order.
    states
        The model at each value of the sweep variable that a frame has, and at 0 and N.
    held
        Whether there is a shell, so that the mass can be held.
    """

    model: BreathingModel
    sequence: Breath
    motions: Mapping[str, Motion]
    fitted: Fit | None
    rest: Rest
    proof: Proof
    mass: MassModel
    densities: Mapping[str, Density]
    options: BreatheOptions
    frames: Sequence[BreathFrame]
    states: Mapping[float, State]
    held: bool


def reasons_to_reject(
    state: State, start: State, options: BreatheOptions, *, held: bool, identity_at_rest: bool
) -> list[str]:
    """Return the codes of the rules that a frame breaks."""
    reasons = []
    if state.tangled or any(not contact.worse_than_rest for contact in state.check.contacts):
        reasons.append("B001")
    if state.check.narrow:
        reasons.append("B002")
    if held and abs(mass_change(state, start)) > options.mass_tolerance:
        reasons.append("B006")
    if state.bent:
        reasons.append("B007")
    if any(contact.worse_than_rest for contact in state.check.contacts):
        reasons.append("B008")
    if state.x == 0.0 and not identity_at_rest and state.moved:
        reasons.append("B009")
    if state.joined:
        reasons.append("B010")
    return reasons


def lung_volume_l(state: State, lungs: Iterable[str]) -> float:
    """Return the volume of the lungs in litres."""
    return sum(state.volumes_mm3.get(name, 0.0) for name in lungs) / LITRE


def mass_change(state: State, start: State) -> float:
    """Return by what share the mass has changed."""
    return state.mass_kg / start.mass_kg - 1.0 if start.mass_kg else 0.0


# A broken rule: code, tissues, count, message, places.
_Broken = tuple[str, list[str], int, str, list[Place]]


def breathing_findings(facts: BreathFacts, settings: Settings) -> list[Finding]:
    """Return every rule that the breath breaks, at the level that the settings give it."""
    return [
        finding
        for code, names, count, message, places in _broken(facts)
        for finding in findings_of(settings, names, [(code, count, message, places)])
    ]


def _broken(facts: BreathFacts) -> list[_Broken]:
    broken: list[_Broken] = []
    states = [facts.states[x] for x in sorted(facts.states)]
    broken += _contacts([c for state in states for c in state.check.contacts], facts)
    for name in sorted({name for state in states for name in state.tangled}):
        counts = [(state.tangled[name], -state.x) for state in states if name in state.tangled]
        most, x = max(counts)
        broken.append(("B001", [name], len(counts), f"it crosses itself in {most} pairs of faces at x = {-x:g}", []))
    broken += _narrows([n for state in states for n in state.check.narrow])
    broken += _unproven(facts.proof, facts.rest)
    broken += _targets(facts)
    start = facts.states[0.0]
    worst = max(states, key=lambda state: abs(mass_change(state, start)))
    change = mass_change(worst, start)
    if facts.held and abs(change) > facts.options.mass_tolerance:
        count = sum(abs(mass_change(state, start)) > facts.options.mass_tolerance for state in states)
        text = f"the mass changes by {change:+.3%} at x = {worst.x:g}, limit {facts.options.mass_tolerance:.3%}"
        broken.append(("B006", [], count, text, []))
    bent: dict[str, tuple[float, float, int]] = {}
    for state in states:
        for name, excess in state.bent.items():
            before = bent.get(name, (0.0, 0.0, 0))
            bent[name] = (max(before[0], excess), state.x if excess > before[0] else before[1], before[2] + 1)
    for name, (excess, x, count) in bent.items():
        broken.append(("B007", [name], count, f"an edge changes by {excess:.2g} mm too much at x = {x:g}", []))
    if start.moved and not facts.sequence.identity_at_rest:
        text = f"the sequence moves {len(start.moved)} tissues at t = 0: {', '.join(start.moved[:5])}"
        broken.append(("B009", [], len(start.moved), text, []))
    for name in sorted({name for state in states for name in state.joined}):
        count = sum(name in state.joined for state in states)
        broken.append(("B010", [name], count, "vertices fall together when rounded to the file's digits", []))
    for contact in facts.rest.contacts.values():
        size = "" if math.isnan(contact.overlap_mm3) else f", {contact.overlap_mm3:.3g} mm3 in common"
        broken.append(
            ("B011", [contact.a, contact.b], contact.faces, f"{contact.faces} faces in contact at rest{size}", [])
        )
    for name, density in facts.densities.items():
        if not density.certain:
            text = f"no density known: {density.kg_per_m3:g} kg/m3 taken ({density.source})"
            broken.append(("B012", [name], 1, text, []))
    return broken


def _contacts(contacts: Sequence[Contact], facts: BreathFacts) -> list[_Broken]:
    broken: list[_Broken] = []
    for pair, items in _by_pair(contacts).items():
        worst = max(items, key=lambda item: (item.faces, -item.x))
        before = facts.rest.contacts.get(pair)
        overlap = "" if math.isnan(worst.overlap_mm3) else f", {worst.overlap_mm3:.3g} mm3 in common"
        at = f"at x = {worst.x:g}"
        if before is not None:
            text = (
                f"{at}: {worst.faces} faces in contact{overlap}; at rest {before.faces}, {before.overlap_mm3:.3g} mm3"
            )
            broken.append(("B008", list(pair), len(items), text, _places(items)))
        elif worst.faces:
            verb = "cross" if worst.crossing else "touch"
            broken.append(
                ("B001", list(pair), len(items), f"they {verb} {at}: {worst.faces} faces{overlap}", _places(items))
            )
        else:
            broken.append(("B001", list(pair), len(items), f"one lies within the other {at}{overlap}", _places(items)))
    return broken


def _narrows(narrows: Sequence[Narrow]) -> list[_Broken]:
    broken: list[_Broken] = []
    for pair, items in _by_pair(narrows).items():
        worst = min(items, key=lambda item: item.gap_mm)
        text = f"gap {worst.gap_mm:.3f} mm at x = {worst.x:g}, needed {worst.needed_mm:.3f} mm"
        broken.append(("B002", list(pair), len(items), text, _places(items)))
    return broken


def _unproven(proof: Proof, rest: Rest) -> list[_Broken]:
    broken: list[_Broken] = []
    by_pair: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for item in proof.unproven:
        by_pair.setdefault((item.a, item.b), []).append((item.start, item.end))
    for pair, spans in by_pair.items():
        first, last = min(start for start, _ in spans), max(end for _, end in spans)
        text = f"no proof that they stay apart between x = {first:.4g} and {last:.4g}"
        if pair in rest.contacts:
            text = f"their contact gets tighter: more than a frame may have in common at x = {first:.4g}"
        broken.append(("B003", list(pair), len(spans), text, []))
    return broken


def _targets(facts: BreathFacts) -> list[_Broken]:
    targets = facts.sequence.targets
    lungs = [name for name, role in facts.model.roles.items() if role.part == "lung"]
    start, full = facts.states[0.0], facts.states[float(facts.sequence.steps)]
    change = lung_volume_l(full, lungs) - lung_volume_l(start, lungs)
    travel = start.lowest_mm - full.lowest_mm
    broken: list[_Broken] = []
    if abs(change - targets.lung_volume_change_l) > VOLUME_TOLERANCE_L:
        text = f"the lungs gain {change:.4f} l, asked for {targets.lung_volume_change_l:g} l"
        broken.append(("B004", [], 1, text, []))
    if abs(travel - targets.diaphragm_travel_mm) > TRAVEL_TOLERANCE_MM:
        text = f"the lungs' lowest point travels {travel:.2f} mm, asked for {targets.diaphragm_travel_mm:g} mm"
        broken.append(("B005", [], 1, text, []))
    return broken


def _by_pair(items: Iterable[Item]) -> dict[tuple[str, str], list[Item]]:
    found: dict[tuple[str, str], list[Item]] = {}
    for item in items:
        found.setdefault((item.a, item.b), []).append(item)
    return found


def _places(items: Sequence[Contact] | Sequence[Narrow]) -> list[Place]:
    return [{"xyz_mm": point(item.xyz_mm), "face": None, "value": item.x} for item in items[:MAX_PLACES]]
