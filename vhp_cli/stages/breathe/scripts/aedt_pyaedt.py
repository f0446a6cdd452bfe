"""The sweep as a PyAEDT script for ANSYS Electronics Desktop."""

from __future__ import annotations

from vhp_cli.stages.breathe.scripts.plan import WARNING, Model, Plan, plan, title

_BODY = '''
HERE = Path(__file__).resolve().parent


def load(modeler, name, path):
    """Import one mesh in mm and give the new object its name."""
    before = set(modeler.object_names)
    modeler.import_3d_cad(str(path), merge_planar_faces=False, input_file_unit="mm")
    new = [found for found in modeler.object_names if found not in before]
    if len(new) != 1:
        raise RuntimeError("%s gave %d objects instead of one" % (path, len(new)))
    modeler[new[0]].name = name


def declare(app, value):
    """Set the sweep variable, and the variables that follow it."""
    app[VARIABLE] = repr(value)
    for name, text in VARIABLES:
        app[name] = text


def transform(modeler):
    """Apply the operations, each in its own coordinate system."""
    for kind, target, system, origin, x_axis, y_axis, axis, values in OPERATIONS:
        modeler.set_working_coordinate_system("Global")
        modeler.create_coordinate_system(origin=origin, name=system, mode="axis", x_pointing=x_axis, y_pointing=y_axis)
        modeler.set_working_coordinate_system(system)
        if kind == "scale":
            modeler.scale([target], x=values[0], y=values[1], z=values[2])
        elif kind == "rotate":
            modeler.rotate(target, axis=axis, angle="(%s)*1deg" % values["XYZ".index(axis)])
        else:
            modeler.move(target, ["(%s)*1mm" % value for value in values])
    modeler.set_working_coordinate_system("Global")


def build(app, value, shell_directory):
    """Build one design: the tissues at rest, moved by the sweep variable, and the shells of one frame."""
    modeler = app.modeler
    modeler.model_units = "mm"
    declare(app, value)
    for name, file in OBJECTS:
        load(modeler, name, HERE / FRAMES[0][1] / file)
    transform(modeler)
    for name, file in SHELLS if shell_directory else []:
        load(modeler, name, HERE / shell_directory / file)


def main():
    """Build the parametric design, or with shells one design per frame."""
    if SHELLS and WITH_SHELLS:
        for number, (value, directory) in enumerate(FRAMES):
            build(Hfss(design="%s_%02d" % (VARIABLE, number)), value, directory)
        return
    app = Hfss(design=VARIABLE)
    build(app, FRAMES[0][0], None)
    if app.setups:
        app.parametrics.add(VARIABLE, 0, STEPS, STEPS + 1, variation_type="LinearCount", name=VARIABLE + "_sweep")


if __name__ == "__main__":
    main()
'''


def write(model: Model) -> str:
    """Return the script as text.

    Affine tissues become a parametric design. Shells are not affine: with them the script builds one design per
    frame, each with the shells of that frame.
    """
    said = plan(model)
    return "\n".join([*_header(said), *_lists(said)]) + "\n" + _BODY


def _header(said: Plan) -> list[str]:
    variable, steps = said.model.sequence.variable, said.model.sequence.steps
    return [
        f'"""Breathing sweep of {title(said.model)} for ANSYS Electronics Desktop, through PyAEDT.',
        "",
        *WARNING,
        "Run it with the interpreter that PyAEDT is installed in; keep it beside the frames.",
        f"The sweep variable {variable} runs from 0 (rest) to {steps} (full inhalation).",
        "Tissues that bend (skin, fat, average body) are no affine function of it: with WITH_SHELLS there is one",
        "design per frame with them, without it one parametric design that leaves them out.",
        '"""',
        "",
        "from pathlib import Path",
        "",
        "from ansys.aedt.core import Hfss",
        "",
        f"VARIABLE = {variable!r}",
        f"STEPS = {steps}",
        "WITH_SHELLS = True",
    ]


def _lists(said: Plan) -> list[str]:
    return [
        "",
        "# value of the sweep variable, directory of the frame",
        *listed("FRAMES", said.model.frames),
        "",
        "# object, mesh file",
        *listed("OBJECTS", said.objects),
        *listed("SHELLS", said.shells),
        "",
        "# name, expression",
        *listed("VARIABLES", [(variable.name, variable.text) for variable in said.variables]),
        "",
        "# kind, object, coordinate system, its origin (mm), x axis and y axis, axis of rotation, factors|degrees|mm",
        *listed("OPERATIONS", operations(said)),
    ]


def operations(said: Plan) -> list[tuple[object, ...]]:
    """Return the steps as plain tuples."""
    return [
        (
            step.kind,
            step.target,
            step.frame_name,
            [f"{value!r}mm" for value in step.frame.origin],
            [f"{value!r}mm" for value in step.frame.x_axis],
            [f"{value!r}mm" for value in step.frame.y_axis],
            step.axis.upper() if step.axis else "",
            step.values,
        )
        for step in said.steps
    ]


def listed(name: str, rows: object) -> list[str]:
    """Return a Python list, one row a line."""
    assert isinstance(rows, list | tuple)
    return [f"{name} = [", *(f"    {row!r}," for row in rows), "]"]
