"""Text into HTML: whatever a name holds, it stays text."""

from __future__ import annotations

import base64
import html
import json
import re
from collections.abc import Iterable, Sequence

from vhp_cli.report.text import visible

_MOST_ROWS = 1000
_HASH = re.compile("[0-9a-f]{64}")
_LONG, _SHORT = 8, 3  # many records with few members each stand on a line each


def words(text: object) -> str:
    """Return text for a place between tags or within an attribute in double quotes."""
    return html.escape(visible(str(text)), quote=True)


def name_words(name: object) -> str:
    """Return a name that may be broken behind its underscores, where a line is too short for it."""
    return words(name).replace("_", "_<wbr>")


def script_json(value: object) -> str:
    """Return JSON in ASCII that can stand in a script element: it holds no ``<``, ``>`` or ``&``."""
    text = json.dumps(value, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def data_uri(png: bytes) -> str:
    """Return a picture as an address that holds it."""
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")


def table(
    headings: Iterable[tuple[str, bool]], rows: Iterable[Iterable[tuple[str, float | str | None]]], *, kind: str = ""
) -> str:
    """Return a table that can be sorted by any column.

    Parameters
    ----------
    headings
        Text of each column, and whether it holds numbers.
    rows
        The HTML of each cell, and by what it is sorted; None comes last.
    kind
        Classes of the table.
    """
    columns = list(headings)
    head = "".join(
        f'<th scope="col"{" class=n" if numeric else ""}><button type="button">{words(text)}</button></th>'
        for text, numeric in columns
    )
    body = []
    for row in rows:
        cells = "".join(
            f"<td{' class=n' if numeric else ''}{_key(key)}>{cell}</td>"
            for (cell, key), (_, numeric) in zip(row, columns, strict=True)
        )
        body.append(f"<tr>{cells}</tr>")
    return (
        f'<div class="scroll"><table class="sortable {kind}"><thead><tr>{head}</tr></thead>\n'
        f"<tbody>\n{chr(10).join(body)}\n</tbody></table></div>"
    )


def _key(key: float | str | None) -> str:
    return "" if key is None else f' data-v="{words(key)}"'


def facts(pairs: Iterable[tuple[str, str]]) -> str:
    """Return names and values side by side; values are HTML."""
    return '<dl class="facts">' + "".join(f"<dt>{words(name)}</dt><dd>{value}</dd>" for name, value in pairs) + "</dl>"


def _line(record: dict[str, object]) -> str:
    return ", ".join(f"{words(key)} {tree(item)}" for key, item in sorted(record.items()) if item is not None) or "off"


def _records(records: Sequence[dict[str, object]]) -> str:
    """Return records as the rows of a table, with a column for each member that one of them has."""
    keys = sorted({key for record in records for key in record})
    head = "".join(f"<th>{words(key)}</th>" for key in keys)
    body = "".join(
        f"<tr>{''.join(f'<td>{tree(record.get(key))}</td>' for key in keys)}</tr>" for record in records[:_MOST_ROWS]
    )
    more = f"<p>{len(records) - _MOST_ROWS:,} more</p>" if len(records) > _MOST_ROWS else ""
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>{more}'


def tree(value: object) -> str:
    """Return any JSON value: members as names and values in alphabetical order, lists of plain values on one line.

    Lists of records become tables. Of a SHA-256 the beginning is shown.
    """
    if isinstance(value, dict):
        if not value:
            return '<span class="dim">none</span>'
        members = sorted(value.items())
        if len(members) > _LONG and all(isinstance(item, dict) and len(item) <= _SHORT for _, item in members):
            lines = (f'<div>{words(key)} <span class="dim">{_line(item)}</span></div>' for key, item in members)
            return f'<div class="list-of">{"".join(lines)}</div>'
        return facts((str(key), tree(item)) for key, item in members)
    if isinstance(value, (list, tuple)):
        if not value:
            return '<span class="dim">none</span>'
        if all(not isinstance(item, (dict, list, tuple)) for item in value):
            return ", ".join(map(tree, value))
        if all(isinstance(item, dict) and item for item in value):
            return _records(value)
        return "<ol>" + "".join(f"<li>{tree(item)}</li>" for item in value) + "</ol>"
    if value is None:
        return '<span class="dim">none</span>'
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, str) and _HASH.fullmatch(value):
        return f'<code title="{value}">{value[:12]}</code>'
    return words(value)
