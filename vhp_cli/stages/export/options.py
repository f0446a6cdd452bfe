"""What `export` may be told in a settings file: values and checks."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

from vhp_cli.config import UNITS
from vhp_cli.errors import UsageError
from vhp_cli.stages.export.dielectric import parse_frequency
from vhp_cli.stages.export.targets import TARGETS
from vhp_cli.stages.options import Keys, Name, StageOptions, Text


@dataclass(frozen=True, slots=True)
class Frequency:
    """A frequency: a text such as ``"300 MHz"``, or a number of Hz."""

    def typed(self, value: object, where: str) -> object:
        """Return Hz."""
        if isinstance(value, bool) or not isinstance(value, int | float | str):
            raise UsageError(f"{where}: expected a frequency, not {value!r}")
        return parse_frequency(str(value))

    def check(self, value: object, key: str) -> None:
        """All that could be parsed are allowed."""


# Keys of the section [export] in vhp.toml, also the long options of the command line.
KEYS: Keys = MappingProxyType(
    {
        "for": ("target", Name(tuple(TARGETS))),
        "format": ("forms", Text()),
        "out-units": ("unit", Name(tuple(UNITS))),
        "frequency": ("frequency_hz", Frequency()),
    }
)


@dataclass(frozen=True, slots=True)
class ExportOptions(StageOptions):
    """How a model is exported.

    Parameters
    ----------
    target
        Program; None: it has to be said.
    forms
        Formats between commas; None: those of the target.
    unit
        Of the files.
    frequency_hz
        Of permittivity and conductivity; None: none.

    Raises
    ------
    UsageError
        If a value is not known.
    """

    known: ClassVar[Keys] = KEYS

    target: str | None = None
    forms: str | None = None
    unit: str = "mm"
    frequency_hz: float | None = None
