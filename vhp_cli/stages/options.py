"""What the options of all stages have in common: values by key, of which each has a kind."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Protocol, Self

from vhp_cli.errors import UsageError


class Kind(Protocol):
    """What a value may be."""

    def typed(self, value: object, where: str) -> object:
        """Return the value of a settings file as the stage takes it; `UsageError` if it has another type."""
        ...

    def check(self, value: object, key: str) -> None:
        """Refuse a value of the right type that is not allowed, by `UsageError`."""
        ...


@dataclass(frozen=True, slots=True)
class Number:
    """A finite number within bounds; the lower one may be excluded."""

    least: float = 0.0
    most: float = math.inf
    may_be_least: bool = False
    whole: bool = False

    def typed(self, value: object, where: str) -> object:
        """Return a float, or an int if it has to be whole."""
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise UsageError(f"{where}: expected a number, not {value!r}")
        if not self.whole:
            return float(value)
        if not math.isfinite(value) or value != int(value):
            raise UsageError(f"{where}: expected a whole number, not {value!r}")
        return int(value)

    def check(self, value: object, key: str) -> None:
        """Refuse a number out of bounds."""
        assert isinstance(value, int | float)
        # NaN is in no range.
        within = math.isfinite(value) and self.least <= value <= self.most
        if not within or (value == self.least and not self.may_be_least):
            lower = f"at least {self.least:g}" if self.may_be_least else f"above {self.least:g}"
            upper = "" if self.most == math.inf else f" and at most {self.most:g}"
            raise UsageError(f"{key}: expected a finite number {lower}{upper}, not {value:g}")


@dataclass(frozen=True, slots=True)
class Name:
    """One of several names."""

    names: tuple[str, ...]

    def typed(self, value: object, where: str) -> object:
        """Return the name."""
        if not isinstance(value, str):
            raise UsageError(f"{where}: expected one of {', '.join(self.names)}, not {value!r}")
        return value

    def check(self, value: object, key: str) -> None:
        """Refuse a name that is none of them."""
        if value not in self.names:
            hint = nearest(str(value), self.names) or f"; one of {', '.join(self.names)}"
            raise UsageError(f"{key}: {value!r} is not known{hint}")


@dataclass(frozen=True, slots=True)
class Flag:
    """True or false."""

    def typed(self, value: object, where: str) -> object:
        """Return the flag."""
        if not isinstance(value, bool):
            raise UsageError(f"{where}: expected true or false, not {value!r}")
        return value

    def check(self, value: object, key: str) -> None:
        """Both are allowed."""


@dataclass(frozen=True, slots=True)
class Text:
    """A text that is not empty."""

    def typed(self, value: object, where: str) -> object:
        """Return the text."""
        if not isinstance(value, str):
            raise UsageError(f"{where}: expected a text, not {value!r}")
        return value

    def check(self, value: object, key: str) -> None:
        """Refuse an empty text."""
        if not value:
            raise UsageError(f"{key}: expected a text that is not empty")


# By the key in a settings file, which is the long option of the command line, too: the field, and what it may be.
Keys = Mapping[str, tuple[str, Kind]]


@dataclass(frozen=True, slots=True)
class StageOptions:
    """Base of the options of a stage, which are fields of a frozen dataclass.

    None stands for a value that is not given or that is decided for each tissue.
    """

    known: ClassVar[Keys] = {}

    def __post_init__(self) -> None:
        for key, (field, kind) in self.known.items():
            value = getattr(self, field)
            if value is not None:
                kind.check(value, key)

    def changed(self, values: Mapping[str, object], where: str) -> Self:
        """Return the options with some values of a settings file in place.

        Parameters
        ----------
        values
            By key, as in `known`.
        where
            Where they stand, for the messages.

        Raises
        ------
        UsageError
            If a key is not known, or a value has the wrong type or is out of range.
        """
        changes = {}
        for key, value in values.items():
            if key not in self.known:
                raise UsageError(f"{where}: {key!r} is not known{nearest(key, self.known)}")
            field, kind = self.known[key]
            changes[field] = kind.typed(value, f"{where}.{key}")
        try:
            return replace(self, **changes)
        except UsageError as error:
            raise UsageError(f"{where}: {error.message}") from None

    def as_dict(self) -> dict[str, object]:
        """Return all values by the keys of a settings file."""
        return {key: getattr(self, field) for key, (field, _) in self.known.items()}


def nearest(name: str, known: Iterable[str]) -> str:
    """Return a clause on the known name that is most like another; empty if none is."""
    near = difflib.get_close_matches(name, list(known), 1)
    return f"; did you mean {near[0]!r}?" if near else ""
