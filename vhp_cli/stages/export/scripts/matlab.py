"""A loader for MATLAB and Octave."""

from __future__ import annotations

import math

from vhp_cli.stages.export.scripts.scene import WARNING, Scene

_BODY = """
here = fileparts(mfilename('fullpath'));
rows = model_rows();
model = struct('name', rows(:, 1), 'tissue', rows(:, 2), 'material', rows(:, 3), 'permittivity', rows(:, 4), ...
  'conductivity', rows(:, 5), 'density', rows(:, 6), 'P', [], 't', [], 'normals', [], 'unit', '');
for k = 1:numel(model)
  loaded = load(fullfile(here, rows{k, 7}));
  model(k).P = loaded.P;
  model(k).t = loaded.t;
  model(k).normals = loaded.normals;
  model(k).unit = loaded.unit;
end
end
"""


def write(scene: Scene) -> str:
    """Return the function as text; it loads one MAT-file for each tissue."""
    lines = [
        "function model = load_model()",
        f"% Loads {scene.comment}: an array of structures, one for each tissue.",
        *(f"% {line}" for line in WARNING),
        "%   name, tissue   of the object, and of the tissue in the model",
        "%   P              n x 3 vertices, in the unit of the field unit",
        "%   t              m x 3 triangles, 1-based, counter-clockwise from outside",
        "%   normals        m x 3 outward unit normals",
        f"%   material, permittivity (relative), conductivity (S/m){scene.at}, density (kg/m3); NaN: not known",
        "% Show one with: trisurf(model(1).t, model(1).P(:, 1), model(1).P(:, 2), model(1).P(:, 3)); axis equal",
    ]
    rows = []
    for part in scene.parts:
        found = part.properties
        numbers = ", ".join(_number(value) for value in (found.permittivity, found.conductivity, found.density))
        rows.append(
            f"  {_text(part.name)}, {_text(found.tissue)}, {_text(found.material)}, {numbers}, {_text(part.file)}"
        )
    table = ["", "function rows = model_rows()", "rows = {", *rows, "};", "end"]
    return "\n".join(lines) + _BODY + "\n".join(table) + "\n"


def _text(value: str) -> str:
    printable = "".join(letter if letter.isprintable() else "_" for letter in value)
    return "'" + printable.replace("'", "''") + "'"


def _number(value: float | None) -> str:
    return "NaN" if value is None or math.isnan(value) else repr(value)
