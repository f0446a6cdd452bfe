"""The tissues of the default phantom, in anatomical order."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from vhp_cli.phantom import wall
from vhp_cli.phantom.curves import Array, monotone_curve
from vhp_cli.phantom.parts import Part
from vhp_cli.phantom.shapes import carved, ellipsoid, first_outside, plate, smooth_intersection, stacked, tube
from vhp_cli.phantom.surface import Surface

# Ranks: what a model of few tissues is made of comes first.
SHELL, LUNG, RIB, ORGAN, BONE, MUSCLE, VESSEL, CARTILAGE, NERVE, VERTEBRA, DETAIL = range(11)

DIAPHRAGM_HALF_THICKNESS = 2.0
DIAPHRAGM_SQUEEZE = 2.1
HEART_CENTRE = np.array([14.0, -31.0, 71.0])
KIDNEY_CENTRE, KIDNEY_AXES = np.array([64.0, 36.0, -97.0]), np.diag([19.0, 16.0, 42.0])


def _heart_axes() -> Array:
    """Half axes of the heart as rows, the long one from base to apex last."""
    apex = np.array([0.62, -0.42, -0.66])
    apex /= np.linalg.norm(apex)
    side = np.cross(apex, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    return np.stack([40.0 * side, 38.0 * np.cross(apex, side), 53.0 * apex])


HEART_AXES = _heart_axes()


def average_body() -> Surface:
    """Body without fat and skin: neck stub above, waist below, no arms."""
    z = np.array([-190, -100, -40, 10, 60, 110, 155, 185, 205, 222, 240, 258, 278.0])
    width = monotone_curve(z, np.array([160, 154, 162, 168, 167, 163, 161, 160, 157, 148, 112, 76, 64.0]))
    front = monotone_curve(z, -np.array([127, 124, 130, 134, 132, 124, 106, 85, 70, 56, 50, 48, 47.0]))
    back = monotone_curve(z, np.array([106, 106, 115, 119, 117, 114, 107, 102, 98, 90, 80, 70, 64.0]))
    levels = np.linspace(z[0], z[-1], 140)
    lean = np.linspace(0, np.pi / 2, 20)[:-1]
    rise, shrink = np.cos(lean), np.sin(lean) ** 0.8
    heights = np.concatenate([levels[0] - 36 * rise, levels, (levels[-1] + 26 * rise)[::-1]])
    scale = np.concatenate([shrink, np.ones(len(levels)), shrink[::-1]])
    centres = np.stack([np.zeros_like(heights), 0.5 * (front(heights) + back(heights)), heights], axis=1)
    across = (width(heights) * scale)[:, None] * [1.0, 0.0, 0.0]
    along = (0.5 * (back(heights) - front(heights)) * scale)[:, None] * [0.0, 1.0, 0.0]
    return stacked(centres, across, along, np.zeros(len(heights)), exponent=2.4, coarsest=36.0, fineness=1.7, around=64)


def lung(side: int) -> Surface:
    """Lung of the left (+1) or right (-1) side: what heart, spine, ribs and diaphragm leave free."""

    def behind(p: Array) -> Array:
        # In front of the rib necks, which run backwards from the spine.
        x, y = side * p[..., 0], p[..., 1] - wall.spine_y(p[..., 2])
        result: Array = 0.94 * y - 0.35 * (x - 45.0)
        return result

    def beside_heart(p: Array) -> Array:
        y, z = p[..., 1] + 36.0, p[..., 2] - 60.0
        bulge = (33.0 if side > 0 else 2.0) * np.exp(-((y / 70.0) ** 2) - (z / 70.0) ** 2)
        result: Array = (38.0 if side > 0 else 42.0) + bulge - side * p[..., 0]
        return result

    field = smooth_intersection(
        wall.inside_wall(6.8, 14.0),
        beside_heart,
        wall.in_ellipsoid(np.array([side * 58.0, 10.0, 60.0]), np.diag([115.0, 140.0, 149.0])),
        wall.above_dome(DIAPHRAGM_HALF_THICKNESS + 4.5),
        behind,
        blend=8.0,
    )
    return carved(
        np.array([side * 106.0, 2.0, 62.0]), np.array([45.0, 75.0, 110.0]), field, coarsest=20.0, fineness=1.2
    )


def around_wall(number: int) -> tuple[Array, Array]:
    """Angle and height along rib `number` (1..12) from where it meets the wall to its tip, nine values each."""
    i = number - 1
    head_z = float(wall.LEVEL_Z[i])
    first = np.arcsin(min(0.92, 62.0 / float(wall.half_width(np.array(head_z - 3)))))
    t = np.linspace(0, 1, 9)
    return first + (wall.RIB_TIP[i] - first) * t, head_z + 1.0 - wall.RIB_DROP[i] * (0.2 * t + 0.8 * t**1.3)


def rib_line(number: int) -> Array:
    """Points along the left rib `number` (1..12), from its head beside the spine around the wall to its tip."""
    head_z = float(wall.LEVEL_Z[number - 1])
    spine = float(wall.spine_y(np.array(head_z)))
    neck = np.array([[20.5, spine + 2.0, head_z + 4.0], [43.0, spine + 8.0, head_z + 3.0]])
    return np.concatenate([neck, wall.on_wall(*around_wall(number))])


def rib(number: int) -> Surface:
    """Left rib with its head beside the spine."""
    taper = np.array([0.7, 0.85, 1, 1, 1, 1, 1, 1, 1, 0.95, 0.72])
    return tube(
        rib_line(number),
        wall.RIB_HALF_HEIGHT * taper,
        wall.RIB_HALF_THICKNESS,
        facing=wall.outward,
        fineness=0.6,
        stretch=3.6,
    )


VERTEBRA_HALF_HEIGHT = 8.2
STERNUM_Z = (192.0, 46.0)
# Height at which the cartilages 1..7 meet the sternum, and angle and height where 8..10 end below the one above.
CARTILAGE_Z = (184.0, 153.0, 131.0, 111.5, 94.0, 78.5, 63.0)
CARTILAGE_END = {8: (149.0, 17.0), 9: (135.5, -16.0), 10: (129.0, -41.0)}


def cartilage(number: int) -> Surface:
    """Left costal cartilage: from beyond the tip of its rib to the sternum (1..7) or the one above (8..10)."""
    i = number - 1
    tip = rib_line(number)[-1]
    start = wall.RIB_TIP[i] + 11.0 / float(np.hypot(tip[0], tip[1] - float(wall.middle(tip[2]))))
    if number <= 7:
        end_z = CARTILAGE_Z[i]
        end = np.pi - np.arcsin(24.0 / float(wall.half_width(np.array(end_z))))
    else:
        end, end_z = np.radians(CARTILAGE_END[number][0]), CARTILAGE_END[number][1]
    t = np.linspace(0, 1, 6)
    z = tip[2] - 1.0 + (end_z - tip[2] + 1.0) * t ** (1.25 if number <= 7 else 1.0)
    taper = np.array([0.85, 1, 1, 1, 1, 0.85])
    return tube(wall.on_wall(start + (end - start) * t, z), 4.0 * taper, 3.3, facing=wall.outward, fineness=0.6)


def sternum() -> Surface:
    """Breastbone as one flat bar."""
    z = np.linspace(*STERNUM_Z, 7)
    width = np.array([7, 16, 17.5, 15, 15, 16, 16, 15, 10, 6.0])
    return tube(
        wall.on_wall(np.full(7, np.pi), z), width, 5.0, facing=wall.outward, exponent=2.5, coarsest=10.0, fineness=0.7
    )


class Extent(NamedTuple):
    """Lowest and highest z of a tissue in mm."""

    bottom: float
    top: float


def _vertebra_scale(level: int) -> Array:
    """Width, depth and height in proportion to a thoracic vertebra."""
    return np.array([1.3, 1.25, 1.25]) if level >= 12 else np.ones(3)


def vertebra_extent(level: int) -> Extent:
    """Extent of a vertebral body."""
    z, half = float(wall.LEVEL_Z[level]), VERTEBRA_HALF_HEIGHT * float(_vertebra_scale(level)[2])
    return Extent(z - half, z + half)


def vertebra(level: int) -> Surface:
    """Vertebra with body and spinous process, without a canal."""
    scale = _vertebra_scale(level)
    z = float(wall.LEVEL_Z[level])
    y = float(wall.spine_y(np.array(z)))
    points = np.array([[0, y + at, z] for at in (-6.0 * scale[1], 10.0, 24.0, 36.0)])
    width = np.array([8, 12.5, 14, 14, 12, 8.5, 6, 5, 4.5, 4, 3.5, 3.5]) * scale[0]
    top = VERTEBRA_HALF_HEIGHT
    height = np.array([5.5, 7.6, top, top, 7.2, 5.8, 5, 4.5, 4.2, 4, 3.5, 3.5]) * scale[2]
    return tube(
        points,
        width,
        height,
        facing=lambda p: np.tile([0.0, 0.0, 1.0], (len(p), 1)),
        exponent=2.5,
        coarsest=12.0,
        fineness=0.65,
    )


def clavicle() -> Surface:
    """Left collar bone."""
    points = np.array([[20, -49, 207], [52, -43, 212], [84, -24, 216], [110, -2, 217], [130, 10, 216.0]])
    return tube(points, np.array([6.5, 5.0, 5.0, 5.5, 6.5]), np.array([5.5, 4.5, 4.5, 5.0, 5.0]), fineness=0.6)


def diaphragm() -> Surface:
    """Dome between chest and belly, cut back behind for aorta, oesophagus and vena cava."""

    def on_dome(p: Array) -> Array:
        x, y = DIAPHRAGM_SQUEEZE * p[..., 0], p[..., 1]
        return np.stack([x, y, wall.dome(x, y)], axis=-1)

    def in_front_of_vessels(p: Array) -> Array:
        x, y, _ = np.moveaxis(on_dome(p), -1, 0)
        result: Array = y - np.hypot(0.15 * x, 20.0)
        return result

    within = wall.inside_wall(9.0)
    field = smooth_intersection(lambda p: within(on_dome(p)), in_front_of_vessels, blend=20.0)
    centre = np.array([0.0, -42.0, 0.0])
    angles = np.linspace(0, 2 * np.pi, 1441)
    rays = np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=1)
    radii = first_outside(centre, rays, field, 200.0)

    def outline(theta: Array) -> Array:
        return np.interp(theta % (2 * np.pi), angles, radii)

    return plate(
        outline,
        centre[:2],
        DIAPHRAGM_HALF_THICKNESS,
        wall.dome,
        squeeze=DIAPHRAGM_SQUEEZE,
        coarsest=17.0,
        fineness=1.1,
        around=72,
    )


def heart() -> Surface:
    """Heart with its apex to the left, front and below."""
    return ellipsoid(HEART_CENTRE, HEART_AXES, egg=-0.08, coarsest=20.0)


def liver() -> Surface:
    """Liver under the right dome."""
    field = smooth_intersection(
        wall.inside_wall(9.0),
        wall.below_dome(DIAPHRAGM_HALF_THICKNESS + 4.5),
        wall.in_ellipsoid(np.array([-58.0, -12.0, -32.0]), np.diag([112.0, 102.0, 84.0])),
        wall.half_space((1, 0, 0), (24.0, 0, 0)),
        wall.half_space((0.537, 0.844, 0), (-16.0, 10.0, 0)),
        wall.half_space((0, 0.92, -0.39), (0, 4.0, -97.0)),
        blend=11.0,
    )
    return carved(np.array([-66.0, -10.0, -46.0]), np.array([75.0, 65.0, 50.0]), field, coarsest=20.0)


def stomach() -> Surface:
    """Stomach under the left dome."""
    field = smooth_intersection(
        wall.inside_wall(9.0),
        wall.below_dome(DIAPHRAGM_HALF_THICKNESS + 4.5),
        wall.in_ellipsoid(np.array([64.0, -26.0, -28.0]), np.diag([56.0, 64.0, 54.0])),
        wall.half_space((-1, 0, 0), (29.0, 0, 0)),
        wall.half_space((0, 1, 0), (0, 12.0, 0)),
    )
    return carved(np.array([70.0, -28.0, -30.0]), np.array([45.0, 45.0, 45.0]), field, coarsest=18.0)


def spleen() -> Surface:
    """Spleen behind the stomach."""
    field = smooth_intersection(
        wall.inside_wall(9.0),
        wall.below_dome(DIAPHRAGM_HALF_THICKNESS + 4.5),
        wall.in_ellipsoid(np.array([94.0, 46.0, -44.0]), np.diag([28.0, 36.0, 38.0])),
        wall.half_space((0, -1, 0), (0, 18.0, 0)),
        wall.outside_ellipsoid(KIDNEY_CENTRE, KIDNEY_AXES, 5.0),
    )
    return carved(np.array([96.0, 44.0, -46.0]), np.array([20.0, 28.0, 30.0]), field, coarsest=10.0)


def pectoralis_major() -> Surface:
    """Left breast muscle over the ribs 2 to 6."""
    angle = np.radians([161, 150, 136, 120, 105.0])
    line = wall.on_wall(angle, np.array([112, 115, 123, 137, 152.0]), -14.5)
    width = np.array([8, 24, 33, 37, 36, 32, 25, 17, 8.0])
    return tube(line, width, 5.2, facing=wall.outward, exponent=2.4, coarsest=18.0)


def rectus_abdominis() -> Surface:
    """Left straight muscle of the belly, from the lower cartilages downwards."""
    z = np.linspace(38.0, -165.0, 9)
    line = wall.on_wall(np.pi - np.arcsin(36.0 / wall.half_width(z)), z, -13.5)
    width = np.array([8, 20, 25, 26, 26, 26, 25, 22, 16, 8.0])
    return tube(line, width, 4.8, facing=wall.outward, exponent=2.4, coarsest=18.0)


def erector_spinae() -> Surface:
    """Left back muscle beside the spinous processes."""
    z = np.linspace(200.0, -165.0, 10)
    line = np.stack([np.full_like(z, 27.0), wall.spine_y(z) + 28.0, z], axis=1)
    scale = np.array([0.5, 0.75, 0.9, 1, 1, 1, 1, 1, 0.9, 0.7])
    return tube(line, 12.5 * scale, 10.0 * scale, facing=lambda p: np.tile([0.0, 1.0, 0.0], (len(p), 1)), coarsest=20.0)


def _beside_spine(z: Array, x: float, before: float) -> Array:
    return np.stack([np.full_like(z, x), wall.spine_y(z) - before, z], axis=1)


def aorta() -> Surface:
    """Aorta: ascending, arch and descending to the belly."""
    arch = np.array([[-2, -14, 129], [-1, -9, 148], [8, 5, 166], [19, 22, 167], [24, 37, 150.0]])
    down = _beside_spine(np.array([115.0, 75, 30, -10]), 22.0, 22.0)
    belly = _beside_spine(np.array([-60.0, -105, -150]), 13.0, 27.0)
    return tube(np.concatenate([arch, down, belly]), np.array([10.5, 10, 9.5, 9.5, 9, 8.5]), fineness=0.7)


def vena_cava() -> Surface:
    """Upper and lower vena cava as one vessel, passing behind the right of the heart."""
    upper = np.array([[-26, -2, 176], [-27, 2, 150], [-26, 22, 115.0]])
    down = _beside_spine(np.array([75.0, 30, -10]), -25.0, 22.0)
    belly = _beside_spine(np.array([-60.0, -105, -150]), -15.0, 27.0)
    return tube(np.concatenate([upper, down, belly]), np.array([8.5, 9, 9.5, 9.5, 10]), fineness=0.7)


def oesophagus() -> Surface:
    """Gullet from the neck to the diaphragm, in front of the spine."""
    return tube(_beside_spine(np.array([266.0, 225, 180, 135, 90, 45, 20]), 0.0, 21.0), 6.0, fineness=0.6)


def trachea() -> Surface:
    """Windpipe from the neck to behind the aortic arch."""
    return tube(np.array([[0, 4, 272], [0, 3, 235], [-5, 11, 195], [-10, 20, 152.0]]), 7.5, fineness=0.6)


def phrenic_nerve(side: int) -> Surface:
    """Nerve of 2 mm from the neck over the side of the heart to the diaphragm."""
    z = np.array([218.0, 200, 175, 145, 120, 100, 82, 64, 46])
    y = np.array([10.0, 6, 0, -6, -12, -16, -18, -20, -20])
    scale = 1 + 4.5 / np.linalg.norm(HEART_AXES, axis=1)
    grown = wall.in_ellipsoid(HEART_CENTRE, HEART_AXES * scale[:, None])
    steps = np.arange(33.0 if side > 0 else 38.5, 90.0, 0.25)
    x = np.array(
        [
            steps[np.flatnonzero(grown(np.stack([side * steps, 0 * steps + b, 0 * steps + a], axis=1)) > 0)[0]]
            for a, b in zip(z, y, strict=True)
        ]
    )
    keep = z > wall.dome(x, y) + 10.0
    return tube(np.stack([side * x, y, z], axis=1)[keep], 1.0, fineness=0.5)


def vagus_nerve(side: int) -> Surface:
    """Nerve of 2 mm beside the gullet."""
    line = _beside_spine(np.array([200.0, 180, 150, 120, 90, 62]), side * 9.3, 21.0)
    neck = np.array([[side * 16.0, 11.0, 242.0], [side * 13.5, 18.0, 222.0]])
    return tube(np.concatenate([neck, line]), 1.0, fineness=0.5)


def internal_thoracic_artery() -> Surface:
    """Left artery of 2.4 mm behind the costal cartilages, beside the sternum."""
    z = np.linspace(186.0, 62.0, 8)
    return tube(wall.on_wall(np.pi - np.arcsin(25.0 / wall.half_width(z)), z, 9.0), 1.2, fineness=0.5)


def default_parts() -> Iterator[Part]:
    """Yield the catalogue of the default phantom but for fat and skin, which follow from the body."""
    yield Part("average_body", average_body(), SHELL)
    yield Part("lung_left", lung(1), LUNG)
    yield Part("lung_right", lung(-1), LUNG)
    yield Part("heart", heart(), ORGAN)
    yield Part("liver", liver(), ORGAN)
    yield Part("stomach", stomach(), ORGAN)
    yield Part("spleen", spleen(), ORGAN)
    yield Part("kidney_{side}", ellipsoid(KIDNEY_CENTRE, KIDNEY_AXES), ORGAN)
    yield Part("diaphragm", diaphragm(), ORGAN)
    for number in range(1, 13):
        yield Part(f"rib_{{side}}_{number:02d}", rib(number), RIB)
    for number in range(1, 11):
        yield Part(f"costal_cartilage_{{side}}_{number:02d}", cartilage(number), CARTILAGE)
    yield Part("sternum", sternum(), BONE)
    yield Part("clavicle_{side}", clavicle(), BONE)
    for level, name in enumerate(wall.LEVELS):
        yield Part(f"vertebra_{name}", vertebra(level), VERTEBRA)
    yield Part("pectoralis_major_{side}", pectoralis_major(), MUSCLE)
    yield Part("rectus_abdominis_{side}", rectus_abdominis(), MUSCLE)
    yield Part("erector_spinae_{side}", erector_spinae(), MUSCLE)
    yield Part("aorta", aorta(), VESSEL)
    yield Part("vena_cava", vena_cava(), VESSEL)
    yield Part("trachea", trachea(), VESSEL)
    yield Part("oesophagus", oesophagus(), VESSEL)
    yield Part("internal_thoracic_artery_{side}", internal_thoracic_artery(), NERVE)
    yield Part("phrenic_nerve_left", phrenic_nerve(1), NERVE)
    yield Part("phrenic_nerve_right", phrenic_nerve(-1), NERVE)
    yield Part("vagus_nerve_left", vagus_nerve(1), NERVE)
    yield Part("vagus_nerve_right", vagus_nerve(-1), NERVE)
