"""The import as a macro (VBA) for CST Studio Suite."""

from __future__ import annotations

from vhp_cli.stages.export.scripts.scene import WARNING, Material, Scene

_COMPONENT = "vhp"

_HEAD = """
' Whether what lies within an object is cut out of it (Boolean, Insert). Without that, mesh priorities decide who gets
' the common volume. Slow for many faces.
Const InsertNested = False

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


def write(scene: Scene) -> str:
    """Return the macro as text. Every step becomes a block of the history list."""
    materials, of_part = scene.materials()
    parts = scene.outermost_first()
    # Outer ones first: what is cut out of an object is still whole.
    nested = [part for part in parts if part.parent]
    # A procedure of VBA may not be longer than 64 kB: each object has its own.
    lines = [
        f"' Imports {scene.comment} into CST Studio Suite (macro).",
        *(f"' {line}" for line in WARNING),
        "' Save the project in the folder of this macro first: the meshes are found from there.",
        f"' Properties of the materials{scene.at}; objects without one keep the default material of the project.",
        "Option Explicit",
        _HEAD,
        "Sub Main ()",
        "    Units",
        *(f"    Material_{number}" for number in range(1, len(materials) + 1)),
        *(f"    Object_{number}" for number in range(1, len(parts) + 1)),
        *(["    If InsertNested Then Nested"] if nested else []),
        "End Sub",
        "",
        "Private Sub Units ()",
        *_block("vhp: units", ["With Units", f'     .Geometry "{scene.unit}"', "End With"]),
        "End Sub",
    ]
    for number, material in enumerate(materials, start=1):
        body = _block(f"vhp: material {material.name}", _material(material))
        lines += ["", f"Private Sub Material_{number} ()", *body, "End Sub"]
    for number, part in enumerate(parts, start=1):
        steps = _stl(part.name, part.file, scene.unit)
        if part.name in of_part:
            steps.append(f'Solid.ChangeMaterial "{_COMPONENT}:{part.name}", "{of_part[part.name]}"')
        lines += ["", f"Private Sub Object_{number} ()", *_block(f"vhp: import {part.name}", steps), "End Sub"]
    if nested:
        lines += ["", "Private Sub Nested ()"]
        for part in nested:
            step = f'Solid.Insert "{_COMPONENT}:{part.parent}", "{_COMPONENT}:{part.name}"'
            lines += _block(f"vhp: insert {part.name}", [step])
        lines.append("End Sub")
    return "\r\n".join("\n".join(lines).split("\n")) + "\r\n"


def _block(caption: str, text: list[str]) -> list[str]:
    """Return the lines that record a history block."""
    said = ['    Say "' + line.replace('"', '""') + '"' for line in text]
    return [*said, f'    Record "{caption}"']


def _material(material: Material) -> list[str]:
    return [
        "With Material",
        "     .Reset",
        f'     .Name "{material.name}"',
        '     .FrqType "all"',
        '     .Type "Normal"',
        f'     .Epsilon "{material.permittivity!r}"',
        f'     .Kappa "{material.conductivity!r}"',
        *([] if material.density is None else [f'     .Rho "{material.density!r}"']),
        "     .Create",
        "End With",
    ]


def _stl(name: str, file: str, unit: str) -> list[str]:
    path = "\\" + file.replace("/", "\\")
    return [
        "With STL",
        "     .Reset",
        f'     .FileName GetProjectPath("Root") & "{path}"',
        f'     .Name "{name}"',
        f'     .Component "{_COMPONENT}"',
        '     .ScaleToUnit "True"',
        f'     .ImportFileUnits "{unit}"',
        "     .Read",
        "End With",
    ]
