"""The shapes that the phantom's tissues are made of."""

from __future__ import annotations

from collections.abc import Callable
from typing import Unpack

import numpy as np

from vhp_cli.phantom.curves import Array, smooth_path
from vhp_cli.phantom.surface import Meshing, Surface

Field = Callable[[Array], Array]  # points (..., 3) in mm -> value (...), negative inside


def _section(theta: Array, exponent: float) -> tuple[Array, Array]:
    """Return points of the unit superellipse |x|^e + |y|^e = 1, as (x, y)."""
    c, s = np.cos(theta), np.sin(theta)
    if exponent == 2.0:
        return c, s
    scale = (np.abs(c) ** exponent + np.abs(s) ** exponent) ** (-1 / exponent)
    return c * scale, s * scale


def stacked(
    centres: Array, across: Array, along: Array, body: Array, *, exponent: float = 2.0, **meshing: Unpack[Meshing]
) -> Surface:
    """Make a surface of superelliptic sections: centre + across cos + along sin, each (S, 3).

    The first and last section must be points; across x along must point from the first to the last.
    """
    table = np.concatenate([centres, across, along], axis=1)
    last = len(table) - 1

    def point(s: Array, theta: Array) -> Array:
        position = np.clip(s, 0, 1) * last
        i = np.minimum(position.astype(np.int64), last - 1)
        w = (position - i)[..., None]
        row = table[i] * (1 - w) + table[i + 1] * w
        x, y = _section(theta, exponent)
        result: Array = row[..., :3] + row[..., 3:6] * x[..., None] + row[..., 6:] * y[..., None]
        return result

    return Surface(point, np.linspace(0, 1, last + 1), body, **meshing)


def tube(
    points: Array,
    half_width: float | Array,
    half_thickness: float | Array | None = None,
    *,
    facing: Callable[[Array], Array] | None = None,
    exponent: float = 2.0,
    samples: int = 161,
    **meshing: Unpack[Meshing],
) -> Surface:
    """Make a tube along a smooth curve with rounded ends.

    Parameters
    ----------
    points : (n, 3)
        Points of the centre line; the ends of the tube reach one end radius beyond the first and last.
    half_width, half_thickness
        Half axes of the section in mm: numbers, or values at equal distances along the tube.
    facing
        Direction of the thickness at given points (n, 3); default: a frame that does not twist.
    """
    line = smooth_path(points, samples)
    tangent = np.gradient(line, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1)[:, None]
    if facing is None:
        thick = _untwisted(tangent)
    else:
        thick = facing(line)
        thick = thick - (thick * tangent).sum(axis=1)[:, None] * tangent
        thick /= np.linalg.norm(thick, axis=1)[:, None]
    wide = np.cross(thick, tangent)
    a = _along(half_width, samples)
    b = a if half_thickness is None else _along(half_thickness, samples)
    lean = np.linspace(0, np.pi / 2, 14)[:-1]
    shrink, reach = np.sin(lean), np.cos(lean)
    cap = [min(a[i], b[i]) for i in (0, -1)]
    first = line[0] - tangent[0] * (cap[0] * reach)[:, None]
    last = line[-1] + tangent[-1] * (cap[1] * reach)[:, None]
    centres = np.concatenate([first, line, last[::-1]])
    scale = np.concatenate([shrink, np.ones(samples), shrink[::-1]])[:, None]
    pick = np.concatenate([np.zeros(13, int), np.arange(samples), np.full(13, samples - 1)])
    body = np.concatenate([np.zeros(14), np.ones(samples - 2), np.zeros(14)])
    across, along = wide[pick] * (a[pick])[:, None] * scale, thick[pick] * (b[pick])[:, None] * scale
    return stacked(centres, across, along, body, exponent=exponent, **meshing)


def _along(values: float | Array, samples: int) -> Array:
    """Return values at equal distances, interpolated to `samples` of them."""
    given = np.atleast_1d(np.asarray(values, float))
    result: Array = np.interp(np.linspace(0, 1, samples), np.linspace(0, 1, len(given)), given)
    return result


def _untwisted(tangent: Array) -> Array:
    """Return normals of a curve that turn as little as possible (parallel transport)."""
    normal = np.empty_like(tangent)
    start = np.eye(3)[np.argmin(np.abs(tangent[0]))]
    for i, t in enumerate(tangent):
        start = start - (start @ t) * t
        start = start / np.linalg.norm(start)
        normal[i] = start
    return normal


def carved(
    centre: Array, radii: Array, field: Field, *, reach: float = 260.0, stations: int = 65, **meshing: Unpack[Meshing]
) -> Surface:
    """Make a star-shaped surface where `field` turns positive on the rays from `centre`.

    Parameters
    ----------
    centre : (3,)
        Point inside, from which every point of the surface can be seen.
    radii : (3,)
        Proportions of the ellipsoid on which the rays are spread (pole along z).
    field
        Negative inside, growing outwards along each ray.
    reach
        Length of the rays in mm, beyond the surface everywhere.
    """
    origin, proportions = np.asarray(centre, float), np.asarray(radii, float)

    def project(p: Array) -> Array:
        ray = p - origin
        ray /= np.linalg.norm(ray, axis=-1)[..., None]
        result: Array = origin + ray * first_outside(origin, ray, field, reach)[..., None]
        return result

    def point(s: Array, theta: Array) -> Array:
        s, theta = np.broadcast_arrays(s, theta)
        lean = np.pi * s
        ray = np.stack([np.sin(lean) * np.cos(theta), np.sin(lean) * np.sin(theta), -np.cos(lean)], axis=-1)
        return project(origin + ray * proportions)

    return Surface(point, np.linspace(0, 1, stations), np.zeros(stations), project=project, **meshing)


def first_outside(origin: Array, ray: Array, field: Field, reach: float) -> Array:
    """Return the distance along each ray at which the field changes sign, by bisection to 1e-5 mm."""
    low = np.zeros(ray.shape[:-1])
    high = np.full(ray.shape[:-1], reach)
    for _ in range(25):
        middle = 0.5 * (low + high)
        outside = field(origin + ray * middle[..., None]) > 0
        high = np.where(outside, middle, high)
        low = np.where(outside, low, middle)
    result: Array = 0.5 * (low + high)
    return result


def smooth_intersection(*fields: Field, blend: float = 5.0) -> Field:
    """Return the intersection of solids with rounded edges; it never reaches beyond any of them."""

    def field(p: Array) -> Array:
        values = np.stack([f(p) for f in fields])
        top = values.max(axis=0)
        result: Array = top + blend * np.log(np.exp((values - top) / blend).sum(axis=0))
        return result

    return field


def plate(
    outline: Callable[[Array], Array],
    centre: Array,
    half_thickness: float,
    lift: Callable[[Array, Array], Array],
    squeeze: float = 1.0,
    **meshing: Unpack[Meshing],
) -> Surface:
    """Make a thin plate with a rounded rim over a star-shaped outline, bent to the height lift(x, y).

    Parameters
    ----------
    outline
        theta -> distance of the rim from the centre in mm.
        Seen in a plane whose x axis is shortened by `squeeze`.
    centre : (2,)
        x and y of the centre in mm.
    """
    rim = np.pi / 2 * half_thickness
    typical = float(outline(np.linspace(0, 2 * np.pi, 360)).mean())

    def place(distance: Array, theta: Array, height: Array) -> Array:
        x = centre[0] + squeeze * distance * np.cos(theta)
        return np.stack([x, centre[1] + distance * np.sin(theta), height], axis=-1)

    def point(s: Array, theta: Array) -> Array:
        s, theta = np.broadcast_arrays(s, theta)
        # Walk outwards on the lower face, around the rim, and back on the upper face.
        walk = (1 - np.abs(2 * s - 1)) * (typical + rim)
        turn = np.maximum(walk - typical, 0) / half_thickness
        distance = np.minimum(walk / typical, 1) * (outline(theta) - half_thickness) + half_thickness * np.sin(turn)
        return place(distance, theta, half_thickness * np.cos(turn) * np.where(s < 0.5, -1.0, 1.0))

    def project(p: Array) -> Array:
        x, y = (p[..., 0] - centre[0]) / squeeze, p[..., 1] - centre[1]
        distance, theta = np.hypot(x, y), np.arctan2(y, x)
        flat = outline(theta) - half_thickness
        beyond = distance - flat
        # On the rounded rim; a point between the two faces that was drawn inwards belongs to the rim's middle.
        drawn_in = (beyond <= 0) & (np.abs(p[..., 2]) < 0.35 * half_thickness)
        beyond = np.where(drawn_in, half_thickness, beyond)
        height = np.where(drawn_in, 0.0, p[..., 2])
        length = np.where(beyond > 0, np.hypot(beyond, height), np.abs(height)) / half_thickness
        return place(np.where(beyond > 0, flat + beyond / length, distance), theta, height / length)

    def bend(p: Array) -> Array:
        return p + lift(p[..., 0], p[..., 1])[..., None] * [0.0, 0.0, 1.0]

    return Surface(
        point,
        np.linspace(0, 1, 129),
        np.zeros(129),
        even=True,
        project=project,
        finish=bend,
        **meshing,
    )


def ellipsoid(centre: Array, axes: Array, *, egg: float = 0.0, **meshing: Unpack[Meshing]) -> Surface:
    """Make an ellipsoid with half axes `axes` (3, 3) as rows, the last one through the poles.

    With `egg` above 0 it is fuller towards the end of that axis.
    """
    origin, frame = np.asarray(centre, float), np.asarray(axes, float)

    def point(s: Array, theta: Array) -> Array:
        s, theta = np.broadcast_arrays(s, theta)
        up = -np.cos(np.pi * s)
        out = np.sin(np.pi * s) * (1 + egg * up)
        local = np.stack([out * np.cos(theta), out * np.sin(theta), up], axis=-1)
        result: Array = origin + local @ frame
        return result

    return Surface(point, np.linspace(0, 1, 33), np.zeros(33), **meshing)
