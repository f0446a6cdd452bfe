"""Settings: command line over ``vhp.toml`` over profile over the rule table."""

from __future__ import annotations

import difflib
import math
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from typing import Any, get_args

from vhp_cli.errors import UsageError
from vhp_cli.measures import Level
from vhp_cli.rules import RULES
from vhp_cli.tissues import guess_type, type_names

UNITS = {"um": 1e-3, "mm": 1.0, "cm": 10.0, "in": 25.4, "m": 1000.0}
LEVELS: tuple[str, ...] = get_args(Level)
# Stages with a section of their own. The values are those of the stage, which checks them when it runs.
STAGES = ("heal", "smooth", "decimate", "breathe", "tetmesh", "clearance", "export")

# What a section says, by stage and key.
StageTables = Mapping[str, Mapping[str, object]]


@dataclass(frozen=True, slots=True)
class RuleSetting:
    """Level (None: off) and limit of one rule."""

    level: Level | None
    limit: float | None


@dataclass(frozen=True, slots=True)
class RuleChange:
    """What a configuration says of one rule; None leaves the value as it is."""

    level: Level | None = None
    off: bool = False
    limit: float | None = None

    def apply(self, setting: RuleSetting) -> RuleSetting:
        """Return `setting` with this change made."""
        level = None if self.off else self.level or setting.level
        return RuleSetting(level, setting.limit if self.limit is None else self.limit)


@dataclass(frozen=True, slots=True)
class TissueOverride:
    """Settings for the tissues whose names match a shell pattern."""

    match: str
    type: str | None
    rules: Mapping[str, RuleChange]
    stages: StageTables = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class PairPattern:
    """Two shell patterns on tissue names: (inner, outer) or (a, b)."""

    first: str
    second: str

    def matches(self, a: str, b: str) -> bool:
        """Tell if `a` matches the first pattern and `b` the second, case aside."""
        return matches(a, self.first) and matches(b, self.second)


@dataclass(frozen=True, slots=True)
class Settings:
    """Everything that decides what is checked and how it is judged."""

    profile: str
    rules: Mapping[str, RuleSetting]
    tissues: tuple[TissueOverride, ...] = ()
    nested: tuple[PairPattern, ...] = ()
    may_touch: tuple[PairPattern, ...] = ()
    units: str = "mm"
    weld_tolerance_mm: float = 0.0
    gap_search_mm: float | None = None  # None: as far as the gap rule looks
    recursive: bool = False
    stages: StageTables = field(default_factory=dict)
    # By shell pattern on the names of tissues; `vhp export` checks the values.
    materials: Mapping[str, Mapping[str, object]] = field(default_factory=dict)

    def rule(self, code: str, *names: str) -> RuleSetting:
        """Return the setting of a rule for a tissue or a pair of tissues.

        For a pair each tissue is looked up by itself and the milder answer holds, so that "nerves may be
        as close as 0.5 mm" covers every pair that has a nerve in it.
        """
        found = [self._rule_of(code, name) for name in names] or [self.rules[code]]
        level: Level | None = None
        if all(setting.level for setting in found):
            level = max((setting.level for setting in found if setting.level), key=LEVELS.index)
        limits = [setting.limit for setting in found if setting.limit is not None]
        return RuleSetting(level, min(limits) if limits else None)

    def tissue_type(self, name: str) -> str:
        """Return the type set for a tissue, else the one its name suggests."""
        for override in reversed(self.tissues):
            if override.type and matches(name, override.match):
                return override.type
        return guess_type(name)

    def stage_tables(self, stage: str, name: str) -> list[tuple[str, Mapping[str, object]]]:
        """Return what the settings say of a stage for one tissue, and where; later tables come before earlier ones."""
        tables = [(f"[[tissue]] {override.match!r}: {stage}", override) for override in self.tissues]
        return [
            (where, override.stages[stage])
            for where, override in tables
            if stage in override.stages and matches(name, override.match)
        ]

    def idle_patterns(self, names: Iterable[str]) -> list[str]:
        """Return the patterns of ``[[tissue]]`` and ``[[may-touch]]`` that match no tissue, as likely misspelt."""
        names = list(names)
        patterns = [override.match for override in self.tissues]
        patterns += [pattern for pair in self.may_touch for pattern in (pair.first, pair.second)]
        return [pattern for pattern in patterns if not any(matches(name, pattern) for name in names)]

    def _rule_of(self, code: str, name: str) -> RuleSetting:
        setting = self.rules[code]
        for override in self.tissues:
            if code in override.rules and matches(name, override.match):
                setting = override.rules[code].apply(setting)
        return setting

    def as_dict(self) -> dict[str, object]:
        """Return the settings in full, as the report stores them and `from_report` reads them."""
        return {
            "profile": self.profile,
            "units": self.units,
            "weld_tolerance_mm": self.weld_tolerance_mm,
            # JSON has no infinity.
            "gap_search_mm": "inf" if self.gap_search_mm == math.inf else self.gap_search_mm,
            "recursive": self.recursive,
            "rules": {
                code: {"level": setting.level or "off", **({} if setting.limit is None else {"limit": setting.limit})}
                for code, setting in self.rules.items()
            },
            "tissue": [
                {
                    "match": override.match,
                    **({"type": override.type} if override.type else {}),
                    "rules": {
                        code: {
                            **({"level": "off" if change.off else change.level} if change.off or change.level else {}),
                            **({} if change.limit is None else {"limit": change.limit}),
                        }
                        for code, change in override.rules.items()
                    },
                    **_copied(override.stages),
                }
                for override in self.tissues
            ],
            "nested": [{"inner": pair.first, "outer": pair.second} for pair in self.nested],
            "may-touch": [{"a": pair.first, "b": pair.second} for pair in self.may_touch],
            **_copied(self.stages),
            **({"materials": _copied(self.materials)} if self.materials else {}),
        }


def profiles() -> tuple[str, ...]:
    """Return the names of the profiles."""
    return tuple(_profile_table())


def load_settings(
    *,
    config: Path | None = None,
    model: Sequence[Path] = (),
    profile: str | None = None,
    select: Iterable[str] = (),
    ignore: Iterable[str] = (),
    limits: Mapping[str, float] | None = None,
    units: str | None = None,
    weld_tolerance_mm: float | None = None,
    gap_search_mm: float | None = None,
    recursive: bool = False,
) -> Settings:
    """Put the settings together from every source.

    Parameters
    ----------
    config
        A configuration file; default: ``vhp.toml`` in the model directory, else ``[tool.vhp]`` of a
        ``pyproject.toml`` there.
    model
        The paths given as the model.
    profile, units, weld_tolerance_mm, gap_search_mm, recursive
        As on the command line; None leaves the choice to the configuration.
    select, ignore
        Rule codes or prefixes of codes; with `select` every other rule is off but those on files that
        can't be read as they should.
    limits
        Limits by rule code.

    Raises
    ------
    UsageError
        If a file is missing, is not TOML, or says something that is not understood.
    """
    table, where = _read_config(config, model)
    known = {
        "profile", "units", "weld-tolerance", "gap-search", "recursive", "select", "ignore",
        "rules", "tissue", "nested", "may-touch", "materials", *STAGES,
    }  # fmt: skip
    _refuse_unknown(table, known, where)
    chosen = next(name for name in (profile, _string(table, "profile", where), "strict") if name is not None)
    if chosen not in _profile_table():
        raise UsageError(f"{where}: no profile {chosen!r}", hint=f"profiles: {', '.join(_profile_table())}")
    rules = {code: RuleSetting(rule.level, rule.limit) for code, rule in RULES.items()}
    for source, place in ((_profile_table()[chosen], f"profile {chosen}"), (table, where)):
        for code, change in _rule_changes(source.get("rules", {}), f"{place}: rules").items():
            rules[code] = change.apply(rules[code])
    for code, limit in (limits or {}).items():
        rules[code] = replace(rules[code], limit=_finite(limit, f"limit of {code}"))
    select, ignore = list(select), list(ignore)
    selected = _codes(select or _strings(table, "select", where), "select")
    if selected:
        # What could not be read can't pass, whatever is looked for; --ignore says so if it is meant.
        selected |= {code for code, rule in RULES.items() if code.startswith("F") and rule.level == "error"}
    # A rule that the command line selects is on, whatever the file says of it.
    ignored = _codes([*([] if select else _strings(table, "ignore", where)), *ignore], "ignore")
    for code, setting in rules.items():
        if (selected and code not in selected) or code in ignored:
            rules[code] = replace(setting, level=None)
        elif code in selected and setting.level is None:
            rules[code] = replace(setting, level=RULES[code].level or "warning")
    search = gap_search_mm if gap_search_mm is not None else _number(table, "gap-search", where)
    unit = units or _string(table, "units", where) or "mm"
    if unit not in UNITS:
        raise UsageError(f"{where}: units: {unit!r} is not known", hint=f"units: {', '.join(UNITS)}")
    return Settings(
        profile=chosen,
        rules=rules,
        tissues=_overrides(table, where),
        nested=_pairs(table, "nested", ("inner", "outer"), where),
        may_touch=_pairs(table, "may-touch", ("a", "b"), where),
        units=unit,
        weld_tolerance_mm=_finite(
            _first(weld_tolerance_mm, _number(table, "weld-tolerance", where), 0.0), "weld tolerance"
        ),
        gap_search_mm=None if search is None else _not_nan(search, "gap search"),
        recursive=recursive or _flag(table, "recursive", where),
        stages=_stage_tables(table, where),
        materials=_material_tables(table, where),
    )


def matches(name: str, pattern: str) -> bool:
    """Tell if a tissue's name matches a shell pattern, case aside."""
    return fnmatchcase(name.casefold(), pattern.casefold())


@cache
def _profile_table() -> dict[str, Any]:
    return tomllib.loads(Path(__file__).with_name("data").joinpath("profiles.toml").read_text(encoding="utf-8"))


def _read_config(config: Path | None, model: Sequence[Path]) -> tuple[dict[str, Any], str]:
    if config is not None:
        return _parse(config), str(config)
    for directory in (path for path in model if path.is_dir()):
        if (directory / "vhp.toml").is_file():
            return _parse(directory / "vhp.toml"), str(directory / "vhp.toml")
        project = directory / "pyproject.toml"
        if project.is_file():
            tools = _parse(project).get("tool", {})
            section = tools.get("vhp", {}) if isinstance(tools, dict) else None
            if not isinstance(section, dict):
                raise UsageError(f"{project}: [tool.vhp] must be a table")
            if section:
                return section, f"{project}: [tool.vhp]"
    return {}, "command line"


def _parse(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise UsageError(f"{path}: can't be read: {error.strerror}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UsageError(f"{path}: not valid TOML: {error}") from error


def _rule_changes(table: object, where: str) -> dict[str, RuleChange]:
    if not isinstance(table, dict):
        raise UsageError(f"{where}: expected a table of rules")
    changes = {}
    for code, value in table.items():
        place = f"{where}.{code}"
        _one_of(code, RULES, place)
        if isinstance(value, str):
            value = {"level": value}
        elif isinstance(value, int | float) and not isinstance(value, bool):
            value = {"limit": value}
        if not isinstance(value, dict):
            raise UsageError(f"{place}: expected a level, a limit, or a table with both")
        _refuse_unknown(value, {"level", "limit"}, place)
        level = _string(value, "level", place)
        if level is not None:
            _one_of(level, (*LEVELS, "off"), f"{place}.level")
        limit = _number(value, "limit", place)
        if limit is not None:
            _finite(limit, f"{place}.limit")
        if limit is not None and RULES[code].limit is None:
            raise UsageError(f"{place}: rule {code} ({RULES[code].name}) has no limit")
        changes[code] = RuleChange(None if level in (None, "off") else level, level == "off", limit)  # type: ignore[arg-type]
    return changes


def _overrides(table: Mapping[str, Any], where: str) -> tuple[TissueOverride, ...]:
    overrides = []
    for index, row in enumerate(_rows(table, "tissue", where)):
        place = f"{where}: tissue[{index}]"
        _refuse_unknown(row, {"match", "type", "rules", *STAGES}, place)
        match, kind = _string(row, "match", place), _string(row, "type", place)
        if not match:
            raise UsageError(f'{place}: needs match = "pattern"')
        if kind is not None:
            _one_of(kind, type_names(), f"{place}.type")
        changes = _rule_changes(row.get("rules", {}), f"{place}.rules")
        overrides.append(TissueOverride(match, kind, changes, _stage_tables(row, place)))
    return tuple(overrides)


def _stage_tables(table: Mapping[str, Any], where: str) -> StageTables:
    tables: dict[str, dict[str, object]] = {}
    for stage in STAGES:
        values = table.get(stage, {})
        if not isinstance(values, dict):
            raise UsageError(f"{where}: {stage}: expected a table")
        for key, value in values.items():
            if not isinstance(value, bool | int | float | str):
                raise UsageError(f"{where}: {stage}.{key}: expected a single value, not {value!r}")
        if values:
            tables[stage] = values
    return tables


def _material_tables(table: Mapping[str, Any], where: str) -> dict[str, dict[str, object]]:
    rows = table.get("materials", {})
    if not isinstance(rows, dict) or not all(isinstance(row, dict) for row in rows.values()):
        raise UsageError(f'{where}: materials: write [materials."pattern"] tables')
    return rows


def _copied(tables: StageTables) -> dict[str, dict[str, object]]:
    return {stage: dict(values) for stage, values in tables.items()}


def _pairs(table: Mapping[str, Any], key: str, fields: tuple[str, str], where: str) -> tuple[PairPattern, ...]:
    pairs = []
    for index, row in enumerate(_rows(table, key, where)):
        place = f"{where}: {key}[{index}]"
        _refuse_unknown(row, set(fields), place)
        first, second = (_string(row, field, place) for field in fields)
        if not first or not second:
            raise UsageError(f"{place}: needs {fields[0]} and {fields[1]}")
        pairs.append(PairPattern(first, second))
    return tuple(pairs)


def _rows(table: Mapping[str, Any], key: str, where: str) -> list[dict[str, Any]]:
    rows = table.get(key, [])
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise UsageError(f"{where}: {key}: write [[{key}]] tables")
    return rows


def _string(table: Mapping[str, Any], key: str, where: str) -> str | None:
    value = table.get(key)
    if value is not None and not isinstance(value, str):
        raise UsageError(f"{where}: {key}: expected a text, not {value!r}")
    return value


def _strings(table: Mapping[str, Any], key: str, where: str) -> list[str]:
    value = table.get(key, [])
    if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
        raise UsageError(f"{where}: {key}: expected a list of texts")
    return value


def _number(table: Mapping[str, Any], key: str, where: str) -> float | None:
    value = table.get(key)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not value >= 0:
        raise UsageError(f"{where}: {key}: expected a number that is not negative, not {value!r}")
    return float(value)


def _flag(table: Mapping[str, Any], key: str, where: str) -> bool:
    value = table.get(key, False)
    if not isinstance(value, bool):
        raise UsageError(f"{where}: {key}: expected true or false, not {value!r}")
    return value


def _first(*values: float | None) -> float:
    return next(value for value in values if value is not None)


def _not_nan(value: float, what: str) -> float:
    # Every comparison with NaN is false, so that no limit would ever be broken.
    if math.isnan(value):
        raise UsageError(f"{what}: expected a number, not {value}")
    return value


def _finite(value: float, what: str) -> float:
    if not math.isfinite(value):
        raise UsageError(f"{what}: expected a finite number, not {value}")
    return value


def _codes(chosen: Iterable[str], where: str) -> set[str]:
    codes: set[str] = set()
    for text in chosen:
        prefix = text.upper()
        matching = {code for code in RULES if code.startswith(prefix)}
        if not matching:
            raise UsageError(f"{where}: no rule {text!r}", hint="`vhp rules` lists them")
        codes |= matching
    return codes


def _one_of(value: str, known: Iterable[str], where: str) -> None:
    known = list(known)
    if value not in known:
        close = difflib.get_close_matches(value, known, 1)
        raise UsageError(f"{where}: {value!r} is not known" + (f"; did you mean {close[0]!r}?" if close else ""))


def _refuse_unknown(table: Mapping[str, Any], known: set[str], where: str) -> None:
    for key in table:
        _one_of(key, sorted(known), where)
