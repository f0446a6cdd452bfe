"""What `heal` may be told: values, defaults and checks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import ClassVar

from vhp_cli.stages.options import Flag, Keys, Number, StageOptions

# Keys of the section [heal] in vhp.toml, also the long options of the command line.
KEYS: Keys = MappingProxyType(
    {
        "max-deviation": ("max_deviation_mm", Number()),
        # No surface has only triangles of better quality.
        "target-q": ("target_quality", Number(0, 0.9, may_be_least=True)),
        "min-edge": ("min_edge_mm", Number(may_be_least=True)),
        "edge-length": ("edge_length_mm", Number()),
        # A closed surface has at least 4.
        "max-triangles": ("max_triangles", Number(4, may_be_least=True, whole=True)),
        "cap-openings": ("cap_openings", Flag()),
        "min-component": ("min_component_mm", Number(may_be_least=True)),
        "only-topology": ("only_topology", Flag()),
        "thicken": ("thicken_mm", Number()),
        "engine-timeout": ("engine_timeout_s", Number()),
        "engine-memory": ("engine_memory_gb", Number()),
    }
)


@dataclass(frozen=True, slots=True)
class HealOptions(StageOptions):
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

    known: ClassVar[Keys] = KEYS

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

    def gentler(self, level: int, diagonal_mm: float) -> HealOptions:
        """Return the options for a further attempt at a tissue of this size: each may move it a quarter as far."""
        limit = self.max_deviation_mm or min(1e-3 * diagonal_mm, 0.1)
        return replace(self, max_deviation_mm=limit / 4**level)
