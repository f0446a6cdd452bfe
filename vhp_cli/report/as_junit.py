"""The report as JUnit XML: a test case per tissue and per pair of tissues with findings."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections import defaultdict
from dataclasses import dataclass, field

from vhp_cli.measures import Finding, Report
from vhp_cli.report import text
from vhp_cli.report.verdict import all_findings, rule_name, seconds, stage_words


@dataclass(slots=True)
class _Case:
    name: str
    findings: list[Finding] = field(default_factory=list)
    stage: str = ""  # what a stage made of the tissue
    error: str = ""  # why it could not be processed

    @property
    def failures(self) -> list[Finding]:
        return [finding for finding in self.findings if finding["level"] == "error" and not finding.get("known")]

    @property
    def remarks(self) -> list[Finding]:
        return [finding for finding in self.findings if finding["level"] != "error" or finding.get("known")]


def _suites(report: Report) -> dict[str, list[_Case]]:
    """Group the findings into cases: tissues first (all of them), then pairs and the model (only with findings)."""
    tissues = [
        _Case(
            text.visible(tissue["name"]),
            stage=stage_words(tissue),
            error=text.visible(tissue.get("reason", "")) if tissue.get("status") == "failed" else "",
        )
        for tissue in report["tissues"]
    ]
    by_name = dict(zip((tissue["name"] for tissue in report["tissues"]), tissues, strict=True))
    pairs: dict[tuple[str, ...], _Case] = {}
    model = _Case("model")
    for finding in all_findings(report):
        names = tuple(finding["tissues"])
        if len(set(names)) > 1:
            case = pairs.setdefault(names, _Case(text.tissue_names(finding)))
        else:
            case = by_name.get(names[0], model) if names else model
        case.findings.append(finding)
    suites: dict[str, list[_Case]] = defaultdict(list, {"vhp.tissue": tissues})
    if pairs:
        suites["vhp.pair"] = list(pairs.values())
    if model.findings:
        suites["vhp.model"] = [model]
    return suites


def _detail(finding: Finding) -> str:
    lines = [text.headline(finding), *(text.place(place) for place in finding["places"])]
    if finding["hint"]:
        lines.append(f"Fix: {text.visible(finding['hint'])}")
    return "\n".join(lines)


def _case_element(classname: str, case: _Case) -> ElementTree.Element:
    element = ElementTree.Element("testcase", name=case.name, classname=classname, time="0")
    for finding in case.failures:
        failure = ElementTree.SubElement(
            element, "failure", message=text.visible(finding["message"]), type=rule_name(finding["rule"])
        )
        failure.text = _detail(finding)
    if case.error:
        ElementTree.SubElement(element, "error", message=case.error, type="failed")
    if case.remarks or case.stage:
        lines = [case.stage] if case.stage else []
        lines += [
            f"{'known ' if finding.get('known') else ''}{finding['level']} {rule_name(finding['rule'])}: "
            f"{_detail(finding)}"
            for finding in case.remarks
        ]
        ElementTree.SubElement(element, "system-out").text = "\n".join(lines)
    return element


def render_junit(report: Report) -> str:
    """Return JUnit XML: a case fails with one ``failure`` per new error; all else is in its ``system-out``."""
    root = ElementTree.Element("testsuites", name=f"vhp {text.visible(report['command'])}")
    time = seconds(report) or 0.0
    for classname, cases in _suites(report).items():
        suite = ElementTree.SubElement(root, "testsuite", name=classname, tests=str(len(cases)))
        suite.set("failures", str(sum(bool(case.failures) for case in cases)))
        suite.set("errors", str(sum(bool(case.error) for case in cases)))
        suite.set("skipped", "0")
        suite.set("time", f"{time:.3f}" if classname == "vhp.tissue" else "0")
        suite.extend(_case_element(classname, case) for case in cases)
    ElementTree.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'
