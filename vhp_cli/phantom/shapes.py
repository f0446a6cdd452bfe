"""Closed surfaces over (s, theta), and their meshing by rings of nearly equilateral triangles.

Every surface has a pole at s = 0 and at s = 1 and a ring of points for each s between them. Rings get
as many points as their length asks for, and neighbouring rings are sewn together in the order of their
points, so that no needles gather at the poles and no fixed grid has to fit all of the surface.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
PointFunction = Callable[[Array, Array], Array]
Field = Callable[[Array], Array]  # points (..., 3) in mm -> value (...), negative inside

RELAXATIONS = 16
GOOD_QUALITY = 0.5
ROW_HEIGHT = np.sqrt(3) / 2  # of an equilateral triangle with unit edge


def monotone_curve(knots: Array, values: Array) -> Callable[[Array], Array]:
    """Return the monotone piecewise cubic through (knots, values), constant beyond the ends.

    Between two knots the curve never leaves the interval of their values (Fritsch and Carlson 1980,
    slopes by the weighted harmonic mean).
    """
    x, y = np.asarray(knots, float), np.asarray(values, float)
    width = np.diff(x)
    secant = np.diff(y) / width
    slope = np.zeros_like(y)
    before, after = secant[:-1], secant[1:]
    w1, w2 = 2 * width[1:] + width[:-1], width[1:] + 2 * width[:-1]
    same_sign = before * after > 0
    slope[1:-1][same_sign] = ((w1 + w2)[same_sign]) / (w1 / np.where(same_sign, before, 1) + w2 / np.where(
        same_sign, after, 1))[same_sign]
    slope[0], slope[-1] = secant[0], secant[-1]

    def curve(at: Array) -> Array:
        at = np.clip(at, x[0], x[-1])
        i = np.clip(np.searchsorted(x, at, side="right") - 1, 0, len(width) - 1)
        t = (at - x[i]) / width[i]
        bump = width[i] * t * (1 - t)
        result: Array = y[i] + secant[i] * width[i] * t * t * (3 - 2 * t) + bump * ((1 - t) * slope[i] - t * slope[i + 1])
        return result

    return curve


def smooth_path(points: Array, samples: int = 161) -> Array:
    """Return `samples` points at equal distances on the natural cubic spline through `points` (n, 3)."""
    points = np.asarray(points, float)
    t = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    n = len(t)
    width = np.diff(t)
    system = np.eye(n)
    right = np.zeros((n, 3))
    for i in range(1, n - 1):
        system[i, i - 1 : i + 2] = width[i - 1], 2 * (width[i - 1] + width[i]), width[i]
        right[i] = 6 * ((points[i + 1] - points[i]) / width[i] - (points[i] - points[i - 1]) / width[i - 1])
    bend = np.linalg.solve(system, right)  # second derivatives at the knots
    fine = np.linspace(0, t[-1], 4 * samples)
    i = np.clip(np.searchsorted(t, fine, side="right") - 1, 0, n - 2)
    h, b = width[i][:, None], (fine - t[i])[:, None]
    a = h - b
    curve = (
        bend[i] * a**3 + bend[i + 1] * b**3
    ) / (6 * h) + (points[i] / h - bend[i] * h / 6) * a + (points[i + 1] / h - bend[i + 1] * h / 6) * b
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
    even = np.linspace(0, length[-1], samples)
    return np.stack([np.interp(even, length, curve[:, k]) for k in range(3)], axis=1)


@dataclass(frozen=True)
class Plan:
    """Rings of one mesh: their parameter s and their number of points (poles have one)."""

    s: Array
    counts: NDArray[np.int64]

    @property
    def triangles(self) -> int:
        """Number of triangles: each ring point but the poles closes two."""
        return int(2 * self.counts[1:-1].sum())


@dataclass(frozen=True)
class Surface:
    """A closed surface over s in [0, 1] (poles at the ends) and theta in [0, 2 pi).

    Parameters
    ----------
    point
        (s, theta) -> (..., 3) in mm; increasing theta runs so that, seen from outside with s upward,
        it goes to the right.
    stations
        Samples of s fine enough to measure lengths.
    body
        For each station, 1 where the surface may be meshed with long triangles, 0 at rounded ends.
    sides
        Fewest points of a ring (except near the poles).
    coarsest
        Longest edge in mm.
    fineness
        Edge length of this surface in proportion to that of others.
    stretch
        Greatest ratio of row height to edge on thin tubes, where the number of sides dictates the edge.
    even
        Always put a ring at half way (the rim of a plate).
    project
        Maps points near the surface onto it; if given, the triangles are evened out by it.
    finish
        Maps the points of the surface to their final places.
    """

    point: PointFunction
    stations: Array
    body: Array
    sides: int = 6
    coarsest: float = 30.0
    fineness: float = 1.0
    stretch: float = 3.3
    even: bool = False
    around: int = 48
    project: Callable[[Array], Array] | None = None
    finish: Callable[[Array], Array] | None = None

    @cached_property
    def _lengths(self) -> tuple[Array, Array]:
        """Mean meridian length up to each station, and length of the ring there."""
        theta = np.linspace(0, 2 * np.pi, self.around, endpoint=False)
        grid = self.point(self.stations[:, None], theta[None, :])
        steps = np.linalg.norm(np.diff(grid, axis=0), axis=2).mean(axis=1)
        girth = np.linalg.norm(np.roll(grid, -1, axis=1) - grid, axis=2).sum(axis=1)
        return np.concatenate([[0.0], np.cumsum(steps)]), girth

    @cached_property
    def _body_girth(self) -> Array:
        """Ring length with that of the rounded ends taken from where they begin."""
        girth = self._lengths[1]
        inside = np.flatnonzero(self.body > 0)
        if not len(inside):
            return np.full_like(girth, girth.max())
        return np.interp(self.stations, self.stations[inside], girth[inside])

    def plan(self, edge: float) -> Plan:
        """Place the rings for edges of about `edge` x fineness mm."""
        wanted = min(edge * self.fineness, self.coarsest)
        meridian, girth = self._lengths
        short = np.minimum(wanted, self._body_girth / self.sides)
        long = np.minimum(wanted, self.stretch * short)
        row = ROW_HEIGHT * (short + (long - short) * self.body)
        density = np.diff(meridian) * 0.5 * (1 / row[1:] + 1 / row[:-1])
        rows = np.concatenate([[0.0], np.cumsum(density)])
        number = max(4, round(rows[-1]))
        if self.even:
            number += number % 2
        s = np.interp(np.linspace(0, rows[-1], number + 1), rows, self.stations)
        ring = np.interp(s, self.stations, girth)
        counts = np.maximum(np.round(ring / np.interp(s, self.stations, short)), 5).astype(np.int64)
        counts[0] = counts[-1] = 1
        return Plan(s, counts)

    def mesh(self, plan: Plan) -> tuple[Array, NDArray[np.int32]]:
        """Return vertices (V, 3) and outward faces (F, 3)."""
        theta, stagger = self._ring_angles(plan)
        s = np.repeat(plan.s, plan.counts)
        vertices, faces = self.point(s, theta), sew(plan.counts, stagger)
        if self.project is not None:
            vertices = self._relaxed(vertices, faces)
        if self.finish is not None:
            vertices = self.finish(vertices)
        return vertices, faces

    def _relaxed(self, vertices: Array, faces: NDArray[np.int32]) -> Array:
        """Move vertices towards the middle of their neighbours as long as the worst triangle gains by it."""
        assert self.project is not None
        best, best_quality = vertices, worst_quality(vertices, faces)
        for _ in range(RELAXATIONS):
            if best_quality >= GOOD_QUALITY:
                break
            vertices = self.project(0.4 * vertices + 0.6 * _neighbour_mean(vertices, faces))
            if (quality := worst_quality(vertices, faces)) > best_quality:
                best, best_quality = vertices, quality
        return best

    def _ring_angles(self, plan: Plan) -> tuple[Array, Array]:
        """Angles of all points, at equal distances along each ring; every other ring by half a step."""
        fine = np.linspace(0, 2 * np.pi, 2 * self.around + 1)
        grid = self.point(plan.s[:, None], fine[None, :])
        length = np.cumsum(np.linalg.norm(np.diff(grid, axis=1), axis=2), axis=1)
        stagger = 0.5 * (np.arange(len(plan.s)) % 2)
        angles = [np.zeros(1)]
        for i in range(1, len(plan.s) - 1):
            at = (np.arange(plan.counts[i]) + stagger[i]) / plan.counts[i] * length[i, -1]
            angles.append(np.interp(at, np.concatenate([[0.0], length[i]]), fine))
        angles.append(np.zeros(1))
        return np.concatenate(angles), stagger


def sew(counts: NDArray[np.int64], stagger: Array) -> NDArray[np.int32]:
    """Triangulate between neighbouring rings.

    Each edge of a ring becomes the base of a triangle with its tip on the other ring; walking around
    both rings at once, the edge whose middle comes first is taken first.

    Parameters
    ----------
    counts : (R,) int64
        Points per ring; the first and last ring are poles with one point.
    stagger : (R,) float64
        Offset of the first point of each ring, in steps of that ring.
    """
    start = np.concatenate([[0], np.cumsum(counts)])
    edges = np.where(counts > 1, counts, 0)
    # One event for every ring edge, once in the strip above its ring and once in the strip below.
    ring = np.repeat(np.arange(len(counts)), edges)
    index = np.arange(len(ring)) - np.repeat(np.concatenate([[0], np.cumsum(edges)])[:-1], edges)
    middle = (index + 0.5 + stagger[ring]) / counts[ring]
    strip = np.concatenate([ring, ring - 1])
    upper = np.concatenate([np.zeros(len(ring), bool), np.ones(len(ring), bool)])
    index, middle = np.tile(index, 2), np.tile(middle, 2)
    order = np.lexsort((upper, middle, strip))
    strip, upper, index = strip[order], upper[order], index[order]
    # How far the walk has come on the other ring when an event takes place.
    first = np.searchsorted(strip, strip)
    passed_upper = np.cumsum(upper) - upper
    passed_upper -= passed_upper[first]
    passed_lower = np.arange(len(strip)) - first - passed_upper
    low, high = strip, strip + 1
    a = start[np.where(upper, high, low)] + index
    b = start[np.where(upper, high, low)] + (index + 1) % counts[np.where(upper, high, low)]
    tip = np.where(
        upper, start[low] + passed_lower % counts[low], start[high] + passed_upper % counts[high]
    )
    faces = np.stack([np.where(upper, b, a), np.where(upper, a, b), tip], axis=1)
    return np.ascontiguousarray(faces, dtype=np.int32)


def worst_quality(vertices: Array, faces: NDArray[np.int32]) -> float:
    """Smallest q = 2 r_in / r_out of the triangles (thesis eq. 2.4)."""
    corners = vertices[faces]
    sides = np.roll(corners, -1, axis=1) - corners
    a, b, c = np.linalg.norm(sides, axis=2).T
    double_area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    return float((4 * double_area**2 / ((a + b + c) * a * b * c)).min())


def _neighbour_mean(vertices: Array, faces: NDArray[np.int32]) -> Array:
    """Mean of the neighbours of each vertex of a closed surface."""
    first, second = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    number = np.bincount(first, minlength=len(vertices))
    sums = [np.bincount(first, vertices[second, k], len(vertices)) for k in range(3)]
    return np.stack(sums, axis=1) / number[:, None]


def _section(theta: Array, exponent: float) -> tuple[Array, Array]:
    """Unit superellipse |x|^e + |y|^e = 1, as (x, y)."""
    c, s = np.cos(theta), np.sin(theta)
    if exponent == 2.0:
        return c, s
    scale = (np.abs(c) ** exponent + np.abs(s) ** exponent) ** (-1 / exponent)
    return c * scale, s * scale


def stacked(
    centres: Array, across: Array, along: Array, body: Array, *, exponent: float = 2.0, **options: float
) -> Surface:
    """Surface of superelliptic sections: centre + across cos + along sin, each (S, 3).

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

    return Surface(point, np.linspace(0, 1, last + 1), body, **options)  # type: ignore[arg-type]


def tube(
    points: Array,
    half_width: float | Array,
    half_thickness: float | Array | None = None,
    *,
    facing: Callable[[Array], Array] | None = None,
    exponent: float = 2.0,
    samples: int = 161,
    **options: float,
) -> Surface:
    """Tube along a smooth curve with rounded ends.

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
    a, b = (
        np.interp(np.linspace(0, 1, samples), np.linspace(0, 1, np.size(v)), np.atleast_1d(v)) if np.size(v) > 1
        else np.full(samples, float(np.asarray(v).ravel()[0]))
        for v in (half_width, half_width if half_thickness is None else half_thickness)
    )
    lean = np.linspace(0, np.pi / 2, 14)[:-1]
    shrink, reach = np.sin(lean), np.cos(lean)
    cap = [min(a[i], b[i]) for i in (0, -1)]
    centres = np.concatenate([
        line[0] - tangent[0] * (cap[0] * reach)[:, None], line, (line[-1] + tangent[-1] * (cap[1] * reach)[:, None])[::-1]
    ])
    scale = np.concatenate([shrink, np.ones(samples), shrink[::-1]])[:, None]
    pick = np.concatenate([np.zeros(13, int), np.arange(samples), np.full(13, samples - 1)])
    body = np.concatenate([np.zeros(14), np.ones(samples - 2), np.zeros(14)])
    across, along = wide[pick] * (a[pick])[:, None] * scale, thick[pick] * (b[pick])[:, None] * scale
    return stacked(centres, across, along, body, exponent=exponent, **options)


def _untwisted(tangent: Array) -> Array:
    """Normals of a curve that turn as little as possible (parallel transport)."""
    normal = np.empty_like(tangent)
    start = np.eye(3)[np.argmin(np.abs(tangent[0]))]
    for i, t in enumerate(tangent):
        start = start - (start @ t) * t
        start = start / np.linalg.norm(start)
        normal[i] = start
    return normal


def carved(
    centre: Array, radii: Array, field: Field, *, reach: float = 260.0, stations: int = 65, **options: float
) -> Surface:
    """Star-shaped surface where `field` turns positive on the rays from `centre`.

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

    def point(s: Array, theta: Array) -> Array:
        s, theta = np.broadcast_arrays(s, theta)
        lean = np.pi * s
        ray = np.stack([np.sin(lean) * np.cos(theta), np.sin(lean) * np.sin(theta), -np.cos(lean)], axis=-1)
        ray = ray * proportions
        ray /= np.linalg.norm(ray, axis=-1)[..., None]
        return origin + ray * _first_outside(origin, ray, field, reach)[..., None]

    def project(p: Array) -> Array:
        ray = p - origin
        ray /= np.linalg.norm(ray, axis=-1)[..., None]
        return origin + ray * _first_outside(origin, ray, field, reach)[..., None]

    return Surface(
        point, np.linspace(0, 1, stations), np.zeros(stations), project=project, **options  # type: ignore[arg-type]
    )


def _first_outside(origin: Array, ray: Array, field: Field, reach: float) -> Array:
    """Distance along each ray at which the field changes sign, by bisection to 1e-5 mm."""
    low = np.zeros(ray.shape[:-1])
    high = np.full(ray.shape[:-1], reach)
    for _ in range(25):
        middle = 0.5 * (low + high)
        outside = field(origin + ray * middle[..., None]) > 0
        high = np.where(outside, middle, high)
        low = np.where(outside, low, middle)
    return 0.5 * (low + high)


def smooth_intersection(*fields: Field, blend: float = 5.0) -> Field:
    """Intersection of solids with rounded edges; it never reaches beyond any of them."""

    def field(p: Array) -> Array:
        values = np.stack([f(p) for f in fields])
        top = values.max(axis=0)
        result: Array = top + blend * np.log(np.exp((values - top) / blend).sum(axis=0))
        return result

    return field


def plate(
    outline: Callable[[Array], Array], centre: Array, half_thickness: float, lift: Callable[[Array, Array], Array],
    squeeze: float = 1.0, **options: float,
) -> Surface:
    """Thin plate with a rounded rim over a star-shaped outline, bent to the height lift(x, y).

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
        height = p[..., 2] / half_thickness
        on_rim = np.abs(height) < 0.35
        flat = outline(theta) - half_thickness
        distance = np.where(on_rim, flat + half_thickness, np.minimum(distance, flat))
        return place(distance, theta, np.where(on_rim, 0.0, np.sign(height)) * half_thickness)

    def bend(p: Array) -> Array:
        return p + lift(p[..., 0], p[..., 1])[..., None] * [0.0, 0.0, 1.0]

    return Surface(
        point, np.linspace(0, 1, 129), np.zeros(129), even=True, project=project, finish=bend,
        **options,  # type: ignore[arg-type]
    )


def ellipsoid(centre: Array, axes: Array, *, egg: float = 0.0, **options: float) -> Surface:
    """Ellipsoid with half axes `axes` (3, 3) as rows (the last one through the poles), fuller towards one pole."""
    origin, frame = np.asarray(centre, float), np.asarray(axes, float)

    def point(s: Array, theta: Array) -> Array:
        s, theta = np.broadcast_arrays(s, theta)
        up = -np.cos(np.pi * s)
        out = np.sin(np.pi * s) * (1 + egg * up)
        local = np.stack([out * np.cos(theta), out * np.sin(theta), up], axis=-1)
        result: Array = origin + local @ frame
        return result

    return Surface(point, np.linspace(0, 1, 33), np.zeros(33), **options)  # type: ignore[arg-type]
