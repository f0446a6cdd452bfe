"""Closed surfaces over (s, theta), and their meshing by rings of nearly equilateral triangles.

Every surface has a pole at s = 0 and at s = 1 and a ring of points for each s between them. Rings get
as many points as their length asks for, and neighbouring rings are sewn together in the order of their
points, so that no needles gather at the poles and no fixed grid has to fit all of the surface.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from vhp_cli.phantom.curves import Array
from vhp_cli.phantom.triangles import FLIP_BELOW, Faces, flip_edges, neighbour_mean, sew, triangle_quality

PointFunction = Callable[[Array, Array], Array]

RELAXATIONS = 16
PASSES = 3
POLISHES = 6
GOOD_QUALITY = 0.5
ROW_HEIGHT = float(np.sqrt(3)) / 2  # of an equilateral triangle with unit edge


class Meshing(TypedDict, total=False):
    """How finely to mesh a surface: parameters of `Surface` that the makers of shapes hand on."""

    sides: int
    coarsest: float
    fineness: float
    stretch: float
    around: int


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

    def mesh(self, plan: Plan) -> tuple[Array, Faces]:
        """Return vertices (V, 3) and outward faces (F, 3)."""
        theta, stagger = self._ring_angles(plan)
        s = np.repeat(plan.s, plan.counts)
        vertices, faces = self.point(s, theta), sew(plan.counts, stagger)
        for _ in range(PASSES):
            vertices = self._relaxed(vertices, faces)
            faces = flip_edges(self._finished(vertices), faces)
            if self.project is None or self._worst(vertices, faces) >= FLIP_BELOW:
                break
        return self._finished(self._polished(vertices, faces)), faces

    def _finished(self, vertices: Array) -> Array:
        return vertices if self.finish is None else self.finish(vertices)

    def _worst(self, vertices: Array, faces: Faces) -> float:
        return float(triangle_quality(self._finished(vertices[faces])).min())

    def _relaxed(self, vertices: Array, faces: Faces) -> Array:
        """Move vertices towards the middle of their neighbours; return the state with the best worst triangle."""
        if self.project is None:
            return vertices
        best, best_quality = vertices, self._worst(vertices, faces)
        for _ in range(RELAXATIONS):
            if best_quality >= GOOD_QUALITY:
                break
            vertices = self.project(0.4 * vertices + 0.6 * neighbour_mean(vertices, faces))
            if (quality := self._worst(vertices, faces)) > best_quality:
                best, best_quality = vertices, quality
        return best

    def _polished(self, vertices: Array, faces: Faces) -> Array:
        """Move single vertices of bad triangles towards the middle of their neighbours where that helps."""
        if self.project is None:
            return vertices
        vertices = vertices.copy()
        for _ in range(POLISHES):
            bad = triangle_quality(self._finished(vertices[faces])) < FLIP_BELOW
            for vertex in np.unique(faces[bad]).tolist():
                fan = faces[(faces == vertex).any(axis=1)]
                middle = vertices[np.setdiff1d(fan, [vertex])].mean(axis=0)
                place, quality = vertices[vertex].copy(), self._worst(vertices, fan)
                for share in (0.3, 0.6, 1.0, -0.3):
                    vertices[vertex] = self.project(place + share * (middle - place))
                    if self._worst(vertices, fan) > quality:
                        break
                else:
                    vertices[vertex] = place
        return vertices

    def _ring_angles(self, plan: Plan) -> tuple[Array, Array]:
        """Return the angles of all points, at equal distances along each ring; every other ring by half a step."""
        fine = np.linspace(0, 2 * np.pi, 2 * self.around + 1)
        grid = self.point(plan.s[:, None], fine[None, :])
        length = np.cumsum(np.linalg.norm(np.diff(grid, axis=1), axis=2), axis=1)
        stagger = 0.5 * (np.arange(len(plan.s)) % 2).astype(np.float64)
        angles = [np.zeros(1)]
        for i in range(1, len(plan.s) - 1):
            at = (np.arange(plan.counts[i]) + stagger[i]) / plan.counts[i] * length[i, -1]
            angles.append(np.interp(at, np.concatenate([[0.0], length[i]]), fine))
        angles.append(np.zeros(1))
        return np.concatenate(angles), stagger
