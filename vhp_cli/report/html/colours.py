"""Colours of tissues: those of an anatomical atlas, by type, tissues of one type a little apart."""

from __future__ import annotations

import colorsys
from collections import Counter
from collections.abc import Sequence

from vhp_cli.measures import Report
from vhp_cli.report.pictures.portraits import Colour

_OF_TYPE: dict[str, Colour] = {
    "shell": (0.87, 0.69, 0.58),
    "cartilage": (0.55, 0.72, 0.82),
    "nerve": (0.90, 0.77, 0.30),
    "vessel": (0.75, 0.27, 0.30),
    "muscle": (0.74, 0.40, 0.36),
    "bone": (0.88, 0.83, 0.69),
    "airway": (0.86, 0.60, 0.62),
    "brain": (0.76, 0.64, 0.72),
    "organ": (0.66, 0.42, 0.34),
}
_OTHER: Colour = (0.62, 0.66, 0.70)
_GOLDEN = 0.6180339887498949
_SHELL_OPACITY, _OUTER_OPACITY = 0.14, 0.4


def tissue_colours(types: Sequence[str]) -> list[Colour]:
    """Return a colour for each tissue by its type; hue and lightness vary from one to the next."""
    seen: Counter[str] = Counter()
    made: list[Colour] = []
    for kind in types:
        hue, light, saturation = colorsys.rgb_to_hls(*_OF_TYPE.get(kind, _OTHER))
        shift = (seen[kind] * _GOLDEN) % 1.0 if seen[kind] else 0.5
        seen[kind] += 1
        hue = (hue + 0.05 * (shift - 0.5)) % 1.0
        light = light + 0.16 * (((shift * 7.0) % 1.0) - 0.5)
        red, green, blue = colorsys.hls_to_rgb(hue, light, saturation)
        made.append((round(red, 3), round(green, 3), round(blue, 3)))
    return made


def opacities(report: Report) -> list[float]:
    """Return how opaque each tissue is at first: what holds other tissues lets them show through."""
    types = [tissue["tissue_type"] for tissue in report["tissues"]]
    shells_only = all(kind == "shell" for kind in types)
    outer = set(report["nesting"].values()) - {None}
    made = []
    for tissue, kind in zip(report["tissues"], types, strict=True):
        holds = tissue["name"] in outer
        if kind == "shell" and (holds or not shells_only):
            made.append(_SHELL_OPACITY)
        else:
            made.append(_OUTER_OPACITY if holds else 1.0)
    return made
