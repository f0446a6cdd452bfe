"""The difference of two reports in words: for a terminal, as Markdown, and as JSON."""

from __future__ import annotations

import json
from collections.abc import Iterator

from vhp_cli.measures import Finding
from vhp_cli.report import text
from vhp_cli.report.as_markdown import escape, table_row
from vhp_cli.report.compare import Change, Difference, TissueChange
from vhp_cli.report.verdict import rule_name

FORMS = ("text", "json", "markdown")
_MOST = 20  # lines of one kind
_FACTS = {"genus": "genus", "components": "parts", "tissue_type": "type"}
_YES_OR_NO = {
    "closed": ("closed", "open"),
    "manifold": ("manifold", "not manifold"),
    "oriented": ("oriented", "not oriented"),
    "outward": ("outward", "not outward"),
}


def render_difference(found: Difference, form: str, *, verbose: bool = False) -> str:
    """Return a difference in one of `FORMS`; `verbose` lists everything."""
    if form == "json":
        return json.dumps(found, indent=2, allow_nan=False) + "\n"
    if form == "markdown":
        return "\n".join(_markdown(found)).rstrip("\n") + "\n"
    return "\n".join(_lines(found, verbose=verbose)) + "\n"


def verdict_words(found: Difference) -> str:
    """Return what came of it in one line."""
    if found["worse"]:
        return f"worse: {'; '.join(map(text.visible, found['worse']))}"
    return "equal" if found["equal"] else "different, nothing is worse"


def _lines(found: Difference, *, verbose: bool) -> Iterator[str]:
    yield f"before: {text.visible(found['before'])}: {_passed(found['passed']['before'])}"
    yield f"after:  {text.visible(found['after'])}: {_passed(found['passed']['after'])}"
    if found["settings_differ"]:
        yield f"judged by different settings: {', '.join(found['settings_differ'])}"
    tissues = found["tissues"]
    counts = [f"{len(tissues[key]):,} {key}" for key in ("added", "removed", "renamed", "changed")]
    yield f"tissues: {', '.join(counts)}, {tissues['unchanged']:,} unchanged; triangles {_change(found['triangles'])}"
    for sign, names in (("+", tissues["added"]), ("-", tissues["removed"])):
        yield from _some([f"  {sign} {text.visible(name)}" for name in names], verbose=verbose)
    yield from _some(
        [f"  > {text.visible(one['before'])} is now {text.visible(one['after'])}" for one in tissues["renamed"]],
        verbose=verbose,
    )
    yield from _some(
        [f"  ~ {text.visible(one['name'])}: {', '.join(_tissue(one))}" for one in tissues["changed"]], verbose=verbose
    )
    relations = [pair for pair in found["pairs"] if pair["relation"]["before"] != pair["relation"]["after"]]
    if found["pairs"]:
        yield f"pairs: {len(relations):,} lie otherwise, {len(found['pairs']) - len(relations):,} with another gap"
    shown = found["pairs"] if verbose else relations
    yield from _some(
        [
            f"  {text.visible(pair['a'])} - {text.visible(pair['b'])}: {_relation(pair['relation'])}, "
            f"gap {_change(pair['min_gap_mm'])} mm"
            for pair in shown
        ],
        verbose=verbose,
    )
    for kind, findings in _kinds(found):
        if findings:
            yield f"findings {kind}: {len(findings):,}"
            yield from _some([f"  {_finding(finding)}" for finding in findings], verbose=verbose)
    yield verdict_words(found)


def _markdown(found: Difference) -> Iterator[str]:
    yield f"# {escape(found['before'])} and {escape(found['after'])}"
    yield ""
    yield f"**{escape(verdict_words(found))}**"
    yield ""
    if found["settings_differ"]:
        yield f"Judged by different settings: {', '.join(found['settings_differ'])}."
        yield ""
    tissues = found["tissues"]
    yield table_row(["", "before", "after"])
    yield "| :--- | ---: | ---: |"
    yield table_row(["verdict", _passed(found["passed"]["before"]), _passed(found["passed"]["after"])])
    yield table_row(["triangles", f"{found['triangles']['before']:,}", f"{found['triangles']['after']:,}"])
    yield ""
    rows = [(name, "added", "") for name in tissues["added"]]
    rows += [(name, "removed", "") for name in tissues["removed"]]
    rows += [(one["after"], f"renamed, was {one['before']}", "") for one in tissues["renamed"]]
    rows += [(one["name"], "changed", ", ".join(_tissue(one))) for one in tissues["changed"]]
    if rows:
        yield table_row(["Tissue", "", "What"])
        yield "| :--- | :--- | :--- |"
        for row in rows:
            yield table_row([escape(cell) for cell in row])
        yield ""
    if found["findings"]["by_rule"]:
        yield table_row(["Rule", "new", "worse", "eased", "fixed"])
        yield "| :--- | ---: | ---: | ---: | ---: |"
        for rule, counts in found["findings"]["by_rule"].items():
            numbers = [str(counts[key]) for key in ("new", "worse", "eased", "fixed")]
            yield table_row([rule_name(rule), *numbers])
        yield ""
        for kind, findings in _kinds(found):
            if findings:
                yield f"Findings {kind}:"
                yield ""
                yield from (f"- {escape(_finding(finding))}" for finding in findings)
                yield ""
    relations = [pair for pair in found["pairs"] if pair["relation"]["before"] != pair["relation"]["after"]]
    if relations:
        yield table_row(["a", "b", "Relation", "Gap (mm)"])
        yield "| :--- | :--- | :--- | ---: |"
        for pair in relations:
            cells = [pair["a"], pair["b"], _relation(pair["relation"]), _change(pair["min_gap_mm"])]
            yield table_row([escape(cell) for cell in cells])


def _kinds(found: Difference) -> list[tuple[str, list[Finding]]]:
    findings = found["findings"]
    return [(kind, findings[kind]) for kind in ("new", "worse", "eased", "fixed")]


def _some(lines: list[str], *, verbose: bool) -> Iterator[str]:
    """Yield lines, only the first ones if there are many."""
    shown = lines if verbose or len(lines) <= _MOST else lines[: _MOST - 1]
    yield from shown
    if len(lines) > len(shown):
        yield f"  ... and {len(lines) - len(shown):,} more (--verbose)"


def _finding(finding: Finding) -> str:
    return f"{finding['level']} {rule_name(finding['rule'])}: {text.headline(finding)}"


def _tissue(change: TissueChange) -> list[str]:
    """Return what became of a tissue, in a few words."""
    measures = change["measures"]
    words = []
    if "triangles" in measures:
        words.append(f"triangles {_change(measures['triangles'])}")
    for key, name in (("volume_change", "volume"), ("area_change", "area")):
        share: float | None = change[key]  # type: ignore[literal-required]
        if share:
            words.append(f"{name} {share:+.3%}")
        elif share is None and f"{name}_{'mm3' if name == 'volume' else 'mm2'}" in measures:
            words.append(f"{name} not comparable")
    for key, name in (("min_q", "least q"), ("mean_q", "mean q"), ("min_edge_mm", "shortest edge (mm)")):
        # What differs in digits that no one reads is left to the JSON form.
        if key in measures and _value(measures[key]["before"]) != _value(measures[key]["after"]):
            words.append(f"{name} {_change(measures[key])}")
    words += [f"{name} {_change(measures[key])}" for key, name in _FACTS.items() if key in measures]
    words += [
        f"now {yes if measures[key]['after'] else no}" for key, (yes, no) in _YES_OR_NO.items() if key in measures
    ]
    if "self_intersections" in measures:
        words.append(f"self-intersections {_change(measures['self_intersections'])}")
    return words or ["other bytes, the same measures"]


def _change(change: Change) -> str:
    return f"{_value(change['before'])} -> {_value(change['after'])}"


def _value(value: object) -> str:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return "-" if value is None else text.visible(str(value))
    return f"{value:,}" if isinstance(value, int) else text.number(value)


def _relation(change: Change) -> str:
    before, after = (str(change[key]).replace("_", " ") for key in ("before", "after"))
    return before if before == after else f"{before} -> {after}"


def _passed(passed: bool) -> str:
    return "passed" if passed else "failed"
