"""The rule table as words: for ``vhp rules``, and ``docs/rules.md`` (``python -m vhp_cli.report.rule_pages FILE``)."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable
from dataclasses import asdict
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

from vhp_cli.report.as_markdown import escape, table_row
from vhp_cli.rules import RULES, Rule

if TYPE_CHECKING:
    from rich.console import Console

FAMILIES = {
    "F": "Files",
    "T": "Topology",
    "X": "Self-intersection",
    "Q": "Quality",
    "P": "Pairs of tissues",
    "M": "Tetrahedra",
    "B": "Breathing",
}

_INTRODUCTION = """\
# Rules

<!-- Generated from vhp_cli/rules/ by: python -m vhp_cli.report.rule_pages docs/rules.md -->

What `vhp` can find in a model. An **error** fails the gate (exit code 1), a **warning** or a **note** does not, and a
rule that is **off** is not looked at. Level and limit of each rule can be changed in `vhp.toml` and by a profile.
`vhp rules` prints this list and `vhp rules T002` the page of one rule.
"""


def level_word(rule: Rule) -> str:
    """Return the default level, or ``off``."""
    return rule.level or "off"


def limit_words(rule: Rule) -> str:
    """Return the default limit with its unit: ``0.1 deg``; empty if the rule has none."""
    return "" if rule.limit is None else f"{rule.limit:,} {rule.unit}".rstrip()


def _table(rules: Iterable[Rule], *, links: bool) -> list[str]:
    lines = [table_row(["Code", "Name", "Level", "Limit", "What"]), "| :--- | :--- | :--- | ---: | :--- |"]
    for rule in rules:
        code = f"[{rule.code}](#{rule.code.lower()}-{rule.name})" if links else rule.code
        lines.append(table_row([code, rule.name, level_word(rule), limit_words(rule), escape(rule.summary)]))
    return lines


def _page(rule: Rule, heading: str) -> list[str]:
    facts = f"Default level: {level_word(rule)}."
    if rule.limit is not None:
        facts += f" Default limit: {limit_words(rule)}."
    lines = [f"{heading} {rule.code} {rule.name}", "", escape(rule.summary), "", facts, ""]
    for title, words in (("Why", rule.why), ("Example", rule.example), ("Fix", rule.fix)):
        lines += [f"**{title}.** {escape(words)}", ""]
    return lines


def markdown(rules: Iterable[Rule]) -> str:
    """Return the pages of some rules as Markdown, one after the other."""
    return "\n".join(line for rule in rules for line in _page(rule, "#")).rstrip("\n") + "\n"


def markdown_list(rules: Iterable[Rule]) -> str:
    """Return the rules as one Markdown table."""
    return "\n".join(_table(rules, links=False)) + "\n"


def markdown_book() -> str:
    """Return the whole of ``docs/rules.md``: a table and the pages, by family."""
    lines = [_INTRODUCTION]
    for letter, group in groupby(RULES.values(), key=lambda rule: rule.code[0]):
        rules = list(group)
        lines += [f"## {FAMILIES[letter]} ({letter})", "", *_table(rules, links=True), ""]
        for rule in rules:
            lines += _page(rule, "###")
    return "\n".join(lines).rstrip("\n") + "\n"


def json_list(rules: Iterable[Rule]) -> str:
    """Return the rules as a JSON list of objects."""
    return json.dumps([asdict(rule) for rule in rules], indent=2) + "\n"


def print_list(rules: Iterable[Rule], console: Console) -> None:
    """Print the rules as a table on a terminal."""
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0), show_edge=False)
    table.add_column("Code", no_wrap=True)
    table.add_column("Name", overflow="fold")
    table.add_column("Level", no_wrap=True)
    table.add_column("Limit", justify="right", overflow="fold")
    table.add_column("What")
    for rule in rules:
        table.add_row(rule.code, rule.name, level_word(rule), limit_words(rule), rule.summary)
    console.print(table)


def print_pages(rules: Iterable[Rule], console: Console) -> None:
    """Print the pages of some rules on a terminal."""
    from rich.text import Text

    for index, rule in enumerate(rules):
        if index:
            console.print()
        limit = f", limit {limit_words(rule)}" if rule.limit is not None else ""
        console.print(Text(f"{rule.code} {rule.name} ({level_word(rule)}{limit})", style="bold"))
        console.print(Text(rule.summary))
        for title, words in (("Why", rule.why), ("Example", rule.example), ("Fix", rule.fix)):
            console.print()
            console.print(Text.assemble((f"{title}. ", "bold"), words))


if __name__ == "__main__":
    if len(sys.argv) == 2:
        Path(sys.argv[1]).write_text(markdown_book(), encoding="utf-8", newline="\n")
    else:
        sys.stdout.write(markdown_book())
