"""What `smooth` may be told: values, defaults and checks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import ClassVar

from vhp_cli.errors import UsageError
from vhp_cli.stages.options import Flag, Keys, Name, Number, StageOptions
from vhp_cli.stages.smooth.textbook import Correction, Method, Update

GUARDED = "guarded"
METHODS = (GUARDED, *Method)

# Most iterations, unless told otherwise: the guarded method stops by itself long before, the others do not.
_GUARDED_ITERATIONS = 50
_TEXTBOOK_ITERATIONS = 10

# Keys of the section [smooth] in vhp.toml, also the long options of the command line.
KEYS: Keys = MappingProxyType(
    {
        "method": ("method", Name(METHODS)),
        "update": ("update", Name(tuple(Update))),
        "correction": ("correction", Name(tuple(Correction))),
        "tangential": ("tangential", Flag()),
        "flips": ("flips", Flag()),
        "iterations": ("iterations", Number(0, 1e6, may_be_least=True, whole=True)),
        "until-q": ("until_quality", Number(0, 1, may_be_least=True)),
        "max-deviation": ("max_deviation_mm", Number()),
        "volume-tolerance": ("volume_tolerance", Number(0, 1)),
        "max-dihedral": ("max_dihedral_deg", Number(0, 180)),
        "feature-angle": ("feature_angle_deg", Number(0, 180)),
        "unguarded": ("unguarded", Flag()),
    }
)


@dataclass(frozen=True, slots=True)
class SmoothOptions(StageOptions):
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

    known: ClassVar[Keys] = KEYS

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

    def gentler(self, level: int, diagonal_mm: float) -> SmoothOptions:
        """Return the options for a further attempt at a tissue of this size: each may move it a quarter as far."""
        limit = self.max_deviation_mm or min(1e-3 * diagonal_mm, 0.1)
        return replace(self, max_deviation_mm=limit / 4**level)
