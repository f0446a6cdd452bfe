"""The scripts, read back: they import every object, with its name, unit and material."""

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
from shapes import box, sphere

from vhp_cli.formats.surfaces import NamedSurface, write_surfaces
from vhp_cli.stages.export.dielectric import dielectric
from vhp_cli.stages.export.materials import Properties
from vhp_cli.stages.export.scripts import SCRIPTS, Part, Scene, write
from vhp_cli.stages.export.targets import TARGETS

FREQUENCY = 300e6


def tissue(name: str, material: str = "", density: float | None = None) -> Properties:
    if not material:
        return Properties(name, density=density)
    found = dielectric(material, FREQUENCY)
    return Properties(name, material, found.permittivity, found.conductivity, density)


def scene(unit: str = "mm") -> Scene:
    """Nested tissues in an order that has inner ones first, one without a material, two that differ in density."""
    parts = (
        Part("liver", "stl/liver.stl", tissue("liver", "Liver", 1079.0), "fat"),
        Part("T_3rd_rib", "stl/T_3rd_rib.stl", tissue("3rd rib", "Bone (Cortical)", 1908.0), "fat"),
        Part("fat", "stl/fat.stl", tissue("fat", "Fat (Not Infiltrated)", 911.0), "skin"),
        Part("skin", "stl/skin.stl", tissue("skin", "Skin (Dry)", 1109.0)),
        Part("ureter", "stl/ureter.stl", tissue("ureter"), "fat"),
        Part("tumour", "stl/tumour.stl", Properties("tumour", "Liver", 61.5, 0.9, 1060.0), "liver"),
        Part("pancreas", "stl/pancreas.stl", tissue('pancreas\'s "head"', "Thyroid"), "fat"),
    )
    return Scene('a model of "VHP" \n\' 3', unit, FREQUENCY, parts)


SCENE = scene()
WANTED = {
    part.name: (
        None
        if not part.properties.known
        else (part.properties.permittivity, part.properties.conductivity, part.properties.density)
    )
    for part in SCENE.parts
}


def fields(arguments: list[Any]) -> dict[str, Any]:
    """Read the "Name:=", value pairs of a native call, and the lists among them."""
    found, rest = {}, arguments[1:]
    while rest:
        if isinstance(rest[0], list):
            found[rest[0][0].removeprefix("NAME:")] = fields(rest[0]) if rest[0][1:] else {}
            rest = rest[1:]
        else:
            assert rest[0].endswith(":="), rest
            found[rest[0].removesuffix(":=")], rest = rest[1], rest[2:]
    return found


class Editor:
    """Records what is imported, renamed and changed, as AEDT's editor would do it."""

    def __init__(self) -> None:
        self.files: dict[str, str] = {}
        self.properties: dict[str, dict[str, Any]] = {}
        self.unit = ""
        self.order: list[str] = []

    def Import(self, arguments: list[Any]) -> None:
        said = fields(arguments)
        # Nothing may be healed, merged or reduced on the way in.
        assert said["STLFileUnit"] and said["MergeFacesAngle"] == -1
        assert not said["HealSTL"] and not said["ReduceSTL"] and not said["HealOption"]
        self.unit = said["STLFileUnit"]
        name = f"Body{len(self.files)}"
        self.files[name] = str(PurePosixPath(said["SourceFile"]))
        self.properties[name] = {}

    def ChangeProperty(self, arguments: list[Any]) -> None:
        tab, (servers, name), (_, *changes) = arguments[1]
        assert (arguments[0], tab, servers) == ("NAME:AllTabs", "NAME:Geometry3DAttributeTab", "NAME:PropServers")
        for change in changes:
            key, value = change[0].removeprefix("NAME:"), fields(change)["Value"]
            if key == "Name":
                assert value not in self.files
                self.files[value] = self.files.pop(name)
                self.properties[value] = self.properties.pop(name)
                self.order.append(value)
            else:
                self.properties[name][key] = value

    def GetObjectsInGroup(self, group: str) -> list[str]:
        return list(self.files) if group == "Solids" else []

    def SetModelUnits(self, arguments: list[Any]) -> None:
        assert fields(arguments)["Rescale"] is False
        self.model_unit = fields(arguments)["Units"]


class Manager:
    """Records materials, as AEDT's definition manager would do it."""

    def __init__(self) -> None:
        self.materials: dict[str, dict[str, Any]] = {}

    def GetProjectMaterialNames(self) -> list[str]:
        return ["vacuum", *self.materials]

    def AddMaterial(self, arguments: list[Any]) -> None:
        name = arguments[0].removeprefix("NAME:")
        assert name not in self.materials
        self.materials[name] = fields(arguments)

    def EditMaterial(self, name: str, arguments: list[Any]) -> None:
        assert name in self.materials
        self.materials[name] = fields(arguments)


def check_aedt(editor: Editor, manager: Manager, unit: str = "mm") -> None:
    """Every object is there with its file and the values of its tissue; outer ones before inner ones."""
    assert editor.unit == unit
    assert set(editor.files) == set(WANTED)
    for name, wanted in WANTED.items():
        assert editor.files[name].endswith(f"/stl/{name}.stl")
        said = editor.properties[name]
        if wanted is None:
            assert "Material" not in said
            continue
        assert said["Solve Inside"] is True
        material = manager.materials[re.fullmatch(r'"(.*)"', said["Material"])[1]]  # type: ignore[index]
        permittivity, conductivity, density = wanted
        assert float(material["permittivity"]) == permittivity
        assert float(material["conductivity"]) == conductivity
        # Left out, or 0 as PyAEDT writes it, where it is not known.
        assert float(material.get("mass_density", 0)) == (density or 0)
    for part in SCENE.parts:
        assert not part.parent or editor.order.index(part.parent) < editor.order.index(part.name)
    assert all(re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name) for name in manager.materials)


# ---------------------------------------------------------------- ANSYS, PyAEDT


@pytest.fixture
def hfss(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[Any]]:
    """Put a recorder in the place of Hfss: modeler, objects and materials are PyAEDT's own, on recorders."""
    pytest.importorskip("ansys.aedt.core", reason="pyaedt is not installed", exc_type=ImportError)
    import ansys.aedt.core
    from ansys.aedt.core.modeler.cad.object_3d import Object3d
    from ansys.aedt.core.modeler.cad.primitives import GeometryModeler
    from ansys.aedt.core.modules.material_lib import Materials

    logger = types.SimpleNamespace(info=lambda *_: None, warning=lambda *_: None, error=lambda *_: None)

    class Modeler:
        """PyAEDT's code for what the script calls, on the recorder."""

        model_units = ""
        import_3d_cad = GeometryModeler.import_3d_cad
        _change_geometry_property = GeometryModeler._change_geometry_property

        def __init__(self, materials: Any) -> None:
            self.oeditor, self.logger, self._materials = Editor(), logger, materials
            self._app = types.SimpleNamespace(logger=logger)

        def convert_to_selections(self, assignment: Any, return_list: bool = False) -> Any:
            return [assignment] if return_list else assignment

        @property
        def object_names(self) -> list[str]:
            return list(self.oeditor.files)

        def refresh_all_ids(self) -> None: ...
        def add_new_objects(self) -> None: ...
        def cleanup_objects(self) -> None: ...

        def __getitem__(self, name: str) -> Any:
            found = Object3d.__new__(Object3d)
            found.__dict__.update(_primitives=self, _m_name=name, _model=True, _material_name=None, _solve_inside=None)
            return found

    class Hfss:
        def __init__(self, design: str) -> None:
            self.odefinition_manager, self.omaterial_manager = Manager(), None
            materials = Materials.__new__(Materials)
            materials.__dict__.update(
                _app=self, _color_id=0, logger=logger, _oproject=None, _Materials__material_keys={},
                _mats=["vacuum"], _mats_lower=[],
            )  # fmt: skip
            self.materials, self.modeler = materials, Modeler(materials)
            designs.append(self)

    designs: list[Any] = []
    monkeypatch.setattr(ansys.aedt.core, "Hfss", Hfss, raising=False)
    yield designs


def run_python(text: str, path: Path, name: str, **given: Any) -> dict[str, Any]:
    path.write_text(text, encoding="utf-8")
    space = {"__name__": name, "__file__": str(path), **given}
    exec(compile(text, str(path), "exec"), space)
    return space


@pytest.mark.parametrize(("unit", "said"), [("mm", "mm"), ("m", "meter"), ("um", "um")])
def test_pyaedt_script_through_its_own_modeler(unit: str, said: str, hfss: list[Any], tmp_path: Path) -> None:
    run_python(write(scene(unit), ["hfss-pyaedt"])["import_hfss_pyaedt.py"], tmp_path / "s.py", "__main__")
    [app] = hfss
    assert app.modeler.model_units == said
    check_aedt(app.modeler.oeditor, app.odefinition_manager, said)


# ---------------------------------------------------------------- ANSYS, native


def test_native_script(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    editor, manager = Editor(), Manager()
    manager.materials["vhp_Liver_300MHz"] = {}  # of a run before
    design = types.SimpleNamespace(SetActiveEditor=lambda name: editor)
    project = types.SimpleNamespace(
        GetDefinitionManager=lambda: manager,
        InsertDesign=lambda kind, name, solution, _: None,
        SetActiveDesign=lambda name: design,
    )
    desktop = types.SimpleNamespace(
        RestoreWindow=lambda: None, GetActiveProject=lambda: None, NewProject=lambda: project
    )
    monkeypatch.setitem(sys.modules, "ScriptEnv", types.SimpleNamespace(Initialize=lambda name: None))
    text = write(SCENE, ["hfss-native"])["import_hfss_native.py"]
    run_python(text, tmp_path / "s.py", "__main__", oDesktop=desktop)
    assert editor.model_unit == "mm"
    check_aedt(editor, manager)


def test_native_script_keeps_to_the_words_of_python_2() -> None:
    """IronPython reads it: no f-strings, annotations or keyword-only arguments."""
    text = write(SCENE, ["hfss-native"])["import_hfss_native.py"]
    assert text.isascii()
    for node in ast.walk(ast.parse(text)):
        assert not isinstance(node, ast.JoinedStr | ast.AnnAssign | ast.NamedExpr | ast.AsyncFunctionDef | ast.Nonlocal)
        if isinstance(node, ast.FunctionDef):
            assert node.returns is None and not node.args.kwonlyargs


def test_an_import_that_gives_several_objects_stops_the_script(hfss: list[Any], tmp_path: Path, monkeypatch) -> None:
    def twice(self: Editor, arguments: list[Any]) -> None:
        self.files |= {"a": "x", "b": "y"}

    monkeypatch.setattr(Editor, "Import", twice)
    with pytest.raises(RuntimeError, match="gave 2 objects instead of one"):
        run_python(write(SCENE, ["hfss-pyaedt"])["import_hfss_pyaedt.py"], tmp_path / "s.py", "__main__")


# ---------------------------------------------------------------- CST


class Cst:
    """Reads the macro back: the text that it says into history blocks, and what those do."""

    def __init__(self, text: str) -> None:
        assert text.count("\r\n") == text.count("\n")
        text = text.replace("\r\n", "\n")
        assert text.isascii() and all(len(line) < 1000 for line in text.splitlines())
        self.procedures = dict(re.findall(r"^(?:Private )?Sub (\w+) \(.*?\)\n(.*?)^End Sub", text, re.S | re.M))
        assert text.count("\nSub ") + text.count("\nPrivate Sub ") == text.count("\nEnd Sub") == len(self.procedures)
        # A procedure of VBA ends at 64 kB of compiled code.
        assert all(len(body) < 50_000 for body in self.procedures.values())
        self.constants = dict(re.findall(r"^Const (\w+) = (\w+)$", text, re.M))
        self.history: list[tuple[str, str]] = []
        self.call("Main")

    def call(self, name: str) -> None:
        block: list[str] = []
        for line in self.procedures[name].splitlines():
            line = line.strip()
            if found := re.fullmatch(r'Say "(.*)"', line):
                inner = found[1].replace('""', "\0")
                assert '"' not in inner
                block.append(inner.replace("\0", '"'))
            elif found := re.fullmatch(r'Record "([^"]*)"', line):
                self.history.append((found[1], "\n".join(block)))
                block = []
            elif found := re.fullmatch(r"If (\w+) Then (\w+)", line):
                if self.constants[found[1]] == "True":
                    self.call(found[2])
            else:
                assert line in self.procedures, line
                self.call(line)
        assert not block

    def blocks(self, kind: str) -> Iterator[dict[str, str]]:
        for _, text in self.history:
            for body in re.findall(rf"^With {kind}\n(.*?)^End With", text, re.S | re.M):
                yield dict(re.findall(r"^     \.(\w+) ?(.*)$", body, re.M))

    def lines(self, start: str) -> Iterator[tuple[str, str]]:
        for _, text in self.history:
            for line in text.splitlines():
                if line.startswith(start):
                    first, second = re.fullmatch(rf'{re.escape(start)} "([^"]*)", "([^"]*)"', line).groups()  # type: ignore[union-attr]
                    yield first, second


@pytest.mark.parametrize("unit", ["um", "mm", "cm", "in", "m"])
def test_cst_macro_read_back(unit: str) -> None:
    macro = Cst(write(scene(unit), ["cst"])["import_cst.bas"])
    [units] = macro.blocks("Units")
    assert units["Geometry"] == f'"{unit}"'
    materials = {}
    for said in macro.blocks("Material"):
        keys = list(said)
        assert keys[0] == "Reset" and keys[-1] == "Create" and said["Type"] == '"Normal"'
        density = float(said["Rho"].strip('"')) if "Rho" in said else None
        materials[said["Name"].strip('"')] = (
            float(said["Epsilon"].strip('"')), float(said["Kappa"].strip('"')), density
        )  # fmt: skip
    files, order = {}, []
    for said in macro.blocks("STL"):
        keys = list(said)
        assert keys[0] == "Reset" and keys[-1] == "Read"
        assert said["ScaleToUnit"] == '"True"' and said["ImportFileUnits"] == f'"{unit}"'
        name = said["Name"].strip('"')
        order.append(f"{said['Component'].strip(chr(34))}:{name}")
        files[name] = re.fullmatch(r'GetProjectPath\("Root"\) & "\\(.*)"', said["FileName"])[1]  # type: ignore[index]
    assert files == {name: f"stl\\{name}.stl" for name in WANTED}
    given = dict(macro.lines("Solid.ChangeMaterial"))
    assert {name: given.get(f"vhp:{name}") and materials[given[f"vhp:{name}"]] for name in WANTED} == WANTED
    assert not list(macro.lines("Solid.Insert"))
    for part in SCENE.parts:
        assert not part.parent or order.index(f"vhp:{part.parent}") < order.index(f"vhp:{part.name}")


def test_cst_macro_can_cut_nested_objects_out() -> None:
    text = write(SCENE, ["cst"])["import_cst.bas"]
    changed = text.replace("Const InsertNested = False", "Const InsertNested = True")
    assert changed != text
    parents = {part.name: part.parent for part in SCENE.parts}
    # The regions that an object fills: its own, and those of all that lies within it.
    filled = {name: {name} for name in parents}
    for name in parents:
        outer = parents[name]
        while outer:
            filled[outer].add(name)
            outer = parents[outer]
    for outer, inner in Cst(changed).lines("Solid.Insert"):
        filled[outer.removeprefix("vhp:")] -= filled[inner.removeprefix("vhp:")]
    assert filled == {name: {name} for name in parents}


# ---------------------------------------------------------------- MATLAB and Octave


@pytest.mark.skipif(shutil.which("octave-cli") is None, reason="octave-cli is not installed")
def test_matlab_loader_runs_in_octave(tmp_path: Path) -> None:
    parts = []
    meshes = (sphere(5, (1, 2, 3), 1), box((0, 0, 0), (1, 2, 3)))
    (tmp_path / "mat").mkdir()
    for part, mesh in zip((SCENE.parts[0], SCENE.parts[6]), meshes, strict=True):
        path = f"mat/{part.name}.mat"
        write_surfaces(tmp_path / path, [NamedSurface(part.name, mesh)], "mat", "cm")
        parts.append(Part(part.name, path, part.properties))
    text = write(Scene("x", "cm", FREQUENCY, tuple(parts)), ["matlab"])["load_model.m"]
    (tmp_path / "load_model.m").write_text(text, encoding="utf-8")
    commands = (
        "m = load_model(); printf('%d\\n', numel(m));"
        "for k = 1:numel(m),"
        " printf('%s|%s|%s|%s|%.17g|%.17g|%.17g\\n', m(k).name, m(k).tissue, m(k).material, m(k).unit,"
        " m(k).permittivity, m(k).conductivity, m(k).density);"
        " a = m(k).P(m(k).t(:, 1), :); b = m(k).P(m(k).t(:, 2), :); c = m(k).P(m(k).t(:, 3), :);"
        " printf('%.17g %d %d\\n', sum(dot(a, cross(b, c, 2), 2))/6, rows(m(k).normals), columns(m(k).normals));"
        "end"
    )
    done = subprocess.run(
        ["octave-cli", "--no-init-file", "--quiet", "--eval", commands],
        cwd=tmp_path, capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0 and "warning" not in done.stderr, done.stderr
    count, *lines = done.stdout.splitlines()
    assert count == "2"
    for part, mesh, head, measures in zip(parts, meshes, lines[::2], lines[1::2], strict=True):
        found = part.properties
        name, tissue_name, material, unit, *numbers = head.split("|")
        assert (name, tissue_name, material, unit) == (part.name, found.tissue, found.material, "cm")
        wanted = [
            np.nan if value is None else value for value in (found.permittivity, found.conductivity, found.density)
        ]
        assert np.array_equal(np.array(numbers, float), wanted, equal_nan=True)
        volume, rows, columns = measures.split()
        a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
        assert float(volume) == pytest.approx(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)
        assert (int(rows), int(columns)) == (len(mesh.faces), 3)


# ---------------------------------------------------------------- all


def test_tissues_without_values_get_no_material() -> None:
    bare = Scene("x", "mm", None, (Part("liver", "stl/liver.stl", Properties("liver", "Liver", density=1079.0)),))
    assert bare.materials() == ((), {})
    assert "MATERIALS = [\n]" in write(bare, ["hfss-pyaedt"])["import_hfss_pyaedt.py"]
    assert not list(Cst(write(bare, ["cst"])["import_cst.bas"]).blocks("Material"))
    assert "NaN, NaN, 1079.0" in write(bare, ["matlab"])["load_model.m"]


def test_scripts_say_that_they_are_untested_in_the_program() -> None:
    texts = write(SCENE, SCRIPTS)
    assert len(texts) == len(SCRIPTS)
    assert all("not run in the program" in text for text in texts.values())
    assert {script for target in TARGETS.values() for script in target.scripts} == set(SCRIPTS)
    with pytest.raises(KeyError):
        write(SCENE, ["abaqus"])


def test_every_procedure_stays_short_for_300_tissues() -> None:
    parts = tuple(
        Part(f"tissue_{number}", f"stl/tissue_{number}.stl", tissue(f"t{number}", "Muscle", 1000.0 + number), "")
        for number in range(300)
    )
    macro = Cst(write(Scene("large", "mm", FREQUENCY, parts), ["cst"])["import_cst.bas"])
    assert len(list(macro.blocks("STL"))) == len(list(macro.blocks("Material"))) == 300
