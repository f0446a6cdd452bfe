"""The shells: one smooth field for skin, fat and body, as large as holds the model's mass."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vhp_cli.stages.breathe.curves import Polynomial
from vhp_cli.stages.breathe.field import Field
from vhp_cli.stages.breathe.fitting.scene import Scene
from vhp_cli.stages.breathe.mass import MassModel
from vhp_cli.stages.breathe.operations import Parameter
from vhp_cli.stages.breathe.polynomials import fit_parameter
from vhp_cli.stages.breathe.sequence import Motion
from vhp_cli.stages.breathe.tissue import Tissue, box, volume

Array = NDArray[np.float64]

# Until the amplitude is known.
NO_AMPLITUDE = Parameter(Polynomial((0.0,)))
_SECANT_STEPS = 8
_LEAST_KG = 1e-9
# The share of the width and of the depth in front of the middle over which the field dies out.
_TAPER_X, _TAPER_Y = 0.25, 0.6
_LEAST_TAPER_MM = 60.0


def shell_field(
    shells: Sequence[Tissue], lungs: Sequence[Tissue], bottom: float, top: float, amplitude: Parameter
) -> Field:
    """Return the field that lifts the front of the trunk.

    Parameters
    ----------
    shells, lungs
        For width and depth: the field ends at the sides of the innermost shell and behind the middle of the lungs.
    bottom, top
        Heights between which the trunk rises.
    amplitude
        In mm, at its middle.
    """
    inner = min(shells, key=lambda shell: shell.volume_mm3)
    vertices = inner.mesh.vertices
    trunk = vertices[(vertices[:, 2] > bottom) & (vertices[:, 2] < top)]
    # Arms may be part of a shell: the lungs tell how wide the trunk is.
    chest_low, chest_high = box(lungs)
    reach = 0.25 * (chest_high[0] - chest_low[0])
    left = max(float(trunk[:, 0].min()), float(chest_low[0]) - reach)
    right = min(float(trunk[:, 0].max()), float(chest_high[0]) + reach)
    back = float(0.5 * (chest_low[1] + chest_high[1]))
    front = float(trunk[:, 1].min())
    return Field(
        "shells",
        amplitude,
        (left, right),
        (bottom, top),
        back,
        x_taper=min(max(_TAPER_X * (right - left), _LEAST_TAPER_MM), 0.5 * (right - left)),
        y_taper=max(_TAPER_Y * (back - front), _LEAST_TAPER_MM),
    )


def fit_shells(scene: Scene, shells: Sequence[Tissue], field: Field, mass: MassModel) -> list[float]:
    """Give the shells the field whose amplitude keeps the mass of the model at every step (secant method).

    Returns
    -------
    list of float
        The amplitude in mm at t = 1..N.
    """
    lifts = {shell.name: field.weight(shell.mesh.vertices)[:, None] * np.asarray(field.direction) for shell in shells}
    rest = mass.kg(mass.rest_mm3)
    amplitudes: list[float] = []
    for t in range(1, scene.steps + 1):
        others = volumes_at(scene, float(t), {shell.name for shell in shells}, mass.rest_mm3)

        def change(amplitude: float, others: Mapping[str, float] = others) -> float:
            volumes = dict(others)
            for shell in shells:
                volumes[shell.name] = abs(volume(shell.mesh.vertices + amplitude * lifts[shell.name], shell.mesh.faces))
            return mass.kg(volumes) - rest

        low, high = 0.0, 1.0
        change_low, change_high = change(low), change(high)
        for _ in range(_SECANT_STEPS):
            if abs(change_high) <= _LEAST_KG or change_high == change_low:
                break
            low, high = high, high - change_high * (high - low) / (change_high - change_low)
            change_low, change_high = change_high, change(high)
        amplitudes.append(high)
    fitted = replace(field, amplitude=fit_parameter(np.array(amplitudes), 0.0))
    for shell in shells:
        scene.set(shell.name, Motion(shell.name, fields=(fitted,), tissues=(shell.name,), role=shell.role.part))
    return amplitudes


def volumes_at(scene: Scene, t: float, leave_out: set[str], rest_mm3: Mapping[str, float]) -> dict[str, float]:
    """Return the volumes (mm3) of all tissues that have one at rest, where they are at `t`."""
    found = {}
    for name, at_rest in rest_mm3.items():
        if name in leave_out:
            continue
        motion, tissue = scene.motions.get(name), scene.tissues[name]
        if motion is None:
            found[name] = at_rest
        elif motion.operations:
            found[name] = at_rest * abs(float(np.linalg.det(motion.matrix(t)[:3, :3])))
        else:
            found[name] = abs(volume(motion.apply(tissue.mesh.vertices, t), tissue.mesh.faces))
    return found
