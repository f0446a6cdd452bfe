"""How the model lies: which way is left, back and up, where the midline is, and whether the unit can be right."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vhp_cli.errors import UsageError
from vhp_cli.stages.breathe.tissue import Tissue, box, of_part

Array = NDArray[np.float64]

# Height of lungs in mm that can be those of a person: from a child to a tall adult at full inspiration.
LUNG_HEIGHT_MM = (100.0, 400.0)

# A direction counts as told if this many times as long as noise: mm between the centres of left and right parts.
_LEAST_MM = 5.0
_NAMES = (("right", "left"), ("anterior", "posterior"), ("inferior", "superior"))


@dataclass(frozen=True, slots=True, eq=False)
class Axes:
    """The frame of a model.

    Parameters
    ----------
    to_lps : (3, 3) float64
        The signed permutation that takes coordinates of the files into LPS.
    said_by
        For each direction what it was told by, or "assumed".
    """

    to_lps: Array
    said_by: tuple[str, str, str]

    @property
    def name(self) -> str:
        """Where the axes of the files point, such as ``LPS`` or ``RAS``."""
        letters = ""
        for column in self.to_lps.T:
            direction = int(np.flatnonzero(column)[0])
            letters += _NAMES[direction][int(column[direction] > 0)][0].upper()
        return letters


def recognise(tissues: Sequence[Tissue]) -> Axes:
    """Find out where left, back and up are, from names and places; what nothing tells is as in LPS.

    Raises
    ------
    UsageError
        If the lungs' size speaks against millimetres, or the model is a mirror image or lies askew.
    """
    lungs = of_part(tissues, "lung")
    clues = (_leftward(tissues), _backward(tissues), _upward(tissues))
    rows, said_by = [], []
    for index, (vector, source) in enumerate(clues):
        row = np.zeros(3)
        if vector is None or np.linalg.norm(vector) < _LEAST_MM:
            row[index], source = 1.0, "assumed"
        else:
            axis = int(np.abs(vector).argmax())
            row[axis] = np.sign(vector[axis])
        rows.append(row)
        said_by.append(source)
    to_lps = np.array(rows)
    found = ", ".join(
        f"{_NAMES[index][1]} is {_axis_name(row)} ({source})"
        for index, (row, source) in enumerate(zip(rows, said_by, strict=True))
    )
    if np.abs(to_lps).sum(axis=0).max() > 1.0:
        raise UsageError(
            f"can't tell how the model lies: {found}",
            hint="give left and right parts their sides ([[tissue]] breathe = { role = ..., side = ... }), or turn the "
            "model so that its axes are those of the body",
        )
    if np.linalg.det(to_lps) < 0.0:
        raise UsageError(
            f"the model is a mirror image: {found}",
            hint="left and right are swapped in the names, or one axis was negated on export; mirror the model back",
        )
    axes = Axes(to_lps, (said_by[0], said_by[1], said_by[2]))
    low, high = box(lungs)
    height = float(np.ptp([low @ to_lps[2], high @ to_lps[2]]))
    if not LUNG_HEIGHT_MM[0] <= height <= LUNG_HEIGHT_MM[1]:
        raise UsageError(
            f"the lungs are {height:.4g} mm high, which is not the size of a person's",
            hint="say what the unit of the files is: --units cm, m, in or um",
        )
    return axes


def _axis_name(row: Array) -> str:
    axis = int(np.flatnonzero(row)[0])
    return ("+" if row[axis] > 0 else "-") + "xyz"[axis]


def _leftward(tissues: Sequence[Tissue]) -> tuple[Array | None, str]:
    """Return the way from right parts to left ones."""
    differences = []
    for left in (tissue for tissue in tissues if tissue.role.side == "left"):
        twins = [
            other
            for other in tissues
            if other.role.side == "right" and (other.role.part, other.role.number) == (left.role.part, left.role.number)
        ]
        if left.role.part in ("lung", "rib", "kidney", "bone", "cartilage") and len(twins) == 1:
            differences.append(left.centre - twins[0].centre)
    return (np.mean(differences, axis=0), "left and right parts") if differences else (None, "")


def _backward(tissues: Sequence[Tissue]) -> tuple[Array | None, str]:
    """Return the way from the chest to the spine, without what is up or down."""
    # Vertebrae and lungs span about the same heights, so that their middles differ from front to back.
    lungs, spine, front = of_part(tissues, "lung"), of_part(tissues, "vertebra"), of_part(tissues, "sternum")
    up, _ = _upward(tissues)
    low, high = box(lungs)
    if spine:
        near = [v for v in spine if ((v.upper >= low - 20) & (v.lower <= high + 20)).all()] or spine
        away, source = np.mean([v.centre for v in near], axis=0) - 0.5 * (low + high), "the spine"
    elif front:
        away, source = 0.5 * (low + high) - np.mean([f.centre for f in front], axis=0), "the sternum"
    else:
        return None, ""
    for direction in (up, _leftward(tissues)[0]):
        if direction is not None:
            axis = int(np.abs(direction).argmax())
            away = np.where(np.arange(3) == axis, 0.0, away)
    return away, source


def _upward(tissues: Sequence[Tissue]) -> tuple[Array | None, str]:
    """Return the way from the lower ribs to the upper ones, or from the belly to the lungs."""
    ribs = [tissue for tissue in of_part(tissues, "rib") if tissue.role.number]
    high = [tissue for tissue in ribs if (tissue.role.number or 0) <= 4]
    low = [tissue for tissue in ribs if (tissue.role.number or 0) >= 7]
    if high and low:
        return _along_one_axis(_difference(high, low)), "ribs"
    lungs, belly = of_part(tissues, "lung"), of_part(tissues, "liver", "stomach", "spleen", "kidney", "diaphragm")
    if belly:
        return _along_one_axis(_difference(lungs, belly)), "lungs above the belly"
    return None, ""


def _difference(high: Sequence[Tissue], low: Sequence[Tissue]) -> Array:
    way: Array = np.mean([t.centre for t in high], axis=0) - np.mean([t.centre for t in low], axis=0)
    return way


def _along_one_axis(vector: Array) -> Array:
    return np.where(np.arange(3) == np.abs(vector).argmax(), vector, 0.0)
