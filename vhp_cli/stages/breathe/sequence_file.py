"""Sequences as TOML text: written so that reading gives back the same numbers."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping

from vhp_cli.errors import UsageError
from vhp_cli.stages.breathe.blend import Blend, Holder
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
)
from vhp_cli.stages.breathe.profile import Profile
from vhp_cli.stages.breathe.sequence import Displacement, Motion, Sequence, Targets
from vhp_cli.stages.breathe.toml_table import Table

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
    bodies = {motion.name: motion.operations for motion in sequence.motions if motion.operations}
    for field in _fields(sequence):
        lines += ["", "[[field]]", *_field_lines(field, bodies)]
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
    reader = Table(data, source, "")
    schema = reader.take("schema", str)
    if schema != SCHEMA:
        raise UsageError(f"{source}: schema is {schema!r}", hint=f"this version reads {SCHEMA!r}")
    _check_frame(reader.table("frame"))
    sweep, targets = reader.table("sweep"), reader.table("targets", {})
    # Fields come first in the file, and name motions whose operations they take part in.
    tables = [(table, table.take("name", str), _operations(table)) for table in reader.tables("motion")]
    bodies = {name: operations for _, name, operations in tables}
    fields: dict[str, Displacement] = {}
    for table in reader.tables("field"):
        field = _field(table, bodies)
        if field.name in fields:
            raise table.error(f"a second field has the name {field.name!r}")
        fields[field.name] = field
    motions = tuple(_motion(table, name, operations, fields) for table, name, operations in tables)
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


def _check_frame(table: Table) -> None:
    for key, wanted in (("length_unit", "mm"), ("angle_unit", "deg"), ("axes", "LPS")):
        value = table.take(key, str)
        if value != wanted:
            raise table.error(f"must be {wanted!r}, not {value!r}", key)
    table.done()


def _operations(table: Table) -> tuple[Operation, ...]:
    return tuple(_operation(entry) for entry in table.tables("operation"))


def _motion(table: Table, name: str, operations: tuple[Operation, ...], fields: Mapping[str, Displacement]) -> Motion:
    names = table.strings("fields")
    for field in names:
        if field not in fields:
            raise table.error(f"there is no field {field!r}", "fields")
    values = {
        "name": name,
        "operations": operations,
        "fields": tuple(fields[field] for field in names),
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


def _operation(table: Table) -> Operation:
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


def _parameter(table: Table, unit: str) -> Parameter:
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


def _field(table: Table, bodies: Mapping[str, tuple[Operation, ...]]) -> Displacement:
    name = table.take("name", str)
    if table.has("holder"):
        blend: Blend = table.build(Blend, name, tuple(_holder(entry, bodies) for entry in table.tables("holder")))
        return blend
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


def _holder(table: Table, bodies: Mapping[str, tuple[Operation, ...]]) -> Holder:
    name = table.take("name", str)
    operations = _operations(table)
    if not operations and not table.take("stays", bool, False):
        if name not in bodies:
            raise table.error(f"there is no motion {name!r}", "name", "give it operations, or say stays = true")
        operations = bodies[name]
    holder: Holder = table.build(Holder, name, operations, table.quadruples("balls"))
    return holder


def _fields(sequence: Sequence) -> list[Displacement]:
    """Return the fields of all motions, each once."""
    found: dict[str, Displacement] = {}
    for motion in sequence.motions:
        for field in motion.fields:
            if found.setdefault(field.name, field) != field:
                raise ValueError(f"two different fields have the name {field.name!r}")
    return list(found.values())


def _field_lines(field: Displacement, bodies: Mapping[str, tuple[Operation, ...]]) -> list[str]:
    if isinstance(field, Blend):
        lines = [f"name = {_text(field.name)}"]
        for holder in field.holders:
            lines += ["  [[field.holder]]", f"  name = {_text(holder.name)}"]
            lines += [] if holder.operations else ["  stays = true"]
            lines.append(f"  balls = [{', '.join(map(_numbers, holder.balls))}]")
            for operation in holder.operations if bodies.get(holder.name) != holder.operations else ():
                lines += ["    [[field.holder.operation]]", *(f"    {line}" for line in _operation_lines(operation))]
        return lines
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
