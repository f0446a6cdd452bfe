"""Take the entries of a TOML file by type, so that what is wrong or not known is named."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from vhp_cli.errors import UsageError

Triple = tuple[float, float, float]
Quadruple = tuple[float, float, float, float]


class Table:
    """One table of the file: entries are taken out by type, and none may be left over."""

    def __init__(self, data: Mapping[str, Any], source: str, path: str) -> None:
        self._data = dict(data)
        self._source = source
        self._path = path

    def error(self, message: str, key: str = "", hint: str = "") -> UsageError:
        """Return an error that names the entry."""
        place = ".".join(part for part in (self._path, key) if part)
        return UsageError(f"{self._source}: {place + ': ' if place else ''}{message}", hint=hint)

    def take(self, key: str, kind: type, default: object = None) -> Any:
        """Take an entry of one type; without a default it must be there."""
        if key not in self._data:
            if default is None:
                raise self.error("missing", key)
            return default
        value = self._data.pop(key)
        # In Python, though not in TOML, true is a whole number.
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            words = {str: "a text", int: "a whole number", bool: "true or false", dict: "a table", list: "a list"}
            raise self.error(f"must be {words[kind]}, not {value!r}", key)
        return value

    def has(self, key: str) -> bool:
        """Tell if an entry is left."""
        return key in self._data

    def number(self, key: str, default: float | None = None) -> float:
        """Take a finite number."""
        if key not in self._data and default is not None:
            return default
        if key not in self._data:
            raise self.error("missing", key)
        return self._as_number(self._data.pop(key), key)

    def numbers(
        self, key: str, count: int | None = None, default: tuple[float, ...] | None = None
    ) -> tuple[float, ...]:
        """Take a list of finite numbers, of one length if `count` says so."""
        if key not in self._data and default is not None:
            return default
        values = self.take(key, list)
        if count is not None and len(values) != count:
            raise self.error(f"must have {count} numbers, not {len(values)}", key)
        return tuple(self._as_number(value, key) for value in values)

    def triple(self, key: str, default: Triple) -> Triple:
        """Take three numbers."""
        x, y, z = self.numbers(key, 3, default)
        return (x, y, z)

    def triples(self, key: str) -> tuple[Triple, ...]:
        """Take a list of three numbers each."""
        return tuple((x, y, z) for x, y, z in self._rows(key, 3))

    def quadruples(self, key: str) -> tuple[Quadruple, ...]:
        """Take a list of four numbers each."""
        return tuple((x, y, z, r) for x, y, z, r in self._rows(key, 4))

    def pair(self, key: str) -> tuple[float, float]:
        """Take two numbers."""
        low, high = self.numbers(key, 2)
        return (low, high)

    def strings(self, key: str) -> tuple[str, ...]:
        """Take a list of texts, which may be missing."""
        values = self.take(key, list, [])
        if not all(isinstance(value, str) for value in values):
            raise self.error("must be a list of texts", key)
        return tuple(values)

    def table(self, key: str, default: Mapping[str, Any] | None = None) -> Table:
        """Take a table."""
        return Table(self.take(key, dict, default), self._source, f"{self._path}.{key}".strip("."))

    def tables(self, key: str) -> list[Table]:
        """Take a list of tables, which may be missing."""
        values = self.take(key, list, [])
        if not all(isinstance(value, dict) for value in values):
            raise self.error("must be a list of tables", key)
        path = f"{self._path}.{key}".strip(".")
        return [Table(value, self._source, f"{path}[{number}]") for number, value in enumerate(values, start=1)]

    def build(self, kind: Any, *arguments: Any, **values: Any) -> Any:
        """Make a value of the entries, once none is left over; a `ValueError` names the entry."""
        self.done()
        try:
            return kind(*arguments, **values)
        except ValueError as error:
            raise self.error(str(error)) from None

    def done(self) -> None:
        """Refuse what is left over."""
        if self._data:
            raise self.error("no such entry", next(iter(self._data)))

    def _rows(self, key: str, width: int) -> list[list[float]]:
        rows = self.take(key, list)
        if not all(isinstance(row, list) and len(row) == width for row in rows):
            raise self.error(f"must be a list of lists of {width} numbers", key)
        return [[self._as_number(value, key) for value in row] for row in rows]

    def _as_number(self, value: object, key: str) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise self.error(f"must be a finite number, not {value!r}", key)
        return float(value)
