from __future__ import annotations

import json
from typing import Any, NotRequired, get_origin, get_type_hints

import jsonschema
import pytest
from example_report import empty, example, finding, healed, sound

from vhp_cli import measures
from vhp_cli.report import render, schema

VALIDATOR = jsonschema.Draft202012Validator(schema())

DEFINITIONS = {
    "place": measures.Place,
    "finding": measures.Finding,
    "topology": measures.Topology,
    "quality": measures.Quality,
    "spread": measures.Spread,
    "bounds": measures.Bounds,
    "self_intersections": measures.SelfIntersections,
    "tissue": measures.TissueRecord,
    "action": measures.Action,
    "distance": measures.Distance,
    "deviation": measures.Deviation,
    "introduced": measures.Introduced,
    "before": measures.Before,
    "pair": measures.PairRecord,
    "summary": measures.Summary,
}


def test_the_schema_is_valid() -> None:
    jsonschema.Draft202012Validator.check_schema(schema())


@pytest.mark.parametrize("report", [example(), sound(), empty(), healed()], ids=["example", "sound", "empty", "healed"])
def test_reports_are_valid(report: measures.Report) -> None:
    VALIDATOR.validate(json.loads(render(report, "json")))


@pytest.mark.parametrize("name", [*DEFINITIONS, ""])
def test_the_schema_agrees_with_the_types(name: str) -> None:
    record = DEFINITIONS.get(name, measures.Report)
    described = schema()["$defs"][name] if name else schema()
    hints = get_type_hints(record, include_extras=True)
    required = {key for key, hint in hints.items() if get_origin(hint) is not NotRequired}
    assert set(described["required"]) == required
    assert set(hints) <= set(described["properties"])


def test_every_fixed_key_is_required() -> None:
    report = json.loads(render(healed(), "json"))
    changed = report["tissues"][1]
    parts: list[tuple[str, dict[str, Any]]] = [
        ("", report),
        ("summary", report["summary"]),
        ("tissue", report["tissues"][0]),
        ("topology", report["tissues"][0]["topology"]),
        ("quality", report["tissues"][0]["quality"]),
        ("spread", report["tissues"][0]["edge_mm"]),
        ("bounds", report["tissues"][0]["bounds_mm"]),
        ("self_intersections", report["tissues"][0]["self_intersections"]),
        ("pair", report["pairs"][0]),
        ("finding", report["findings"][1]),
        ("place", report["findings"][1]["places"][0]),
        ("action", changed["actions"][0]),
        ("deviation", changed["deviation_mm"]),
        ("distance", changed["deviation_mm"]["to_input"]),
        ("introduced", changed["introduced"][0]),
        ("before", changed["before"]),
    ]
    assert {name for name, _ in parts} == {"", *DEFINITIONS}
    for name, record in parts:
        for key in schema()["$defs"][name]["required"] if name else schema()["required"]:
            value = record.pop(key)
            assert not VALIDATOR.is_valid(report), f"{name}.{key} may be missing"
            record[key] = value
    VALIDATOR.validate(report)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("schema",), "vhp-report/2"),
        (("summary", "passed"), "yes"),
        (("summary", "counts"), {"open-edge": 1}),
        (("summary", "triangles"), 1.5),
        (("tissues", 0, "triangles"), -1),
        (("tissues", 0, "sha256"), "abc"),
        (("tissues", 0, "volume_mm3"), None),
        (("tissues", 0, "quality", "histogram"), [1, 2, 3]),
        (("tissues", 0, "quality", "min"), 1.5),
        (("tissues", 0, "bounds_mm", "min"), [0.0, 1.0]),
        (("tissues", 0, "genus"), 0.5),
        (("tissues", 0, "status"), "fixed"),
        (("pairs", 0, "relation"), "overlapping"),
        (("pairs", 0, "faces"), [1]),
        (("pairs", 0, "overlap_mm3"), "3.5"),
        (("findings", 0, "level"), "fatal"),
        (("findings", 0, "rule"), "open-edge"),
        (("findings", 0, "tissues"), "Liver"),
        (("findings", 1, "places", 0, "xyz_mm"), [0.0, 0.0, None]),
        (("findings", 1, "places", 0, "face"), -1),
        (("nesting", "Liver"), 3),
    ],
)
def test_wrong_values_are_refused(path: tuple[str | int, ...], value: object) -> None:
    report: Any = json.loads(render(example(), "json"))
    record = report
    for step in path[:-1]:
        record = record[step]
    assert record.get(path[-1]) != value if isinstance(record, dict) else record[path[-1]] != value
    record[path[-1]] = value
    assert not VALIDATOR.is_valid(report)


def test_further_keys_are_welcome() -> None:
    report: Any = json.loads(render(example(), "json"))
    for record in (report, report["tissues"][0], report["pairs"][0], report["findings"][0], report["summary"]):
        record["something_new"] = {"a": 1}
    VALIDATOR.validate(report)


@pytest.mark.parametrize("form", ["json", "jsonl", "sarif"])
@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
def test_numbers_that_json_lacks_are_never_written(form: str, value: float) -> None:
    report = example()
    place: measures.Place = {"xyz_mm": [0.0, value, 0.0], "face": 1}
    report["findings"].append(finding("X001", ["Liver"], places=[place]))
    with pytest.raises(ValueError, match=r"not a finite number: .*places\[0\].xyz_mm\[1\]"):
        render(report, form)
