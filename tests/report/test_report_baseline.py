from __future__ import annotations

import copy
import json
from typing import Any

import pytest
from example_report import build, example, finding, many
from hypothesis import given
from hypothesis import strategies as st

from vhp_cli.errors import UsageError
from vhp_cli.measures import Finding
from vhp_cli.report import render
from vhp_cli.report.baseline import mark_known, parse_baseline


def baseline(*findings: Finding) -> dict[str, Any]:
    return parse_baseline(render(build([], [], list(findings), {}), "json"))


def known(findings: list[Finding]) -> list[bool]:
    return [bool(item.get("known")) for item in findings]


def test_everything_is_known_in_the_report_itself() -> None:
    report = many(30)
    before = copy.deepcopy(report["findings"])
    marked = mark_known(report["findings"], parse_baseline(render(report, "json").encode()))
    assert all(known(marked))
    assert report["findings"] == before
    assert [{**item, "known": True} for item in before] == marked


def test_nothing_is_known_to_an_empty_baseline() -> None:
    findings = example()["findings"]  # one is marked as known there
    assert not any(known(mark_known(findings, baseline())))


def test_another_rule_or_other_tissues_are_new() -> None:
    old = baseline(finding("T001", ["a"], 5), finding("P001", ["a", "b"], 5))
    new = [finding("T002", ["a"], 1), finding("T001", ["b"], 1), finding("P001", ["a", "c"], 1), finding("P001", ["a"])]
    assert not any(known(mark_known(new, old)))


def test_a_pair_is_known_in_either_order() -> None:
    assert known(mark_known([finding("P001", ["b", "a"], 5)], baseline(finding("P001", ["a", "b"], 5)))) == [True]


@pytest.mark.parametrize(("count", "expected"), [(1, True), (5, True), (6, False)])
def test_more_occurrences_than_before_are_new(count: int, expected: bool) -> None:
    (marked,) = mark_known([finding("T001", ["a"], count, "open edges")], baseline(finding("T001", ["a"], 5)))
    assert known([marked]) == [expected]
    assert marked["message"] == ("open edges" if expected else "open edges (was 5)")


def test_a_former_warning_does_not_excuse_an_error() -> None:
    old = baseline(finding("T001", ["a"], 5, level="warning"))
    (marked,) = mark_known([finding("T001", ["a"], 5, "open edges")], old)
    assert known([marked]) == [False]
    assert marked["message"] == "open edges (was a warning)"
    assert known(mark_known([finding("T001", ["a"], 5, level="note")], old)) == [True]


def test_one_old_finding_excuses_one_new_one() -> None:
    old = baseline(finding("P001", ["a", "b"], 5))
    assert known(mark_known([finding("P001", ["a", "b"], 2), finding("P001", ["b", "a"], 2)], old)) == [True, False]


@given(st.lists(st.integers(1, 4), max_size=5), st.lists(st.integers(1, 4), max_size=5))
def test_known_findings_can_be_matched_one_to_one(new: list[int], old: list[int]) -> None:
    marked = mark_known(
        [finding("T001", ["a"], count) for count in new], baseline(*(finding("T001", ["a"], count) for count in old))
    )
    excused = sorted((item["count"] for item in marked if item.get("known")), reverse=True)
    assert len(excused) <= len(old)
    assert all(count <= allowed for count, allowed in zip(excused, sorted(old, reverse=True), strict=False))
    if sorted(new) == sorted(old):
        assert len(excused) == len(new)


GOOD: dict[str, Any] = {"schema": "vhp-report/1", "findings": []}


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"{",
        b"\xff\xfe\x00",
        "[" * 100_000,
        "[]",
        "3",
        '"report"',
        "null",
        "{}",
        '{"schema": "vhp-report/2", "findings": []}',
        '{"schema": "vhp-report/1"}',
        '{"schema": "vhp-report/1", "findings": {}}',
        '{"schema": "vhp-report/1", "findings": [1]}',
        *(
            json.dumps({**GOOD, "findings": [{**finding("T001", ["a"]), key: value}]})
            for key, value in [
                ("rule", None),
                ("rule", ["T001"]),
                ("tissues", "a"),
                ("tissues", [1]),
                ("level", "fatal"),
                ("level", ["error"]),
                ("count", "5"),
                ("count", 1e400),
                ("count", True),
                ("count", None),
            ]
        ),
    ],
)
def test_a_malformed_baseline_is_a_usage_error(data: str | bytes) -> None:
    with pytest.raises(UsageError, match="baseline") as caught:
        parse_baseline(data)
    assert "--report" in caught.value.hint


def test_a_malformed_dictionary_is_a_usage_error_too() -> None:
    with pytest.raises(UsageError):
        mark_known([], {"schema": "vhp-report/1", "findings": [{}]})
    assert mark_known([], GOOD) == []
