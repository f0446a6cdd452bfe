"""``vhp rules``: list the rules, or explain some of them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from vhp_cli.errors import UsageError

if TYPE_CHECKING:
    from vhp_cli.rules import Rule


def _find(words: tuple[str, ...]) -> list[Rule]:
    """Return the rules with these codes, names or families (first letter), each once and in the order asked for."""
    from difflib import get_close_matches

    from vhp_cli.rules import RULES

    names = {rule.name: rule for rule in RULES.values()}
    found: dict[str, Rule] = {}
    for word in words:
        family = [rule for code, rule in RULES.items() if code[0] == word.upper()]
        rule = RULES.get(word.upper()) or names.get(word.lower())
        if rule is None and not family:
            near = get_close_matches(word.upper(), RULES, n=3) + get_close_matches(word.lower(), names, n=3)
            hint = f"did you mean {' or '.join(near)}?" if near else "vhp rules lists all of them"
            raise UsageError(f"no such rule {word!r}", hint=hint)
        found |= {rule.code: rule} if rule else {rule.code: rule for rule in family}
    return list(found.values())


@click.command("rules")
@click.argument("codes", nargs=-1, metavar="[RULE]...")
@click.option(
    "--format",
    "form",
    type=click.Choice(("table", "json", "markdown")),
    default="table",
    show_default=True,
    help="How to print the rules.",
)
def rules(codes: tuple[str, ...], form: str) -> None:
    """List all rules, or explain each RULE: a code (T002), a name (open-edge) or a family (T)."""
    from vhp_cli.report import rule_pages
    from vhp_cli.rules import RULES

    chosen = _find(codes) if codes else list(RULES.values())
    if form == "json":
        click.echo(rule_pages.json_list(chosen), nl=False)
    elif form == "markdown":
        click.echo(rule_pages.markdown(chosen) if codes else rule_pages.markdown_list(chosen), nl=False)
    else:
        from rich.console import Console

        console = Console(highlight=False)
        if codes:
            rule_pages.print_pages(chosen, console)
        else:
            rule_pages.print_list(chosen, console)
