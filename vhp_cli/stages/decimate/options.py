"""What `decimate` may be told: values, defaults and checks."""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from types import MappingProxyType
from typing import cast, get_args

from vhp_cli.errors import UsageError
from vhp_cli.kernels.decimating import Method

METHODS: tuple[Method, ...] = get_args(Method)
# Each further attempt at a tissue may move it by this part of the one before.
_GENTLER = 0.25


@dataclass(frozen=True, slots=True)
class DecimateOptions:
    """How a tissue is decimated; lengths in mm.

    Parameters
    ----------
    ratio
        Part of the triangles that is left.
    triangles
        Number of triangles that is left.
    edge_length_mm
        Mean length of the edges that are left.
    max_deviation_mm
        How far input and output may lie apart; None: decided by the size of the tissue and its edges. Where none of
        the three above is given, as many triangles go as this allows.
    method
        Where the vertex goes into which an edge is merged; see `vhp_cli.kernels.decimating.decimate`.
    target_quality
        Smallest q = 2 r_in / r_out that triangles are brought to.
    limit_share
        Part of the allowed deviation that is made use of.

    Raises
    ------
    UsageError
        If a value is out of range, or more than one target is given.
    """

    ratio: float | None = None
    triangles: int | None = None
    edge_length_mm: float | None = None
    max_deviation_mm: float | None = None
    method: Method = "quadric"
    target_quality: float = 0.3
    limit_share: float = 1.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, int | float):
                _check_range(field.name, value)
        if self.method not in METHODS:
            near = difflib.get_close_matches(str(self.method), METHODS, 1)
            hint = f"did you mean {near[0]!r}?" if near else f"methods: {', '.join(METHODS)}"
            raise UsageError(f"method: {self.method!r} is not known; {hint}")
        if len(self.targets) > 1:
            raise UsageError(f"{' and '.join(self.targets)} exclude each other")

    @property
    def targets(self) -> list[str]:
        """Keys of the targets that are given; a limit on the deviation alone is none."""
        return [_KEY_OF[name] for name in _TARGETS if getattr(self, name) is not None]

    def changed(self, values: Mapping[str, object], where: str) -> DecimateOptions:
        """Return the options with some values of a settings file in place; a target takes the place of another.

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
        changes: dict[str, object] = {}
        for key, value in values.items():
            if key not in KEYS:
                near = difflib.get_close_matches(key, KEYS, 1)
                raise UsageError(f"{where}: {key!r} is not known" + (f"; did you mean {near[0]!r}?" if near else ""))
            changes[KEYS[key]] = _typed(KEYS[key], value, f"{where}.{key}")
        if any(name in changes for name in _TARGETS):
            changes = {**dict.fromkeys(_TARGETS), **changes}
        try:
            return replace(self, **changes)  # type: ignore[arg-type]
        except UsageError as error:
            raise UsageError(f"{where}: {error.message}") from None

    def gentler(self, level: int, diagonal_mm: float) -> DecimateOptions:
        """Return the options for a further attempt at a tissue: each may move it a quarter as far."""
        return replace(self, limit_share=_GENTLER**level)

    def as_dict(self) -> dict[str, object]:
        """Return all values by the keys of a settings file; None: not given."""
        values = asdict(self)
        return {key: values[name] for key, name in KEYS.items()}


# Keys of the section [decimate] in vhp.toml, also the long options of the command line.
KEYS: Mapping[str, str] = MappingProxyType(
    {
        "ratio": "ratio",
        "triangles": "triangles",
        "edge-length": "edge_length_mm",
        "max-deviation": "max_deviation_mm",
        "method": "method",
        "target-q": "target_quality",
    }
)
TARGETS = ("ratio", "triangles", "edge-length")
_TARGETS = tuple(KEYS[key] for key in TARGETS)
_KEY_OF = {name: key for key, name in KEYS.items()}


def _typed(name: str, value: object, where: str) -> object:
    if name == "method":
        if not isinstance(value, str):
            raise UsageError(f"{where}: expected one of {', '.join(METHODS)}, not {value!r}")
        return cast("Method", value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise UsageError(f"{where}: expected a number, not {value!r}")
    if name == "triangles":
        if not math.isfinite(value) or value != int(value):
            raise UsageError(f"{where}: expected a whole number, not {value!r}")
        return int(value)
    return float(value)


def _check_range(name: str, value: float) -> None:
    # NaN would be below and above no limit.
    if not math.isfinite(value) or value < 0 or (value == 0 and name != "target_quality"):
        kind = "a finite number, not negative" if name == "target_quality" else "a finite number above 0"
        raise UsageError(f"{_KEY_OF[name]}: expected {kind}, not {value:g}")
    if name == "target_quality" and value > 0.9:
        raise UsageError(f"target-q: no surface has only triangles of quality {value:g}; at most 0.9")
    if name == "ratio" and value > 1:
        raise UsageError(f"ratio: expected the part of the triangles that is left, at most 1, not {value:g}")
    if name == "triangles" and value < 4:
        raise UsageError(f"triangles: a closed surface has at least 4, not {value:g}")
