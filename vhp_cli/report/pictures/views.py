"""Directions to look from, in the axes of the models: x to the left of the person, y to the back, z up (LPS)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Float = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A parallel projection.

    Parameters
    ----------
    name
        In words.
    towards : (3,) float64
        Unit vector from the surface to the viewer.
    """

    name: str
    towards: Float

    @property
    def axes(self) -> Float:
        """Unit vectors to the right, down and away from the viewer, as rows (3, 3)."""
        up = np.array([0.0, 0.0, 1.0]) if abs(self.towards[2]) < 0.99 else np.array([0.0, -1.0, 0.0])
        right = np.cross(up, self.towards)
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(right, self.towards), -self.towards])


def view_from(name: str, direction: ArrayLike) -> View:
    """Return the view from this direction, of any length."""
    towards = np.asarray(direction, dtype=np.float64)
    return View(name, towards / np.linalg.norm(towards))


FRONT = view_from("front", (0, -1, 0))
LEFT = view_from("left", (1, 0, 0))
BACK = view_from("back", (0, 1, 0))
TOP = view_from("above", (0, 0, 1))
OBLIQUE = tuple(
    view_from(f"{side} {front}", (x, y, 0.35))
    for side, x, front, y in (
        ("front", 0.55, "left", -1),
        ("front", -0.55, "right", -1),
        ("back", 0.55, "left", 1),
        ("back", -0.55, "right", 1),
    )
)


def best_oblique(normal: ArrayLike | None) -> View:
    """Return the oblique view that looks most directly at a surface with this normal; the first without one."""
    if normal is None:
        return OBLIQUE[0]
    return max(OBLIQUE, key=lambda view: round(float(view.towards @ np.asarray(normal)), 9))


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """A view of a part of space in a picture.

    Parameters
    ----------
    view
        From where.
    middle : (3,) float64
        What is in the middle of the picture, in mm.
    scale
        Pixels for a mm.
    width, height
        Of the picture, in pixels.
    """

    view: View
    middle: Float
    scale: float
    width: int
    height: int

    def project(self, points: ArrayLike) -> Float:
        """Return column, row and depth (N, 3), all in pixels."""
        seen = (np.asarray(points, dtype=np.float64) - self.middle) @ self.view.axes.T
        made: Float = seen * self.scale + np.array([0.5 * self.width, 0.5 * self.height, 0.0])
        return made


def frame_all(view: View, points: Float, width: int, height: int, *, margin: float = 0.06) -> Frame:
    """Return the frame that holds all points (N, 3), with a margin as a share of the picture."""
    seen = points @ view.axes.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    room = 1.0 - 2.0 * margin
    size = np.maximum(high - low, 1e-12)
    scale = float(min(width * room / size[0], height * room / size[1]))
    return Frame(view, (0.5 * (low + high)) @ view.axes, scale, width, height)
