"""Pictures of a tissue, of the surroundings of a place, and of a model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vhp_cli.mesh import Mesh
from vhp_cli.report.pictures.png import png_bytes
from vhp_cli.report.pictures.raster import Seen, edge_functions, rasterise
from vhp_cli.report.pictures.views import Frame, View, frame_all

Float = NDArray[np.float64]
Colour = tuple[float, float, float]

_FINE = 2  # pixels drawn for one of the picture, along each axis
_SHADES = 30  # of each of the two colours
_OPACITIES = _FINE * _FINE
_LIGHT = np.array([-0.45, -0.65, -0.62])  # from the left, above and the viewer, in the axes of the view
_LINE = 0.7  # half the width of drawn edges in pixels
MARKED: Colour = (0.86, 0.15, 0.15)


@dataclass(frozen=True, slots=True, eq=False)
class Portrait:
    """A picture, and where in it things are.

    Parameters
    ----------
    png
        The file.
    frame
        Of the picture.
    depth : (H, W) float64
        Of what is seen at each pixel, as `Frame.project` gives it; inf for nothing.
    """

    png: bytes
    frame: Frame
    depth: Float

    def is_hidden(self, point: ArrayLike, *, slack: float = 3.0) -> bool:
        """Tell whether a point (3,) lies behind what is seen, by more than some pixels."""
        column, row, depth = self.frame.project(np.asarray(point)[None])[0]
        if not (0 <= column < self.frame.width and 0 <= row < self.frame.height):
            return True
        return bool(depth > self.depth[int(row), int(column)] + slack)


def portrait(
    mesh: Mesh, frame: Frame, colour: Colour, marked: NDArray[np.int64] | None = None, *, edges: bool = False
) -> Portrait:
    """Draw a tissue.

    Parameters
    ----------
    mesh
        The surface, with at least one vertex.
    frame
        What part of it is seen, from where.
    colour
        Of the tissue: red, green and blue from 0 to 1.
    marked
        Faces in the colour `MARKED`.
    edges
        Draw the edges of triangles.
    """
    is_marked = np.zeros(len(mesh.faces) + 1, dtype=bool)
    if marked is not None:
        is_marked[marked] = True
    points, seen = _seen(mesh, frame)
    shade = _shades(points, mesh.faces, seen)
    if edges:
        shade = shade * (1.0 - 0.55 * _edge_lines(points, mesh.faces, seen))
    covered = seen.face >= 0
    opacity = _pooled(covered).astype(np.int64)
    level = _pooled(np.where(covered, shade, 0.0)) / np.maximum(opacity, 1)
    # A pixel that a marked face has a part in shows it, lest small ones vanish.
    is_red = _pooled(is_marked[seen.face] & covered) > 0
    number = (
        1 + (is_red * _OPACITIES + np.maximum(opacity, 1) - 1) * _SHADES + np.rint(level * (_SHADES - 1)).astype(int)
    )
    pixels = np.where(opacity > 0, number, 0).astype(np.uint8)
    return Portrait(png_bytes(pixels, _palette((colour, MARKED))), frame, _nearest(seen.depth))


def model_picture(meshes: Sequence[Mesh], colours: Sequence[Colour], view: View, width: int, height: int) -> Portrait:
    """Draw several tissues in one picture of opaque surfaces, each in its colour; at least one has a face."""
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    whole = Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + offset for mesh, offset in zip(meshes, offsets[:-1], strict=True)]),
    )
    tissue = np.repeat(np.arange(len(meshes)), [len(mesh.faces) for mesh in meshes])
    frame = frame_all(view, whole.vertices, width, height, margin=0.03)
    points, seen = _seen(whole, frame)
    covered = seen.face >= 0
    shade = _shades(points, whole.faces, seen)
    red_green_blue = np.zeros((*covered.shape, 3))
    red_green_blue[covered] = _lit(np.asarray(colours)[tissue[seen.face[covered]]], shade[covered][:, None])
    opacity = _pooled(covered)
    colour = np.stack([_pooled(red_green_blue[..., index]) for index in range(3)], axis=2)
    colour /= np.maximum(opacity, 1)[..., None]
    pixels = np.rint(255 * np.concatenate((colour, opacity[..., None] / _OPACITIES), axis=2)).astype(np.uint8)
    return Portrait(png_bytes(pixels), frame, _nearest(seen.depth))


def _seen(mesh: Mesh, frame: Frame) -> tuple[Float, Seen]:
    """Return the vertices in fine pixels, and what is seen at each of these."""
    points = frame.project(mesh.vertices) * _FINE
    return points, rasterise(points, mesh.faces, frame.width * _FINE, frame.height * _FINE)


def _shades(points: Float, faces: NDArray[np.int32], seen: Seen) -> Float:
    """Return how bright each pixel is (H, W), from 0 to 1: light from the upper left, both sides alike."""
    if not len(faces):
        return np.zeros(seen.face.shape)
    is_shown = np.zeros(len(faces) + 1, dtype=bool)
    is_shown[seen.face] = True
    shown = np.flatnonzero(is_shown[:-1])
    corners = points[faces[shown]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1)
    normals /= np.maximum(length, 1e-300)[:, None]
    # Towards the viewer, who is at negative depth.
    normals[normals[:, 2] > 0] *= -1.0
    light = _LIGHT / np.linalg.norm(_LIGHT)
    bright = 0.30 + 0.45 * np.maximum(normals @ light, 0.0) + 0.25 * np.abs(normals[:, 2])
    of_face = np.zeros(len(faces) + 1)
    of_face[shown] = bright
    return of_face[seen.face]


def _edge_lines(points: Float, faces: NDArray[np.int32], seen: Seen) -> Float:
    """Return how far each pixel belongs to an edge of the face seen there (H, W), from 0 to 1."""
    made = np.zeros(seen.face.shape)
    row, column = np.nonzero(seen.face >= 0)
    if not len(row):
        return made
    corners = points[faces[seen.face[row, column]]]
    x, y = (np.asarray(place[:, None], dtype=np.float64) + 0.5 for place in (column, row))
    area = np.abs(edge_functions(corners, x, y)[..., 0])
    sides = np.stack(
        [np.linalg.norm((corners[:, (c + 1) % 3] - corners[:, (c + 2) % 3])[:, :2], axis=1) for c in range(3)]
    )
    distance = (area / np.maximum(sides, 1e-12)).min(axis=0)
    made[row, column] = np.clip(_LINE + 0.5 - distance, 0.0, 1.0)
    return made


def _pooled(values: NDArray[np.float64] | NDArray[np.bool_]) -> Float:
    """Return the sums over the fine pixels of each pixel."""
    found = np.zeros((values.shape[0] // _FINE, values.shape[1] // _FINE))
    for row in range(_FINE):
        for column in range(_FINE):
            found += values[row::_FINE, column::_FINE]
    return found


def _nearest(depth: Float) -> Float:
    """Return the least depth of the fine pixels of each pixel, in its size."""
    found = depth[::_FINE, ::_FINE]
    for row in range(_FINE):
        for column in range(_FINE):
            found = np.minimum(found, depth[row::_FINE, column::_FINE])
    return found / _FINE


def _lit(colour: Float, shade: Float) -> Float:
    """Return colours at a brightness: darker ones, and a gleam where it is greatest."""
    gleam = 0.25 * np.clip((shade - 0.8) / 0.2, 0.0, 1.0)
    return np.clip(colour * np.minimum(shade / 0.9, 1.0) * (1.0 - gleam) + gleam, 0.0, 1.0)


def _palette(colours: Sequence[Colour]) -> NDArray[np.uint8]:
    """Return clear, then for each colour and opacity its shades: (N, 4)."""
    shades = np.linspace(0.0, 1.0, _SHADES)[:, None]
    rows = [np.zeros((1, 4))]
    for colour in colours:
        lit = _lit(np.asarray(colour)[None], shades)
        rows += [np.column_stack((lit, np.full(_SHADES, (n + 1) / _OPACITIES))) for n in range(_OPACITIES)]
    return np.rint(255 * np.concatenate(rows)).astype(np.uint8)
