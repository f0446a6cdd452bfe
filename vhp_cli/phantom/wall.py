"""The body wall of the phantom: the surface on which the ribs lie, the spine and the diaphragm's dome.

Everything is in mm in the LPS frame: +x to the subject's left, +y posterior, +z superior. The level z = 0
is that of the eleventh thoracic vertebra. The proportions are those of a tall adult with full lungs.
"""

from __future__ import annotations

import numpy as np

from vhp_cli.phantom.curves import Array, monotone_curve
from vhp_cli.phantom.shapes import Field

# Half width, half depth and middle (y) of the wall at the height z. Below the ribs it is the abdominal wall.
_Z = np.array([-190.0, -100.0, -40.0, 10.0, 60.0, 110.0, 155.0, 190.0, 210.0, 226.0])
half_width = monotone_curve(_Z, np.array([149.0, 142.0, 149.0, 154.0, 152.0, 143.0, 122.0, 93.0, 72.0, 54.0]))
half_depth = monotone_curve(_Z, np.array([102.0, 99.0, 105.0, 109.0, 107.0, 100.0, 86.0, 68.0, 55.0, 46.0]))
middle = monotone_curve(_Z, np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 4.0, 9.0, 15.0, 20.0]))
spine_y = monotone_curve(
    np.array([-190.0, -105.0, -20.0, 90.0, 178.0, 222.0]), np.array([56.0, 52.0, 60.0, 66.0, 55.0, 42.0])
)

LEVELS = (*(f"t{i:02d}" for i in range(1, 13)), "l1", "l2", "l3")
LEVEL_Z = np.concatenate([222.0 - 22.0 * np.arange(12), -20.0 - 27.0 * np.arange(1, 4)])

# Per rib 1..12: how far the front end lies below the head, and its angle around the wall from the back.
RIB_DROP = np.array([36, 45, 52, 58, 62, 66, 70, 74, 74, 72, 46, 30.0])
RIB_TIP = np.radians([138, 145, 146, 145, 142, 139, 135, 129, 122, 115, 84, 62.0])
RIB_HALF_HEIGHT, RIB_HALF_THICKNESS = 5.3, 3.2

DOME_RIM_Z, DOME_HEIGHT = -48.0, 56.0


def on_wall(angle: Array, z: Array, depth: Array | float = 0.0) -> Array:
    """Point of the wall at an angle around it (0 back, 90 deg left, 180 deg front), `depth` mm inwards."""
    a, b = half_width(z), half_depth(z)
    normal = np.stack([np.sin(angle) / a, np.cos(angle) / b], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1)[..., None]
    x = a * np.sin(angle) - depth * normal[..., 0]
    y = middle(z) + b * np.cos(angle) - depth * normal[..., 1]
    return np.stack(np.broadcast_arrays(x, y, z), axis=-1)


def outward(points: Array) -> Array:
    """Outer normal of the wall at points (n, 3) near it, by central differences."""
    field, step = inside_wall(0.0), 0.5 * np.eye(3)
    gradient = np.stack([field(points + e) - field(points - e) for e in step], axis=-1)
    normal: Array = gradient / np.linalg.norm(gradient, axis=-1)[..., None]
    return normal


def inside_wall(depth: float, depth_at_top: float | None = None) -> Field:
    """Field of what lies at least `depth` mm within the wall (more where it closes in at the top)."""
    top = depth if depth_at_top is None else depth_at_top

    def field(p: Array) -> Array:
        z = p[..., 2]
        inset = depth + (top - depth) * np.clip((z - 120.0) / 90.0, 0, 1)
        a, b = half_width(z) - inset, half_depth(z) - inset
        radius = np.hypot(p[..., 0] / a, (p[..., 1] - middle(z)) / b)
        result: Array = (radius - 1) * np.minimum(a, b)
        return result

    return field


def dome(x: Array, y: Array) -> Array:
    """Height of the diaphragm's middle surface."""
    result: Array = DOME_RIM_Z + DOME_HEIGHT * (1 - (x / 142.0) ** 2 - ((y + 6.0) / 100.0) ** 2)
    return result


def above_dome(gap: float) -> Field:
    """Field of what lies at least `gap` mm above the diaphragm's middle surface, measured upright."""
    return lambda p: dome(p[..., 0], p[..., 1]) + gap - p[..., 2]


def below_dome(gap: float) -> Field:
    """Field of what lies at least `gap` mm below the diaphragm's middle surface, measured upright."""
    return lambda p: p[..., 2] - dome(p[..., 0], p[..., 1]) + gap


def half_space(normal: tuple[float, float, float], through: tuple[float, float, float]) -> Field:
    """Field of the side of a plane that its normal points away from."""
    direction = np.array(normal) / np.linalg.norm(normal)
    offset = float(direction @ np.array(through))
    return lambda p: p @ direction - offset


def in_ellipsoid(centre: Array, axes: Array) -> Field:
    """Field of an ellipsoid with half axes `axes` (3, 3) as rows, orthogonal to each other."""
    lengths = np.linalg.norm(axes, axis=1)
    to_unit = (axes / lengths[:, None] ** 2).T
    origin = np.asarray(centre, float)
    return lambda p: (np.linalg.norm((p - origin) @ to_unit, axis=-1) - 1) * float(lengths.min())


def outside_ellipsoid(centre: Array, axes: Array, gap: float) -> Field:
    """Field of what lies outside an ellipsoid whose half axes are longer by `gap` mm."""
    lengths = np.linalg.norm(axes, axis=1)[:, None]
    grown = in_ellipsoid(centre, axes * (1 + gap / lengths))
    return lambda p: -grown(p)
