"""Affine operations, each in a local coordinate system with curves of the sweep variable as parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vhp_cli.stages.breathe.curves import Curve, Polynomial
from vhp_cli.stages.breathe.intervals import Interval, sine_and_cosine

Array = NDArray[np.float64]
Triple = tuple[float, float, float]
Axis = Literal["x", "y", "z"]
AXES: tuple[Axis, Axis, Axis] = ("x", "y", "z")

# How far the axes of a local coordinate system may be from unit length and from a right angle.
_AXIS_TOLERANCE = 1e-9


@dataclass(frozen=True, slots=True)
class LocalFrame:
    """A right-handed local coordinate system.

    Parameters
    ----------
    origin
        In mm.
    x_axis, y_axis
        Unit vectors at a right angle.

    Raises
    ------
    ValueError
        If a number is not finite, or the axes are more than 1e-9 from unit length or from a right angle.
    """

    origin: Triple = (0.0, 0.0, 0.0)
    x_axis: Triple = (1.0, 0.0, 0.0)
    y_axis: Triple = (0.0, 1.0, 0.0)

    def __post_init__(self) -> None:
        if not np.isfinite([self.origin, self.x_axis, self.y_axis]).all():
            raise ValueError("a local coordinate system needs finite numbers")
        x, y = np.asarray(self.x_axis), np.asarray(self.y_axis)
        if max(abs(np.linalg.norm(x) - 1.0), abs(np.linalg.norm(y) - 1.0), abs(x @ y)) > _AXIS_TOLERANCE:
            raise ValueError("the axes of a local coordinate system must be unit vectors at a right angle")

    @classmethod
    def along(cls, origin: ArrayLike, direction: ArrayLike) -> LocalFrame:
        """Return the local coordinate system with x along `direction` and y as near to the global y as possible."""
        x = np.asarray(direction, dtype=np.float64)
        x = x / np.linalg.norm(x)
        # Where x is near the global y, the global z takes its place.
        helper = np.array([0.0, 1.0, 0.0]) if abs(x[1]) < 0.9 else np.array([0.0, 0.0, 1.0])
        y = helper - x * (x @ helper)
        y /= np.linalg.norm(y)
        return cls(triple(origin), triple(x), triple(y))

    @property
    def basis(self) -> Array:
        """The axes as columns, (3, 3)."""
        x = np.asarray(self.x_axis)
        x = x / np.linalg.norm(x)
        # What is left of the tolerance would change lengths.
        y = np.asarray(self.y_axis) - x * (x @ np.asarray(self.y_axis))
        y = y / np.linalg.norm(y)
        return np.stack([x, y, np.cross(x, y)], axis=1)

    @property
    def z_axis(self) -> Triple:
        """The third axis."""
        return triple(self.basis[:, 2])


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of an operation: its curve and where that comes from.

    Parameters
    ----------
    curve
        Of the sweep variable; in mm (move, field), degrees (rotate) or 1 (scale).
    table
        The samples at t = 1..N that the curve was fitted to; may be empty.
    residual
        Largest distance of the curve from them.
    errata
        Entries of the list of errata that bear on it.
    """

    curve: Curve
    table: tuple[float, ...] = ()
    residual: float = 0.0
    errata: tuple[str, ...] = ()

    def constant(self) -> bool:
        """Tell whether the value is the same at all times."""
        return isinstance(self.curve, Polynomial) and not any(self.curve.coefficients[1:])


NO_MOVE = Parameter(Polynomial((0.0,)))
NO_SCALE = Parameter(Polynomial((1.0,)))


@dataclass(frozen=True, slots=True)
class Scale:
    """Scaling along the axes of a local coordinate system, its origin fixed."""

    frame: LocalFrame
    x: Parameter = NO_SCALE
    y: Parameter = NO_SCALE
    z: Parameter = NO_SCALE

    identity = 1.0

    def parameters(self) -> dict[str, Parameter]:
        """Return the parameters by name."""
        return {"x": self.x, "y": self.y, "z": self.z}


@dataclass(frozen=True, slots=True)
class Rotate:
    """Right-handed rotation by `angle` (degrees) about one axis of a local coordinate system."""

    frame: LocalFrame
    axis: Axis
    angle: Parameter

    identity = 0.0

    def __post_init__(self) -> None:
        if self.axis not in AXES:
            raise ValueError(f"an axis is x, y or z, not {self.axis!r}")

    def parameters(self) -> dict[str, Parameter]:
        """Return the parameters by name."""
        return {"angle": self.angle}


@dataclass(frozen=True, slots=True)
class Move:
    """Translation (mm) along the axes of a local coordinate system."""

    frame: LocalFrame
    x: Parameter = NO_MOVE
    y: Parameter = NO_MOVE
    z: Parameter = NO_MOVE

    identity = 0.0

    def parameters(self) -> dict[str, Parameter]:
        """Return the parameters by name."""
        return {"x": self.x, "y": self.y, "z": self.z}


Operation = Scale | Rotate | Move


def matrices(operation: Operation, times: Array) -> Array:
    """Return the matrices of an operation in homogeneous coordinates.

    Where all its parameters are the identity, so is the matrix, exactly.

    Parameters
    ----------
    operation
        The operation.
    times : (T,) float64
        Values of the sweep variable.

    Returns
    -------
    (T, 4, 4) float64
        To be multiplied by column vectors (x, y, z, 1) in mm.
    """
    values = {name: parameter.curve(times) for name, parameter in operation.parameters().items()}
    changed = np.any([value != operation.identity for value in values.values()], axis=0)
    origin, basis = np.asarray(operation.frame.origin), operation.frame.basis
    result = np.tile(np.eye(4), (len(times), 1, 1))
    if isinstance(operation, Move):
        offset = np.stack([values[axis] for axis in AXES], axis=1) @ basis.T
        result[changed, :3, 3] = offset[changed]
        return result
    if isinstance(operation, Scale):
        factors = np.stack([values[axis] for axis in AXES], axis=1)
        linear = np.einsum("ij,tj,kj->tik", basis, factors, basis)
    else:
        along, across, turned = _rotation_parts(operation)
        angle = np.radians(values["angle"])[:, None, None]
        linear = along + np.cos(angle) * across + np.sin(angle) * turned
    result[changed, :3, :3] = linear[changed]
    # The origin of the local coordinate system stays where it is.
    result[changed, :3, 3] = origin - linear[changed] @ origin
    return result


def _rotation_parts(operation: Rotate) -> tuple[Array, Array, Array]:
    """Return P, I - P and [a]x of the rotation ``P + cos (I - P) + sin [a]x`` about the axis a (Rodrigues)."""
    a = operation.frame.basis[:, AXES.index(operation.axis)]
    along = np.outer(a, a)
    turned = np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])
    return along, np.eye(3) - along, turned


@dataclass(frozen=True, slots=True, eq=False)
class Moments:
    """Enclosures of an affine map and of its derivative by t, over K intervals of t.

    Parameters
    ----------
    place, place_rate : (K, 3)
        Image of the base point, and its derivative.
    linear, linear_rate : (K, 3, 3)
        The linear part, and its derivative.
    """

    place: Interval
    place_rate: Interval
    linear: Interval
    linear_rate: Interval

    @classmethod
    def identity(cls, base: Array, count: int) -> Moments:
        """Return the enclosures of the identity, with the base point `base` (3,)."""
        zero = Interval.exactly(np.zeros((count, 3)))
        nothing = Interval.exactly(np.zeros((count, 3, 3)))
        return cls(
            Interval.exactly(np.tile(base, (count, 1))),
            zero,
            Interval.exactly(np.tile(np.eye(3), (count, 1, 1))),
            nothing,
        )

    def followed_by(self, operation: Operation, start: Array, end: Array) -> Moments:
        """Return the enclosures after one more operation, over the intervals from `start` to `end` (K,)."""
        values = {name: parameter.curve.bounds(start, end) for name, parameter in operation.parameters().items()}
        rates = {name: parameter.curve.slope_bounds(start, end) for name, parameter in operation.parameters().items()}
        basis = operation.frame.basis
        if isinstance(operation, Move):
            offset = _combination([(values[axis], basis[:, i]) for i, axis in enumerate(AXES)])
            speed = _combination([(rates[axis], basis[:, i]) for i, axis in enumerate(AXES)])
            return Moments(self.place + offset, self.place_rate + speed, self.linear, self.linear_rate)
        if isinstance(operation, Scale):
            projections = [np.outer(basis[:, i], basis[:, i]) for i in range(3)]
            matrix = _combination([(values[axis], projections[i]) for i, axis in enumerate(AXES)])
            rate = _combination([(rates[axis], projections[i]) for i, axis in enumerate(AXES)])
        else:
            along, across, turned = _rotation_parts(operation)
            degree = Interval.exactly(math.pi / 180.0)
            sine, cosine = sine_and_cosine(values["angle"] * degree)
            turning = rates["angle"] * degree
            one = Interval.exactly(np.ones(len(start)))
            matrix = _combination([(one, along), (cosine, across), (sine, turned)])
            rate = _combination([(-(turning * sine), across), (turning * cosine, turned)])
        origin = Interval.exactly(np.asarray(operation.frame.origin))
        arm = self.place - origin
        return Moments(
            origin + _times_vector(matrix, arm),
            _times_vector(rate, arm) + _times_vector(matrix, self.place_rate),
            matrix.matmul(self.linear),
            rate.matmul(self.linear) + matrix.matmul(self.linear_rate),
        )


def map_of(operations: tuple[Operation, ...], t: float) -> Array:
    """Return the affine map of operations, one after the other, at `t` in homogeneous coordinates, (4, 4)."""
    result: Array = np.eye(4)
    for operation in operations:
        result = matrices(operation, np.array([t]))[0] @ result
    return result


def velocities(operations: tuple[Operation, ...], points: Array, start: Array, end: Array) -> tuple[Array, Array]:
    """Return enclosures of the derivative by t of where operations carry `points`.

    Parameters
    ----------
    operations
        One after the other.
    points : (P, 3) float64
        At rest, in mm.
    start, end : (K,) float64
        Intervals of t.

    Returns
    -------
    tuple of (K, P, 3) float64
        Middle and radius, in mm per step.
    """
    base = 0.5 * (points.min(axis=0) + points.max(axis=0))
    moments = Moments.identity(base, len(start))
    for operation in operations:
        moments = moments.followed_by(operation, start, end)
    place, place_radius = moments.place_rate.middle_and_radius()
    linear, linear_radius = moments.linear_rate.middle_and_radius()
    arms = points - base
    velocity = arms @ np.swapaxes(linear, 1, 2) + place[:, None, :]
    radius = np.abs(arms) @ np.swapaxes(linear_radius, 1, 2) + place_radius[:, None, :]
    return velocity, radius


def _combination(terms: list[tuple[Interval, Array]]) -> Interval:
    """Return the sum of (K,) intervals times constant arrays."""
    total: Interval | None = None
    for factor, array in terms:
        term = factor.reshape(-1, *(1 for _ in array.shape)) * Interval.exactly(array[None])
        total = term if total is None else total + term
    assert total is not None
    return total


def _times_vector(matrix: Interval, vector: Interval) -> Interval:
    return matrix.matmul(vector.reshape(-1, 3, 1)).reshape(-1, 3)


def triple(values: ArrayLike) -> Triple:
    """Return three floats."""
    x, y, z = np.asarray(values, dtype=np.float64).tolist()
    return (x, y, z)
