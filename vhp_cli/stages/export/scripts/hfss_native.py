"""The import as a native script (IronPython) of ANSYS Electronics Desktop."""

from __future__ import annotations

from vhp_cli.stages.export.scripts.scene import WARNING, Scene, python_lists

_BODY = '''
ScriptEnv.Initialize("Ansoft.ElectronicsDesktop")
oDesktop.RestoreWindow()


def objects(editor):
    return list(editor.GetObjectsInGroup("Solids")) + list(editor.GetObjectsInGroup("Sheets"))


def change(editor, name, changes):
    """Change attributes of an object."""
    editor.ChangeProperty(["NAME:AllTabs", ["NAME:Geometry3DAttributeTab", ["NAME:PropServers", name],
        ["NAME:ChangedProps"] + changes]])


def load(editor, name, path):
    """Import one mesh and give the new object its name."""
    before = set(objects(editor))
    editor.Import([
        "NAME:NativeBodyParameters", "HealOption:=", 0, "Options:=", "-1", "FileType:=", "UnRecognized",
        "MaxStitchTol:=", -1, "ImportFreeSurfaces:=", False, "GroupByAssembly:=", False, "CreateGroup:=", True,
        "MergeFacesAngle:=", -1, "HealSTL:=", False, "ReduceSTL:=", False, "ReduceMaxError:=", 0,
        "ReducePercentage:=", 0, "PointCoincidenceTol:=", 1e-06, "CreateLightweightPart:=", False,
        "ImportMaterialNames:=", False, "SeparateDisjointLumps:=", False, "SourceFile:=", path, "STLFileUnit:=", UNIT,
    ])
    new = [found for found in objects(editor) if found not in before]
    if len(new) != 1:
        raise RuntimeError("%s gave %d objects instead of one" % (path, len(new)))
    change(editor, new[0], [["NAME:Name", "Value:=", name]])


def define(project):
    """Create the materials of the project."""
    manager = project.GetDefinitionManager()
    known = [name.lower() for name in manager.GetProjectMaterialNames()]
    for name, permittivity, conductivity, density in MATERIALS:
        properties = [
            "NAME:" + name, "CoordinateSystemType:=", "Cartesian", "BulkOrSurfaceType:=", 1,
            ["NAME:PhysicsTypes", "set:=", ["Electromagnetic", "Thermal", "Structural"]],
            "permittivity:=", repr(permittivity), "conductivity:=", repr(conductivity),
        ]
        if density:
            properties += ["mass_density:=", repr(density)]
        if name.lower() in known:
            manager.EditMaterial(name, properties)
        else:
            manager.AddMaterial(properties)


def build(project):
    """Import every object into a new design."""
    project.InsertDesign("HFSS", DESIGN, "DrivenModal", "")
    editor = project.SetActiveDesign(DESIGN).SetActiveEditor("3D Modeler")
    editor.SetModelUnits(["NAME:Units Parameter", "Units:=", UNIT, "Rescale:=", False])
    define(project)
    for name, file, material in OBJECTS:
        load(editor, name, os.path.join(FOLDER, *file.split("/")))
        if material:
            change(editor, name, [["NAME:Material", "Value:=", '"%s"' % material]])
            change(editor, name, [["NAME:Solve Inside", "Value:=", True]])


build(oDesktop.GetActiveProject() or oDesktop.NewProject())
'''


def write(scene: Scene) -> str:
    """Return the script as text."""
    lines = [
        "# -*- coding: utf-8 -*-",
        f"# Imports {scene.comment} into ANSYS Electronics Desktop: Tools > Run Script.",
        *(f"# {line}" for line in WARNING),
        "# Objects that lie wholly within others are left so: HFSS gives the volume to the inner one.",
        "import os",
        "import ScriptEnv",
        "",
        "# The folder of this script; write it here if the program does not know it.",
        "try:",
        "    FOLDER = os.path.dirname(os.path.abspath(__file__))",
        "except NameError:",
        "    FOLDER = os.getcwd()",
        'DESIGN = "vhp_model"',
        *python_lists(scene),
    ]
    return "\n".join(lines) + "\n" + _BODY
