"""What two tissues are to each other: beside each other, one inside the other, or one and the same labelled twice."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

from vhp_cli.config import PairPattern, Settings
from vhp_cli.gate import GAP_ROUNDING
from vhp_cli.measures import PairRecord, TissueRecord
from vhp_cli.stages.clearance.options import ClearanceOptions
from vhp_cli.stages.clearance.stiffness import Stiffness, share_of

Kind = Literal["apart", "nested", "conflict", "identical", "kept"]

# The gap of two tissues that may touch, where they cross.
TOUCHING_MM = 0.05
# A gap that the settings leave at nothing is still one that float32 coordinates tell.
_LEAST_GAP_MM = 0.01
# Of a thin tissue so much has to lie in another one for it to be meant to lie inside.
_THIN_NESTED_SHARE = 0.9


@dataclass(frozen=True, slots=True)
class Pairing:
    """How two tissues are to lie to each other.

    Parameters
    ----------
    a, b
        Their names.
    kind
        ``"apart"``: beside each other; ``"nested"``: `inner` inside the other one; ``"conflict"``: they share so much
        that `winner` takes it all; ``"identical"``: both are the same surface; ``"kept"``: nothing can be done.
    gap_mm
        The gap that is asked for.
    close
        Whether they are nearer than that now, or in contact, or not nested as they should be.
    share
        By which `a` gives way, 0 to 1.
    inner
        The inner one of a nested pair; else empty.
    winner
        Of a conflict; else empty.
    reason
        Why nothing can be done, or what the conflict is; else empty.
    may_touch
        Whether they may touch and come as near as they like, but not cross.
    least_mm
        The gap that is worked for, if that is less; None: the one asked for.
    """

    a: str
    b: str
    kind: Kind
    gap_mm: float
    close: bool
    share: float = 0.5
    inner: str = ""
    winner: str = ""
    reason: str = ""
    may_touch: bool = False
    least_mm: float | None = None

    @property
    def aim_mm(self) -> float:
        """The gap that is worked for."""
        return self.gap_mm if self.least_mm is None else min(self.gap_mm, self.least_mm)

    @property
    def outer(self) -> str:
        """The outer one of a nested pair; else empty."""
        return "" if not self.inner else self.b if self.inner == self.a else self.a

    def other(self, name: str) -> str:
        """Return the other one."""
        return self.b if name == self.a else self.a

    def share_of(self, name: str) -> float:
        """Return by which share one of them gives way."""
        return self.share if name == self.a else 1 - self.share


def pairing(
    pair: PairRecord,
    tissues: Mapping[str, TissueRecord],
    stiffness: Mapping[str, Stiffness],
    settings: Settings,
    options: ClearanceOptions,
) -> Pairing:
    """Decide how two tissues are to lie to each other, by their given surfaces.

    Parameters
    ----------
    pair
        What was measured between them.
    tissues, stiffness
        Of the model, by name.
    settings
        Declared pairs, and the gaps asked for.
    options
        From which share of common volume on a pair is nested, or a conflict.
    """
    a, b = pair["a"], pair["b"]
    gap = gap_of(a, b, settings)
    touching_allowed = any(_either(pattern, a, b) for pattern in settings.may_touch)
    if touching_allowed:
        gap = min(gap, TOUCHING_MM)
        close = pair["relation"] in ("crossing", "identical")
    else:
        contact = pair["relation"] in ("touching", "crossing", "identical")
        close = contact or (pair["min_gap_mm"] is not None and pair["min_gap_mm"] < gap * (1 - GAP_ROUNDING))
    found = Pairing(a, b, "apart", gap, close, may_touch=touching_allowed)
    if pair["relation"] == "identical":
        return replace(found, kind="identical", reason="both are the same surface: remove one of the two")
    if stiffness[a].fixed and stiffness[b].fixed:
        return replace(found, kind="kept", reason="both are fixed")
    shares = {name: _overlap_share(pair, tissues[name]) for name in (a, b)}
    if inner := _inner(pair, shares, stiffness, gap, settings, options):
        close = close or not pair["inside"]
        return replace(found, kind="nested", close=close, inner=inner, share=_nested_share(found, inner, stiffness))
    if max(shares.values()) >= options.conflict_share:
        return _conflict(found, shares, tissues, stiffness)
    if stiffness[a].rigid and stiffness[b].rigid and not touching_allowed and options.rigid_pairs != "share":
        return _rigid(found, pair, tissues, stiffness, options)
    return replace(found, share=share_of(stiffness[a], stiffness[b], thin_mm=options.thin_mm))


def gap_of(a: str, b: str, settings: Settings) -> float:
    """Return the gap that two tissues have to keep: the limit of P005."""
    return max(settings.rule("P005", a, b).limit or 0.0, _LEAST_GAP_MM)


def _rigid(
    found: Pairing,
    pair: PairRecord,
    tissues: Mapping[str, TissueRecord],
    stiffness: Mapping[str, Stiffness],
    options: ClearanceOptions,
) -> Pairing:
    """Let two rigid tissues stay as they are, or the larger one give way to the other if one has to change anyway."""
    a, b = found.a, found.b
    if options.rigid_pairs == "keep":
        return replace(found, kind="kept", reason="both are rigid")
    if pair["relation"] == "disjoint":
        # Measured when they were parted before: nearer than asked, but not in contact.
        return replace(found, kind="kept", reason="both are rigid, and neither cross nor touch")
    if stiffness[a].fixed != stiffness[b].fixed:
        yields = b if stiffness[a].fixed else a
    else:
        yields = max((a, b), key=lambda name: (abs(tissues[name]["volume_mm3"]), name))
    least, reason = None, ""
    if options.rigid_gap_mm is not None and options.rigid_gap_mm < found.gap_mm:
        least = options.rigid_gap_mm
        reason = f"both are rigid: {yields} gives way by no more than parts them, to a gap of {least:g} mm"
    return replace(found, share=1.0 if yields == a else 0.0, least_mm=least, reason=reason)


def _overlap_share(pair: PairRecord, tissue: TissueRecord) -> float:
    volume = abs(tissue["volume_mm3"])
    return pair["overlap_mm3"] / volume if tissue["closed"] and volume > 0 else 0.0


def _inner(
    pair: PairRecord,
    shares: Mapping[str, float],
    stiffness: Mapping[str, Stiffness],
    gap_mm: float,
    settings: Settings,
    options: ClearanceOptions,
) -> str:
    """Return which one lies, or was meant to lie, inside the other; empty if none does.

    What is not thicker by two gaps has no room for another one in it, and of a thin one that sticks out far little
    would be left if it were brought inside: then the labels contradict each other. Around a rigid one the other one
    grows.
    """
    a, b = pair["a"], pair["b"]
    for first, second in ((a, b), (b, a)):
        if any(pattern.matches(first, second) for pattern in settings.nested):
            return first
    if pair["inside"]:
        return a if pair["inside"] == "a" else b
    most = max((a, b), key=lambda name: shares[name])
    other = b if most == a else a
    if shares[most] < options.nested_share or shares[a] == shares[b]:
        return ""
    within, around = stiffness[most], stiffness[other]
    fits = within.thickness_mm + 2 * gap_mm <= around.thickness_mm
    sticks_out = within.thickness_mm < 2 * options.thin_mm and shares[most] < _THIN_NESTED_SHARE
    return most if within.rigid or (fits and not sticks_out) else ""


def _nested_share(found: Pairing, inner: str, stiffness: Mapping[str, Stiffness]) -> float:
    """Return the share of the first one: the inner one gives way, unless it is rigid and the outer one is not."""
    within, around = stiffness[inner], stiffness[found.other(inner)]
    stays = within.fixed or (within.rigid and not around.rigid)
    return 0.0 if stays == (inner == found.a) else 1.0


def _conflict(
    found: Pairing, shares: Mapping[str, float], tissues: Mapping[str, TissueRecord], stiffness: Mapping[str, Stiffness]
) -> Pairing:
    """Decide who keeps the common volume: the one for which losing it is worse.

    That is the larger share of its volume, weighed by how little it yields: a thin wall or a stiff tissue keeps what a
    large soft one can spare.
    """
    a, b = found.a, found.b

    def harm(name: str) -> tuple[bool, float, float, str]:
        yielding = 0.0 if stiffness[name].fixed else stiffness[name].yielding
        lost = shares[name] / yielding if yielding else math.inf
        return (stiffness[name].fixed, lost, -abs(tissues[name]["volume_mm3"]), name)

    winner = max((a, b), key=harm)
    loser = found.other(winner)
    most = max((a, b), key=lambda name: shares[name])
    reason = f"{shares[most]:.0%} of {most} has the label of the other too; {winner} keeps it, {loser} loses it"
    return replace(found, kind="conflict", share=0.0 if winner == a else 1.0, winner=winner, reason=reason)


def _either(pattern: PairPattern, a: str, b: str) -> bool:
    return pattern.matches(a, b) or pattern.matches(b, a)
