"""The sweep as a native script (IronPython) of ANSYS Electronics Desktop."""

from __future__ import annotations

from vhp_cli.stages.breathe.scripts.aedt_pyaedt import listed, operations
from vhp_cli.stages.breathe.scripts.plan import WARNING, Model, plan, title

_BODY = '''
ScriptEnv.Initialize("Ansoft.ElectronicsDesktop")
oDesktop.RestoreWindow()


def selection(name):
    return ["NAME:Selections", "Selections:=", name, "NewPartsModelFlag:=", "Model"]


def load(editor, name, path):
    """Import one mesh in mm and give the new object its name."""
    before = set(editor.GetObjectsInGroup("Solids")) | set(editor.GetObjectsInGroup("Sheets"))
    editor.Import([
        "NAME:NativeBodyParameters", "HealOption:=", 0, "Options:=", "-1", "FileType:=", "UnRecognized",
        "MaxStitchTol:=", -1, "ImportFreeSurfaces:=", False, "GroupByAssembly:=", False, "CreateGroup:=", True,
        "MergeFacesAngle:=", -1, "HealSTL:=", False, "ReduceSTL:=", False, "ReduceMaxError:=", 0,
        "ReducePercentage:=", 0, "PointCoincidenceTol:=", 1e-06, "CreateLightweightPart:=", False,
        "ImportMaterialNames:=", False, "SeparateDisjointLumps:=", False, "SourceFile:=", path, "STLFileUnit:=", "mm",
    ])
    after = list(editor.GetObjectsInGroup("Solids")) + list(editor.GetObjectsInGroup("Sheets"))
    new = [found for found in after if found not in before]
    if len(new) != 1:
        raise RuntimeError("%s gave %d objects instead of one" % (path, len(new)))
    editor.ChangeProperty(["NAME:AllTabs", ["NAME:Geometry3DAttributeTab", ["NAME:PropServers", new[0]],
        ["NAME:ChangedProps", ["NAME:Name", "Value:=", name]]]])


def declare(design, name, text):
    """Create one variable of the design."""
    design.ChangeProperty(["NAME:AllTabs", ["NAME:LocalVariableTab", ["NAME:PropServers", "LocalVariables"],
        ["NAME:NewProps", ["NAME:" + name, "PropType:=", "VariableProp", "UserDef:=", True, "Value:=", text]]]])


def transform(editor):
    """Apply the operations, each in its own coordinate system."""
    def work_in(system):
        editor.SetWCS(["NAME:SetWCS Parameter", "Working Coordinate System:=", system, "RegionDepCSOk:=", False])
    for kind, target, system, origin, x_axis, y_axis, axis, values in OPERATIONS:
        work_in("Global")
        editor.CreateRelativeCS(
            ["NAME:RelativeCSParameters", "Mode:=", "Axis/Position",
             "OriginX:=", origin[0], "OriginY:=", origin[1], "OriginZ:=", origin[2],
             "XAxisXvec:=", x_axis[0], "XAxisYvec:=", x_axis[1], "XAxisZvec:=", x_axis[2],
             "YAxisXvec:=", y_axis[0], "YAxisYvec:=", y_axis[1], "YAxisZvec:=", y_axis[2]],
            ["NAME:Attributes", "Name:=", system])
        work_in(system)
        if kind == "scale":
            editor.Scale(selection(target), ["NAME:ScaleParameters", "ScaleX:=", values[0], "ScaleY:=", values[1],
                "ScaleZ:=", values[2]])
        elif kind == "rotate":
            editor.Rotate(selection(target), ["NAME:RotateParameters", "RotateAxis:=", axis,
                "RotateAngle:=", "(%s)*1deg" % values["XYZ".index(axis)]])
        else:
            editor.Move(selection(target), ["NAME:TranslateParameters"] + [
                item for name, value in zip("XYZ", values)
                for item in ("TranslateVector%s:=" % name, "(%s)*1mm" % value)])
    work_in("Global")


def build(project, name, value, shell_directory):
    """Build one design: the tissues at rest, moved by the sweep variable, and the shells of one frame."""
    project.InsertDesign("HFSS", name, "DrivenModal", "")
    design = project.SetActiveDesign(name)
    editor = design.SetActiveEditor("3D Modeler")
    editor.SetModelUnits(["NAME:Units Parameter", "Units:=", "mm", "Rescale:=", False])
    declare(design, VARIABLE, repr(value))
    for variable, text in VARIABLES:
        declare(design, variable, text)
    for target, file in OBJECTS:
        load(editor, target, os.path.join(FOLDER, FRAMES[0][1], file))
    transform(editor)
    for target, file in SHELLS if shell_directory else []:
        load(editor, target, os.path.join(FOLDER, shell_directory, file))
    return design


project = oDesktop.GetActiveProject() or oDesktop.NewProject()
if SHELLS and WITH_SHELLS:
    for number, (value, directory) in enumerate(FRAMES):
        build(project, "%s_%02d" % (VARIABLE, number), value, directory)
else:
    build(project, VARIABLE, FRAMES[0][0], None)
# Once the design has a setup named Setup1, this adds the sweep:
# project.GetActiveDesign().GetModule("Optimetrics").InsertSetup("OptiParametric", ["NAME:" + VARIABLE + "_sweep",
#     "IsEnabled:=", True, ["NAME:ProdOptiSetupDataV2", "SaveFields:=", False, "CopyMesh:=", False,
#     "SolveWithCopiedMeshOnly:=", False], ["NAME:StartingPoint"], "Sim. Setups:=", ["Setup1"], ["NAME:Sweeps",
#     ["NAME:SweepDefinition", "Variable:=", VARIABLE, "Data:=", "LIN 0 %d 1" % STEPS, "OffsetF1:=", False,
#     "Synchronize:=", 0]], ["NAME:Sweep Operations"], ["NAME:Goals"]])
'''


def write(model: Model) -> str:
    """Return the script as text; shells as in the PyAEDT script."""
    said = plan(model)
    variable, steps = model.sequence.variable, model.sequence.steps
    lines = [
        "# -*- coding: utf-8 -*-",
        f"# Breathing sweep of {title(model)} for ANSYS Electronics Desktop: Tools > Run Script.",
        *(f"# {line}" for line in WARNING),
        f"# The sweep variable {variable} runs from 0 (rest) to {steps} (full inhalation).",
        "# Tissues that bend (skin, fat, average body) are no affine function of it: with WITH_SHELLS there is one",
        "# design per frame with them, without it one parametric design that leaves them out.",
        "import os",
        "import ScriptEnv",
        "",
        "# The folder of this script; write it here if the program does not know it.",
        "try:",
        "    FOLDER = os.path.dirname(os.path.abspath(__file__))",
        "except NameError:",
        "    FOLDER = os.getcwd()",
        f"VARIABLE = {variable!r}",
        f"STEPS = {steps}",
        "WITH_SHELLS = True",
        "",
        *listed("FRAMES", model.frames),
        *listed("OBJECTS", said.objects),
        *listed("SHELLS", said.shells),
        *listed("VARIABLES", [(item.name, item.text) for item in said.variables]),
        *listed("OPERATIONS", operations(said)),
    ]
    return "\n".join(lines) + "\n" + _BODY
