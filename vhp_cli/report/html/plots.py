"""Plots as SVG, whose colours come from the page's style."""

from __future__ import annotations

from collections.abc import Sequence

from vhp_cli.measures import SmoothingStep
from vhp_cli.report.html.markup import words
from vhp_cli.report.text import number

_WIDTH, _HEIGHT, _LEFT, _BOTTOM, _TOP = 250, 120, 6, 18, 18


def histogram(
    title: str,
    counts: Sequence[int],
    low: float,
    high: float,
    *,
    before: Sequence[int] | None = None,
    open_end: bool = False,
) -> str:
    """Return bars of equal width over a range, those of before as an outline behind them.

    Parameters
    ----------
    title
        What is counted, with its unit.
    counts
        In each bin.
    low, high
        Ends of the range.
    before
        Counts before a stage, in the same bins; each distribution is drawn as shares of its own sum.
    open_end
        Whether the last bin also holds what lies beyond.
    """
    tallest = max([_share(counts, index) for index in range(len(counts))], default=0.0)
    if before:
        tallest = max([tallest, *(_share(before, index) for index in range(len(before)))])
    wide, tall = _WIDTH - 2 * _LEFT, _HEIGHT - _BOTTOM - _TOP
    step = wide / max(len(counts), 1)
    parts = _opening(title)
    for index, count in enumerate(counts):
        height = tall * _share(counts, index) / tallest if tallest else 0.0
        if count:
            height = max(height, 1.0)
        start, end = (low + (high - low) * (index + side) / len(counts) for side in (0, 1))
        upto = "and more" if open_end and index == len(counts) - 1 else f"to {number(end)}"
        parts.append(
            f'<rect class="bar" x="{_LEFT + index * step:.1f}" y="{_TOP + tall - height:.1f}" width="{step - 1:.1f}" '
            f'height="{height:.1f}"><title>{number(start)} {upto}: {count:,}</title></rect>'
        )
    if before and tallest:
        line = []
        for index in range(len(before)):
            y = _TOP + tall * (1 - _share(before, index) / tallest)
            line += [f"{_LEFT + index * step:.1f},{y:.1f}", f"{_LEFT + (index + 1) * step:.1f},{y:.1f}"]
        parts.append(f'<polyline class="was" points="{" ".join(line)}"><title>before</title></polyline>')
    for share, anchor in ((0.0, "start"), (0.5, "middle"), (1.0, "end")):
        value = number(low + share * (high - low)) + ("+" if open_end and share == 1 else "")
        parts.append(
            f'<text class="tick" x="{_LEFT + share * wide:.1f}" y="{_HEIGHT - 5}" text-anchor="{anchor}">{value}</text>'
        )
    return "".join([*parts, "</svg>"])


def _share(counts: Sequence[int], index: int) -> float:
    total = sum(counts)
    return counts[index] / total if total else 0.0


def sparkline(counts: Sequence[int]) -> str:
    """Return a histogram the size of a word."""
    tallest = max(counts, default=0)
    if not tallest:
        return ""
    bars = "".join(
        f"M{3 * index},16v-{max(round(15 * count / tallest, 1), 1)}h2.4V16"
        for index, count in enumerate(counts)
        if count
    )
    return f'<svg class="spark" viewBox="0 0 60 16" aria-hidden="true"><path d="{bars}"/></svg>'


def history_plot(steps: Sequence[SmoothingStep]) -> str:
    """Return mean and least q over the iterations of smoothing."""
    wide, tall = _WIDTH - 2 * _LEFT - 22, _HEIGHT - _BOTTOM - _TOP
    last = max(steps[-1]["iteration"], 1)
    parts = _opening("Mean and least q by iteration")
    for level in (0.0, 0.5, 1.0):
        y = _TOP + tall * (1 - level)
        parts.append(f'<line class="grid" x1="{_LEFT + 22}" x2="{_WIDTH - _LEFT}" y1="{y:.1f}" y2="{y:.1f}"/>')
        parts.append(
            f'<text class="tick" x="{_LEFT + 17}" y="{y + 3:.1f}" text-anchor="end">{number(level)[:3]}</text>'
        )
    for key, kind in (("mean_q", "mean"), ("min_q", "least")):
        points = [
            (_LEFT + 22 + wide * step["iteration"] / last, _TOP + tall * (1 - float(step[key])), step)  # type: ignore[literal-required]
            for step in steps
        ]
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y, _ in points)
        parts.append(f'<polyline class="line {kind}" points="{path}"/>')
        for x, y, step in points:
            value = number(float(step[key]))  # type: ignore[literal-required]
            parts.append(
                f'<circle class="dot {kind}" cx="{x:.1f}" cy="{y:.1f}" r="1.8"><title>{step["iteration"]} '
                f"{words(step['step'])}: {kind} q {value}</title></circle>"
            )
    parts.append(f'<text class="tick" x="{_LEFT + 22}" y="{_HEIGHT - 5}">0</text>')
    parts.append(f'<text class="tick" x="{_WIDTH - _LEFT}" y="{_HEIGHT - 5}" text-anchor="end">{last}</text>')
    return "".join([*parts, "</svg>"])


def _opening(title: str) -> list[str]:
    return [
        f'<svg class="plot" viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" aria-label="{words(title)}">',
        f'<text class="caption" x="{_LEFT}" y="11">{words(title)}</text>',
    ]
