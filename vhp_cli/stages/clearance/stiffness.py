"""Who gives way to whom."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from vhp_cli.errors import UsageError
from vhp_cli.stages.clearance.options import TISSUE_KEYS
from vhp_cli.stages.options import nearest

# Between these, thickness counts.
_THIN_MM, _THICK_MM = 1.0, 20.0


@dataclass(frozen=True, slots=True)
class Stiffness:
    """How a tissue gives way.

    Parameters
    ----------
    yielding
        How readily, 0 (rigid) to 1.
    fixed
        It is never changed, not even for another rigid tissue.
    thickness_mm
        How thick it is. A thin tissue gives way less, as it has less to give.
    """

    yielding: float
    fixed: bool = False
    thickness_mm: float = _THICK_MM

    @property
    def weight(self) -> float:
        """Its part in the way between it and a neighbour."""
        return self.yielding * self._thickness

    @property
    def _thickness(self) -> float:
        return min(max(self.thickness_mm, _THIN_MM), _THICK_MM)

    @property
    def rigid(self) -> bool:
        """Whether it stays as it is wherever the other one can give way."""
        return self.fixed or self.yielding == 0


@cache
def default_yielding() -> Mapping[str, float]:
    """Return how readily tissues give way, by tissue type."""
    path = Path(__file__).parents[2] / "data" / "yielding.toml"
    return {name: float(value) for name, value in tomllib.loads(path.read_text(encoding="utf-8")).items()}


def stiffness_of(
    tissue_type: str, tables: Iterable[tuple[str, Mapping[str, object]]], thickness_mm: float = _THICK_MM
) -> Stiffness:
    """Return how a tissue of this type gives way.

    Parameters
    ----------
    tissue_type
        As of `Settings.tissue_type`.
    tables
        What the settings say of it, and where; later ones come before earlier ones.
    thickness_mm
        See `thickness_of`.

    Raises
    ------
    UsageError
        If a key is not known or a value is not allowed.
    """
    known = default_yielding()
    values: dict[str, object] = {"yielding": known.get(tissue_type, known["tissue"]), "fixed": False}
    for where, table in tables:
        for key, value in table.items():
            if key not in TISSUE_KEYS:
                raise UsageError(f"{where}: {key!r} is not known{nearest(key, TISSUE_KEYS)}")
            kind = TISSUE_KEYS[key]
            values[key] = kind.typed(value, f"{where}.{key}")
            kind.check(values[key], f"{where}.{key}")
    return Stiffness(float(str(values["yielding"])), bool(values["fixed"]), thickness_mm)


def share_of(a: Stiffness, b: Stiffness, *, thin_mm: float) -> float:
    """Return by which share the first of two tissues beside each other gives way, 0 to 1; the second by the rest.

    Where one of them is a thin wall, one gives way for both: a thin wall is moved as a whole or stays, as there is no
    way through the middle of what both have in common that would leave it its thickness.
    """
    if a.fixed != b.fixed:
        return 0.0 if a.fixed else 1.0
    if a.weight + b.weight == 0:
        return a._thickness / (a._thickness + b._thickness)
    share = a.weight / (a.weight + b.weight)
    if min(a.thickness_mm, b.thickness_mm) < 2 * thin_mm:
        # Of two that are alike the second one, in the order of the model's files.
        return 1.0 if share > 0.5 else 0.0
    return share


def thickness_of(volume_mm3: float, area_mm2: float) -> float:
    """Return how thick a solid is in mm: its mean chord 4 V / A, which is the diameter of a long cylinder.

    It is two thirds of the diameter of a ball, and twice the thickness of a plate.
    """
    return 4 * abs(volume_mm3) / area_mm2 if area_mm2 > 0 else 0.0
