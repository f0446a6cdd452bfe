"""Sequences as TOML text: written so that reading gives back the same numbers."""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Mapping
from typing import Any

from vhp_cli.errors import UsageError
from vhp_cli.stages.breathe.curves import Curve, Interpolant, Polynomial, Power
from vhp_cli.stages.breathe.field import Field
from vhp_cli.stages.breathe.operations import (
    AXES,
    LocalFrame,
    Move,
    Operation,
    Parameter,
    Rotate,
    Scale,
    Triple,
)
from vhp_cli.stages.breathe.profile import Profile
from vhp_cli.stages.breathe.sequence import Displacement, Motion, Sequence, Targets

SCHEMA = "vhp-sequence/1"

_UNITS = {Scale: "1", Rotate: "deg", Move: "mm"}
_KINDS: dict[str, type[Scale] | type[Rotate] | type[Move]] = {"scale": Scale, "rotate": Rotate, "move": Move}


def format_sequence(sequence: Sequence) -> str:
    """Return a sequence as TOML text.

    Numbers have all the digits that they need to be read back the same. What has its default value is left out.
    """
    lines = [
        f"schema = {_text(SCHEMA)}",
        f"name = {_text(sequence.name)}",
        *_optional("description", sequence.description),
        *_optional("source", sequence.source),
        *_optional("errata", sequence.errata),
        *([] if sequence.identity_at_rest else ["identity_at_rest = false"]),
        "",
        "[frame]",
        'length_unit = "mm"',
        'angle_unit = "deg"',
        'axes = "LPS"  # +x to the subject\'s left, +y to the back, +z to the head',
        "",
        "[sweep]",
        f"variable = {_text(sequence.variable)}",
        f"steps = {sequence.steps}",
        f"period_s = {_number(sequence.period_s)}",
        "",
        "[targets]",
        f"lung_volume_change_l = {_number(sequence.targets.lung_volume_change_l)}",
        f"diaphragm_travel_mm = {_number(sequence.targets.diaphragm_travel_mm)}",
    ]
    for field in _fields(sequence):
        lines += ["", "[[field]]", *_field_lines(field)]
    for motion in sequence.motions:
        lines += ["", "[[motion]]", f"name = {_text(motion.name)}"]
        lines += _optional("role", motion.role) + _optional("side", motion.side)
        lines += [] if motion.number is None else [f"number = {motion.number}"]
        lines += _optional("tissues", motion.tissues) + _optional("fields", tuple(f.name for f in motion.fields))
        lines += _optional("name_has", motion.name_has)
        lines += _optional("errata", motion.errata) + _optional("note", motion.note)
        for operation in motion.operations:
            lines += ["  [[motion.operation]]", *(f"  {line}" for line in _operation_lines(operation))]
    return "\n".join(lines) + "\n"


def parse_sequence(text: str, source: str = "sequence") -> Sequence:
    """Return the sequence that a TOML text describes.

    Parameters
    ----------
    text
        The text.
    source
        Its name in messages, such as the path.

    Raises
    ------
    UsageError
        If it is no TOML or no sequence; the message names the entry.
    """
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise UsageError(f"{source}: not a TOML file: {error}") from None
    reader = _Table(data, source, "")
    schema = reader.take("schema", str)
    if schema != SCHEMA:
        raise UsageError(f"{source}: schema is {schema!r}", hint=f"this version reads {SCHEMA!r}")
    _check_frame(reader.table("frame"))
    sweep, targets = reader.table("sweep"), reader.table("targets", {})
    fields: dict[str, Displacement] = {}
    for table in reader.tables("field"):
        field = _field(table)
        if field.name in fields:
            raise table.error(f"a second field has the name {field.name!r}")
        fields[field.name] = field
    motions = tuple(_motion(table, fields) for table in reader.tables("motion"))
    defaults = Targets()
    with_targets = targets.build(
        Targets,
        lung_volume_change_l=targets.number("lung_volume_change_l", defaults.lung_volume_change_l),
        diaphragm_travel_mm=targets.number("diaphragm_travel_mm", defaults.diaphragm_travel_mm),
    )
    values = {
        "name": reader.take("name", str),
        "motions": motions,
        "steps": sweep.take("steps", int),
        "period_s": sweep.number("period_s"),
        "variable": sweep.take("variable", str),
        "targets": with_targets,
        "identity_at_rest": reader.take("identity_at_rest", bool, True),
        "description": reader.take("description", str, ""),
        "source": reader.take("source", str, ""),
        "errata": reader.strings("errata"),
    }
    sweep.done()
    sequence: Sequence = reader.build(Sequence, **values)
    return sequence


class _Table:
    """One table of the file: entries are taken out by type, and none may be left over."""

    def __init__(self, data: Mapping[str, Any], source: str, path: str) -> None:
        self._data = dict(data)
        self._source = source
        self._path = path

    def error(self, message: str, key: str = "", hint: str = "") -> UsageError:
        place = ".".join(part for part in (self._path, key) if part)
        return UsageError(f"{self._source}: {place + ': ' if place else ''}{message}", hint=hint)

    def take(self, key: str, kind: type, default: object = None) -> Any:
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
        return key in self._data

    def number(self, key: str, default: float | None = None) -> float:
        if key not in self._data and default is not None:
            return default
        if key not in self._data:
            raise self.error("missing", key)
        return self._as_number(self._data.pop(key), key)

    def numbers(
        self, key: str, count: int | None = None, default: tuple[float, ...] | None = None
    ) -> tuple[float, ...]:
        if key not in self._data and default is not None:
            return default
        values = self.take(key, list)
        if count is not None and len(values) != count:
            raise self.error(f"must have {count} numbers, not {len(values)}", key)
        return tuple(self._as_number(value, key) for value in values)

    def triple(self, key: str, default: Triple) -> Triple:
        x, y, z = self.numbers(key, 3, default)
        return (x, y, z)

    def triples(self, key: str) -> tuple[Triple, ...]:
        rows = self.take(key, list)
        if not all(isinstance(row, list) and len(row) == 3 for row in rows):
            raise self.error("must be a list of lists of 3 numbers", key)
        return tuple((self._as_number(x, key), self._as_number(y, key), self._as_number(z, key)) for x, y, z in rows)

    def pair(self, key: str) -> tuple[float, float]:
        low, high = self.numbers(key, 2)
        return (low, high)

    def strings(self, key: str) -> tuple[str, ...]:
        values = self.take(key, list, [])
        if not all(isinstance(value, str) for value in values):
            raise self.error("must be a list of texts", key)
        return tuple(values)

    def table(self, key: str, default: Mapping[str, Any] | None = None) -> _Table:
        return _Table(self.take(key, dict, default), self._source, f"{self._path}.{key}".strip("."))

    def tables(self, key: str) -> list[_Table]:
        values = self.take(key, list, [])
        if not all(isinstance(value, dict) for value in values):
            raise self.error("must be a list of tables", key)
        path = f"{self._path}.{key}".strip(".")
        return [_Table(value, self._source, f"{path}[{number}]") for number, value in enumerate(values, start=1)]

    def build(self, kind: Any, *arguments: Any, **values: Any) -> Any:
        """Make a value of the entries, once none is left over."""
        self.done()
        try:
            return kind(*arguments, **values)
        except ValueError as error:
            raise self.error(str(error)) from None

    def done(self) -> None:
        if self._data:
            raise self.error("no such entry", next(iter(self._data)))

    def _as_number(self, value: object, key: str) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise self.error(f"must be a finite number, not {value!r}", key)
        return float(value)


def _check_frame(table: _Table) -> None:
    for key, wanted in (("length_unit", "mm"), ("angle_unit", "deg"), ("axes", "LPS")):
        value = table.take(key, str)
        if value != wanted:
            raise table.error(f"must be {wanted!r}, not {value!r}", key)
    table.done()


def _motion(table: _Table, fields: Mapping[str, Displacement]) -> Motion:
    names = table.strings("fields")
    for name in names:
        if name not in fields:
            raise table.error(f"there is no field {name!r}", "fields")
    values = {
        "name": table.take("name", str),
        "operations": tuple(_operation(entry) for entry in table.tables("operation")),
        "fields": tuple(fields[name] for name in names),
        "tissues": table.strings("tissues"),
        "role": table.take("role", str, ""),
        "side": table.take("side", str, ""),
        "number": table.take("number", int) if table.has("number") else None,
        "name_has": table.take("name_has", str, ""),
        "errata": table.strings("errata"),
        "note": table.take("note", str, ""),
    }
    motion: Motion = table.build(Motion, **values)
    return motion


def _operation(table: _Table) -> Operation:
    kind = table.take("kind", str)
    if kind not in _KINDS:
        raise table.error(f"must be scale, rotate or move, not {kind!r}", "kind")
    default = LocalFrame()
    try:
        frame = LocalFrame(
            table.triple("origin", default.origin),
            table.triple("x_axis", default.x_axis),
            table.triple("y_axis", default.y_axis),
        )
    except ValueError as error:
        raise table.error(str(error)) from None
    cls = _KINDS[kind]
    unit = _UNITS[cls]
    if cls is Rotate:
        axis = table.take("axis", str)
        angle = _parameter(table.table("angle"), unit)
        rotation: Operation = table.build(Rotate, frame, axis, angle)
        return rotation
    parameters = {axis: _parameter(table.table(axis), unit) for axis in AXES if table.has(axis)}
    operation: Operation = table.build(cls, frame, **parameters)
    return operation


def _parameter(table: _Table, unit: str) -> Parameter:
    said = table.take("unit", str)
    if said != unit:
        raise table.error(f"must be {unit!r}, not {said!r}", "unit")
    forms = [form for form in ("polynomial", "values", "base") if table.has(form)]
    if len(forms) != 1:
        raise table.error("needs exactly one of polynomial, values and base")
    table_values = table.numbers("table", default=())
    residual = table.number("residual", 0.0)
    errata = table.strings("errata")
    try:
        if forms[0] == "polynomial":
            curve: Curve = Polynomial(table.numbers("polynomial"))
        elif forms[0] == "values":
            curve = Interpolant(table.numbers("values"), table.take("joining", str, "monotone"))
        else:
            curve = Power(table.number("base"))
    except ValueError as error:
        raise table.error(str(error)) from None
    parameter: Parameter = table.build(Parameter, curve, table_values, residual, errata)
    return parameter


def _field(table: _Table) -> Displacement:
    name = table.take("name", str)
    if table.has("heights"):
        amplitude = _parameter(table.table("amplitude"), "1")
        profile: Profile = table.build(
            Profile, name, amplitude, table.numbers("heights"), table.triples("displacements")
        )
        return profile
    values = {
        "name": name,
        "amplitude": _parameter(table.table("amplitude"), "mm"),
        "x_window": table.pair("x_window"),
        "z_window": table.pair("z_window"),
        "y_back": table.number("y_back"),
        "x_taper": table.number("x_taper"),
        "y_taper": table.number("y_taper"),
        "direction": table.triple("direction", (0.0, -1.0, 0.0)),
    }
    field: Field = table.build(Field, **values)
    return field


def _fields(sequence: Sequence) -> list[Displacement]:
    """Return the fields of all motions, each once."""
    found: dict[str, Displacement] = {}
    for motion in sequence.motions:
        for field in motion.fields:
            if found.setdefault(field.name, field) != field:
                raise ValueError(f"two different fields have the name {field.name!r}")
    return list(found.values())


def _field_lines(field: Displacement) -> list[str]:
    if isinstance(field, Profile):
        return [
            f"name = {_text(field.name)}",
            f"amplitude = {_parameter_text(field.amplitude, '1')}",
            f"heights = {_numbers(field.heights)}",
            f"displacements = [{', '.join(map(_numbers, field.displacements))}]",
        ]
    return [
        f"name = {_text(field.name)}",
        f"amplitude = {_parameter_text(field.amplitude, 'mm')}",
        f"x_window = {_numbers(field.x_window)}",
        f"z_window = {_numbers(field.z_window)}",
        f"y_back = {_number(field.y_back)}",
        f"x_taper = {_number(field.x_taper)}",
        f"y_taper = {_number(field.y_taper)}",
        f"direction = {_numbers(field.direction)}",
    ]


def _operation_lines(operation: Operation) -> list[str]:
    frame = operation.frame
    kind = next(name for name, cls in _KINDS.items() if isinstance(operation, cls))
    lines = [f"kind = {_text(kind)}", f"origin = {_numbers(frame.origin)}"]
    lines += [f"x_axis = {_numbers(frame.x_axis)}", f"y_axis = {_numbers(frame.y_axis)}"]
    if isinstance(operation, Rotate):
        lines.append(f"axis = {_text(operation.axis)}")
    unit, unchanged = _UNITS[type(operation)], Parameter(Polynomial((operation.identity,)))
    for name, parameter in operation.parameters().items():
        if isinstance(operation, Rotate) or parameter != unchanged:
            lines.append(f"{name} = {_parameter_text(parameter, unit)}")
    return lines


def _parameter_text(parameter: Parameter, unit: str) -> str:
    curve = parameter.curve
    if isinstance(curve, Polynomial):
        entries = [f"polynomial = {_numbers(curve.coefficients)}"]
    elif isinstance(curve, Interpolant):
        entries = [f"values = {_numbers(curve.values)}", f"joining = {_text(curve.joining)}"]
    else:
        entries = [f"base = {_number(curve.base)}"]
    entries.append(f"unit = {_text(unit)}")
    if parameter.table:
        entries.append(f"table = {_numbers(parameter.table)}")
    if parameter.residual:
        entries.append(f"residual = {_number(parameter.residual)}")
    entries += _optional("errata", parameter.errata)
    return "{ " + ", ".join(entries) + " }"


def _optional(key: str, value: str | tuple[str, ...]) -> list[str]:
    if not value:
        return []
    return [f"{key} = {_text(value) if isinstance(value, str) else '[' + ', '.join(map(_text, value)) + ']'}"]


def _numbers(values: tuple[float, ...]) -> str:
    return "[" + ", ".join(map(_number, values)) + "]"


def _number(value: float) -> str:
    return repr(float(value))


def _text(value: str) -> str:
    # A JSON string is a TOML string, but for the delete character.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
