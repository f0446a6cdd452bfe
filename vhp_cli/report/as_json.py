"""The report as JSON: one document, or one line per record."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from functools import lru_cache
from itertools import chain

from vhp_cli import measures
from vhp_cli.measures import Report
from vhp_cli.report.verdict import all_findings

_encode = json.JSONEncoder(allow_nan=False, separators=(", ", ": ")).encode

# Keys stand as in the types, outermost type first; all others follow in alphabetical order, so that the order never
# depends on how a record came about (computed or read from a cache).
_RECORDS = (
    measures.Report,
    measures.Summary,
    measures.Finding,
    measures.TissueRecord,
    measures.PairRecord,
    measures.Place,
    measures.Introduced,
    measures.Action,
    measures.Deviation,
    measures.Distance,
)
_FIRST = (
    *("record", "schema", "rule", "level", "passed"),
    *("step", "name", "file", "sha256", "format", "tissue_type", "status", "reason", "a", "b", "min", "mean", "max"),
)
_RANK = {
    key: rank for rank, key in enumerate(dict.fromkeys(chain(_FIRST, *(record.__annotations__ for record in _RECORDS))))
}


@lru_cache(maxsize=1024)
def _ordered(keys: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(sorted(keys, key=lambda key: (_RANK.get(key, len(_RANK)), key)))


def _in_order(value: dict[str, object]) -> dict[str, object]:
    keys = tuple(value)
    order = _ordered(keys)
    return value if order == keys else {key: value[key] for key in order}


def _sorted_deeply(value: object) -> object:
    if isinstance(value, dict):
        return {key: _sorted_deeply(item) for key, item in _in_order(value).items()}
    if isinstance(value, (list, tuple)):
        return [_sorted_deeply(item) for item in value]
    return value


def _lines(value: dict[str, object]) -> Iterator[str]:
    """Yield the text of a document: its members on lines of their own, and the records or members within these too.

    What lies deeper stands on the line of its record, written by the C encoder: large reports are written in
    milliseconds, and a line of a difference is a tissue, a pair or a finding.
    """
    opening = "{"
    for key, item in _in_order(value).items():
        yield f"{opening}\n  {_encode(key)}: "
        opening = ","
        if isinstance(item, dict) and item:
            members = (
                f"{_encode(name)}: {_encode(_sorted_deeply(member))}" for name, member in _in_order(item).items()
            )
            yield "{\n    " + ",\n    ".join(members) + "\n  }"
        elif isinstance(item, (list, tuple)) and item:
            yield "[\n    " + ",\n    ".join(_encode(_sorted_deeply(record)) for record in item) + "\n  ]"
        else:
            yield _encode(item)
    yield "\n}\n"


def _not_finite(value: object, where: str) -> Iterator[str]:
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _not_finite(item, f"{where}.{key}" if where else str(key))
    elif isinstance(value, (list, tuple)):
        for index, item in enumerate(value):
            yield from _not_finite(item, f"{where}[{index}]")
    elif isinstance(value, float) and not math.isfinite(value):
        yield where


def dumps(document: Mapping[str, object]) -> str:
    """Return a JSON document in ASCII, keys in a fixed order.

    Raises
    ------
    ValueError
        If a number is NaN or infinite, which JSON can't hold; names the place.
    """
    try:
        return "".join(_lines(dict(document)))
    except ValueError as error:
        raise ValueError(f"not a finite number: {next(_not_finite(document, ''), error)}") from None


def render_json(report: Report) -> str:
    """Return the whole report as one JSON document (schema vhp-report/1)."""
    return dumps(report)


def render_jsonl(report: Report) -> str:
    """Return one JSON object per line: the run, each tissue, pair and finding, and the summary as last line."""
    described = ("schema", "tool", "command", "settings", "model", "nesting", "run")
    extra = [key for key in report if key not in measures.Report.__annotations__]
    lines: list[dict[str, object]] = [
        {"record": "report", **{key: report[key] for key in (*described, *extra)}}  # type: ignore[literal-required]
    ]
    lines += [{"record": "tissue", **tissue} for tissue in report["tissues"]]
    lines += [{"record": "pair", **pair} for pair in report["pairs"]]
    lines += [{"record": "finding", **finding} for finding in all_findings(report)]
    lines.append({"record": "summary", **report["summary"]})
    try:
        return "".join(f"{_encode(_sorted_deeply(line))}\n" for line in lines)
    except ValueError as error:
        raise ValueError(f"not a finite number: {next(_not_finite(report, ''), error)}") from None
