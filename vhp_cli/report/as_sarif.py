"""The report as SARIF 2.1.0, the exchange format of code scanners."""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from urllib.parse import quote

from vhp_cli.measures import Finding, Report
from vhp_cli.report import text
from vhp_cli.report.as_json import dumps
from vhp_cli.report.verdict import all_findings, is_staged, left_alone, stage_words
from vhp_cli.rules import RULES

_SCHEMA = "https://docs.oasis-open.org/sarif/sarif/v2.1.0/errata01/os/schemas/sarif-schema-2.1.0.json"


def uri(path: str) -> str:
    """Return a path as a percent-encoded URI reference; an absolute path becomes a ``file:`` URI."""
    if re.match(r"[A-Za-z]:[\\/]", path):
        return f"file:///{path[0]}:{_quote(path[2:].replace(chr(92), '/'))}"
    return f"file://{_quote(path)}" if path.startswith("/") else _quote(path)


def _quote(path: str) -> str:
    try:
        return quote(path.encode("utf-8", "surrogateescape"))  # the bytes of the name on disk (PEP 383)
    except UnicodeEncodeError:  # other lone surrogates: names from Windows
        return quote(path.encode("utf-8", "surrogatepass"))


def _message(words: str) -> str:
    # "[words](target)" would be a link.
    return text.visible(words).replace("](", "] (")


def _rule(code: str) -> dict[str, object]:
    rule = RULES.get(code)
    if rule is None:
        return {"id": code}
    explanation = " ".join(filter(None, (rule.summary, rule.why)))
    advice = "\n".join(
        f"{title}: {words}"
        for title, words in (("Why", rule.why), ("Example", rule.example), ("Fix", rule.fix))
        if words
    )
    return {
        "id": code,
        "name": "".join(part.capitalize() for part in rule.name.split("-")),
        "shortDescription": {"text": rule.summary},
        "fullDescription": {"text": explanation},
        "help": {"text": advice or rule.summary},
        "defaultConfiguration": {"enabled": rule.level is not None, "level": rule.level or "warning"},
    }


def _location(name: str, file: str) -> dict[str, object]:
    location: dict[str, object] = {"logicalLocations": [{"name": text.visible(name), "kind": "object"}]}
    if file:
        # A mesh file has no lines to speak of, but code scanning shows nothing that has no line.
        location["physicalLocation"] = {"artifactLocation": {"uri": uri(file)}, "region": {"startLine": 1}}
    return location


def _result(finding: Finding, rules: list[str], files: dict[str, str], fingerprint: str) -> dict[str, object]:
    locations = [_location(name, files.get(name, "")) for name in finding["tissues"]]
    result: dict[str, object] = {
        "ruleId": finding["rule"],
        "ruleIndex": rules.index(finding["rule"]),
        "level": finding["level"],
        "message": {"text": _message(text.headline(finding))},
        "locations": locations[:1],
        "partialFingerprints": {"vhpFinding/v1": fingerprint, "primaryLocationLineHash": fingerprint},
        "occurrenceCount": max(1, finding["count"]),
        "properties": {"tissues": finding["tissues"], "places": finding["places"], "hint": finding["hint"]},
    }
    if len(locations) > 1:
        result["relatedLocations"] = [{"id": index, **place} for index, place in enumerate(locations[1:], start=1)]
    return result


def _fingerprint(finding: Finding) -> str:
    """Hash what makes a finding the same one in the next run: its rule and its tissues, in any order."""
    identity = "\0".join((finding["rule"], *sorted(finding["tissues"])))
    return hashlib.sha256(identity.encode("utf-8", "surrogatepass")).hexdigest()[:32]


def _invocation(report: Report, files: dict[str, str]) -> dict[str, object]:
    """Return what became of the tissues that a stage left alone, as remarks on the run itself."""
    notifications = [
        {
            "level": "error" if tissue.get("status") == "failed" else "warning",
            "message": {"text": _message(f"{text.visible(tissue['name'])}: {stage_words(tissue)}")},
            "locations": [_location(tissue["name"], files.get(tissue["name"], ""))],
        }
        for tissue in left_alone(report)
    ]
    return {
        "executionSuccessful": not any(tissue.get("status") == "failed" for tissue in report["tissues"]),
        "toolExecutionNotifications": notifications,
    }


def render_sarif(report: Report, *, base: str = "") -> str:
    """Return a SARIF log with one run; results stand in the order of the report's findings.

    Parameters
    ----------
    report
        The report.
    base
        What to put before the file of a tissue so that it is relative to the repository, such as ``"model/"``.
    """
    findings = all_findings(report)
    rules = sorted({finding["rule"] for finding in findings})
    files = {tissue["name"]: text.file_path(base, tissue["file"]) for tissue in report["tissues"] if tissue["file"]}
    compared = any(finding.get("known") for finding in findings)
    results = []
    seen: Counter[str] = Counter()
    for finding in findings:
        digest = _fingerprint(finding)
        seen[digest] += 1
        result = _result(finding, rules, files, f"{digest}:{seen[digest]}")
        if compared:
            result["baselineState"] = "unchanged" if finding.get("known") else "new"
        results.append(result)
    driver: dict[str, object] = {"name": "vhp", "rules": [_rule(code) for code in rules]}
    version = report["tool"].get("version")
    if isinstance(version, str):
        driver["version"] = version
    properties: dict[str, object] = {"command": report["command"], "summary": report["summary"]}
    run = {
        "tool": {"driver": driver},
        "columnKind": "unicodeCodePoints",
        "results": results,
        "properties": properties,
    }
    if is_staged(report):
        properties["stage"] = [
            {"tissue": tissue["name"], **{key: tissue.get(key) for key in ("status", "reason", "deviation_mm")}}
            for tissue in report["tissues"]
        ]
        run["invocations"] = [_invocation(report, files)]
    return dumps({"$schema": _SCHEMA, "version": "2.1.0", "runs": [run]})
