"""Compare the findings with those of an earlier report, so that only new ones fail the gate."""

from __future__ import annotations

import json
from collections import defaultdict
from typing import Any

from vhp_cli.errors import UsageError
from vhp_cli.measures import Finding, Level
from vhp_cli.report.verdict import LEVELS

_HINT = "write the baseline with: vhp check MODEL --format json --report baseline.json"
_Identity = tuple[str, frozenset[str]]
_Old = tuple[Level, int]


def parse_baseline(data: bytes | str) -> dict[str, Any]:
    """Read the text of an earlier JSON report.

    Raises
    ------
    UsageError
        If it is not a report of vhp.
    """
    try:
        report = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise UsageError(f"the baseline is not a JSON document: {error}", hint=_HINT) from None
    _old_findings(report)
    return dict(report)


def mark_known(findings: list[Finding], baseline_report: dict[str, Any]) -> list[Finding]:
    """Mark the findings that an earlier report holds already.

    A finding is known if the earlier report has one with the same rule and the same tissues (in any order), at least
    as many occurrences, and a level at least as severe. One with more occurrences is new; its message says so.

    Parameters
    ----------
    findings
        Findings of this run; not changed.
    baseline_report
        The earlier report.

    Returns
    -------
    list of Finding
        The findings in the same order; the known ones with ``known: True``.

    Raises
    ------
    UsageError
        If the earlier report is malformed.
    """
    before = _old_findings(baseline_report)
    marked: list[Finding] = []
    for finding in findings:
        copy = finding.copy()
        copy.pop("known", None)
        old = before.get((finding["rule"], frozenset(finding["tissues"])), [])
        match = _best_match(finding, old)
        if match is None and old:
            level, count = max(old, key=lambda item: item[1])
            copy["message"] += f" (was {count:,})" if finding["count"] > count else f" (was a {level})"
        elif match is not None:
            old.remove(match)  # one old finding excuses one new finding
            copy["known"] = True
        marked.append(copy)
    return marked


def _best_match(finding: Finding, old: list[_Old]) -> _Old | None:
    severity = LEVELS.index(finding["level"])
    enough = [(level, count) for level, count in old if count >= finding["count"] and LEVELS.index(level) <= severity]
    return min(enough, key=lambda item: item[1], default=None)


def _old_findings(report: object) -> dict[_Identity, list[_Old]]:
    """Return level and count of the findings of an earlier report by rule and tissues, checked."""
    if not isinstance(report, dict):
        raise UsageError("the baseline is not a report of vhp", hint=_HINT)
    if report.get("schema") != "vhp-report/1":
        raise UsageError(f"the baseline has the schema {report.get('schema')!r}, not 'vhp-report/1'", hint=_HINT)
    findings = report.get("findings")
    if not isinstance(findings, list):
        raise UsageError("the baseline has no list of findings", hint=_HINT)
    old: dict[_Identity, list[_Old]] = defaultdict(list)
    for index, finding in enumerate(findings):
        if not isinstance(finding, dict):
            raise UsageError(f"findings[{index}] of the baseline is not an object", hint=_HINT)
        rule, tissues, level, count = (finding.get(key) for key in ("rule", "tissues", "level", "count"))
        if (
            not isinstance(rule, str)
            or not isinstance(tissues, list)
            or not all(isinstance(name, str) for name in tissues)
            or level not in LEVELS
            or not isinstance(count, int)
            or isinstance(count, bool)
        ):
            raise UsageError(f"findings[{index}] of the baseline lacks a rule, level, tissues or count", hint=_HINT)
        old[rule, frozenset(tissues)].append((level, count))
    return old
