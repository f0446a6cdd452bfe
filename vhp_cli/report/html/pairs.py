"""Tissues near each other: which pairs, as a matrix and as a table."""

from __future__ import annotations

from collections.abc import Sequence

from vhp_cli.measures import PairRecord
from vhp_cli.report.html.markup import name_words, table, words
from vhp_cli.report.text import number, plural, visible

_ROWS = 400  # of the table
_LABELLED = 45  # tissues up to which the matrix has names beside it
_SIDE = 640  # of the matrix
_ORDER = ("identical", "crossing", "touching", "disjoint", "a_inside_b", "b_inside_a")
_WORDS = {
    "identical": "identical",
    "crossing": "crossing",
    "touching": "touching",
    "disjoint": "apart",
    "a_inside_b": "first in second",
    "b_inside_a": "second in first",
}
_LEGEND = (
    ("error", "crossing or identical"),
    ("warning", "touching"),
    ("apart", "apart"),
    ("inside", "one in the other"),
)


def pairs_section(pairs: Sequence[PairRecord], names: Sequence[str]) -> str:
    """Return the near pairs, worst first; only tissues that have one are in the matrix.

    Parameters
    ----------
    pairs
        Those of the report.
    names
        Of all tissues, in order.
    """
    # A tissue deep within another is not near its surface.
    far = [pair for pair in pairs if pair["min_gap_mm"] is None]
    pairs = [pair for pair in pairs if pair["min_gap_mm"] is not None]
    deep = f"<p>{plural(len(far), 'pair')}, one within the other and not near its surface.</p>" if far else ""
    if not pairs:
        return f'<p class="calm">No two surfaces are near each other.</p>{deep}'
    ordered = sorted(pairs, key=_severity)
    number_of = {name: index for index, name in enumerate(names)}
    rows = [_row(pair, number_of) for pair in ordered[:_ROWS]]
    headings = [("First", False), ("Second", False), ("Relation", False), ("Gap (mm)", True)]
    headings += [("Crossing faces", True), ("Overlap (mm3)", True)]
    made = _matrix(pairs, names) + table(headings, rows, kind="pairs")
    if len(pairs) > _ROWS:
        made += f'<p class="dim">{plural(len(pairs) - _ROWS, "pair")} further apart: see the JSON report.</p>'
    return made + deep


def _severity(pair: PairRecord) -> tuple[int, float, float, str, str]:
    relation = pair["relation"]
    rank = _ORDER.index(relation) if relation in _ORDER[:3] else 3
    gap = pair["min_gap_mm"]
    return rank, -pair["overlap_mm3"], float("inf") if gap is None else gap, pair["a"], pair["b"]


def _row(pair: PairRecord, number_of: dict[str, int]) -> list[tuple[str, float | str | None]]:
    first, second = (
        f'<button type="button" class="name" data-pair="{number_of.get(pair["a"], "")},{number_of.get(pair["b"], "")}">'
        f"<span>{name_words(name)}</span></button>"
        for name in (pair["a"], pair["b"])
    )
    gap = pair["min_gap_mm"]
    said = _WORDS.get(pair["relation"], pair["relation"])
    return [
        (first, visible(pair["a"]).casefold()),
        (second, visible(pair["b"]).casefold()),
        (f'<span class="{_kind(pair)}">{words(said)}</span>', _ORDER.index(pair["relation"])),
        (number(gap), gap),
        (f"{pair['crossing_faces']:,}", pair["crossing_faces"]),
        (number(pair["overlap_mm3"]), pair["overlap_mm3"]),
    ]


def _kind(pair: PairRecord) -> str:
    if pair["relation"] in ("crossing", "identical"):
        return "error"
    if pair["relation"] == "touching":
        return "warning"
    return "inside" if pair["relation"] != "disjoint" else "apart"


def _matrix(pairs: Sequence[PairRecord], names: Sequence[str]) -> str:
    """Return a square with a cell for each near pair, below the diagonal."""
    involved = {name for pair in pairs for name in (pair["a"], pair["b"])}
    # Tissues with the worst pairs come first.
    rank = dict.fromkeys(involved, len(_ORDER))
    for pair in pairs:
        for name in (pair["a"], pair["b"]):
            rank[name] = min(rank[name], _severity(pair)[0])
    order = {name: index for index, name in enumerate(names)}
    listed = sorted(involved, key=lambda name: (rank[name], order.get(name, len(order)), name))
    place = {name: index for index, name in enumerate(listed)}
    labelled = len(listed) <= _LABELLED
    left = 150 if labelled else 8
    step = min((_SIDE - left) / len(listed), 22.0)
    side = step * len(listed)
    parts = [
        f'<svg class="matrix" viewBox="0 0 {left + side:.1f} {side:.1f}" style="max-width:{left + side:.0f}px" '
        f'role="img" aria-label="Near pairs of {len(listed)} tissues">',
        f'<path class="half" d="M{left},0V{side:.1f}H{left + side:.1f}Z"/>',
    ]
    if labelled:
        for name, index in place.items():
            short = name if len(name) <= 24 else name[:23] + "…"
            y = (index + 0.5) * step + 3
            parts.append(f'<text class="tick" x="{left - 5}" y="{y:.1f}" text-anchor="end">{words(short)}</text>')
    for pair in pairs:
        column, row = sorted((place[pair["a"]], place[pair["b"]]))
        gap = pair["min_gap_mm"]
        said = f"{pair['a']} and {pair['b']}: {_WORDS.get(pair['relation'], pair['relation'])}"
        said += "" if gap is None else f", gap {number(gap)} mm"
        said += f", overlap {number(pair['overlap_mm3'])} mm3" if pair["overlap_mm3"] else ""
        parts.append(
            f'<rect class="cell {_kind(pair)}" x="{left + column * step:.2f}" y="{row * step:.2f}" '
            f'width="{step * 0.92:.2f}" height="{step * 0.92:.2f}" '
            f'data-pair="{order.get(pair["a"], "")},{order.get(pair["b"], "")}"><title>{words(said)}</title></rect>'
        )
    legend = "".join(f'<span><i class="{kind}"></i>{text}</span>' for kind, text in _LEGEND)
    return f'<div class="legend">{legend}</div>' + "".join(parts) + "</svg>"
