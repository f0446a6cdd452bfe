#!/usr/bin/env python
"""Write the pages of docs/ that come from the code: docs/rules.md and docs/commands/; or check that they are fresh.

`make docs` writes them, ``python tools/make_docs.py --check`` ends with exit code 1 if one is out of date.
"""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import click

from vhp_cli.cli import COMMANDS, cli
from vhp_cli.report.as_markdown import escape, table_row
from vhp_cli.report.rule_pages import markdown_book

ROOT = Path(__file__).resolve().parents[1]
_NOTE = "<!-- Generated from the code by: make docs -->"
# Pages that tell more of a command than its options.
_MORE = {
    "breathe": ("breathe.md", "breathe-sequence.md"),
    "check": ("check.md", "rules.md", "settings.md"),
    "diff": ("pipelines.md",),
    "phantom": ("tutorial.md",),
    "rules": ("rules.md",),
    "run": ("pipelines.md", "tutorial.md"),
    "separate": ("clearance.md",),
    "shells": ("clearance.md",),
}


def pages() -> dict[Path, str]:
    """Return the text of every generated page by its path below the checkout."""
    found = {Path("docs/rules.md"): markdown_book(), Path("docs/commands/README.md"): _lines_to_text(_index())}
    for name in COMMANDS:
        found[Path(f"docs/commands/{name}.md")] = _lines_to_text(_page(name))
    return found


def stale(root: Path) -> list[Path]:
    """Return the pages that are missing or differ, and those of commands that are gone."""
    wanted = pages()
    differing = [path for path, text in wanted.items() if _read(root / path) != text]
    present = {path.relative_to(root) for path in (root / "docs" / "commands").glob("*.md")}
    return sorted({*differing, *(present - wanted.keys())})


def write(root: Path) -> None:
    """Write every page, and remove those of commands that are gone."""
    wanted = pages()
    for path in (root / "docs" / "commands").glob("*.md"):
        if path.relative_to(root) not in wanted:
            path.unlink()
    for path, text in wanted.items():
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        (root / path).write_text(text, encoding="utf-8", newline="\n")


def _read(path: Path) -> str | None:
    return path.read_text(encoding="utf-8") if path.is_file() else None


def _lines_to_text(lines: Iterator[str]) -> str:
    return "\n".join(lines).rstrip("\n") + "\n"


def _index() -> Iterator[str]:
    yield from ("# Commands", "", _NOTE, "", _prose(cli.help or ""), "")
    yield from (table_row(["Command", "What"]), "| :--- | :--- |")
    for name, entry in sorted(COMMANDS.items()):
        yield table_row([f"[vhp {name}]({name}.md)", escape(entry.summary)])
    yield from ("", "Options of `vhp` itself stand before the command:", "")
    yield from _options(cli)
    yield from ("", _prose(cli.epilog or ""))


def _page(name: str) -> Iterator[str]:
    with click.Context(cli, info_name="vhp") as parent:
        command = cli.get_command(parent, name)
    assert command is not None
    yield from _section(command, f"vhp {name}", "#")
    if isinstance(command, click.Group):
        for inner in command.commands.values():
            yield ""
            yield from _section(inner, f"vhp {name} {inner.name}", "##")
    links = [page for page in _MORE.get(name, (f"{name}.md",)) if (ROOT / "docs" / page).is_file()]
    if links:
        yield ""
        yield f"More: {', '.join(f'[{Path(page).stem}](../{page})' for page in links)}."


def _section(command: click.Command, words: str, heading: str) -> Iterator[str]:
    yield f"{heading} `{words}`"
    yield ""
    if heading == "#":
        yield from (_NOTE, "")
    arguments = [
        parameter.metavar or (parameter.name or "").upper() + "..." * (parameter.nargs == -1)
        for parameter in command.params
        if isinstance(parameter, click.Argument)
    ]
    if isinstance(command, click.Group):
        usage = f"{words} {command.subcommand_metavar}"
    else:
        usage = " ".join([words, command.options_metavar or "", *arguments])
    yield from (f"    {usage}", "")
    yield _prose(command.help or "")
    if any(isinstance(parameter, click.Option) for parameter in command.params):
        yield ""
        yield from _options(command)


def _options(command: click.Command) -> Iterator[str]:
    yield from (table_row(["Option", "What"]), "| :--- | :--- |")
    for parameter in command.params:
        if not isinstance(parameter, click.Option) or parameter.hidden:
            continue
        yield table_row([_names(parameter), _words(parameter)])
    yield table_row(["`-h`, `--help`", "Show the options and exit."])


def _names(option: click.Option) -> str:
    value = "" if option.is_flag or option.count else f" {option.metavar or _kind(option)}"
    names = [f"`{name}{value if name.startswith('--') else ''}`" for name in (*option.opts, *option.secondary_opts)]
    return escape_bars(", ".join(names))


def _kind(option: click.Option) -> str:
    """Return what stands for the value of an option without a word of its own."""
    if isinstance(option.type, click.Choice):
        return "|".join(str(choice) for choice in option.type.choices)
    if isinstance(option.type, click.types.IntParamType):
        return "N"
    return "FILE" if isinstance(option.type, click.Path) else "VALUE"


def _words(option: click.Option) -> str:
    words = option.help or ""
    if option.show_default and "[default" not in words:
        words += f" [default: {option.default}]"
    if option.required:
        words += " [required]"
    return escape(words)


def escape_bars(text: str) -> str:
    """Return text that stands in a cell of a table, where a bar would end it even within backquotes."""
    return text.replace("|", "\\|")


def _prose(text: str) -> str:
    """Return the help text of a command as Markdown: one line for each paragraph."""
    paragraphs = re.split(r"\n\s*\n", inspect.cleandoc(text).replace("\b", ""))
    return "\n\n".join(_escape_outside_code(" ".join(paragraph.split())) for paragraph in paragraphs)


def _escape_outside_code(text: str) -> str:
    return "".join(part if part.startswith("`") else escape(part) for part in re.split(r"(`[^`]*`)", text))


if __name__ == "__main__":
    if sys.argv[1:] == ["--check"]:
        outdated = stale(ROOT)
        for page in outdated:
            print(f"{page} is out of date; run: make docs", file=sys.stderr)
        sys.exit(1 if outdated else 0)
    write(ROOT)
