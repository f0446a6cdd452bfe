"""A breathing sequence: which tissue moves how, as a function of the sweep variable.

The sweep variable t runs from 0, the model at rest (full exhalation), to N, full inhalation. Coordinates are in mm
in the frame LPS: +x to the subject's left, +y to the back, +z to the head.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vhp_cli.stages.breathe.blend import Blend
from vhp_cli.stages.breathe.field import Field
from vhp_cli.stages.breathe.operations import Operation, map_of, matrices, velocities
from vhp_cli.stages.breathe.profile import Profile

Array = NDArray[np.float64]
Displacement = Field | Profile | Blend

STEPS = 11
VARIABLE = "breath"

# Parts into which an interval of t is cut for a bound of the travel.
_PARTS = 4
# What rounding may add to the points themselves, in mm and as a share: far above, and far below what matters.
_SLACK_MM = 1e-9
_SLACK = 1e-9


@dataclass(frozen=True, slots=True)
class Motion:
    """How one tissue moves: affine operations one after the other, or displacement fields.

    Parameters
    ----------
    name
        Of the motion, once in a sequence.
    operations
        Applied in this order, each to the result of the one before, in coordinate systems that stand still.
    fields
        Displacements of the points at rest, added up; only without operations.
    tissues
        Names of the tissues that move so; empty: all of the role.
    role, side, number
        What the tissue is, as ``"rib"``, ``"left"``, 6; empty or None where it does not matter.
    name_has
        A word of the tissue's name, where the role alone does not tell two motions apart, as ``"minor"``.
    errata
        Entries of the list of errata that bear on it.
    note
        A remark for the reader.

    Raises
    ------
    ValueError
        If it has both operations and fields.
    """

    name: str
    operations: tuple[Operation, ...] = ()
    fields: tuple[Displacement, ...] = ()
    tissues: tuple[str, ...] = ()
    role: str = ""
    side: str = ""
    number: int | None = None
    name_has: str = ""
    errata: tuple[str, ...] = ()
    note: str = ""

    def __post_init__(self) -> None:
        if self.operations and self.fields:
            raise ValueError(f"the motion {self.name!r} has both operations and fields")

    def matrices(self, times: ArrayLike) -> Array:
        """Return the affine maps at `times` (T,) in homogeneous coordinates, (T, 4, 4).

        Where every parameter is the identity, so is the matrix, exactly.
        """
        moments = np.atleast_1d(np.asarray(times, dtype=np.float64))
        result: Array = np.tile(np.eye(4), (len(moments), 1, 1))
        for operation in self.operations:
            result = matrices(operation, moments) @ result
        return result

    def matrix(self, t: float) -> Array:
        """Return the affine map at `t` in homogeneous coordinates, (4, 4)."""
        return map_of(self.operations, t)

    def apply(self, points: ArrayLike, t: float) -> Array:
        """Return `points` (P, 3) where they are at `t`; at rest, the same numbers."""
        rest = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        if self.fields:
            displaced: Array = rest + np.sum([field.displacement(rest, t) for field in self.fields], axis=0)
            return displaced
        matrix = self.matrix(t)
        if np.array_equal(matrix, np.eye(4)):
            return rest.copy()
        moved: Array = rest @ matrix[:3, :3].T + matrix[:3, 3]
        return moved

    def travel_bound(self, points: ArrayLike, start: float, end: float) -> float:
        """Return an upper bound of the length of path, in mm, of any of `points` from `start` to `end`.

        It holds for every point of their convex hull when the motion is affine (so that the eight corners of a
        box do for all in it), and for every point of triangles whose vertices they are in any case.
        """
        return float(self.travel_bounds(points, [start, end])[0])

    def travel_bounds(self, points: ArrayLike, times: ArrayLike, parts: int = _PARTS) -> Array:
        """Return the bounds of `travel_bound` between consecutive `times`.

        Parameters
        ----------
        points : (P, 3) float64
            At rest, in mm.
        times : (T,) float64
            Ascending values of the sweep variable.
        parts
            Into how many parts each interval is cut: more give a closer bound and take longer.

        Returns
        -------
        (T - 1,) float64
            In mm. From enclosures of the derivative by interval arithmetic, so the path is never longer.
        """
        paths = self.paths(points, times, parts)
        bounds: Array = paths.max(axis=1) if paths.shape[1] else np.zeros(len(paths))
        return bounds

    def paths(self, points: ArrayLike, times: ArrayLike, parts: int = _PARTS) -> Array:
        """Return the bounds of `travel_bounds` for each of `points`, (T - 1, P) mm."""
        rest = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        grid = np.asarray(times, dtype=np.float64)
        cuts = np.linspace(grid[:-1], grid[1:], parts + 1)
        cuts[0], cuts[-1] = grid[:-1], grid[1:]
        start, end = cuts[:-1].T.reshape(-1), cuts[1:].T.reshape(-1)
        if not len(rest) or not (self.operations or self.fields):
            return np.zeros((len(grid) - 1, len(rest)))
        speeds = self.speeds(rest, start, end)
        paths = (speeds * (end - start)[:, None]).reshape(len(grid) - 1, parts, len(rest)).sum(axis=1)
        bounds: Array = paths * (1.0 + _SLACK) + _SLACK_MM
        return bounds

    def speeds(self, rest: Array, start: Array, end: Array) -> Array:
        """Return upper bounds of the speed of points (P, 3) in intervals of t from `start` to `end` (K,), (K, P)."""
        if self.fields:
            total: Array = np.sum([field.speeds(rest, start, end) for field in self.fields], axis=0)
            return total
        velocity, radius = velocities(self.operations, rest, start, end)
        bounds: Array = np.linalg.norm(np.abs(velocity) + radius, axis=2)
        return bounds


@dataclass(frozen=True, slots=True)
class Targets:
    """What a breath is to achieve.

    Parameters
    ----------
    lung_volume_change_l
        Change of the lungs' volume from rest to t = N, in litres.
    diaphragm_travel_mm
        Travel of the lowest point of the lungs.
    """

    lung_volume_change_l: float = 0.32
    diaphragm_travel_mm: float = 20.0


@dataclass(frozen=True, slots=True)
class Sequence:
    """A breathing sequence.

    Parameters
    ----------
    name
        Of the sequence.
    motions
        One per tissue or role; tissues without one stay.
    steps
        N, the value of the sweep variable at full inhalation.
    period_s
        Duration of one breath in seconds.
    variable
        Name of the sweep variable in scripts.
    targets
        What the breath is to achieve.
    identity_at_rest
        Whether t = 0 is the model as it is. False only for a published sequence as printed, which misses it.
    description, source
        Remarks for the reader: what it is, and where it comes from.
    errata
        Entries of the list of errata that bear on all of it.

    Raises
    ------
    ValueError
        If N, the period or a name is not usable, two motions have one name, or `identity_at_rest` does not hold.
    """

    name: str
    motions: tuple[Motion, ...]
    steps: int = STEPS
    period_s: float = 5.0
    variable: str = VARIABLE
    targets: Targets = Targets()
    identity_at_rest: bool = True
    description: str = ""
    source: str = ""
    errata: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.steps < 1:
            raise ValueError(f"the number of steps must be 1 or more, not {self.steps}")
        if not self.period_s > 0.0:
            raise ValueError(f"the period must be above 0 seconds, not {self.period_s}")
        if not (self.variable.isascii() and self.variable.isidentifier()):
            raise ValueError(f"the sweep variable needs a name of letters, digits and _, not {self.variable!r}")
        names = [motion.name for motion in self.motions]
        if len(set(names)) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            raise ValueError(f"two motions have the name {twice!r}")
        if self.identity_at_rest:
            for motion in self.motions:
                _check_rest(motion)

    def motion(self, name: str) -> Motion:
        """Return the motion of this name; `KeyError` if there is none."""
        for motion in self.motions:
            if motion.name == name:
                return motion
        raise KeyError(name)


def _check_rest(motion: Motion) -> None:
    for number, operation in enumerate(motion.operations, start=1):
        for name, parameter in operation.parameters().items():
            if float(parameter.curve(0.0)) != operation.identity:
                raise ValueError(
                    f"operation {number} of the motion {motion.name!r}: {name} is {float(parameter.curve(0.0))!r} "
                    f"at t = 0 instead of {operation.identity}"
                )
    for field in motion.fields:
        if not field.rests():
            raise ValueError(f"the field {field.name!r} of the motion {motion.name!r} is not 0 at t = 0")
