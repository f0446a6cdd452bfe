"""How the tissues of a model are to lie to each other: who bounds whose room, and who comes before whom."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

from vhp_cli.config import Settings
from vhp_cli.measures import Report
from vhp_cli.stages.clearance.options import ClearanceOptions
from vhp_cli.stages.clearance.relations import Pairing, gap_of, pairing
from vhp_cli.stages.clearance.stiffness import Stiffness, stiffness_of, thickness_of

# Neighbours so much farther away than the gap, in mm, are known to a tissue, so that it does not move into them.
_REACH_MM = 2.0


@dataclass(frozen=True, slots=True)
class Neighbour:
    """A tissue that bounds the room of another one; fields as of `Bound`."""

    kind: Literal["apart", "parent", "core", "beyond"]
    name: str
    gap_mm: float
    share: float = 1.0


@dataclass(frozen=True, slots=True)
class Plan:
    """How the tissues of a model are to lie to each other.

    Parameters
    ----------
    pairings
        Of all pairs that are near.
    stiffness
        By tissue.
    """

    pairings: tuple[Pairing, ...]
    stiffness: Mapping[str, Stiffness]
    of: Mapping[str, list[Pairing]] = field(default_factory=dict)

    def neighbours(self, name: str) -> list[Neighbour]:
        """Return what bounds the room of a tissue."""
        found = []
        for pair in self.of.get(name, []):
            other, share = pair.other(name), pair.share_of(name)
            if pair.kind == "identical":
                continue
            if pair.kind == "kept" or (pair.may_touch and not pair.close):
                # Neither gives way, but what moves for others must not move into it.
                found.append(Neighbour("apart", other, pair.aim_mm, 0.0))
            elif pair.kind == "nested":
                if share:
                    found.append(Neighbour("parent" if pair.inner == name else "core", other, pair.aim_mm))
            else:
                found.append(Neighbour("apart", other, pair.aim_mm, share))
                found += [
                    Neighbour("beyond", core.inner, core.aim_mm + pair.aim_mm)
                    for core in self.of[other]
                    if share and core.outer == other and core.close and core.share_of(other) == 1
                ]
        # A core that grows out of a neighbour may be a neighbour itself.
        return list(dict.fromkeys(found))

    def has_to_change(self, name: str) -> bool:
        """Tell whether a tissue is too close to something that does not leave it at that."""
        if any(neighbour.kind == "beyond" for neighbour in self.neighbours(name)):
            return True
        return any(
            pair.close and pair.kind not in ("identical", "kept") and pair.share_of(name) > 0
            for pair in self.of.get(name, [])
        )

    def parents(self, name: str) -> list[str]:
        """Return the tissues within which a tissue has to stay."""
        return [neighbour.name for neighbour in self.neighbours(name) if neighbour.kind == "parent"]

    def may_shrink(self, name: str) -> bool:
        """Tell whether a tissue has to leave a common volume to another one."""
        return any(pair.kind == "conflict" and pair.share_of(name) == 1 for pair in self.of.get(name, []))

    def waves(self, names: Sequence[str]) -> list[list[str]]:
        """Return the tissues in groups, each after those within which its tissues lie."""
        depth: dict[str, int] = {}

        def depth_of(name: str, below: tuple[str, ...]) -> int:
            if name not in depth:
                parents = [parent for parent in self.parents(name) if parent not in below]
                depth[name] = 1 + max((depth_of(parent, (*below, name)) for parent in parents), default=-1)
            return depth[name]

        for name in names:
            depth_of(name, ())
        return [[name for name in names if depth[name] == level] for level in range(max(depth.values(), default=0) + 1)]


def make_plan(
    report: Report,
    settings: Settings,
    options: ClearanceOptions,
    stuck: Collection[str] = (),
    squeezed: Collection[str] = (),
) -> Plan:
    """Decide how the tissues of a model are to lie to each other.

    Parameters
    ----------
    report
        Of the check of the model.
    settings, options
        Of the run.
    stuck
        Tissues that turned out not to give way: others beside them do it for both, but not rigid ones.
    squeezed
        Tissues that turned out to give way a part of the way only: others do it for both, but not rigid or thin ones,
        for which that would be worse than a gap that is too small.

    Raises
    ------
    UsageError
        If the settings say something of a tissue that is not understood.
    """
    tissues = {tissue["name"]: tissue for tissue in report["tissues"]}
    stiffness = {
        name: stiffness_of(
            tissue["tissue_type"],
            settings.stage_tables("clearance", name),
            thickness_of(tissue["volume_mm3"], tissue["area_mm2"]),
        )
        for name, tissue in tissues.items()
    }
    pairings = tuple(
        _without(
            squeezed,
            _without(stuck, pairing(pair, tissues, stiffness, settings, options), stiffness),
            stiffness,
            least_mm=2 * options.thin_mm,
        )
        for pair in report["pairs"]
    )
    of: dict[str, list[Pairing]] = {name: [] for name in tissues}
    for one in pairings:
        of[one.a].append(one)
        of[one.b].append(one)
    return Plan(pairings, stiffness, of)


def _without(
    stuck: Collection[str], pair: Pairing, stiffness: Mapping[str, Stiffness], least_mm: float = 0.0
) -> Pairing:
    """Return how two tissues beside each other are to lie if some do not give way.

    A rigid one does not for them, nor one that is thinner than `least_mm`.
    """
    if pair.kind != "apart" or (pair.a in stuck) == (pair.b in stuck):
        return pair
    other = pair.b if pair.a in stuck else pair.a
    stays = stiffness[other].rigid or stiffness[other].thickness_mm < least_mm
    return pair if stays else replace(pair, share=1.0 if other == pair.a else 0.0)


def looking_farther(settings: Settings, names: Sequence[str]) -> Settings:
    """Return the settings with gaps measured as far as rooms depend on them."""
    most = max((gap_of(name, name, settings) for name in names), default=0.0)
    return replace(settings, gap_search_mm=max(settings.gap_search_mm or 0.0, 2 * most + _REACH_MM))
