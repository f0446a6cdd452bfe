from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner, Result
from markdown_it import MarkdownIt

from vhp_cli.commands.rules import rules
from vhp_cli.errors import UsageError
from vhp_cli.report.rule_pages import FAMILIES, markdown_book
from vhp_cli.rules import RULES, Rule

DOCS = Path(__file__).resolve().parents[2] / "docs" / "rules.md"


def run(*arguments: str) -> Result:
    return CliRunner().invoke(rules, arguments, catch_exceptions=False)


def test_the_page_of_rules_is_current() -> None:
    # Write it anew with: python -m vhp_cli.report.rule_pages docs/rules.md
    assert DOCS.read_text(encoding="utf-8") == markdown_book()


def test_every_family_has_a_title() -> None:
    assert {code[0] for code in RULES} == set(FAMILIES)


@pytest.mark.parametrize("rule", RULES.values(), ids=lambda rule: rule.code)
def test_every_rule_is_explained(rule: Rule) -> None:
    assert re.fullmatch(r"[FTXQPMB]\d{3}", rule.code)
    assert re.fullmatch(r"[a-z]+(-[a-z]+)*", rule.name)
    for words in (rule.summary, rule.why, rule.example, rule.fix):
        assert words.endswith(".")
        assert "  " not in words
        assert words.isascii()
        assert len(words) < 330
    assert len({rule.summary, rule.why, rule.example, rule.fix}) == 4
    # A sentence begins with a capital, or with the name of a command.
    assert all(words[0].isupper() or words.startswith("vhp ") for words in (rule.why, rule.example, rule.fix))


def test_codes_and_names_are_unique() -> None:
    assert len({rule.name for rule in RULES.values()}) == len(RULES)
    assert list(RULES) == [rule.code for rule in RULES.values()]


def test_advice_names_only_commands_that_are_planned() -> None:
    known = {"check", "heal", "smooth", "decimate", "tetmesh", "breathe", "rules", "phantom"}
    for rule in RULES.values():
        commands = re.findall(r"\bvhp ([a-z]+)", rule.fix)
        # "vhp writes" and the like speak of the program.
        assert set(commands) - {"writes", "itself"} <= known, rule.code


def test_the_list_names_every_rule() -> None:
    done = run()
    assert done.exit_code == 0
    lines = done.output.splitlines()
    for rule in RULES.values():
        (line,) = [line for line in lines if line.startswith(rule.code)]
        assert rule.name in line
        assert f" {rule.level or 'off'} " in line


@pytest.mark.parametrize("word", ["T002", "t002", "non-manifold-edge"])
def test_one_rule_is_explained(word: str) -> None:
    text = " ".join(run(word).output.split())
    rule = RULES["T002"]
    for part in ("T002 non-manifold-edge (error)", rule.summary, f"Why. {rule.why}", f"Fix. {rule.fix}"):
        assert part in text
    assert "T001" not in text


def test_limits_are_told() -> None:
    assert "X005 sharp-fold (warning, limit 0.1 deg)" in run("X005").output
    assert "Q005 face-budget (off, limit 100,000)" in run("Q005").output


def test_a_family_and_several_rules_can_be_asked_for_and_come_once() -> None:
    listed = json.loads(run("T", "t001", "P001", "--format", "json").output)
    assert [rule["code"] for rule in listed] == [*(code for code in RULES if code[0] == "T"), "P001"]


def test_json_holds_the_whole_table() -> None:
    listed: list[dict[str, Any]] = json.loads(run("--format", "json").output)
    assert [Rule(**row) for row in listed] == list(RULES.values())


def test_markdown_is_a_table_or_a_page() -> None:
    listed = MarkdownIt("commonmark").enable("table").render(run("--format", "markdown").output)
    assert listed.count("<tr>") == len(RULES) + 1
    page = MarkdownIt().render(run("Q001", "--format", "markdown").output)
    assert "<h1>Q001 low-quality</h1>" in page
    assert "Default limit: 0.01." in page


@pytest.mark.parametrize(("word", "near"), [("T022", "T002"), ("open-egde", "open-edge"), ("xyzzy", "vhp rules")])
def test_an_unknown_rule_is_a_usage_error_with_advice(word: str, near: str) -> None:
    with pytest.raises(UsageError, match=word) as caught:
        run(word)
    assert near in caught.value.hint


def test_every_option_has_help() -> None:
    assert rules.help
    assert all(option.help for option in rules.params if isinstance(option, click.Option))
