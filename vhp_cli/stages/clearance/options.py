"""What `separate` may be told: values, defaults and checks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

from vhp_cli.stages.options import Flag, Keys, Kind, Name, Number, StageOptions

# Keys of the section [clearance] in vhp.toml; METHOD and the lengths are also long options of the command line.
KEYS: Keys = MappingProxyType(
    {
        "method": ("method", Name(("auto", "move", "cut"))),
        "grid": ("grid_mm", Number()),
        "max-move": ("max_move_mm", Number(may_be_least=True)),
        "thin": ("thin_mm", Number(may_be_least=True)),
        "nested-share": ("nested_share", Number(0, 1)),
        "conflict-share": ("conflict_share", Number(0, 1)),
        "rigid-pairs": ("rigid_pairs", Name(("least", "share", "keep"))),
        "rigid-gap": ("rigid_gap_mm", Number()),
        "rounds": ("rounds", Number(0, 6, may_be_least=True, whole=True)),
        "target-q": ("target_quality", Number(0, 0.9, may_be_least=True)),
        "min-edge": ("min_edge_mm", Number(may_be_least=True)),
        "engine-timeout": ("engine_timeout_s", Number()),
        "engine-memory": ("engine_memory_gb", Number()),
    }
)
# What a [[tissue]] may say of itself.
TISSUE_KEYS: Mapping[str, Kind] = MappingProxyType({"yielding": Number(0, 1, may_be_least=True), "fixed": Flag()})


@dataclass(frozen=True, slots=True)
class ClearanceOptions(StageOptions):
    """How tissues are taken apart; lengths in mm.

    Parameters
    ----------
    method
        ``"move"``: move vertices only; ``"cut"``: cut only; ``"auto"``: move, and cut what can't be moved.
    grid_mm
        Cells in which cuts are worked out; None: 0.8 of the gap, at least 0.05.
    max_move_mm
        How far vertices may be moved; what is deeper is cut.
    thin_mm
        Walls thinner than this are moved as a whole, both sides together.
    nested_share
        A tissue of which at least this share of the volume lies in another one was meant to lie inside.
    conflict_share
        From this share of common volume on, one of the two tissues takes it all: the labels contradict each other.
    rigid_pairs
        What becomes of two rigid tissues that are too close: ``"least"``: if they cross or touch, the larger one gives
        way, else both stay as they are; ``"share"``: both give way; ``"keep"``: both stay.
    rigid_gap_mm
        The gap of two rigid tissues that crossed or touched, if that is less than the gap asked for; None: that one.
    rounds
        How often what is still too close is done anew, each time more finely.
    target_quality
        q = 2 r_in / r_out that triangles at cuts are brought to.
    min_edge_mm
        Shortest edge that is left at cuts.
    engine_timeout_s, engine_memory_gb
        Limits of each call of a third-party engine.

    Raises
    ------
    UsageError
        If a value is out of range.
    """

    known: ClassVar[Keys] = KEYS

    method: str = "auto"
    grid_mm: float | None = None
    max_move_mm: float = 2.0
    thin_mm: float = 4.5
    nested_share: float = 0.6
    conflict_share: float = 0.3
    rigid_pairs: str = "least"
    rigid_gap_mm: float | None = None
    rounds: int = 3
    target_quality: float = 0.3
    min_edge_mm: float = 0.02
    engine_timeout_s: float = 300.0
    engine_memory_gb: float = 4.0
