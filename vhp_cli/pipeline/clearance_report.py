"""What a report says of taking tissues apart: pairs before and after, and how tissues were deformed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from vhp_cli.gate import GAP_ROUNDING
from vhp_cli.measures import Clearance, ClearancePair, ClearanceState, ClearanceTissue, PairRecord, Place, Report
from vhp_cli.pipeline.journal import Entry
from vhp_cli.stages.clearance.cutting import SQUEEZED
from vhp_cli.stages.clearance.relations import Pairing
from vhp_cli.stages.clearance.stiffness import Stiffness

_APART: ClearanceState = {"relation": "disjoint", "min_gap_mm": None, "overlap_mm3": 0.0}
_CONTACTS = ("touching", "crossing", "identical")


def clearance_report(
    before: Report,
    after: Report,
    pairings: Sequence[Pairing],
    stiffness: Mapping[str, Stiffness],
    entries: Sequence[Entry],
) -> Clearance:
    """Put together what became of the pairs that were too close, and of the tissues.

    Parameters
    ----------
    before
        The check of the model.
    after
        The report of the stage, tissues in the same order.
    pairings
        How pairs were to lie to each other.
    stiffness
        By tissue.
    entries
        What became of each tissue, in the same order.
    """
    states = [{(pair["a"], pair["b"]): pair for pair in report["pairs"]} for report in (before, after)]
    status = {record["name"]: entry for record, entry in zip(after["tissues"], entries, strict=True)}
    pairs = []
    for pairing in pairings:
        old, new = (state.get((pairing.a, pairing.b)) for state in states)
        is_reached = new is None or reached(pairing, new)
        if pairing.close or not is_reached:
            pairs.append(_pair(pairing, old, new, status, is_reached=is_reached))
    tissues = [
        _tissue(record["name"], stiffness[record["name"]], entry, record.get("volume_change"))
        for record, entry in zip(after["tissues"], entries, strict=True)
        if entry.status != "unchanged"
    ]
    return {
        "pairs": pairs,
        "tissues": tissues,
        "close_before": sum(pairing.close for pairing in pairings),
        "close_after": sum(not pair["reached"] for pair in pairs),
        "crossing_before": _crossings(before),
        "crossing_after": _crossings(after),
        "unreached": [pair for pair in pairs if not pair["reached"]],
        "conflicts": [pairing.reason for pairing in pairings if pairing.kind == "conflict"],
    }


def reached(pairing: Pairing, pair: PairRecord, *, aimed: bool = False) -> bool:
    """Tell whether a pair lies as it should, by what was measured between the two.

    `aimed`: whether it has the gap that was worked for, which may be less than the one asked for.
    """
    if pair["relation"] == "touching":
        return pairing.may_touch
    if pair["relation"] in ("crossing", "identical"):
        return False
    if pairing.inner and pair["inside"] != ("a" if pairing.inner == pairing.a else "b"):
        return False
    gap = pair["min_gap_mm"]
    return pairing.may_touch or gap is None or gap >= (pairing.aim_mm if aimed else pairing.gap_mm) * (1 - GAP_ROUNDING)


def _pair(
    pairing: Pairing,
    old: PairRecord | None,
    new: PairRecord | None,
    status: Mapping[str, Entry],
    *,
    is_reached: bool,
) -> ClearancePair:
    reason = pairing.reason
    places: list[Place] = []
    if not is_reached:
        if pairing.kind not in ("kept", "identical"):
            reason = "; ".join(part for part in (reason, _why_not(pairing, status)) if part)
        if new is not None and new["points_mm"]:
            places = [
                {"xyz_mm": xyz, "face": None, "tissue": name}
                for xyz, name in zip(new["points_mm"], (pairing.a, pairing.b), strict=True)
            ]
    return {
        "a": pairing.a,
        "b": pairing.b,
        "kind": pairing.kind,
        "inner": pairing.inner,
        "winner": pairing.winner,
        "gap_mm": pairing.gap_mm,
        "share": pairing.share,
        "before": _state(old),
        "after": _state(new),
        "reached": is_reached,
        "reason": reason,
        "places": places,
    }


def _why_not(pairing: Pairing, status: Mapping[str, Entry]) -> str:
    """Return what kept the tissues that should have given way from doing so."""
    said = []
    for name in (pairing.a, pairing.b):
        if pairing.share_of(name) > 0:
            entry = status[name]
            said += [f"{name}: {entry.reason}"] if entry.reason else []
            said += [f"{name} is {action['message']}" for action in entry.actions if action["step"] == SQUEEZED]
    return "; ".join(said) or "no attempt came closer to the gap"


def _state(pair: PairRecord | None) -> ClearanceState:
    if pair is None:
        return _APART
    return {"relation": pair["relation"], "min_gap_mm": pair["min_gap_mm"], "overlap_mm3": pair["overlap_mm3"]}


def _tissue(name: str, stiffness: Stiffness, entry: Entry, volume_change: float | None) -> ClearanceTissue:
    deviation = entry.deviation
    farthest = max((deviation["to_output"], deviation["to_input"]), key=lambda way: way["max"]) if deviation else None
    return {
        "name": name,
        "yielding": stiffness.yielding,
        "fixed": stiffness.fixed,
        "status": entry.status,
        "level": entry.level,
        "max_mm": deviation["max"] if deviation else 0.0,
        "mean_mm": deviation["mean"] if deviation else 0.0,
        "xyz_mm": farthest["xyz_mm"] if farthest else None,
        "volume_change": volume_change,
    }


def _crossings(report: Report) -> int:
    return sum(pair["relation"] in _CONTACTS for pair in report["pairs"])
