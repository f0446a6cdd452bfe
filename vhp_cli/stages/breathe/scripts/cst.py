"""The sweep as a macro (VBA) for CST Studio Suite."""

from __future__ import annotations

from vhp_cli.stages.breathe.operations import Triple
from vhp_cli.stages.breathe.scripts.plan import WARNING, Model, Plan, Step, plan, title

_COMPONENT = "breathe"
_TRANSFORM = {"scale": ("ScaleFactor", "Scale"), "rotate": ("Angle", "Rotate"), "move": ("Vector", "Translate")}

_HEAD = """
' Text of the history block that is being written.
Private Block As String

Private Sub Say (text As String)
    Block = Block & text & vbNewLine
End Sub

Private Sub Record (caption As String)
    AddToHistory caption, Block
    Block = ""
End Sub
"""


def write(model: Model) -> str:
    """Return the macro as text.

    Every operation becomes a block of the history list, so that the model is rebuilt when the sweep variable
    changes. Shells, which are not affine, are imported again from the frame nearest to the sweep variable.
    """
    said = plan(model)
    variable, steps = model.sequence.variable, model.sequence.steps
    lines = [
        f"' Breathing sweep of {title(model)} for CST Studio Suite (macro).",
        *(f"' {line}" for line in WARNING),
        "' Save the project in the folder of this macro first: the meshes are found from there.",
        f"' The sweep variable {variable} runs from 0 (rest) to {steps} (full inhalation).",
        "' Tissues that bend (skin, fat, average body) are no affine function of it: their history block imports the",
        "' mesh of the frame nearest to the sweep variable. Between the frames they do not fit: sweep whole steps.",
        "Option Explicit",
        _HEAD,
        "Sub Main ()",
        "    Parameters",
        *(f"    Tissue_{number}" for number in range(1, len(said.objects) + 1)),
        *(f"    Shell_{number}" for number in range(1, len(said.shells) + 1)),
        "    Sweep",
        "End Sub",
        "",
        "Private Sub Parameters ()",
        f'    MakeSureParameterExists "{variable}", "0"',
        *(f'    StoreParameter "{item.name}", "{item.text}"' for item in said.variables),
        *_block("breathe: units", ["With Units", '     .Geometry "mm"', "End With"]),
        "End Sub",
    ]
    for number, (name, file) in enumerate(said.objects, start=1):
        lines += ["", f"Private Sub Tissue_{number} ()", *_block(f"breathe: import {name}", _import(said, name, file))]
        for step in said.steps:
            if step.target == name:
                lines += _block(f"breathe: {step.kind} {name}", _transform(step))
        lines += [*_block("breathe: global", ['WCS.ActivateWCS "global"']), "End Sub"]
    for number, (name, file) in enumerate(said.shells, start=1):
        body = _block(f"breathe: import {name}", _import_frame(said, name, file))
        lines += ["", f"Private Sub Shell_{number} ()", *body, "End Sub"]
    lines += ["", *_sweep(variable, steps)]
    return "\r\n".join("\n".join(lines).split("\n")) + "\r\n"


def _block(caption: str, text: list[str]) -> list[str]:
    """Return the lines that record a history block."""
    said = ['    Say "' + line.replace('"', '""') + '"' for line in text]
    return [*said, f'    Record "{caption}"']


def _import(said: Plan, name: str, file: str) -> list[str]:
    return _stl(f'GetProjectPath("Root") & "{_path(said.model.frames[0][1], file)}"', name)


def _import_frame(said: Plan, name: str, file: str) -> list[str]:
    lines = ["Dim breathe_file As String", f"Select Case CInt({said.model.sequence.variable})"]
    for value, directory in said.model.frames:
        lines += [f"Case {round(value)}", f'     breathe_file = GetProjectPath("Root") & "{_path(directory, file)}"']
    return [*lines, "End Select", *_stl("breathe_file", name)]


def _stl(path: str, name: str) -> list[str]:
    return [
        "With STL",
        "     .Reset",
        f"     .FileName {path}",
        f'     .Name "{name}"',
        f'     .Component "{_COMPONENT}"',
        '     .ScaleToUnit "True"',
        '     .ImportFileUnits "mm"',
        "     .Read",
        "End With",
    ]


def _path(directory: str, file: str) -> str:
    return "\\" + f"{directory}/{file}".replace("/", "\\")


def _transform(step: Step) -> list[str]:
    key, how = _TRANSFORM[step.kind]
    return [
        "With WCS",
        f"     .SetNormal {_quoted(step.frame.z_axis)}",
        f"     .SetOrigin {_quoted(step.frame.origin)}",
        f"     .SetUVector {_quoted(step.frame.x_axis)}",
        '     .ActivateWCS "local"',
        "End With",
        "With Transform",
        "     .Reset",
        f'     .Name "{_COMPONENT}:{step.target}"',
        '     .Origin "Free"',
        '     .Center "0", "0", "0"',
        f'     .{key} "{step.values[0]}", "{step.values[1]}", "{step.values[2]}"',
        '     .MultipleObjects "False"',
        '     .GroupObjects "False"',
        '     .Repetitions "1"',
        '     .MultipleSelection "False"',
        f'     .Transform "Shape", "{how}"',
        "End With",
    ]


def _quoted(vector: Triple) -> str:
    return ", ".join(f'"{value!r}"' for value in vector)


def _sweep(variable: str, steps: int) -> list[str]:
    return [
        "' Runs the transient solver at every whole step once ParameterSweep.Start is called.",
        "Private Sub Sweep ()",
        "    With ParameterSweep",
        '        .SetSimulationType "Transient"',
        '        .AddSequence "Breath"',
        f'        .AddParameter_Samples "Breath", "{variable}", "0", "{steps}", "{steps + 1}", "False"',
        "    End With",
        "End Sub",
    ]
