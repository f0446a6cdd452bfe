"""Permittivity and conductivity of tissues: the 4-Cole-Cole model (Gabriel et al., Phys. Med. Biol. 41 (1996) 2271)."""

from __future__ import annotations

import math
import re
import tomllib
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from vhp_cli.errors import UsageError

SOURCE = "Gabriel et al. 1996"
VACUUM_PERMITTIVITY = 8.8541878128e-12  # F/m, CODATA 2018
# What the model was fitted to.
LOWEST_HZ, HIGHEST_HZ = 10.0, 100e9

_TAU_UNITS_S = (1e-12, 1e-9, 1e-6, 1e-3)
_PREFIXES = {"": 1.0, "k": 1e3, "M": 1e6, "G": 1e9}
_FREQUENCY = re.compile(r"\s*([0-9.]+(?:[eE][+-]?[0-9]+)?)\s*([kMG]?)(?:Hz)?\s*")


@dataclass(frozen=True, slots=True)
class Dielectric:
    """Properties at one frequency: relative permittivity, and conductivity in S/m (displacement and ionic current)."""

    permittivity: float
    conductivity: float


@dataclass(frozen=True, slots=True)
class ColeCole:
    """Four Cole-Cole dispersions.

    Parameters
    ----------
    eps_inf
        Relative permittivity far above all of them.
    delta
        By how much each raises the relative permittivity below it.
    tau_s
        Relaxation times in s.
    alpha
        Broadening, 0 to 1.
    sigma
        Ionic conductivity in S/m.
    """

    eps_inf: float
    delta: tuple[float, ...]
    tau_s: tuple[float, ...]
    alpha: tuple[float, ...]
    sigma: float

    def complex_permittivity(self, frequency_hz: float) -> complex:
        """Return the relative complex permittivity eps' - j eps'' (eq. 1 of the paper)."""
        omega = 2.0 * math.pi * frequency_hz
        steps = (
            delta / (1.0 + (1j * omega * tau) ** (1.0 - alpha))
            for delta, tau, alpha in zip(self.delta, self.tau_s, self.alpha, strict=True)
        )
        return self.eps_inf + sum(steps) + self.sigma / (1j * omega * VACUUM_PERMITTIVITY)


@cache
def _table() -> dict[str, tuple[ColeCole, ...]]:
    path = Path(__file__).parents[2] / "data" / "electromagnetic.toml"
    rows = tomllib.loads(path.read_text(encoding="utf-8"))
    found: dict[str, tuple[ColeCole, ...]] = {
        name: (
            ColeCole(
                row["eps_inf"],
                tuple(row["delta"]),
                tuple(tau * unit for tau, unit in zip(row["tau"], _TAU_UNITS_S, strict=True)),
                tuple(row["alpha"]),
                row["sigma"],
            ),
        )
        for name, row in rows.items()
        if "mean_of" not in row
    }
    for name, row in rows.items():
        if "mean_of" in row:
            found[name] = tuple(found[part][0] for part in row["mean_of"])
    return dict(sorted(found.items()))


def material_names() -> tuple[str, ...]:
    """Return the names of the materials in the table."""
    return tuple(_table())


def dielectric(material: str, frequency_hz: float) -> Dielectric:
    """Return the properties of a material of the table at a frequency.

    Raises
    ------
    KeyError
        If there is no such material.
    UsageError
        If the frequency is not one that the model was made for.
    """
    if not LOWEST_HZ <= frequency_hz <= HIGHEST_HZ:
        raise UsageError(f"the properties of tissues are known from 10 Hz to 100 GHz, not at {frequency_hz:g} Hz")
    parts = _table()[material]
    mean = sum(part.complex_permittivity(frequency_hz) for part in parts) / len(parts)
    return Dielectric(mean.real, -mean.imag * 2.0 * math.pi * frequency_hz * VACUUM_PERMITTIVITY)


def parse_frequency(text: str) -> float:
    """Return the Hz of a text such as ``"300 MHz"``, ``"2.45GHz"`` or ``"3e8"``.

    Raises
    ------
    UsageError
        If it is none, or out of the range of the model.
    """
    found = _FREQUENCY.fullmatch(text)
    try:
        value = float(found[1]) * _PREFIXES[found[2]] if found else math.nan
    except ValueError:
        value = math.nan
    if not LOWEST_HZ <= value <= HIGHEST_HZ:
        raise UsageError(f"frequency {text!r}: expected 10 Hz to 100 GHz", hint="such as 300MHz, 2.45GHz or 3e8")
    return value


def frequency_text(frequency_hz: float) -> str:
    """Return a frequency in the unit that suits it: ``"300 MHz"``."""
    for unit, size in (("GHz", 1e9), ("MHz", 1e6), ("kHz", 1e3)):
        if frequency_hz >= size:
            return f"{frequency_hz / size:.10g} {unit}"
    return f"{frequency_hz:.10g} Hz"
