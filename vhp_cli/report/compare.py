"""Two reports side by side: what came, went, got better and got worse."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypedDict

from vhp_cli.errors import UsageError
from vhp_cli.measures import Finding, PairRecord, Report, TissueRecord
from vhp_cli.report.baseline import mark_known

SCHEMA = "vhp-diff/1"
FailOn = Literal["worse", "errors", "changes", "never"]

# A pair that is not in a report is farther apart than gaps are measured.
APART = "apart"
_FACTS = ("components", "genus", "closed", "manifold", "oriented", "outward", "tissue_type")


class Change(TypedDict):
    """A value in both reports."""

    before: Any
    after: Any


class TissueChange(TypedDict):
    """A tissue that is not the same in both."""

    name: str
    same_file: bool  # the bytes are equal: settings make the difference
    measures: dict[str, Change]  # those that differ
    volume_change: float | None  # as a share; None where one of the two is not defined
    area_change: float | None


class PairChange(TypedDict):
    """Two tissues that lie to each other in another way."""

    a: str
    b: str
    relation: Change
    min_gap_mm: Change
    overlap_mm3: Change


class RuleCounts(TypedDict):
    """How the findings of a rule changed."""

    new: int
    worse: int
    eased: int
    fixed: int


class Tissues(TypedDict):
    """The tissues of both."""

    added: list[str]
    removed: list[str]
    renamed: list[Change]
    changed: list[TissueChange]
    unchanged: int


class Findings(TypedDict):
    """The findings of both."""

    new: list[Finding]
    worse: list[Finding]  # more often than before, or of a severer level
    eased: list[Finding]
    fixed: list[Finding]
    by_rule: dict[str, RuleCounts]


class Difference(TypedDict):
    """What two reports differ in."""

    schema: str
    before: str
    after: str
    equal: bool
    worse: list[str]  # in words, what counts as worse
    passed: Change
    triangles: Change
    settings_differ: list[str]
    tissues: Tissues
    pairs: list[PairChange]
    findings: Findings


_NEEDED = {
    "tissues": (
        *("name", "sha256", "triangles", "volume_mm3", "area_mm2", "quality", "edge_mm", "self_intersections"),
        *_FACTS,
    ),
    "pairs": ("a", "b", "relation", "min_gap_mm", "overlap_mm3"),
    "findings": ("rule", "level", "tissues", "count", "message", "places", "hint"),
}


def parse_report(data: bytes | str, name: str) -> Report:
    """Read a JSON report, and make sure that it can be compared.

    Raises
    ------
    UsageError
        If it is not a report of vhp.
    """
    hint = "write a report with: vhp check MODEL --report report.json"
    try:
        report = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise UsageError(f"{name}: not a JSON document: {error}", hint=hint) from None
    if not isinstance(report, dict) or report.get("schema") != "vhp-report/1":
        raise UsageError(f"{name}: not a report of the form vhp-report/1", hint=hint)
    summary, settings = report.get("summary"), report.get("settings")
    if not isinstance(summary, dict) or not {"passed", "triangles"} <= summary.keys() or not isinstance(settings, dict):
        raise UsageError(f"{name}: a report without summary or settings", hint=hint)
    for part, keys in _NEEDED.items():
        records = report.get(part)
        if not isinstance(records, list):
            raise UsageError(f"{name}: a report without {part}", hint=hint)
        for index, record in enumerate(records):
            missing = [key for key in keys if not isinstance(record, dict) or key not in record]
            if missing:
                raise UsageError(f"{name}: {part}[{index}] lacks {missing[0]}", hint=hint)
    found: Report = report  # type: ignore[assignment]
    return found


def compare(
    before: Report,
    after: Report,
    *,
    names: tuple[str, str] = ("before", "after"),
    max_volume_change: float | None = None,
    fail_on: FailOn = "worse",
) -> Difference:
    """Compare two reports.

    Parameters
    ----------
    before, after
        The reports.
    names
        What to call them.
    max_volume_change
        A share; a tissue whose volume changes by more counts as worse.
    fail_on
        What goes into `worse`: ``"worse"``: a verdict that was lost, new or worse errors and warnings, a tissue that is
        gone; ``"errors"``: the verdict and errors alone; ``"changes"``: any difference; ``"never"``: nothing.

    Raises
    ------
    UsageError
        If a report is malformed.
    """
    tissues = _tissues(before["tissues"], after["tissues"])
    findings = _findings(_renamed(before["findings"], tissues["renamed"]), after["findings"])
    pairs = _pairs(before["pairs"], after["pairs"], tissues["renamed"])
    settings = sorted(
        key
        for key in {*before["settings"], *after["settings"]}
        if before["settings"].get(key) != after["settings"].get(key)
    )
    found: Difference = {
        "schema": SCHEMA,
        "before": names[0],
        "after": names[1],
        "equal": False,
        "worse": [],
        "passed": {"before": before["summary"]["passed"], "after": after["summary"]["passed"]},
        "triangles": {"before": before["summary"]["triangles"], "after": after["summary"]["triangles"]},
        "settings_differ": settings,
        "tissues": tissues,
        "pairs": pairs,
        "findings": findings,
    }
    found["equal"] = not (
        pairs
        or findings["by_rule"]
        or found["passed"]["before"] != found["passed"]["after"]
        or any(tissues[key] for key in ("added", "removed", "renamed", "changed"))
    )
    found["worse"] = _worse(found, max_volume_change, fail_on)
    return found


def _worse(found: Difference, max_volume_change: float | None, fail_on: FailOn) -> list[str]:
    if fail_on == "never":
        return []
    words = []
    if found["passed"]["before"] and not found["passed"]["after"]:
        words.append("passed before, fails now")
    levels = ("error",) if fail_on == "errors" else ("error", "warning")
    for kind in ("new", "worse"):
        findings: list[Finding] = found["findings"]["new"] if kind == "new" else found["findings"]["worse"]
        for level in levels:
            count = sum(finding["level"] == level for finding in findings)
            if count:
                words.append(f"{count:,} {kind} {level}{'s' * (count != 1)}")
    if fail_on != "errors" and (removed := found["tissues"]["removed"]):
        words.append(f"gone: {', '.join(removed)}")
    if max_volume_change is not None:
        for tissue in found["tissues"]["changed"]:
            change = tissue["volume_change"]
            lost = change is None and "volume_mm3" in tissue["measures"]
            if lost or (change is not None and abs(change) > max_volume_change):
                words.append(f"{tissue['name']}: volume {'not defined' if change is None else f'{change:+.2%}'}")
    if fail_on == "changes" and not words and not found["equal"]:
        words.append("there are changes")
    return words


def _tissues(before: Sequence[TissueRecord], after: Sequence[TissueRecord]) -> Tissues:
    old, new = ({record["name"]: record for record in records} for records in (before, after))
    removed, added = [name for name in old if name not in new], [name for name in new if name not in old]
    renamed: list[Change] = []
    for name in list(added):
        # A file that holds nothing tells no tissue from another.
        twins = [one for one in removed if old[one]["sha256"] == new[name]["sha256"] and old[one]["triangles"]]
        if twins:
            renamed.append({"before": twins[0], "after": name})
            removed.remove(twins[0])
            added.remove(name)
    changes = [_tissue(old[name], new[name]) for name in new if name in old]
    changed = [change for change in changes if change["measures"] or not change["same_file"]]
    return {
        "added": added,
        "removed": removed,
        "renamed": renamed,
        "changed": changed,
        "unchanged": len(changes) - len(changed),
    }


def _tissue(old: TissueRecord, new: TissueRecord) -> TissueChange:
    first, second = _values(old), _values(new)
    measures: dict[str, Change] = {
        key: {"before": first[key], "after": second[key]} for key in first if first[key] != second[key]
    }
    closed = bool(old["closed"] and new["closed"])
    return {
        "name": new["name"],
        "same_file": old["sha256"] == new["sha256"] and bool(new["sha256"]),
        "measures": measures,
        "volume_change": _share(abs(old["volume_mm3"]), abs(new["volume_mm3"])) if closed else None,
        "area_change": _share(old["area_mm2"], new["area_mm2"]),
    }


def _values(record: TissueRecord) -> dict[str, object]:
    quality, edge = record["quality"], record["edge_mm"]
    facts: Mapping[str, object] = record
    return {
        "triangles": record["triangles"],
        "volume_mm3": record["volume_mm3"],
        "area_mm2": record["area_mm2"],
        "min_q": quality["min"] if quality else None,
        "mean_q": quality["mean"] if quality else None,
        "min_edge_mm": edge["min"] if edge else None,
        **{key: facts.get(key) for key in _FACTS},
        "self_intersections": record["self_intersections"]["pairs"],
    }


def _share(before: float, after: float) -> float | None:
    return after / before - 1.0 if before and math.isfinite(after) else None


def _pairs(before: Sequence[PairRecord], after: Sequence[PairRecord], renamed: Sequence[Change]) -> list[PairChange]:
    """Return the pairs that differ, named as they are now; contacts before gaps, small gaps before large ones."""
    now = {change["before"]: change["after"] for change in renamed}
    old, new = _by_names(before, now), _by_names(after, {})
    changes: list[PairChange] = []
    for key in sorted({*old, *new}):
        first, second = old.get(key, (APART, None, 0.0)), new.get(key, (APART, None, 0.0))
        if first != second:
            relation, gap, overlap = ({"before": x, "after": y} for x, y in zip(first, second, strict=True))
            changes.append(
                {
                    "a": key[0],
                    "b": key[1],
                    "relation": relation,  # type: ignore[typeddict-item]
                    "min_gap_mm": gap,  # type: ignore[typeddict-item]
                    "overlap_mm3": overlap,  # type: ignore[typeddict-item]
                }
            )
    return changes


def _by_names(
    pairs: Sequence[PairRecord], now: Mapping[str, str]
) -> dict[tuple[str, str], tuple[str, float | None, float]]:
    """Return relation, gap and overlap by the names in alphabetical order."""
    found = {}
    for pair in pairs:
        a, b = now.get(pair["a"], pair["a"]), now.get(pair["b"], pair["b"])
        relation: str = pair["relation"]
        if a > b:
            a, b = b, a
            relation = {"a_inside_b": "b_inside_a", "b_inside_a": "a_inside_b"}.get(relation, relation)
        found[a, b] = (relation, pair["min_gap_mm"], pair["overlap_mm3"])
    return found


def _renamed(findings: Sequence[Finding], renamed: Sequence[Change]) -> list[Finding]:
    now = {change["before"]: change["after"] for change in renamed}
    return [{**finding, "tissues": [now.get(name, name) for name in finding["tissues"]]} for finding in findings]


def _findings(before: list[Finding], after: list[Finding]) -> Findings:
    came = [finding for finding in mark_known(after, _as_baseline(before)) if not finding.get("known")]
    went = [finding for finding in mark_known(before, _as_baseline(after)) if not finding.get("known")]
    was, is_now = ({_identity(finding) for finding in findings} for findings in (before, after))
    worse = [finding for finding in came if _identity(finding) in was]
    worsened = {_identity(finding) for finding in worse}
    kinds = {
        "new": [finding for finding in came if _identity(finding) not in was],
        "worse": worse,
        "eased": [finding for finding in went if _identity(finding) in is_now and _identity(finding) not in worsened],
        "fixed": [finding for finding in went if _identity(finding) not in is_now],
    }
    rules = sorted({finding["rule"] for findings in kinds.values() for finding in findings})
    by_rule: dict[str, RuleCounts] = {
        rule: {kind: sum(finding["rule"] == rule for finding in findings) for kind, findings in kinds.items()}  # type: ignore[misc]
        for rule in rules
    }
    return {
        "new": kinds["new"],
        "worse": kinds["worse"],
        "eased": kinds["eased"],
        "fixed": kinds["fixed"],
        "by_rule": by_rule,
    }


def _as_baseline(findings: list[Finding]) -> dict[str, Any]:
    return {"schema": "vhp-report/1", "findings": findings}


def _identity(finding: Finding) -> tuple[str, frozenset[str]]:
    return finding["rule"], frozenset(finding["tissues"])
