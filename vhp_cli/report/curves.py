"""Curves of a breath as one SVG picture."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from vhp_cli.measures import Breathe, BreathFrame

_WIDTH, _HEIGHT, _LEFT, _BOTTOM, _TOP = 360, 190, 62, 34, 26
_COLUMNS = 2
_TICKS = 4


def curves_svg(section: Breathe) -> str:
    """Return lung volume, travel, mass and smallest gap over time, each frame a dot; rejected ones are red.

    Parameters
    ----------
    section
        The section `breathe` of a report.
    """
    panels: list[tuple[str, Callable[[BreathFrame], float | None]]] = [
        ("lung volume in l", lambda frame: frame["lung_volume_l"]),
        ("diaphragm travel in mm", lambda frame: frame["diaphragm_travel_mm"]),
        ("change of mass in %", lambda frame: 100.0 * frame["mass_change"]),
        ("smallest gap in mm", lambda frame: frame["min_gap_mm"]),
    ]
    frames = sorted(section["frames"], key=lambda frame: frame["time_over_T"])
    rows = -(-len(panels) // _COLUMNS)
    size = _COLUMNS * _WIDTH, rows * _HEIGHT
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {size[0]} {size[1]}" width="{size[0]}" '
        f'height="{size[1]}" font-family="sans-serif" font-size="11">',
        f'<rect width="{size[0]}" height="{size[1]}" fill="white"/>',
    ]
    for number, (title, value) in enumerate(panels):
        x, y = number % _COLUMNS * _WIDTH, number // _COLUMNS * _HEIGHT
        lines += [f'<g transform="translate({x},{y})">', *_panel(title, frames, value), "</g>"]
    return "\n".join([*lines, "</svg>", ""])


def _panel(title: str, frames: Sequence[BreathFrame], value: Callable[[BreathFrame], float | None]) -> list[str]:
    known = [(frame, found) for frame in frames if (found := value(frame)) is not None]
    lines = [f'<text x="{_LEFT}" y="16">{title}</text>']
    if not known:
        return [*lines, f'<text x="{_LEFT}" y="60" fill="#777">none measured</text>']
    low, high = min(found for _, found in known), max(found for _, found in known)
    if high - low < 1e-6 * max(1.0, abs(high)):
        # Rounding would fill the panel.
        margin = max(0.05 * abs(high), 1e-3)
        low, high = low - margin, high + margin
    first, last = frames[0]["time_over_T"], frames[-1]["time_over_T"]
    span = last - first or 1.0
    wide, tall = _WIDTH - _LEFT - 14, _HEIGHT - _BOTTOM - _TOP

    def place(time: float, height: float) -> tuple[float, float]:
        return _LEFT + (time - first) / span * wide, _TOP + (1.0 - (height - low) / (high - low)) * tall

    for tick in range(_TICKS + 1):
        level = low + (high - low) * tick / _TICKS
        _, y = place(first, level)
        lines.append(f'<line x1="{_LEFT}" x2="{_LEFT + wide}" y1="{y:.1f}" y2="{y:.1f}" stroke="#ddd"/>')
        lines.append(f'<text x="{_LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{level:.4g}</text>')
        time = first + span * tick / _TICKS
        x, _ = place(time, low)
        lines.append(f'<text x="{x:.1f}" y="{_HEIGHT - _BOTTOM + 16}" text-anchor="middle">{time:.3g}</text>')
    lines.append(f'<text x="{_LEFT + wide / 2:.1f}" y="{_HEIGHT - 5}" text-anchor="middle">t / T</text>')
    points = [place(frame["time_over_T"], found) for frame, found in known]
    path = " ".join(f"{x:.2f},{y:.2f}" for x, y in points)
    lines.append(f'<polyline points="{path}" fill="none" stroke="#1f5fa8" stroke-width="1.5"/>')
    for (frame, _), (x, y) in zip(known, points, strict=True):
        colour = "#1f5fa8" if frame["passed"] else "#c22"
        lines.append(f'<circle cx="{x:.2f}" cy="{y:.2f}" r="2.5" fill="{colour}"/>')
    return lines
