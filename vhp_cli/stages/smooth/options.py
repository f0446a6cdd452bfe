"""What `smooth` may be told: values, defaults and checks."""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from types import MappingProxyType

from vhp_cli.errors import UsageError
from vhp_cli.stages.smooth.textbook import Correction, Method, Update

GUARDED = "guarded"
METHODS = (GUARDED, *Method)

# Most iterations, unless told otherwise: the guarded method stops by itself long before, the others do not.
_GUARDED_ITERATIONS = 50
_TEXTBOOK_ITERATIONS = 10


@dataclass(frozen=True, slots=True)
class SmoothOptions:
    """How a tissue is smoothed; lengths in mm.

    Parameters
    ----------
    method
        ``"guarded"``: relaxation along the surface and flips; else one of `textbook.Method`.
    update, correction, tangential
        Of a textbook method, as for `kernels.smoothing.Smoothing`.
    flips
        Whether edges are flipped; None: by the guarded method only.
    iterations
        Most iterations; None: 50 of the guarded method, 10 of another.
    until_quality
        Stop as soon as every triangle has this q = 2 r_in / r_out.
    max_deviation_mm
        How far input and output may lie apart; None: 0.1 % of the diagonal of the tissue's box, at most 0.1 mm.
    volume_tolerance
        Most change of the enclosed volume, as a share of it.
    max_dihedral_deg
        Edges at which the surface turns by more are rounded off; None: none.
    feature_angle_deg
        Edges at which the surface turns by more stay as they are; None: none.
    unguarded
        The textbook behaviour: whatever comes out is taken.
    min_edge_mm
        No edge gets shorter than this, unless it was.

    Raises
    ------
    UsageError
        If a value is not known or out of range.
    """

    method: str = GUARDED
    update: str = Update.SIMULTANEOUS
    correction: str = Correction.NONE
    tangential: bool = False
    flips: bool | None = None
    iterations: int | None = None
    until_quality: float | None = None
    max_deviation_mm: float | None = None
    volume_tolerance: float = 1e-3
    max_dihedral_deg: float | None = None
    feature_angle_deg: float | None = None
    unguarded: bool = False
    min_edge_mm: float = 0.01

    def __post_init__(self) -> None:
        for name, known in _NAMES.items():
            _check_name(name, getattr(self, name), known)
        for name, (least, most, may_be_least) in _RANGES.items():
            value = getattr(self, name)
            if value is not None:
                _check_range(name, value, least, most, may_be_least=may_be_least)

    @property
    def with_flips(self) -> bool:
        """Whether edges are flipped."""
        return self.method == GUARDED if self.flips is None else self.flips

    @property
    def most_iterations(self) -> int:
        """Most iterations."""
        if self.iterations is not None:
            return self.iterations
        return _GUARDED_ITERATIONS if self.method == GUARDED else _TEXTBOOK_ITERATIONS

    def require_sense(self, where: str) -> None:
        """Refuse values that contradict each other.

        Raises
        ------
        UsageError
            If they do.
        """
        if self.unguarded and self.method == GUARDED:
            raise UsageError(f"{where}: unguarded needs one of the methods {', '.join(Method)}")
        if self.unguarded and self.max_dihedral_deg is not None:
            raise UsageError(f"{where}: max-dihedral is a guarded operation; it can't be unguarded")
        if self.max_dihedral_deg is not None and self.feature_angle_deg is not None:
            raise UsageError(
                f"{where}: sharp edges can be rounded off (max-dihedral) or kept (feature-angle), not both"
            )

    def changed(self, values: Mapping[str, object], where: str) -> SmoothOptions:
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

    def gentler(self, level: int, diagonal_mm: float) -> SmoothOptions:
        """Return the options for a further attempt at a tissue of this size: each may move it a quarter as far."""
        limit = self.max_deviation_mm or min(1e-3 * diagonal_mm, 0.1)
        return replace(self, max_deviation_mm=limit / 4**level)

    def as_dict(self) -> dict[str, object]:
        """Return all values by the keys of a settings file; None: decided for each tissue."""
        values = asdict(self)
        return {key: values[name] for key, name in KEYS.items()}


# Keys of the section [smooth] in vhp.toml, also the long options of the command line.
KEYS: Mapping[str, str] = MappingProxyType(
    {
        "method": "method",
        "update": "update",
        "correction": "correction",
        "tangential": "tangential",
        "flips": "flips",
        "iterations": "iterations",
        "until-q": "until_quality",
        "max-deviation": "max_deviation_mm",
        "volume-tolerance": "volume_tolerance",
        "max-dihedral": "max_dihedral_deg",
        "feature-angle": "feature_angle_deg",
        "unguarded": "unguarded",
    }
)
_KEY_OF = {name: key for key, name in KEYS.items()}
_NAMES: Mapping[str, tuple[str, ...]] = {"method": METHODS, "update": tuple(Update), "correction": tuple(Correction)}
_FLAGS = ("tangential", "flips", "unguarded")
_WHOLE = ("iterations",)
# Least and largest value, and whether the least one is allowed itself.
_RANGES: Mapping[str, tuple[float, float, bool]] = {
    "iterations": (0, 1e6, True),
    "until_quality": (0, 1, True),
    "max_deviation_mm": (0, math.inf, False),
    "volume_tolerance": (0, 1, False),
    "max_dihedral_deg": (0, 180, False),
    "feature_angle_deg": (0, 180, False),
}


def _check_name(name: str, value: str, known: tuple[str, ...]) -> None:
    if value not in known:
        near = difflib.get_close_matches(str(value), known, 1)
        hint = f"; did you mean {near[0]!r}?" if near else f"; one of {', '.join(known)}"
        raise UsageError(f"{_KEY_OF[name]}: {value!r} is not known{hint}")


def _check_range(name: str, value: float, least: float, most: float, *, may_be_least: bool) -> None:
    # NaN is in no range.
    if not (math.isfinite(value) and least <= value <= most) or (value == least and not may_be_least):
        lower = f"at least {least:g}" if may_be_least else f"above {least:g}"
        upper = "" if most == math.inf else f" and at most {most:g}"
        raise UsageError(f"{_KEY_OF[name]}: expected a finite number {lower}{upper}, not {value:g}")


def _typed(name: str, value: object, where: str) -> object:
    if name in _NAMES:
        if not isinstance(value, str):
            raise UsageError(f"{where}: expected a name, not {value!r}")
        return value
    if name in _FLAGS:
        if not isinstance(value, bool):
            raise UsageError(f"{where}: expected true or false, not {value!r}")
        return value
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise UsageError(f"{where}: expected a number, not {value!r}")
    if name in _WHOLE:
        if not math.isfinite(value) or value != int(value):
            raise UsageError(f"{where}: expected a whole number, not {value!r}")
        return int(value)
    return float(value)
