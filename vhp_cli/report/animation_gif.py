"""A breathing model as a small animated picture, for pages and mails that run no script."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from vhp_cli.report.animation import Shown, is_shown, style_of
from vhp_cli.report.gif import gif_bytes
from vhp_cli.report.pictures.raster import rasterise
from vhp_cli.report.pictures.views import Frame, frame_all, view_from

Array = NDArray[np.float64]

WIDTH, HEIGHT = 360, 420
# Pictures from rest to full inhalation, both included.
LEVELS = 12
_VIEW = view_from("front left", (0.5, -1.0, 0.25))
_SHADES = 12
_DARKEST = 0.35
_LEAST_DELAY = 2


def animation_gif(tissues: Sequence[Shown], *, period_s: float) -> bytes:
    """Return the breath as a GIF: what is solid, seen from the front and the left.

    As on the page, vertices move on parabolas between three states, and pictures stay as long as the breath does.

    Parameters
    ----------
    tissues
        What is shown; shells and muscles, which hide the rest, are left out.
    period_s
        Duration of a breath.
    """
    solid = [tissue for tissue in tissues if is_shown(tissue.part)] or list(tissues)
    parts = list(dict.fromkeys(tissue.part for tissue in solid))
    offsets = np.cumsum([0, *(tissue.states.shape[1] for tissue in solid)])
    faces = np.concatenate([t.faces + offset for t, offset in zip(solid, offsets[:-1], strict=True)]).astype(np.int32)
    colours = np.concatenate([np.full(len(t.faces), parts.index(t.part)) for t in solid])
    every = np.concatenate([state for tissue in solid for state in tissue.states])
    frame = frame_all(_VIEW, every, WIDTH, HEIGHT)
    drawn = [_picture(frame, _placed(solid, level), faces, colours) for level in np.linspace(0.0, 1.0, LEVELS)]
    order = [*range(LEVELS), *range(LEVELS - 2, 0, -1)]
    return gif_bytes([(drawn[i], delay) for i, delay in zip(order, delays(period_s), strict=True)], _palette(parts))


def delays(period_s: float) -> list[int]:
    """Return for how many hundredths of a second each picture stays, so that the breath follows sin^4 (pi t / T)."""
    levels = np.linspace(0.0, 1.0, LEVELS)
    rising = np.arcsin(levels**0.25) / np.pi
    times = np.concatenate([rising, 1.0 - rising[-2::-1]])
    # Each picture stays from half way after the one before to half way before the next.
    borders = np.concatenate([[times[0]], 0.5 * (times[1:] + times[:-1]), [times[-1]]])
    stays = np.diff(borders) * 100.0 * period_s
    # The last one is the first one again.
    stays[0] += stays[-1]
    return [max(_LEAST_DELAY, min(65535, int(stay))) for stay in np.rint(stays[:-1])]


def _placed(tissues: Sequence[Shown], level: float) -> Array:
    """Return the vertices of all tissues at a share of the full sweep, (V, 3)."""
    placed = []
    for tissue in tissues:
        if len(tissue.states) == 1:
            placed.append(tissue.states[0])
            continue
        rest, half, full = tissue.states
        weights = (2.0 * (level - 0.5) * (level - 1.0), 4.0 * level * (1.0 - level), 2.0 * level * (level - 0.5))
        placed.append(weights[0] * rest + weights[1] * half + weights[2] * full)
    return np.concatenate(placed)


def _picture(frame: Frame, vertices: Array, faces: NDArray[np.int32], colours: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Return rows of the palette, (H, W): 0 is the background, then the shades of each part."""
    face = rasterise(frame.project(vertices), faces, WIDTH, HEIGHT).face
    seen = face >= 0
    shown, place = np.unique(face[seen], return_inverse=True)
    corners = vertices[faces[shown]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    light = np.abs(normals @ frame.view.towards) / np.where(lengths > 0.0, lengths, 1.0)
    shades = np.minimum((light * _SHADES).astype(np.int64), _SHADES - 1)
    pixels = np.zeros(face.shape, np.uint8)
    pixels[seen] = (1 + colours[shown] * _SHADES + shades)[place]
    return pixels


def _palette(parts: Sequence[str]) -> NDArray[np.uint8]:
    light = np.linspace(_DARKEST, 1.0, _SHADES)[:, None]
    rows = [np.ones((1, 3)), *(light * np.array(style_of(part)[0][:3]) for part in parts)]
    palette: NDArray[np.uint8] = np.rint(255.0 * np.concatenate(rows)).astype(np.uint8)
    return palette
