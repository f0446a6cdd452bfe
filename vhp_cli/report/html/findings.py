"""The findings by rule, each with what it means and where it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from vhp_cli.measures import Finding
from vhp_cli.report.html.markup import words
from vhp_cli.report.text import place, plural, tissue_names, visible
from vhp_cli.report.verdict import rule_name
from vhp_cli.rules import RULES

_OPEN = 8  # findings of a rule that are shown at once
_PLACES = 12


def findings_section(groups: Sequence[tuple[str, Sequence[tuple[int, Finding]]]], left_out: int) -> str:
    """Return the findings.

    Parameters
    ----------
    groups
        By rule, worst first: each finding with its number on the page.
    left_out
        Findings that the page does not hold.
    """
    if not groups:
        return '<p class="calm">No rule is broken.</p>'
    parts = [_rule(code, findings) for code, findings in groups]
    if left_out:
        parts.append(f"<p>{plural(left_out, 'finding')} more: see the JSON report.</p>")
    return "".join(parts)


def _rule(code: str, findings: Sequence[tuple[int, Finding]]) -> str:
    worst = findings[0][1]
    known = bool(worst.get("known"))
    rule = RULES.get(code)
    head = (
        f'<summary><span class="tag {"known" if known else worst["level"]}">{worst["level"]}</span> '
        f"<b>{words(rule_name(code))}</b> "
        f'<span class="dim">{plural(len(findings), "finding")}{", known" if known else ""}</span>'
        + (f'<br><span class="sum">{words(rule.summary)}</span>' if rule else "")
        + "</summary>"
    )
    explained = []
    if rule:
        said = (("Why it matters", rule.why), ("How it comes about", rule.example), ("What to do", rule.fix))
        explained = [f"<p><b>{title}.</b> {words(text)}</p>" for title, text in said if text]
    hints = dict.fromkeys(visible(finding["hint"]) for _, finding in findings if finding["hint"])
    if rule:
        hints.pop(visible(rule.fix), None)
    explained += [f"<p>{words(hint)}</p>" for hint in list(hints)[:3]]
    items = [_item(index, finding) for index, finding in findings]
    rest = items[_OPEN:]
    more = f'<details class="more"><summary>{len(rest):,} more</summary>{"".join(rest)}</details>' if rest else ""
    return (
        f'<details class="rule {worst["level"]}" id="rule-{words(code)}"{"" if known else " open"}>{head}'
        f'<details class="why"><summary>What it means</summary>{"".join(explained)}</details>'
        f'<div class="items">{"".join(items[:_OPEN])}{more}</div></details>'
    )


def _item(index: int, finding: Finding) -> str:
    spots = finding["places"]
    text = f"<b>{words(tissue_names(finding))}</b> {words(finding['message'])}"
    if not spots:
        return f'<div class="item"><span>{text}</span></div>'
    buttons = "".join(
        f'<button type="button" class="spot" data-finding="{index}" data-place="{number}" '
        f'title="{words(place(spot))}">{number + 1}</button>'
        for number, spot in enumerate(spots[:_PLACES])
    )
    return (
        f'<div class="item"><button type="button" class="go" data-finding="{index}" data-place="0">{text}'
        f"<small>{words(place(spots[0]))}</small></button>"
        + (f'<span class="spots">{buttons}</span>' if len(spots) > 1 else "")
        + "</div>"
    )


def rule_counts(counts: Mapping[str, tuple[int, str]]) -> str:
    """Return how many findings each rule has as bars; counts are with their level."""
    if not counts:
        return ""
    most = max(count for count, _ in counts.values())
    rows = "".join(
        f'<a class="count" href="#rule-{words(code)}"><span>{words(rule_name(code))}</span>'
        f'<i class="{level}" style="width:{max(100 * count / most, 1.5):.1f}%"></i><em>{count:,}</em></a>'
        for code, (count, level) in counts.items()
    )
    return f'<div class="counts">{rows}</div>'
