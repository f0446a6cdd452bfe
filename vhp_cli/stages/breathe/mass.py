"""What the model weighs: nested own volumes times densities (thesis 5.2)."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

from vhp_cli.errors import UsageError
from vhp_cli.stages.breathe.roles import SHELLS
from vhp_cli.stages.breathe.tissue import Tissue
from vhp_cli.tissues import guess_type, words

Convention = Literal["fixed-mass", "fixed-density", "none"]
CONVENTIONS: tuple[Convention, ...] = ("fixed-mass", "fixed-density", "none")

_KG_PER_MM3 = 1e-9  # of 1 kg/m3


@dataclass(frozen=True, slots=True)
class Density:
    """Mass per volume of a tissue.

    Parameters
    ----------
    kg_per_m3
        The value.
    source
        Where it is from, or "settings".
    certain
        False where nothing was known of the tissue and that of soft tissue was taken.
    """

    kg_per_m3: float
    source: str
    certain: bool = True


@cache
def _table() -> dict[str, Any]:
    path = Path(__file__).parents[2] / "data" / "densities.toml"
    return tomllib.loads(path.read_text(encoding="utf-8"))


def density_of(name: str, part: str, tissue_type: str | None = None) -> Density:
    """Return the density that name, part in breathing and tissue type suggest, in this order."""
    text = f" {' '.join(words(name))} "
    for row in _table()["tissue"]:
        if any(f" {p[:-1]}" in text if p.endswith("*") else f" {p} " in text for p in row.get("phrases", ())):
            return Density(float(row["kg_per_m3"]), row["source"])
    kind = tissue_type or guess_type(name)
    for key in (part, kind):
        row = _table()["part"].get(key)
        if row is not None:
            return Density(float(row["kg_per_m3"]), row["source"])
    row = _table()["part"]["body"]
    return Density(float(row["kg_per_m3"]), row["source"], certain=False)


def densities(
    tissues: Iterable[Tissue],
    settings: Mapping[str, Mapping[str, object]] | None = None,
    types: Mapping[str, str] | None = None,
) -> dict[str, Density]:
    """Return the density of every tissue; ``density`` in its settings comes first.

    Raises
    ------
    UsageError
        If a setting is no positive number.
    """
    found = {}
    for tissue in tissues:
        said = (settings or {}).get(tissue.name, {}).get("density")
        if said is None:
            found[tissue.name] = density_of(tissue.name, tissue.role.part, (types or {}).get(tissue.name))
        elif isinstance(said, bool) or not isinstance(said, int | float) or not 0.0 <= said < float("inf"):
            raise UsageError(f"{tissue.name}: density must be a number of kg/m3, not {said!r}")
        else:
            found[tissue.name] = Density(float(said), "settings")
    return found


@dataclass(frozen=True, slots=True)
class MassModel:
    """How mass follows from volumes.

    Parameters
    ----------
    parents
        The smallest tissue that contains each tissue.
    kg_per_m3
        Density of each tissue.
    lungs
        Names of the lungs.
    rest_mm3
        Volume of each tissue at rest.
    convention
        ``"fixed-mass"``: the lungs keep their mass, the air they take in weighs nothing; ``"fixed-density"``: they keep
        their density; ``"none"``: they weigh nothing.
    """

    parents: Mapping[str, str | None]
    kg_per_m3: Mapping[str, float]
    lungs: frozenset[str]
    rest_mm3: Mapping[str, float]
    convention: Convention = "fixed-mass"

    def own_mm3(self, volumes: Mapping[str, float]) -> dict[str, float]:
        """Return the volume of each tissue without what lies within it."""
        own = dict(volumes)
        for name, parent in self.parents.items():
            if parent is not None and name in volumes and parent in own:
                own[parent] -= volumes[name]
        return own

    def kg(self, volumes: Mapping[str, float]) -> float:
        """Return the mass of the model with its tissues at these volumes (mm3)."""
        rest = self.own_mm3(self.rest_mm3)
        total = 0.0
        for name, own in self.own_mm3(volumes).items():
            if name in self.lungs:
                if self.convention == "none":
                    continue
                if self.convention == "fixed-mass":
                    own = rest[name]
            total += self.kg_per_m3[name] * own * _KG_PER_MM3
        return total


def has_container(tissues: Sequence[Tissue]) -> bool:
    """Tell if the model has a shell around the lungs, without which its mass can't be held."""
    return any(tissue.role.part in SHELLS for tissue in tissues)
