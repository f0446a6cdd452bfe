"""What `decimate` may be told: values, defaults and checks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import ClassVar, get_args

from vhp_cli.errors import UsageError
from vhp_cli.kernels.decimating import Method
from vhp_cli.stages.options import Keys, Name, Number, StageOptions

METHODS: tuple[Method, ...] = get_args(Method)
# Each further attempt at a tissue may move it by this part of the one before.
_GENTLER = 0.25

# Keys of the section [decimate] in vhp.toml, also the long options of the command line.
KEYS: Keys = MappingProxyType(
    {
        "ratio": ("ratio", Number(0, 1)),
        # A closed surface has at least 4.
        "triangles": ("triangles", Number(4, may_be_least=True, whole=True)),
        "edge-length": ("edge_length_mm", Number()),
        "max-deviation": ("max_deviation_mm", Number()),
        "method": ("method", Name(METHODS)),
        # No surface has only triangles of better quality.
        "target-q": ("target_quality", Number(0, 0.9, may_be_least=True)),
    }
)
# Those that say how far; a tissue has one at the most.
TARGETS = MappingProxyType({key: KEYS[key][0] for key in ("ratio", "triangles", "edge-length")})


@dataclass(frozen=True, slots=True)
class DecimateOptions(StageOptions):
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

    known: ClassVar[Keys] = KEYS

    ratio: float | None = None
    triangles: int | None = None
    edge_length_mm: float | None = None
    max_deviation_mm: float | None = None
    method: Method = "quadric"
    target_quality: float = 0.3
    limit_share: float = 1.0

    def __post_init__(self) -> None:
        StageOptions.__post_init__(self)
        if len(self.targets) > 1:
            raise UsageError(f"{' and '.join(self.targets)} exclude each other")

    @property
    def targets(self) -> list[str]:
        """Keys of the targets that are given; a limit on the deviation alone is none."""
        return [key for key, name in TARGETS.items() if getattr(self, name) is not None]

    def changed(self, values: Mapping[str, object], where: str) -> DecimateOptions:
        """Return the options with some values of a settings file in place; a target takes the place of another."""
        cleared = replace(self, ratio=None, triangles=None, edge_length_mm=None)
        return StageOptions.changed(cleared if values.keys() & TARGETS.keys() else self, values, where)

    def gentler(self, level: int, diagonal_mm: float) -> DecimateOptions:
        """Return the options for a further attempt at a tissue: each may move it a quarter as far."""
        return replace(self, limit_share=_GENTLER**level)
