"""The scripts, read back and applied: they give the vertices that the motions give."""

from __future__ import annotations

import ast
import re
import shutil
import subprocess
import sys
import types
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import pytest
from breathing_motions import every_form
from scipy.spatial.transform import Rotation

from vhp_cli.stages.breathe.published import published_sequence
from vhp_cli.stages.breathe.scripts import TARGETS, Model, Part, write
from vhp_cli.stages.breathe.scripts.plan import object_names
from vhp_cli.stages.breathe.sequence import Sequence

TOLERANCE_MM = 1e-6
TIMES = (0.0, 0.5, 3.0, 6.75, 7.0)
POINTS = np.random.default_rng(5).uniform(-350.0, 350.0, (40, 3))


def model(sequence: Sequence) -> Model:
    parts = [Part(motion.name, f"{motion.name}.stl", motion) for motion in sequence.motions]
    frames = tuple((float(t), f"../frames/t{t:05.2f}") for t in range(sequence.steps + 1))
    return Model(sequence, (*parts, Part("Spine's end", "Spine's end.stl")), frames)


MODELS = {
    "every form": model(every_form()),
    "published": model(published_sequence()),
    "as printed": model(published_sequence(as_printed=True)),
}


@pytest.fixture(params=MODELS)
def example(request: pytest.FixtureRequest) -> Model:
    return MODELS[request.param]


# ---------------------------------------------------------------- an evaluator of its own


def number(text: str, variables: dict[str, float]) -> float:
    """Evaluate an expression of the scripts, in which only + - * ^ abs() and units occur."""
    assert re.fullmatch(r"[\w.+\-*^() ]+", text), text
    value = eval(text.replace("^", "**"), {"abs": abs, "mm": 1.0, "deg": 1.0, "__builtins__": {}}, variables)
    return float(value)


def with_unit(text: str, unit: str, variables: dict[str, float]) -> float:
    """Evaluate "(...)*1mm" or "12.5mm"."""
    assert text.endswith(unit), text
    text = text.removesuffix(unit)
    return number(text.removesuffix("*1") if text.endswith("*1") else text, variables)


def transformed(points: np.ndarray, kind: str, system: tuple[Any, Any, Any], values: list[float]) -> np.ndarray:
    """Apply one operation in a coordinate system given by origin, x and y axis."""
    origin, x, y = (np.asarray(vector, dtype=float) for vector in system)
    basis = np.stack([x / np.linalg.norm(x), y / np.linalg.norm(y), np.cross(x, y)], axis=1)
    local = (points - origin) @ basis
    if kind == "scale":
        local = local * values
    elif kind == "move":
        local = local + np.asarray(values)
    else:
        assert sum(value != 0.0 for value in values) <= 1
        local = Rotation.from_rotvec(np.array(values), degrees=True).apply(local)
    return local @ basis.T + origin


def compare(example: Model, t: float, moved: dict[str, np.ndarray]) -> None:
    """The objects in `moved` are those that are not shells, and where they should be."""
    names = object_names(part.name for part in example.parts)
    affine = {
        name: part for name, part in zip(names, example.parts, strict=True) if not (part.motion and part.motion.fields)
    }
    assert set(moved) == set(affine)
    for name, part in affine.items():
        wanted = POINTS if part.motion is None else part.motion.apply(POINTS, t)
        assert np.abs(moved[name] - wanted).max() < TOLERANCE_MM, (name, t)


# ---------------------------------------------------------------- ANSYS Electronics Desktop


class Editor:
    """Records the native calls of the modeler, and carries them out on points."""

    def __init__(self) -> None:
        self.objects: dict[str, str] = {}
        self.calls: list[tuple[str, tuple[Any, ...]]] = []

    def __getattr__(self, name: str) -> Any:
        def call(*arguments: Any) -> None:
            self.calls.append((name, arguments))
            if name == "Import":
                path = PurePosixPath(fields(arguments[0])["SourceFile"])
                assert fields(arguments[0])["STLFileUnit"] == "mm"
                assert fields(arguments[0])["MergeFacesAngle"] == -1
                self.objects[f"Body{len(self.objects)}"] = str(path)
            if name == "ChangeProperty":
                tab = arguments[0][1]
                if tab[0] != "NAME:Geometry3DCSTab":
                    assert tab[0] == "NAME:Geometry3DAttributeTab"
                    self.rename(tab[1][1], fields(tab[2][1])["Value"])

        return call

    def rename(self, old: str, new: str) -> None:
        self.objects[new] = self.objects.pop(old)

    def GetObjectsInGroup(self, group: str) -> list[str]:
        return list(self.objects) if group == "Solids" else []

    def moved(self, variables: dict[str, float]) -> dict[str, np.ndarray]:
        """Carry out what was recorded, on the same points for every object."""
        points = dict.fromkeys(self.objects, POINTS)
        systems = {"Global": (np.zeros(3), np.array([1.0, 0, 0]), np.array([0, 1.0, 0]))}
        current = "Global"
        for name, arguments in self.calls:
            if name == "ChangeProperty" and arguments[0][1][0] == "NAME:Geometry3DCSTab":
                # PyAEDT says again of a new coordinate system what it is: this is what counts.
                _, servers, [_, *changes] = arguments[0][1]
                assert servers[0] == "NAME:PropServers"
                said = {change[0].removeprefix("NAME:"): fields(change) for change in changes}
                if "Reference CS" in said or "Mode" in said:
                    assert said in ({"Reference CS": {"Value": "Global"}}, {"Mode": {"Value": "Axis/Position"}})
                else:
                    systems[servers[1]] = tuple(
                        np.array([with_unit(said[key][axis], "mm", {}) for axis in "XYZ"])
                        for key in ("Origin", "X Axis", "Y Point")
                    )
            if name not in ("CreateRelativeCS", "SetWCS", "Scale", "Rotate", "Move"):
                continue
            said = fields(arguments[0])
            if name == "CreateRelativeCS":
                vectors = (("OriginX", "OriginY", "OriginZ"), *(tuple(f"{a}Axis{b}vec" for b in "XYZ") for a in "XY"))
                assert said["Mode"] == "Axis/Position"
                systems[fields(arguments[1])["Name"]] = tuple(
                    np.array([with_unit(said[key], "mm", {}) for key in keys]) for keys in vectors
                )
            elif name == "SetWCS":
                current = said["Working Coordinate System"]
            else:
                target, values = said["Selections"], fields(arguments[1])
                if name == "Scale":
                    found = [number(values[f"Scale{axis}"], variables) for axis in "XYZ"]
                elif name == "Move":
                    found = [with_unit(values[f"TranslateVector{axis}"], "mm", variables) for axis in "XYZ"]
                else:
                    angle = with_unit(values["RotateAngle"], "deg", variables)
                    found = [angle if axis == values["RotateAxis"] else 0.0 for axis in "XYZ"]
                points[target] = transformed(points[target], name.lower(), systems[current], found)
        assert current == "Global"
        return points


def fields(arguments: list[Any]) -> dict[str, Any]:
    """Read the "Name:=", value pairs of a native call."""
    pairs = arguments[1:]
    assert len(pairs) % 2 == 0
    return {key.removesuffix(":="): value for key, value in zip(pairs[::2], pairs[1::2], strict=True)}


def evaluated(texts: list[tuple[str, str]]) -> dict[str, float]:
    """Evaluate variables in their order, each from those before it."""
    values: dict[str, float] = {}
    for name, text in texts:
        assert re.fullmatch(r"[A-Za-z]\w*", name)
        values[name] = number(text, values)
    return values


def check_design(example: Model, editor: Editor, variables: list[tuple[str, str]], directory: str | None) -> None:
    """One design has all affine tissues at rest in place, and the shells of its frame."""
    sweep = example.sequence.variable
    assert variables[0][0] == sweep
    shells = {part.file for part in example.parts if part.motion and part.motion.fields}
    for path in editor.objects.values():
        folder = directory if PurePosixPath(path).name in shells else example.frames[0][1]
        assert folder and f"/{folder}/" in path
    names = object_names(part.name for part in example.parts)
    affine = {name for name, part in zip(names, example.parts, strict=True) if not (part.motion and part.motion.fields)}
    assert set(editor.objects) == (set(names) if directory else affine)
    if directory:
        times = [number(variables[0][1], {})]
        assert dict(example.frames)[times[0]] == directory
    else:
        times = list(TIMES)
    for t in times:
        moved = editor.moved(evaluated([(sweep, repr(t)), *variables[1:]]))
        compare(example, t, {name: points for name, points in moved.items() if name in affine})


@pytest.fixture
def pyaedt_hfss(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[Any]]:
    """Put a recorder in the place of Hfss: the modeler is PyAEDT's own, with an editor that only records."""
    pytest.importorskip("ansys.aedt.core", reason="pyaedt is not installed")
    import ansys.aedt.core
    from ansys.aedt.core.modeler.cad.modeler import CoordinateSystem
    from ansys.aedt.core.modeler.cad.primitives import GeometryModeler

    designs: list[Any] = []

    class Modeler:
        """PyAEDT's code for what the script calls, on the recorder."""

        model_units = "mm"
        _app = types.SimpleNamespace(
            value_with_units=lambda value, units=None, units_system="Length": (
                value if isinstance(value, str) else f"{value}{units or 'mm'}"
            )
        )
        logger = types.SimpleNamespace(info=lambda *_: None, error=lambda *_: None)
        _pos_with_arg = GeometryModeler._pos_with_arg

        def __init__(self) -> None:
            self.oeditor = Editor()
            self._coordinate_systems: list[Any] = []

        @property
        def object_names(self) -> list[str]:
            return list(self.oeditor.objects)

        def __getitem__(self, name: str) -> Any:
            return Named(self.oeditor, name)

        def refresh_all_ids(self) -> None: ...

        def convert_to_selections(self, assignment: Any, return_list: bool = False) -> Any:
            names = [assignment] if isinstance(assignment, str) else assignment
            return names if return_list else ",".join(names)

        def create_coordinate_system(self, origin: Any, name: str, mode: str, x_pointing: Any, y_pointing: Any) -> None:
            system = CoordinateSystem.__new__(CoordinateSystem)
            system._modeler, system.name, system.model_units = self, name, "mm"
            CoordinateSystem.create(
                system, origin=origin, name=name, mode=mode, x_pointing=x_pointing, y_pointing=y_pointing
            )

        import_3d_cad = GeometryModeler.import_3d_cad
        set_working_coordinate_system = GeometryModeler.set_working_coordinate_system
        scale, rotate, move = GeometryModeler.scale, GeometryModeler.rotate, GeometryModeler.move

    class Named:
        def __init__(self, editor: Editor, name: str) -> None:
            object.__setattr__(self, "said", (editor, name))

        def __setattr__(self, key: str, value: str) -> None:
            assert key == "name"
            editor, name = self.said
            editor.rename(name, value)

    class Hfss:
        def __init__(self, design: str) -> None:
            self.design, self.modeler, self.said = design, Modeler(), []
            self.setups: list[Any] = ["Setup1"]
            self.swept: list[Any] = []
            self.parametrics = types.SimpleNamespace(add=lambda *a, **k: self.swept.append((a, k)))
            designs.append(self)

        def __setitem__(self, name: str, text: str) -> None:
            self.said.append((name, text))

    monkeypatch.setattr(ansys.aedt.core, "Hfss", Hfss, raising=False)
    yield designs


def run_python(text: str, path: Path, name: str, **given: Any) -> dict[str, Any]:
    path.write_text(text, encoding="utf-8")
    space = {"__name__": name, "__file__": str(path), **given}
    exec(compile(text, str(path), "exec"), space)
    return space


def test_pyaedt_script_through_its_own_modeler(example: Model, pyaedt_hfss: list[Any], tmp_path: Path) -> None:
    space = run_python(write(example, ["aedt"])["aedt_pyaedt.py"], tmp_path / "s.py", "script")
    space["main"]()
    frames = example.frames
    assert [design.design for design in pyaedt_hfss] == [f"{space['VARIABLE']}_{n:02d}" for n in range(len(frames))]
    for design, (_, directory) in list(zip(pyaedt_hfss, frames, strict=True))[::4]:
        check_design(example, design.modeler.oeditor, design.said, directory)
    pyaedt_hfss.clear()
    space["WITH_SHELLS"] = False
    space["main"]()
    [design] = pyaedt_hfss
    check_design(example, design.modeler.oeditor, design.said, None)
    steps = example.sequence.steps
    [(arguments, options)] = design.swept
    assert arguments == (example.sequence.variable, 0, steps, steps + 1)
    assert options["variation_type"] == "LinearCount"


class Desktop:
    """The native objects: desktop, project and designs in one recorder."""

    def __init__(self) -> None:
        self.designs: dict[str, Any] = {}

    def RestoreWindow(self) -> None: ...

    def GetActiveProject(self) -> None:
        return None

    def NewProject(self) -> Desktop:
        return self

    def InsertDesign(self, kind: str, name: str, solution: str, parent: str) -> None:
        assert kind == "HFSS"
        editor = Editor()
        said: list[tuple[str, str]] = []

        def change(tabs: list[Any]) -> None:
            tab = tabs[1]
            assert tab[0] == "NAME:LocalVariableTab" and tab[1] == ["NAME:PropServers", "LocalVariables"]
            new = tab[2][1]
            said.append((new[0].removeprefix("NAME:"), fields(new)["Value"]))

        self.designs[name] = types.SimpleNamespace(
            ChangeProperty=change, SetActiveEditor=lambda _: editor, editor=editor, said=said
        )

    def SetActiveDesign(self, name: str) -> Any:
        return self.designs[name]


def native(text: str, path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    environment = types.ModuleType("ScriptEnv")
    environment.Initialize = lambda _: None  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "ScriptEnv", environment)
    desktop = Desktop()
    run_python(text, path, "__main__", oDesktop=desktop)
    return desktop.designs


def test_native_script_on_a_recording_desktop(example: Model, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = write(example, ["aedt-native"])["aedt_native.py"]
    designs = list(native(text, tmp_path / "s.py", monkeypatch).values())
    assert len(designs) == len(example.frames)
    for design, (_, directory) in list(zip(designs, example.frames, strict=True))[::4]:
        check_design(example, design.editor, design.said, directory)
    single = text.replace("WITH_SHELLS = True", "WITH_SHELLS = False")
    assert single != text
    [design] = native(single, tmp_path / "s.py", monkeypatch).values()
    check_design(example, design.editor, design.said, None)


def test_native_script_keeps_to_the_words_of_python_2() -> None:
    """IronPython reads it: no f-strings, annotations or keyword-only arguments."""
    tree = ast.parse(write(MODELS["published"], ["aedt-native"])["aedt_native.py"])
    for node in ast.walk(tree):
        assert not isinstance(node, ast.JoinedStr | ast.AnnAssign | ast.NamedExpr | ast.AsyncFunctionDef | ast.Nonlocal)
        if isinstance(node, ast.FunctionDef):
            assert node.returns is None and not node.args.kwonlyargs


# ---------------------------------------------------------------- CST


class Cst:
    """Reads the macro back: the text that it says into history blocks, and what those do."""

    def __init__(self, text: str) -> None:
        assert all(len(line) < 1000 for line in text.splitlines())
        self.procedures = dict(re.findall(r"^(?:Private )?Sub (\w+) \(.*?\)\n(.*?)^End Sub", text, re.S | re.M))
        assert text.count("\nSub ") + text.count("\nPrivate Sub ") == text.count("\nEnd Sub") == len(self.procedures)
        self.parameters: list[tuple[str, str]] = []
        self.blocks: list[tuple[str, str]] = []
        self.swept = ""
        self._call("Main")

    def _call(self, name: str) -> None:
        block: list[str] = []
        for line in self.procedures[name].splitlines():
            line = line.strip()
            if found := re.fullmatch(r'Say "(.*)"', line):
                inner = found[1].replace('""', "\0")
                assert '"' not in inner
                block.append(inner.replace("\0", '"'))
            elif found := re.fullmatch(r'Record "([^"]*)"', line):
                self.blocks.append((found[1], "\n".join(block)))
                block = []
            elif found := re.fullmatch(r'(?:StoreParameter|MakeSureParameterExists) "(\w+)", "([^"]*)"', line):
                self.parameters.append((found[1], found[2]))
            elif name == "Sweep":
                self.swept += line + "\n"
            else:
                assert line in self.procedures, line
                self._call(line)
        assert not block

    def run(self, t: float) -> tuple[dict[str, np.ndarray], dict[str, str]]:
        """Rebuild at t: where the points of every object are, and the files of the objects."""
        (sweep, start), *others = self.parameters
        assert start == "0"
        variables = evaluated([(sweep, repr(t)), *others])
        points: dict[str, np.ndarray] = {}
        files: dict[str, str] = {}
        system: tuple[Any, Any, Any] = (np.zeros(3), np.array([1.0, 0, 0]), np.array([0, 1.0, 0]))
        local = False
        for _, block in self.blocks:
            chosen = self._choice(block, variables[sweep])
            for kind, body in re.findall(r"^With (\w+)\n(.*?)^End With", block, re.S | re.M):
                said = dict(re.findall(r"^     \.(\w+) ?(.*)$", body, re.M))
                if kind == "Units":
                    assert said["Geometry"] == '"mm"'
                elif kind == "STL":
                    assert said["ImportFileUnits"] == '"mm"' and "Reset" in said and "Read" in said
                    name = said["Name"].strip('"')
                    path = chosen if said["FileName"] == "breathe_file" else said["FileName"]
                    files[name] = re.fullmatch(r'GetProjectPath\("Root"\) & "\\(.*)"', path)[1]  # type: ignore[index]
                    points[name] = POINTS
                elif kind == "WCS":
                    x, z = vector(said["SetUVector"], {}), vector(said["SetNormal"], {})
                    system, local = (vector(said["SetOrigin"], {}), x, np.cross(z, x)), True
                    assert said["ActivateWCS"] == '"local"'
                else:
                    assert kind == "Transform" and local
                    how = re.fullmatch(r'"Shape", "(\w+)"', said["Transform"])[1]  # type: ignore[index]
                    key, verb = {
                        "Scale": ("ScaleFactor", "scale"),
                        "Rotate": ("Angle", "rotate"),
                        "Translate": ("Vector", "move"),
                    }[how]
                    assert said["Origin"] == '"Free"' and said["Center"] == '"0", "0", "0"'
                    assert said["Repetitions"] == '"1"' and said["MultipleObjects"] == '"False"'
                    name = said["Name"].strip('"').removeprefix("breathe:")
                    points[name] = transformed(points[name], verb, system, list(vector(said[key], variables)))
            if 'WCS.ActivateWCS "global"' in block:
                local = False
        assert not local
        return points, files

    @staticmethod
    def _choice(block: str, value: float) -> str:
        if "Select Case" not in block:
            return ""
        # CInt rounds to the nearest whole number, halves to the even one, as round does.
        return re.search(rf"^Case {round(value)}\n     breathe_file = (.*)$", block, re.M)[1]  # type: ignore[index]


def vector(text: str, variables: dict[str, float]) -> np.ndarray:
    parts = re.fullmatch(r'"([^"]*)", "([^"]*)", "([^"]*)"', text)
    assert parts, text
    return np.array([number(part, variables) for part in parts.groups()])


def test_cst_macro_read_back_and_applied(example: Model) -> None:
    text = write(example, ["cst"])["cst_breathe.bas"]
    assert text.count("\r\n") == text.count("\n")
    macro = Cst(text.replace("\r\n", "\n"))
    names = object_names(part.name for part in example.parts)
    shells = {name: part for name, part in zip(names, example.parts, strict=True) if part.motion and part.motion.fields}
    for t in TIMES:
        points, files = macro.run(t)
        compare(example, t, {name: moved for name, moved in points.items() if name not in shells})
        directories = dict(example.frames)
        for name, part in zip(names, example.parts, strict=True):
            directory = directories[float(round(t))] if name in shells else directories[0.0]
            assert files[name] == f"{directory}/{part.file}".replace("/", "\\")
    variable, steps = example.sequence.variable, example.sequence.steps
    assert f'.AddParameter_Samples "Breath", "{variable}", "0", "{steps}", "{steps + 1}", "False"' in macro.swept


# ---------------------------------------------------------------- MATLAB and Octave

needs_octave = pytest.mark.skipif(shutil.which("octave-cli") is None, reason="octave-cli is not installed")


def octave(folder: Path, commands: str) -> str:
    done = subprocess.run(
        ["octave-cli", "--no-init-file", "--quiet", "--eval", commands],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    assert "warning" not in done.stderr
    return done.stdout


@needs_octave
def test_matlab_function_runs_in_octave(tmp_path: Path) -> None:
    """Shells too: their field is written out. One start of Octave for all models."""
    np.savetxt(tmp_path / "points.csv", POINTS, delimiter=",", fmt="%.17g")
    commands = ["P = dlmread('points.csv');"]
    cases = []
    for number_, example in enumerate(MODELS.values()):
        folder = tmp_path / f"m{number_}"
        folder.mkdir()
        for name, text in write(example, ["matlab"]).items():
            (folder / name).write_text(text, encoding="utf-8")
        commands.append(f"cd('{folder}'); clear breathe_apply;")
        for part in example.parts:
            for t in TIMES:
                target = tmp_path / f"{len(cases)}.csv"
                said = part.name.replace("'", "''")
                commands.append(f"dlmwrite('{target}', breathe_apply('{said}', P, {t!r}), 'precision', '%.17g');")
                cases.append((part, t, target))
    octave(tmp_path, "\n".join(commands))
    for part, t, target in cases:
        wanted = POINTS if part.motion is None else part.motion.apply(POINTS, t)
        found = np.loadtxt(target, delimiter=",")
        assert np.abs(found - wanted).max() < TOLERANCE_MM, (part.name, t)


@needs_octave
def test_matlab_function_names_an_unknown_tissue(tmp_path: Path) -> None:
    for name, text in write(MODELS["published"], ["matlab"]).items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    said = octave(tmp_path, "try, breathe_apply('Tail', [0 0 0], 1); catch e, disp(e.message), end")
    assert said.strip() == "there is no tissue Tail"


# ---------------------------------------------------------------- all


def test_every_target_has_its_files() -> None:
    files = write(MODELS["published"])
    assert set(files) == {
        "aedt_pyaedt.py", "aedt_native.py", "cst_breathe.bas", "breathe_apply.m", "breathe_frame.m"
    }  # fmt: skip
    assert files == {name: text for target in TARGETS for name, text in write(MODELS["published"], [target]).items()}
    with pytest.raises(KeyError):
        write(MODELS["published"], ["abaqus"])


def test_scripts_say_that_they_are_untested_in_the_program() -> None:
    for name, text in write(MODELS["every form"]).items():
        if name != "breathe_frame.m":
            assert "not run in the program itself" in text


def test_names_of_objects_are_plain_and_unique() -> None:
    names = object_names(["Rib 1 (left)", "rib-1-LEFT", "7th rib", "肋骨", "", "Rib_1_left_n2"])
    assert names == ["Rib_1_left", "rib_1_LEFT_n2", "T_7th_rib", "T", "T_n2", "Rib_1_left_n2_n2"]


def test_names_that_a_script_cannot_say_are_refused() -> None:
    sequence = every_form()
    for file in ('a"b.stl', "a\nb.stl"):
        with pytest.raises(ValueError, match="can't be said"):
            Model(sequence, (Part("a", file),), ((0.0, "f"),))
    with pytest.raises(ValueError, match="at t = 0"):
        Model(sequence, (), ((1.0, "f"),))
