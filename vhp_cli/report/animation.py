"""A breathing model as one page that plays in a browser, with nothing to load beside it."""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vhp_cli.measures import Breathe
from vhp_cli.report.curves import curves_svg

Array = NDArray[np.float64]

_LEVELS = 65535
# Colour and opacity by part, and whether it is shown at first.
_STYLES: Mapping[str, tuple[tuple[float, float, float, float], bool]] = {
    "lung": ((0.93, 0.62, 0.62, 1.0), True),
    "rib": ((0.92, 0.88, 0.76, 1.0), True),
    "sternum": ((0.92, 0.88, 0.76, 1.0), True),
    "cartilage": ((0.70, 0.82, 0.90, 1.0), True),
    "vertebra": ((0.86, 0.82, 0.70, 1.0), True),
    "disc": ((0.70, 0.82, 0.90, 1.0), True),
    "bone": ((0.86, 0.82, 0.70, 1.0), True),
    "diaphragm": ((0.72, 0.30, 0.30, 1.0), True),
    "heart": ((0.75, 0.15, 0.15, 1.0), True),
    "liver": ((0.55, 0.25, 0.18, 1.0), True),
    "stomach": ((0.85, 0.60, 0.45, 1.0), True),
    "spleen": ((0.50, 0.20, 0.35, 1.0), True),
    "kidney": ((0.60, 0.30, 0.25, 1.0), True),
    "pectoral": ((0.80, 0.40, 0.35, 1.0), False),
    "abdominal": ((0.80, 0.40, 0.35, 1.0), False),
    "erector": ((0.80, 0.40, 0.35, 1.0), False),
    "carried": ((0.45, 0.45, 0.75, 1.0), True),
    "body": ((0.80, 0.55, 0.50, 0.25), False),
    "fat": ((0.95, 0.85, 0.50, 0.25), False),
    "skin": ((0.90, 0.72, 0.60, 0.30), True),
}
_OTHER = ((0.6, 0.6, 0.6, 1.0), True)


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """One tissue of the page.

    Parameters
    ----------
    name, part
        Its name, and its part in breathing.
    faces : (F, 3) int32
        Vertex indices.
    states : (1 or 3, V, 3) float64
        Where its vertices are, in mm in LPS: at rest, or at rest, half way and at full inhalation.
    """

    name: str
    part: str
    faces: NDArray[np.int32]
    states: Array


def animation_html(title: str, tissues: Sequence[Shown], section: Breathe, *, steps: int, period_s: float) -> str:
    """Return the page.

    Coordinates are rounded to a 65,535th of the model's longest side, and between the three states vertices move on
    parabolas: it is to look at, and the frames are what was proven.

    Parameters
    ----------
    title
        Of the page.
    tissues
        What is shown.
    section
        The section `breathe` of the report, for the curves.
    steps, period_s
        N, and the duration of a breath.
    """
    every = np.concatenate([tissue.states.reshape(-1, 3) for tissue in tissues])
    low, size = every.min(axis=0), np.ptp(every, axis=0)
    step = float(size.max()) / _LEVELS or 1.0
    parts = list(dict.fromkeys(tissue.part for tissue in tissues))
    data: dict[str, Any] = {
        "low": low.tolist(),
        "size": size.tolist(),
        "step": step,
        "steps": steps,
        "period": period_s,
        "parts": {part: _style(part) for part in sorted(parts)},
        "tissues": [
            {
                "name": tissue.name,
                "part": tissue.part,
                "faces": _text(tissue.faces.astype("<u4")),
                "states": [_text(np.rint((state - low) / step).astype("<u2")) for state in tissue.states],
            }
            for tissue in tissues
        ],
    }
    page = files("vhp_cli.report").joinpath("animation.html").read_text(encoding="utf-8")
    # "</" would end the script within a text.
    script = json.dumps(data, separators=(",", ":")).replace("</", "<\\/")
    for mark, text in (("@TITLE@", html.escape(title)), ("@CURVES@", curves_svg(section)), ("@DATA@", script)):
        page = page.replace(mark, text)
    return page


def style_of(part: str) -> tuple[tuple[float, float, float, float], bool]:
    """Return red, green, blue and opacity of a part, and whether it is shown at first."""
    return _STYLES.get(part, _OTHER)


def is_shown(part: str) -> bool:
    """Tell whether a part is shown at first, and hides what is behind it."""
    colour, shown = style_of(part)
    return shown and colour[3] == 1.0


def _style(part: str) -> dict[str, object]:
    colour, shown = style_of(part)
    return {"colour": list(colour), "shown": shown}


def _text(values: NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode("ascii")
