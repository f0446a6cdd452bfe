"""The material of each tissue and its properties: what the user says first, then the tables of the package."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

from vhp_cli.config import Settings, matches
from vhp_cli.errors import UsageError
from vhp_cli.stages.breathe.mass import density_of
from vhp_cli.stages.breathe.roles import guess_role
from vhp_cli.stages.export.dielectric import SOURCE, dielectric, material_names
from vhp_cli.stages.options import nearest
from vhp_cli.tissues import words

NONE = "none"
_KEYS = ("material", "permittivity", "conductivity", "density", "source")


@dataclass(frozen=True, slots=True)
class Properties:
    """What a tissue is made of; None where nothing is known.

    Parameters
    ----------
    tissue
        Its name.
    material
        Name of the material, empty if there is none.
    permittivity
        Relative permittivity at the frequency asked for.
    conductivity
        S/m, at that frequency.
    density
        kg/m3.
    dielectric_source, density_source
        Where the values are from.
    """

    tissue: str
    material: str = ""
    permittivity: float | None = None
    conductivity: float | None = None
    density: float | None = None
    dielectric_source: str = ""
    density_source: str = ""

    @property
    def known(self) -> bool:
        """Whether a solver can be given a material for the tissue."""
        return self.permittivity is not None and self.conductivity is not None


@dataclass(frozen=True, slots=True)
class UserMaterial:
    """What the user says of the tissues whose names match a shell pattern."""

    match: str
    where: str
    material: str | None = None
    permittivity: float | None = None
    conductivity: float | None = None
    density: float | None = None
    source: str | None = None


def user_materials(table: Mapping[str, object], where: str) -> tuple[UserMaterial, ...]:
    """Return the rows of a table ``[materials]``: by shell pattern on names of tissues, values.

    Parameters
    ----------
    table
        Pattern to a table with some of ``material`` (a name of the package's table, a name of the user's own with
        ``permittivity`` and ``conductivity``, or ``"none"``), ``density`` (kg/m3) and ``source``.
    where
        For the messages.

    Raises
    ------
    UsageError
        If something is not understood.
    """
    rows = []
    for match, values in table.items():
        place = f"{where}.{match!r}"
        if not isinstance(values, Mapping):
            raise UsageError(f"{place}: expected a table of {', '.join(_KEYS)}")
        for key in values:
            if key not in _KEYS:
                raise UsageError(f"{place}: {key!r} is not known{nearest(str(key), _KEYS)}")
        texts = {key: _text(values.get(key), f"{place}.{key}") for key in ("material", "source")}
        numbers = {
            key: _number(values.get(key), f"{place}.{key}", least)
            for key, least in (("permittivity", 1.0), ("conductivity", 0.0), ("density", 0.0))
        }
        row = UserMaterial(match, place, **texts, **numbers)  # type: ignore[arg-type]
        if (row.permittivity is None) != (row.conductivity is None):
            raise UsageError(f"{place}: permittivity and conductivity belong together")
        if row.material not in (None, NONE, *material_names()) and row.permittivity is None:
            close = nearest(str(row.material), material_names())
            raise UsageError(
                f"{place}: no material {row.material!r} in the table{close}",
                hint="give permittivity and conductivity of a material of your own",
            )
        if row.material == NONE and row.permittivity is not None:
            raise UsageError(f"{place}: no material, yet permittivity and conductivity")
        rows.append(row)
    return tuple(rows)


def properties_of(
    names: Iterable[str],
    settings: Settings,
    user: Sequence[UserMaterial] = (),
    frequency_hz: float | None = None,
) -> tuple[Properties, ...]:
    """Return the properties of each tissue.

    Parameters
    ----------
    names
        The tissues.
    settings
        For tissue types, and for densities that are said for `vhp breathe`.
    user
        What comes before the tables; later rows come before earlier ones.
    frequency_hz
        Of permittivity and conductivity; None: only those that the user gives.

    Raises
    ------
    UsageError
        If the frequency is out of range.
    """
    return tuple(_properties(name, settings, user, frequency_hz) for name in names)


def own_volumes(volumes: Mapping[str, float], nesting: Mapping[str, str | None]) -> dict[str, float]:
    """Return the volume of each tissue without the tissues directly within it; unit as given."""
    own = dict(volumes)
    for name, parent in nesting.items():
        if parent is not None and name in volumes and parent in own:
            own[parent] -= volumes[name]
    return own


def _properties(name: str, settings: Settings, user: Sequence[UserMaterial], frequency_hz: float | None) -> Properties:
    explicit = next(
        (found.type for found in reversed(settings.tissues) if found.type and matches(name, found.match)), None
    )
    material, like, blocked = _from_table(name, explicit, settings.tissue_type(name))
    found = Properties(name, material)
    if material and frequency_hz is not None:
        values = dielectric(material, frequency_hz)
        source = f"{SOURCE}: {material}" + (f" ({like})" if like else "")
        found = replace(
            found, permittivity=values.permittivity, conductivity=values.conductivity, dielectric_source=source
        )
    kind = explicit or settings.tissue_type(name)
    density = density_of(name, guess_role(name, kind).part, kind)
    if not density.certain and material and not like:
        density = density_of(material, guess_role(material).part)
    if density.certain and not blocked:
        found = replace(found, density=density.kg_per_m3, density_source=density.source)
    for _, said in settings.stage_tables("breathe", name):
        if "density" in said:
            value = _number(said["density"], f"{name}: density", 0.0)
            found = replace(found, density=value, density_source="settings")
    for row in user:
        if matches(name, row.match):
            found = _with(found, row, frequency_hz)
    return found


def _with(found: Properties, row: UserMaterial, frequency_hz: float | None) -> Properties:
    """Return properties with what the user says in place."""
    source = row.source or "settings"
    if row.density is not None:
        found = replace(found, density=row.density, density_source=source)
    if row.material == NONE:
        return replace(found, material="", permittivity=None, conductivity=None, dielectric_source=source)
    if row.permittivity is not None:
        return replace(
            found,
            material=row.material or found.material or found.tissue,
            permittivity=row.permittivity,
            conductivity=row.conductivity,
            dielectric_source=source,
        )
    if row.material is None:
        return found
    found = replace(found, material=row.material, permittivity=None, conductivity=None, dielectric_source="")
    if frequency_hz is None:
        return found
    values = dielectric(row.material, frequency_hz)
    return replace(
        found,
        permittivity=values.permittivity,
        conductivity=values.conductivity,
        dielectric_source=f"{SOURCE}: {row.material} ({source})",
    )


@cache
def _rows() -> dict[str, Any]:
    path = Path(__file__).parents[2] / "data" / "tissue_materials.toml"
    return tomllib.loads(path.read_text(encoding="utf-8"))


def _from_table(name: str, explicit_type: str | None, tissue_type: str) -> tuple[str, str, bool]:
    """Return the material that the tables give a tissue, why that of another stands for it, and if there is none."""
    text = f" {' '.join(words(name))} "
    for row in _rows()["tissue"]:
        if _has(text, row["phrases"]) and not _has(text, row.get("except", ())):
            if "material" in row:
                return row["material"], row.get("like", ""), False
            if explicit_type is None:
                return "", "", True
            break
    return _rows()["type"].get(explicit_type or tissue_type, ""), "", False


def _has(text: str, phrases: Iterable[str]) -> bool:
    return any(f" {phrase[:-1]}" in text if phrase.endswith("*") else f" {phrase} " in text for phrase in phrases)


def _text(value: object, where: str) -> str | None:
    if value is not None and (not isinstance(value, str) or not value.isprintable() or not value.strip()):
        raise UsageError(f"{where}: expected a text, not {value!r}")
    return value


def _number(value: object, where: str, least: float) -> float | None:
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value) or value < least:
        raise UsageError(f"{where}: expected a finite number of at least {least:g}, not {value!r}")
    return float(value)
