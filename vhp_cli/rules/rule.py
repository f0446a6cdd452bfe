"""One row of the rule table."""

from __future__ import annotations

from dataclasses import dataclass

from vhp_cli.measures import Level


@dataclass(frozen=True, slots=True)
class Rule:
    """One row of the table.

    Parameters
    ----------
    code, name
        Stable identifier (letter of the family and three digits) and short name.
    level
        Default level; None: off unless a profile or the configuration turns it on.
    summary
        One line.
    why
        Why a solver chokes on it.
    example
        How it comes about.
    fix
        What to do; the hint of each finding.
    limit
        Default limit, if the rule compares a measure with one.
    unit
        Unit of the limit.
    """

    code: str
    name: str
    level: Level | None
    summary: str
    why: str = ""
    example: str = ""
    fix: str = ""
    limit: float | None = None
    unit: str = ""
