"""The sweep as functions for MATLAB and Octave."""

from __future__ import annotations

from vhp_cli.stages.breathe.blend import Blend
from vhp_cli.stages.breathe.curves import added
from vhp_cli.stages.breathe.operations import AXES, Operation, Rotate, Scale
from vhp_cli.stages.breathe.profile import Profile
from vhp_cli.stages.breathe.scripts.plan import WARNING, Model, title
from vhp_cli.stages.breathe.sequence import Displacement

NAME = "breathe_apply"

_FRAMES = """
function breathe_frame(t, target)
% Write every tissue at the value t of the sweep variable into the folder target (MATLAB R2018b or newer).
here = fileparts(mfilename('fullpath'));
tissues = breathe_tissues();
if ~exist(target, 'dir'), mkdir(target); end
for k = 1:size(tissues, 1)
  rest = stlread(fullfile(here, rest_directory(), tissues{k, 2}));
  moved = breathe_apply(tissues{k, 1}, rest.Points, t);
  stlwrite(triangulation(rest.ConnectivityList, moved), fullfile(target, tissues{k, 2}));
end
end
"""


def write(model: Model) -> dict[str, str]:
    """Return the files by name: ``breathe_apply.m`` moves points, ``breathe_frame.m`` writes the meshes of a frame.

    Shells are moved exactly, by the formula of their field.
    """
    return {f"{NAME}.m": _apply(model), "breathe_frame.m": _frame(model)}


def _apply(model: Model) -> str:
    variable, steps = model.sequence.variable, model.sequence.steps
    lines = [
        f"function P = {NAME}(name, P, t)",
        f"% Breathing sequence {title(model)}: where points of a tissue are.",
        *(f"% {line}" for line in WARNING),
        "%   name  name of the tissue",
        "%   P     n x 3 points of the tissue at rest, in mm",
        f"%   t     value of the sweep variable ({variable}), 0 (rest) to {steps} (full inhalation)",
        "switch name",
    ]
    for part in model.parts:
        if part.motion is None or not (part.motion.operations or part.motion.fields):
            continue
        lines.append(f"  case {_text(part.name)}")
        for operation in part.motion.operations:
            lines += _operation(operation)
        if part.motion.fields:
            lines += ["    R = P;", *(line for field in part.motion.fields for line in _field(field))]
    known = ", ".join(_text(part.name) for part in model.parts) or "''"
    lines += [
        "  otherwise",
        f"    if ~any(strcmp(name, {{{known}}})), error('there is no tissue %s', name); end",
        "end",
        "end",
        "",
        "function w = rise(depth, width)",
        "if width == 0, w = double(depth > 0); return, end",
        "s = min(max(depth/width, 0), 1);",
        "w = s.*s.*(3 - 2*s);",
        "end",
        "",
        "function d = outside(P, balls)",
        "d = inf(size(P, 1), 1);",
        "for k = 1:size(balls, 1)",
        "  d = min(d, sqrt(sum(bsxfun(@minus, P, balls(k, 1:3)).^2, 2)) - balls(k, 4));",
        "end",
        "d = max(d, 0).^2;",
        "end",
        "",
        "function W = shares(D)",
        "W = ones(size(D));",
        "for k = 1:size(D, 2), W(:, k) = prod(D(:, [1:k-1, k+1:end]), 2); end",
        "W = bsxfun(@rdivide, W, sum(W, 2));",
        "end",
    ]
    return "\n".join(lines) + "\n"


def _operation(operation: Operation) -> list[str]:
    rows = "; ".join(" ".join(map(repr, row)) for row in operation.frame.basis.tolist())
    origin = " ".join(map(repr, operation.frame.origin))
    values = {name: added(parameter.curve.terms("t")) for name, parameter in operation.parameters().items()}
    lines = [f"    B = [{rows}]; o = [{origin}];", "    Q = bsxfun(@minus, P, o)*B;"]
    if isinstance(operation, Rotate):
        k = AXES.index(operation.axis)
        i, j = (k + 1) % 3 + 1, (k + 2) % 3 + 1
        lines += [
            f"    a = ({values['angle']})*pi/180; c = cos(a); s = sin(a);",
            f"    Q(:, [{i} {j}]) = [c*Q(:, {i}) - s*Q(:, {j}), s*Q(:, {i}) + c*Q(:, {j})];",
        ]
    else:
        row = ", ".join(f"({values[axis]})" for axis in AXES)
        lines.append(f"    Q = bsxfun(@{'times' if isinstance(operation, Scale) else 'plus'}, Q, [{row}]);")
    return [*lines, "    P = bsxfun(@plus, Q*B', o);"]


def _field(field: Displacement) -> list[str]:
    if isinstance(field, Blend):
        return _blend(field)
    amplitude = added(field.amplitude.curve.terms("t"))
    if isinstance(field, Profile):
        heights = " ".join(map(repr, field.heights))
        rows = "; ".join(" ".join(map(repr, row)) for row in field.displacements)
        return [
            f"    h = [{heights}]; d = [{rows}];",
            f"    P = P + ({amplitude})*interp1(h, d, min(max(R(:, 3), h(1)), h(end)));",
        ]
    (left, right), (low, high) = field.x_window, field.z_window
    direction = " ".join(map(repr, field.direction))
    return [
        f"    s = min(max((R(:, 3) - ({low!r}))/{high - low!r}, 0), 1);",
        f"    w = sin(pi*s).*(s > 0 & s < 1).*rise({field.y_back!r} - R(:, 2), {field.y_taper!r});",
        f"    w = w.*rise(R(:, 1) - ({left!r}), {field.x_taper!r}).*rise({right!r} - R(:, 1), {field.x_taper!r});",
        f"    P = P + ({amplitude})*w*[{direction}];",
    ]


def _blend(blend: Blend) -> list[str]:
    lines = ["    S = P; D = zeros(size(R, 1), 0);"]
    for holder in blend.holders:
        rows = "; ".join(" ".join(map(repr, ball)) for ball in holder.balls)
        lines.append(f"    D(:, end + 1) = outside(R, [{rows}]);")
    lines.append("    W = shares(D);")
    for number, holder in enumerate(blend.holders, start=1):
        if holder.operations:
            lines += ["    P = R;", *(line for operation in holder.operations for line in _operation(operation))]
            lines.append(f"    S = S + bsxfun(@times, W(:, {number}), P - R);")
    return [*lines, "    P = S;"]


def _frame(model: Model) -> str:
    rows = "; ".join(f"{_text(part.name)}, {_text(part.file)}" for part in model.parts)
    helpers = [
        "",
        "function tissues = breathe_tissues()",
        f"tissues = {{{rows}}};",
        "end",
        "",
        "function folder = rest_directory()",
        f"folder = {_text(model.frames[0][1])};",
        "end",
    ]
    return _FRAMES.lstrip() + "\n".join(helpers) + "\n"


def _text(value: str) -> str:
    return "'" + value.replace("'", "''") + "'"
