"""What `heal` may be told: values, defaults and checks."""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from types import MappingProxyType

from vhp_cli.errors import UsageError


@dataclass(frozen=True, slots=True)
class HealOptions:
    """How a tissue is healed; lengths in mm.

    Parameters
    ----------
    max_deviation_mm
        How far input and output may lie apart; None: 0.1 % of the diagonal of the tissue's box, at most 0.1 mm.
    target_quality
        Smallest q = 2 r_in / r_out that triangles are brought to.
    min_edge_mm
        Shortest edge that is left.
    edge_length_mm
        Edge length to remesh to; None: that of the input, finer where the shape needs it.
    max_triangles
        Most triangles of the tissue; None: as many as it takes.
    cap_openings
        Whether wide openings are closed; else they stay open, and the rest is healed.
    min_component_mm
        Separate parts whose box has a diagonal below this are removed; None: only specks.
    only_topology
        Close, orient and resolve, but leave the shape of the triangles alone.
    thicken_mm
        Make open sheets solids of this thickness; None: sheets are refused.
    engine_timeout_s, engine_memory_gb
        Limits of each call of a third-party engine.

    Raises
    ------
    UsageError
        If a value is out of range.
    """

    max_deviation_mm: float | None = None
    target_quality: float = 0.4
    min_edge_mm: float = 0.01
    edge_length_mm: float | None = None
    max_triangles: int | None = None
    cap_openings: bool = True
    min_component_mm: float | None = None
    only_topology: bool = False
    thicken_mm: float | None = None
    engine_timeout_s: float = 30.0
    engine_memory_gb: float = 4.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, int | float) and not isinstance(value, bool):
                _check_range(field.name, value)

    def changed(self, values: Mapping[str, object], where: str) -> HealOptions:
        """Return the options with some values of a settings file in place.

        Parameters
        ----------
        values
            By key, as in `KEYS`.
        where
            Where they stand, for the messages.

        Raises
        ------
        UsageError
            If a key is not known, or a value has the wrong type or is out of range.
        """
        changes = {}
        for key, value in values.items():
            if key not in KEYS:
                near = difflib.get_close_matches(key, KEYS, 1)
                raise UsageError(f"{where}: {key!r} is not known" + (f"; did you mean {near[0]!r}?" if near else ""))
            changes[KEYS[key]] = _typed(KEYS[key], value, f"{where}.{key}")
        try:
            return replace(self, **changes)  # type: ignore[arg-type]
        except UsageError as error:
            raise UsageError(f"{where}: {error.message}") from None

    def gentler(self, level: int, diagonal_mm: float) -> HealOptions:
        """Return the options for a further attempt at a tissue of this size: each may move it a quarter as far."""
        limit = self.max_deviation_mm or min(1e-3 * diagonal_mm, 0.1)
        return replace(self, max_deviation_mm=limit / 4**level)

    def as_dict(self) -> dict[str, object]:
        """Return all values by the keys of a settings file; None: decided for each tissue."""
        values = asdict(self)
        return {key: values[name] for key, name in KEYS.items()}


# Keys of the section [heal] in vhp.toml, also the long options of the command line.
KEYS: Mapping[str, str] = MappingProxyType(
    {
        "max-deviation": "max_deviation_mm",
        "target-q": "target_quality",
        "min-edge": "min_edge_mm",
        "edge-length": "edge_length_mm",
        "max-triangles": "max_triangles",
        "cap-openings": "cap_openings",
        "min-component": "min_component_mm",
        "only-topology": "only_topology",
        "thicken": "thicken_mm",
        "engine-timeout": "engine_timeout_s",
        "engine-memory": "engine_memory_gb",
    }
)
_FLAGS = ("cap_openings", "only_topology")
_WHOLE = ("max_triangles",)
_MAY_BE_ZERO = ("target_quality", "min_edge_mm", "min_component_mm")
_KEY_OF = {name: key for key, name in KEYS.items()}


def _typed(name: str, value: object, where: str) -> object:
    if name in _FLAGS:
        if not isinstance(value, bool):
            raise UsageError(f"{where}: expected true or false, not {value!r}")
        return value
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise UsageError(f"{where}: expected a number, not {value!r}")
    if name in _WHOLE:
        if value != int(value):
            raise UsageError(f"{where}: expected a whole number, not {value!r}")
        return int(value)
    return float(value)


def _check_range(name: str, value: float) -> None:
    # NaN would be below and above no limit.
    if not math.isfinite(value) or value < 0 or (value == 0 and name not in _MAY_BE_ZERO):
        kind = "a finite number, not negative" if name in _MAY_BE_ZERO else "a finite number above 0"
        raise UsageError(f"{_KEY_OF[name]}: expected {kind}, not {value:g}")
    if name == "target_quality" and value > 0.9:
        raise UsageError(f"target-q: no surface has only triangles of quality {value:g}; at most 0.9")
    if name == "max_triangles" and value < 4:
        raise UsageError(f"max-triangles: a closed surface has at least 4, not {value:g}")
