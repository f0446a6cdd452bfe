"""What `breathe` may be told: values, defaults and checks."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar, Literal

from vhp_cli.errors import UsageError
from vhp_cli.stages.breathe.mass import CONVENTIONS, Convention
from vhp_cli.stages.breathe.sequence import STEPS, Targets
from vhp_cli.stages.breathe.time import PERIOD_S, PRESETS, Moment, even_frames, frames_at, full_cycle
from vhp_cli.stages.options import Keys, Name, Number, StageOptions, Text

# Keys of the section [breathe] in vhp.toml, also the long options of the command line.
KEYS: Keys = MappingProxyType(
    {
        "preset": ("preset", Name(tuple(PRESETS))),
        "volume-change": ("volume_change_l", Number()),
        "travel": ("travel_mm", Number()),
        "forward": ("forward_mm", Number(may_be_least=True)),
        "ribs": ("ribs", Name(("follow", "least"))),
        "steps": ("steps", Number(1, 1000, may_be_least=True, whole=True)),
        "period": ("period_s", Number()),
        "frames": ("frames", Number(2, 100_000, may_be_least=True, whole=True)),
        "times": ("times", Text()),
        "gap": ("gap_mm", Number(may_be_least=True)),
        "mass-tolerance": ("mass_tolerance", Number()),
        "lung-mass": ("lung_mass", Name(CONVENTIONS)),
    }
)
# What may be said of a tissue: [[tissue]] match = "..." breathe = { ... }.
TISSUE_KEYS = ("role", "side", "number", "density")


@dataclass(frozen=True, slots=True)
class BreatheOptions(StageOptions):
    """What a breath is to be; lengths in mm, times in seconds.

    Parameters
    ----------
    preset
        ``"quiet"``, ``"deep"`` or ``"shallow"``: what the next two are unless given.
    volume_change_l, travel_mm
        Change of the lungs' volume in litres and travel of their lowest point.
    forward_mm
        How far the lungs move forward; None: 3 mm per 200 mm of their height.
    ribs
        ``"follow"``: ribs lift so that the front of the chest goes forward with the lungs, as far as there is room;
        ``"least"``: they make room for the lungs and no more.
    steps
        N, the value of the sweep variable at full inhalation.
    period_s
        Duration of one breath.
    frames
        Number of frames, evenly spaced in time; None: 2N + 1 at whole values of the sweep variable.
    times
        Times of the frames in seconds, separated by commas; None: as `frames` says.
    gap_mm
        The gap to keep between tissues, or that at rest where it is smaller.
    mass_tolerance
        Most change of the model's mass, as a share.
    lung_mass
        One of `mass.CONVENTIONS`.

    Raises
    ------
    UsageError
        If a value is not known or out of range.
    """

    known: ClassVar[Keys] = KEYS

    preset: str = "quiet"
    volume_change_l: float | None = None
    travel_mm: float | None = None
    forward_mm: float | None = None
    ribs: Literal["follow", "least"] = "follow"
    steps: int = STEPS
    period_s: float = PERIOD_S
    frames: int | None = None
    times: str | None = None
    gap_mm: float = 1.0
    mass_tolerance: float = 1e-3
    lung_mass: Convention = "fixed-mass"

    @property
    def targets(self) -> Targets:
        """Change of volume and travel."""
        preset = PRESETS[self.preset]
        return Targets(
            preset.lung_volume_change_l if self.volume_change_l is None else self.volume_change_l,
            preset.diaphragm_travel_mm if self.travel_mm is None else self.travel_mm,
        )

    def moments(self, steps: int, period_s: float) -> tuple[Moment, ...]:
        """Return the frames of a sequence with N steps.

        Raises
        ------
        UsageError
            If the times are not numbers.
        """
        if self.times is not None and self.frames is not None:
            raise UsageError("frames are given by their number or by their times, not both")
        if self.times is not None:
            try:
                return frames_at([float(text) for text in self.times.split(",")], period_s, steps)
            except ValueError as error:
                raise UsageError(
                    f"times: {error}", hint="seconds with commas between them, such as 0,1.25,2.5"
                ) from None
        return full_cycle(steps) if self.frames is None else even_frames(self.frames, steps)
