"""Tissues beyond the default phantom: discs, vessels, nerves, lymph nodes and what organs enclose."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from vhp_cli.phantom import torso, wall
from vhp_cli.phantom.curves import Array
from vhp_cli.phantom.parts import Part
from vhp_cli.phantom.shapes import ellipsoid, tube
from vhp_cli.phantom.surface import Surface

DETAIL, INTERCOSTAL, BRANCH, NODE = range(torso.DETAIL, torso.DETAIL + 4)


def disc(level: int) -> Surface:
    """Intervertebral disc below vertebra `level`."""
    upper, lower = (torso.vertebra_extent(at) for at in (level, level + 1))
    z = 0.5 * (upper.bottom + lower.top)
    y = float(wall.spine_y(np.array(z)))
    return ellipsoid(np.array([0.0, y, z]), np.diag([12.5, 9.0, 0.5 * (upper.bottom - lower.top) - 1.3]), fineness=0.6)


def intercostal(number: int, depth: float, radius: float) -> Surface:
    """Left nerve or vessel between the hind parts of rib `number` and the next, `depth` mm within the wall."""
    (angle, z), (next_angle, next_z) = torso.around_wall(number), torso.around_wall(number + 1)
    part = np.linspace(0.06, 0.34, 6)
    t = np.linspace(0, 1, 9)
    line = wall.on_wall(np.interp(part, t, 0.5 * (angle + next_angle)), np.interp(part, t, 0.5 * (z + next_z)), depth)
    return tube(line, radius, fineness=0.5, samples=81)


def directions(number: int) -> Array:
    """Return `number` directions spread evenly over the half sphere x > 0 (Fibonacci lattice)."""
    i = np.arange(number) + 0.5
    x, turn = i / number, np.pi * (1 + np.sqrt(5)) * i
    out = np.sqrt(1 - x * x)
    return np.stack([x, out * np.cos(turn), out * np.sin(turn)], axis=1)


def branch(root: Array, direction: Array, start: float, stop: float, radius: float) -> Surface:
    """Vessel that leaves `root` in a direction, bending a little downwards."""
    at = np.linspace(start, stop, 4)[:, None]
    points = root + at * direction - ((at - start) / 60.0) ** 2 * [0.0, 0.0, 8.0]
    return tube(points, np.array([radius, 0.8 * radius]), fineness=0.6, samples=41)


def further_parts() -> Iterator[Part]:
    """Yield the catalogue of further tissues."""
    yield from _spine_and_vessels()
    yield from _enclosed()
    for number in range(1, 12):
        yield Part(f"intercostal_nerve_{{side}}_{number:02d}", intercostal(number, 0.0, 1.0), INTERCOSTAL)
        yield Part(f"intercostal_artery_{{side}}_{number:02d}", intercostal(number, -3.6, 0.9), INTERCOSTAL)
        yield Part(f"intercostal_vein_{{side}}_{number:02d}", intercostal(number, 3.3, 0.9), INTERCOSTAL)
    root = np.array([82.0, 14.0, 96.0])
    kinds = (("bronchus", 2.4), ("pulmonary_artery_branch", 1.8), ("pulmonary_vein_branch", 1.8))
    for i, direction in enumerate(directions(24)):
        name, radius = kinds[i % 3]
        yield Part(f"{name}_{{side}}_{i // 3 + 1:02d}", branch(root, direction, 16.0, 40.0, radius), BRANCH)
    yield from _lymph_nodes()


def _spine_and_vessels() -> Iterator[Part]:
    for level in range(len(wall.LEVELS) - 1):
        name = f"intervertebral_disc_{wall.LEVELS[level]}_{wall.LEVELS[level + 1]}"
        yield Part(name, disc(level), DETAIL)
    z = np.array([-72.0, -100, -130, -160])
    psoas = np.stack([np.array([29.0, 32, 33, 34]), wall.spine_y(z) + np.array([2, 0, -2, -6]), z], axis=1)
    yield Part("psoas_major_{side}", tube(psoas, np.array([5.0, 8, 9, 7])), DETAIL)
    yield Part("adrenal_gland_{side}", ellipsoid(np.array([46.0, 42, -44]), np.diag([6.0, 4, 8])), DETAIL)
    yield Part("thyroid_lobe_{side}", ellipsoid(np.array([16.5, 1, 236]), np.diag([5.0, 5, 12])), DETAIL)
    carotid = np.array([[26, 8, 214], [27, 10, 240], [27, 10, 264.0]])
    yield Part("carotid_artery_{side}", tube(carotid, 3.0, fineness=0.6), DETAIL)
    jugular = np.array([[38, 6, 232], [37, 8, 245], [37, 8, 262.0]])
    yield Part("jugular_vein_{side}", tube(jugular, 4.0, fineness=0.6), DETAIL)
    z = np.linspace(150.0, 0.0, 6)
    for name, x, radius in (("azygos_vein", -18.0, 2.0), ("hemiazygos_vein", 18.0, 1.5)):
        upper = z if x < 0 else z - 40.0
        line = np.stack([np.full_like(upper, x), wall.spine_y(upper) - 8.0, upper], axis=1)
        yield Part(name, tube(line, radius, fineness=0.5), DETAIL)


def _enclosed() -> Iterator[Part]:
    """Chambers of the heart, vessels of the liver, and the renal pelvis."""
    side, up, apex = torso.HEART_AXES / np.linalg.norm(torso.HEART_AXES, axis=1)[:, None]
    chambers = {
        "heart_ventricle_left": (-15.0, 0.0, 12.0, (11.0, 15.0, 18.0)),
        "heart_ventricle_right": (14.0, 0.0, 12.0, (11.0, 15.0, 18.0)),
        "heart_atrium_left": (-14.0, 0.0, -23.0, (10.0, 13.0, 12.0)),
        "heart_atrium_right": (14.0, 0.0, -23.0, (10.0, 13.0, 12.0)),
    }
    for name, (a, b, c, radii) in chambers.items():
        axes = np.stack([radii[0] * side, radii[1] * up, radii[2] * apex])
        yield Part(name, ellipsoid(torso.HEART_CENTRE + a * side + b * up + c * apex, axes, fineness=0.7), BRANCH)
    pelvis = ellipsoid(torso.KIDNEY_CENTRE, torso.KIDNEY_AXES * 0.4, fineness=0.6)
    yield Part("renal_pelvis_{side}", pelvis, BRANCH)
    root = np.array([-58.0, -24.0, -46.0])
    for i, direction in enumerate(directions(6) * [-1, 1, 1]):
        name = ("hepatic_vein", "portal_vein_branch")[i % 2]
        yield Part(f"{name}_{i // 2 + 1:02d}", branch(root, direction, 10.0, 28.0, 2.5), BRANCH)


def _lymph_nodes() -> Iterator[Part]:
    axes = np.diag([2.6, 3.2, 4.2])
    for i in range(8):
        angle, z = np.radians(72.0 + 14.0 * (i % 2)), 84.0 + 10.0 * i
        centre = wall.on_wall(np.array(angle), np.array(z), -11.0)
        yield Part(f"axillary_lymph_node_{{side}}_{i + 1:02d}", ellipsoid(centre, axes, fineness=0.6), NODE)
    for i in range(12):
        centre = np.array([14.0 + 16.0 * (i % 4), -26.0 + 14.0 * (i // 4), -148.0 - 6.0 * (i % 3)])
        yield Part(f"mesenteric_lymph_node_{{side}}_{i + 1:02d}", ellipsoid(centre, axes, fineness=0.6), NODE)
