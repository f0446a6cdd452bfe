"""The import as a PyAEDT script for ANSYS Electronics Desktop."""

from __future__ import annotations

from vhp_cli.stages.export.scripts.scene import WARNING, Scene, python_lists

_BODY = '''
HERE = Path(__file__).resolve().parent


def load(modeler, name, path):
    """Import one mesh and give the new object its name."""
    before = set(modeler.object_names)
    modeler.import_3d_cad(str(path), merge_planar_faces=False, input_file_unit=UNIT)
    new = [found for found in modeler.object_names if found not in before]
    if len(new) != 1:
        raise RuntimeError("%s gave %d objects instead of one" % (path, len(new)))
    modeler[new[0]].name = name


def define(materials):
    """Create the materials of the project."""
    for name, permittivity, conductivity, density in MATERIALS:
        material = materials.add_material(name)
        material.permittivity = permittivity
        material.conductivity = conductivity
        if density:
            material.mass_density = density


def build(app):
    """Import every object into a design."""
    app.modeler.model_units = UNIT
    define(app.materials)
    for name, file, material in OBJECTS:
        load(app.modeler, name, HERE / file)
        if material:
            app.modeler[name].material_name = material
            app.modeler[name].solve_inside = True


if __name__ == "__main__":
    build(Hfss(design="vhp_model"))
'''


def write(scene: Scene) -> str:
    """Return the script as text."""
    lines = [
        f'"""Imports {scene.comment} into ANSYS HFSS, through PyAEDT.',
        "",
        *WARNING,
        "Run it with the interpreter that PyAEDT is installed in; keep it beside the folder of the meshes.",
        "Objects that lie wholly within others are left so: HFSS gives the volume to the inner one.",
        '"""',
        "",
        "from pathlib import Path",
        "",
        "from ansys.aedt.core import Hfss",
        "",
        *python_lists(scene),
    ]
    return "\n".join(lines) + "\n" + _BODY
