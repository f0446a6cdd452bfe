"""The lungs: volume and travel are met exactly, without a search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vhp_cli.errors import UsageError
from vhp_cli.stages.breathe.fitting.curves import at, even, even_move
from vhp_cli.stages.breathe.operations import Scale, Triple
from vhp_cli.stages.breathe.sequence import Motion, Targets
from vhp_cli.stages.breathe.tissue import Tissue, box

LITRE = 1e6  # mm3

# Scale across outside of these limits: volume and travel hardly suit these lungs.
ACROSS = (0.99, 1.05)
# How far the lungs of 200 mm height move forward (thesis A.1).
FORWARD_MM, FORWARD_HEIGHT_MM = 3.0, 200.0


@dataclass(frozen=True, slots=True)
class LungMotion:
    """How the lungs deform up to t = N: scaled about a point, then moved forward.

    Parameters
    ----------
    origin
        On the midline, at the back and the top of the lungs.
    across, along
        Scales in x and y, and in z.
    forward_mm
        Translation towards -y.
    height_mm
        Of the lungs at rest.
    """

    origin: Triple
    across: float
    along: float
    forward_mm: float
    height_mm: float

    def motion(self, name: str, tissues: tuple[str, ...], steps: int) -> Motion:
        """Return it as a motion."""
        across, along = even(self.across, steps, 1.0), even(self.along, steps, 1.0)
        operations = [Scale(at(self.origin), across, across, along)]
        if self.forward_mm:
            return Motion(
                name,
                (*operations, even_move((0.0, -self.forward_mm, 0.0), steps)),
                tissues=tissues,
                role="lung",
            )
        return Motion(name, tuple(operations), tissues=tissues, role="lung")


def fit_lungs(lungs: Sequence[Tissue], targets: Targets, midline: float, forward_mm: float | None) -> LungMotion:
    """Return the scales by which lungs gain the wanted volume while their lowest point travels as wanted.

    With the height H and the volume V: ``s_z = 1 + travel / H`` and ``s_x = s_y = sqrt((1 + dV / V) / s_z)``. With H
    = 200 mm and V = 2.22 l these are the 10 % and the 2 % by which the volumes of the thesis are met.

    Parameters
    ----------
    lungs
        All tissues of the lungs.
    targets
        Change of volume and travel.
    midline
        x of the plane between left and right.
    forward_mm
        How far they move forward; None: 3 mm per 200 mm of height.

    Raises
    ------
    UsageError
        If a surface is open, so that it has no volume.
    """
    for lung in lungs:
        if not lung.closed:
            raise UsageError(f"{lung.name}: the surface is open, so that it has no volume", hint="run vhp heal first")
    low, high = box(lungs)
    volume = sum(lung.volume_mm3 for lung in lungs)
    height = float(high[2] - low[2])
    along = 1.0 + targets.diaphragm_travel_mm / height
    across = float(np.sqrt((1.0 + targets.lung_volume_change_l * LITRE / volume) / along))
    if forward_mm is None:
        forward_mm = FORWARD_MM * height / FORWARD_HEIGHT_MM
    return LungMotion((midline, float(high[1]), float(high[2])), across, along, forward_mm, height)
