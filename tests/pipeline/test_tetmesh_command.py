"""``vhp tetmesh`` from the command line to the files."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import NotRequired, get_origin, get_type_hints

import jsonschema
import numpy as np
import pytest
from click.testing import CliRunner
from shapes import box, flipped, joined, moved, sphere

from vhp_cli import engines, measures
from vhp_cli.cli import main
from vhp_cli.commands.tetmesh import tetmesh
from vhp_cli.formats import read_mesh, write_mesh
from vhp_cli.mesh import Mesh
from vhp_cli.report import render, schema

BALL = 4 / 3 * np.pi
DEFAULTS = ("--no-cache", "--attempts", "1", "--time-limit", "60", "--epsilon", "0.4")


def run(*arguments):
    """Run the command with few demands on the mesh, and return its exit code and its report."""
    arguments = [str(argument) for argument in arguments]
    out = Path(arguments[arguments.index("-o") + 1])
    code = main(["--quiet", "tetmesh", *DEFAULTS, *arguments])
    report = json.loads((out / "report.json").read_text()) if (out / "report.json").is_file() else None
    return code, report


def label(report, name):
    return next(record for record in report["tetmesh"]["labels"] if record["name"] == name)


def codes(report, name=None):
    return {finding["rule"] for finding in report["findings"] if name is None or finding["tissues"] == [name]}


def write(directory, **meshes):
    directory.mkdir()
    for name, mesh in meshes.items():
        write_mesh(directory / f"{name}.stl", mesh)
    return directory


def capsule(radius, length, centre, rings=6, sides=16):
    """Return a cylinder along x with half spheres on both ends."""
    latitude = np.linspace(0, np.pi / 2, rings)[:-1]
    profile = [(length / 2 + radius * np.sin(angle), radius * np.cos(angle)) for angle in latitude]
    profile = [(-x, r) for x, r in reversed(profile)] + profile
    turn = 2 * np.pi * np.arange(sides) / sides
    points = [(x, r * np.cos(angle), r * np.sin(angle)) for x, r in profile for angle in turn]
    points += [(-length / 2 - radius, 0, 0), (length / 2 + radius, 0, 0)]
    first, last = len(points) - 2, len(points) - 1
    faces = []
    for ring in range(len(profile) - 1):
        for side in range(sides):
            a, b = ring * sides + side, ring * sides + (side + 1) % sides
            faces += [(a, a + sides, b), (b, a + sides, b + sides)]
    faces += [(first, side, (side + 1) % sides) for side in range(sides)]
    start = (len(profile) - 1) * sides
    faces += [(last, start + (side + 1) % sides, start + side) for side in range(sides)]
    mesh = Mesh(np.array(points) + centre, np.array(faces))
    a, b, c = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
    return mesh if np.einsum("ij,ij->", a, np.cross(b, c)) > 0 else flipped(mesh)


@pytest.fixture(scope="module")
def nested(tmp_path_factory):
    """Return a sound model, where its mesh went, exit code and report."""
    directory = tmp_path_factory.mktemp("nested")
    model = write(
        directory / "model",
        skin=sphere(20, subdivisions=3),
        organ=sphere(11, (4, 0, 0), subdivisions=3),
        vessel=capsule(2.5, 6, (4, 0, 0)),
        pair=joined(moved(sphere(3), (-12, 0, 4)), moved(sphere(3), (-12, 0, -4))),
    )
    options = ("--edge-length", 5, "--epsilon", 0.2, "--surfaces", "--format", "vtu,msh,mat")
    code, report = run(model, "-o", directory / "out", *options)
    return model, directory / "out", code, report


def test_a_sound_model(nested):
    _, out, code, report = nested
    assert code == 0 and report["summary"]["passed"]
    assert not {finding["rule"] for finding in report["findings"] if finding["level"] == "error"}
    mesh = report["tetmesh"]
    assert mesh["conforming"] and not mesh["reproducible"] and mesh["engine"].startswith("pytetwild")
    assert mesh["quality"]["min_dihedral_deg"] >= 8 and mesh["quality"]["inverted"] == 0
    assert mesh["quality"]["scaled_jacobian_min"] > 0
    assert [record["name"] for record in mesh["labels"]] == ["organ", "pair", "skin", "vessel"]
    assert {record["name"]: record["parts"] for record in mesh["labels"]} == {
        "organ": 1, "pair": 2, "skin": 1, "vessel": 1
    }  # fmt: skip
    assert all(record["parts"] == record["expected_parts"] for record in mesh["labels"])
    assert all(not record["boundary"]["nonmanifold_edges"] for record in mesh["labels"])
    assert mesh["input"]["passed"] and not mesh["input"]["errors"]
    assert sorted(path.name for path in out.iterdir()) == [
        "model.mat", "model.msh", "model.vtu", "report.json", "surfaces"
    ]  # fmt: skip
    assert set(mesh["files"]) == {path.relative_to(out).as_posix() for path in out.rglob("*.*")} - {"report.json"}


def test_volumes_are_those_of_the_surfaces_and_nearly_analytic(nested):
    report = nested[-1]
    assert len(report["tetmesh"]["labels"]) == 4
    vessel = BALL * 2.5**3 + np.pi * 2.5**2 * 6
    solid = {"vessel": vessel, "organ": BALL * 11**3 - vessel, "pair": 2 * BALL * 3**3}
    solid["skin"] = BALL * 20**3 - BALL * 11**3 - solid["pair"]
    for name, volume in solid.items():
        record = label(report, name)
        assert record["surface_volume_exact"]
        assert abs(record["volume_error"]) < 0.02, name
        assert record["volume_mm3"] == pytest.approx(record["surface_volume_mm3"] * (1 + record["volume_error"]))
        # The facets of the surfaces lie within the round shapes.
        assert 0.93 * volume < record["volume_mm3"] < 1.01 * volume, name


def read_vtu(path):
    meshio = pytest.importorskip("meshio")
    found = meshio.read(path)
    return found.points, found.cells_dict["tetra"], np.concatenate(found.cell_data["label"])


def test_the_file_holds_what_the_report_says(nested):
    _, out, _, report = nested
    points, tetrahedra, labels = read_vtu(out / "model.vtu")
    assert len(points) == report["tetmesh"]["points"] and len(tetrahedra) == report["tetmesh"]["tets"]
    sizes = np.linalg.det(points[tetrahedra[:, 1:]] - points[tetrahedra[:, :1]]) / 6
    assert sizes.min() > 0
    for record in report["tetmesh"]["labels"]:
        assert sizes[labels == record["label"]].sum() == pytest.approx(record["volume_mm3"], rel=1e-9)
        assert (labels == record["label"]).sum() == record["tets"]
    distance = np.linalg.norm(points[tetrahedra].mean(axis=1) - [4, 0, 0], axis=1)
    organ = label(report, "organ")["label"]
    assert (labels[(distance > 5.6) & (distance < 10.5)] == organ).all()


def test_the_surfaces_are_those_of_the_input(nested):
    model, out, _, _ = nested
    for name in ("organ", "pair", "skin", "vessel"):
        given, made = (read_mesh(path / f"{name}.stl").mesh for path in (model, out / "surfaces"))
        volume = []
        for mesh in (given, made):
            a, b, c = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
            volume.append(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)
        assert volume[1] == pytest.approx(volume[0], rel=0.02)
    assert main(["--quiet", "check", str(out / "surfaces"), "--gap", "0.01", "--no-cache"]) == 0


DEFINITIONS = {
    "tetrahedron_shape": measures.TetrahedronShape,
    "label_boundary": measures.LabelBoundary,
    "tetmesh_label": measures.TetmeshLabel,
    "tetmesh_interface": measures.TetmeshInterface,
    "tetmesh_attempt": measures.TetmeshAttempt,
    "tetmesh_cluster": measures.TetmeshCluster,
    "tetmesh_overlap": measures.TetmeshOverlap,
    "tetmesh_input": measures.TetmeshInput,
    "tetmesh": measures.Tetmesh,
}


def test_the_report_is_valid_and_every_fixed_key_is_required(nested):
    report = json.loads(json.dumps(nested[-1]))
    validator = jsonschema.Draft202012Validator(schema())
    validator.validate(report)
    mesh = report["tetmesh"]
    parts = {
        "tetmesh": mesh,
        "tetmesh_label": mesh["labels"][0],
        "tetrahedron_shape": mesh["quality"],
        "label_boundary": mesh["labels"][0]["boundary"],
        "tetmesh_interface": mesh["interfaces"][0],
        "tetmesh_attempt": mesh["attempts"][0],
        "tetmesh_cluster": mesh["clusters"][0],
        "tetmesh_input": mesh["input"],
    }
    for name, record in parts.items():
        for key in schema()["$defs"][name]["required"]:
            value = record.pop(key)
            assert not validator.is_valid(report), f"{name}.{key} may be missing"
            record[key] = value


@pytest.mark.parametrize("name", DEFINITIONS)
def test_the_schema_has_every_key(name):
    hints = get_type_hints(DEFINITIONS[name], include_extras=True)
    described = schema()["$defs"][name]
    assert set(described["properties"]) == set(hints)
    assert set(described["required"]) == {key for key, hint in hints.items() if get_origin(hint) is not NotRequired}


@pytest.mark.parametrize("form", ["table", "json", "jsonl", "csv", "markdown", "junit", "sarif", "github"])
def test_every_form_of_the_report(nested, form):
    text = render(nested[-1], form)
    assert "organ" in text or form == "github"
    if form == "table":
        assert f"{nested[-1]['tetmesh']['tets']:,} tetrahedra" in text and "conforming" in text
        assert "slightly different mesh each time" in text


@pytest.mark.slow
def test_nothing_of_the_model_and_nothing_else_is_touched(nested, tmp_path, monkeypatch, capfd):
    model = nested[0]
    before = {path: path.read_bytes() for path in model.iterdir()}
    monkeypatch.chdir(tmp_path)
    code = main(["--quiet", "tetmesh", str(model), "-o", "out", "--edge-length", "6", *DEFAULTS, "--epsilon", "0.3"])
    assert code == 0
    assert capfd.readouterr() == ("", "")
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["model.vtu", "report.json"]
    assert {path: path.read_bytes() for path in model.iterdir()} == before


def test_wrong_usage(nested, tmp_path, capsys):
    model, out, _, _ = nested
    for arguments, said in (
        ([model, "-o", out], "not empty"),
        ([model, "-o", model / "out"], "overlap"),
        ([model, "-o", tmp_path / "x", "--format", "stl"], "known: vtu"),
        ([model, "-o", tmp_path / "x", "--edge-length", "short"], "edge-length"),
        ([model, "-o", tmp_path / "x", "--with-air", "5", "--per-tissue"], "with-air"),
        ([model, "-o", tmp_path / "x", "--surface-gap", "1", "--per-tissue"], "--surface-gap"),
        ([model, "-o", tmp_path / "x", "--with-air", "0,0,0,1,1,1"], "does not hold the model"),
    ):
        assert main(["tetmesh", *map(str, arguments), "--no-cache"]) == 2
        assert said in capsys.readouterr().err
    assert not (tmp_path / "x").exists() or not any((tmp_path / "x").iterdir())


@pytest.mark.slow
def test_settings_file(tmp_path, capsys):
    model = write(tmp_path / "model", skin=sphere(20), organ=sphere(8))
    settings = model / "vhp.toml"
    settings.write_text('[tetmesh]\nedge-length = "50%"\n\n[[tissue]]\nmatch = "org*"\ntetmesh = {edge-length = 2.5}\n')
    code, report = run(model, "-o", tmp_path / "out")
    assert code == 0
    lengths = {name: label(report, name)["quality"]["mean_edge_mm"] for name in ("skin", "organ")}
    assert lengths["organ"] < 3 < lengths["skin"]
    assert report["settings"]["tetmesh"]["edge-length"] == "50%"
    settings.write_text('[[tissue]]\nmatch = "org*"\ntetmesh = {epsilon = 0.1}\n')
    assert main(["tetmesh", str(model), "-o", str(tmp_path / "other")]) == 2
    assert "epsilon belongs to the whole run" in capsys.readouterr().err


@pytest.mark.slow
def test_defective_surfaces_are_meshed_and_named(tmp_path):
    """An open one, one inside out, two that cross, of which the config prefers the larger, and one that is no mesh."""
    opened = sphere(8, (8, 0, 0), subdivisions=3)
    model = write(
        tmp_path / "model",
        skin=flipped(sphere(20, subdivisions=3)),
        opened=Mesh(opened.vertices, opened.faces[3:]),
        large=sphere(5, (-8, 0, 0), subdivisions=3),
        small=sphere(4, (-8, 0, 6), subdivisions=3),
    )
    (model / "garbage.stl").write_bytes(b"no mesh at all")
    (model / "vhp.toml").write_text('[[tissue]]\nmatch = "large"\ntetmesh = {priority = 1}\n')
    code, report = run(model, "-o", tmp_path / "out", "--edge-length", 8, "--epsilon", 0.15)
    assert code == 3
    assert codes(report, "garbage") == {"F001"}
    assert "M012" in codes(report, "opened") & codes(report, "skin")
    (overlap,) = report["tetmesh"]["overlaps"]
    assert overlap["winner"] == "large"
    large, small = label(report, "large"), label(report, "small")
    assert large["volume_mm3"] == pytest.approx(BALL * 125, rel=0.03)
    # A lens of the two spheres: their centres are 6 mm apart.
    lens = np.pi * (5 + 4 - 6) ** 2 * (36 + 2 * 6 * 9 - 3 * 1) / (12 * 6)
    assert small["volume_mm3"] == pytest.approx(BALL * 64 - lens, rel=0.03)
    assert small["surface_volume_mm3"] == pytest.approx(BALL * 64 - lens, rel=0.03)
    assert not small["surface_volume_exact"] and abs(small["volume_error"]) < 0.01
    assert label(report, "opened")["volume_mm3"] == pytest.approx(BALL * 512, rel=0.03)
    assert label(report, "opened")["volume_error"] is None
    assert report["tetmesh"]["conforming"] and not report["tetmesh"]["input"]["passed"]


@pytest.mark.slow
def test_a_crossing_model_comes_back_as_surfaces_that_pass_the_gate(tmp_path, capsys):
    """The organs of a phantom with planted defects of pairs; without the layers around them, which take long."""
    phantom, model, out = tmp_path / "phantom", tmp_path / "model", tmp_path / "out"
    planted = ("--tissues", "6", "--triangles", "4500", "--defects", "3", "--defect-rules", "P")
    assert main(["--quiet", "phantom", str(phantom), *planted]) == 0
    model.mkdir()
    for path in (*phantom.glob("lung*.stl"), *phantom.glob("rib*.stl")):
        path.rename(model / path.name)
    names = {path.stem for path in model.glob("*.stl")}
    assert {"lung_left", "lung_right_copy", "rib_left_01"} <= names
    assert main(["--quiet", "check", str(model), "--no-cache"]) == 1
    code, report = run(model, "-o", out, "--surface-gap", "0.5")
    # The copy of a tissue can't have tetrahedra of its own.
    assert code == 1 and "M001" in codes(report, "lung_right_copy")
    written = {path.stem for path in (out / "surfaces").glob("*.stl")}
    assert written == names - {"lung_right_copy"}
    assert main(["--quiet", "check", str(out / "surfaces"), "--gap", "0.5", "--no-cache"]) == 0
    apart = json.loads((out / "surfaces" / "report.json").read_text())
    assert apart["summary"]["passed"] and "heal" in apart["settings"]
    assert any("set apart by 0.5 mm, they pass the gate" in note for note in report["tetmesh"]["notes"])
    assert report["settings"]["tetmesh"]["surface-gap"] == 0.5
    assert not list(out.glob(".*"))
    for record in report["tetmesh"]["labels"]:
        if record["tets"]:
            assert (out / record["surface_file"]).is_file()
            volume = next(tissue["volume_mm3"] for tissue in apart["tissues"] if tissue["name"] == record["name"])
            assert volume == pytest.approx(record["volume_mm3"], rel=0.1)
    # A gap that can't be had is told, and the command does not pass.
    sheets = write(tmp_path / "sheets", a=box((0, 0, 0), (10, 10, 1)), b=box((0, 0, 1), (10, 10, 1.4)))
    code, report = run(sheets, "-o", tmp_path / "thin", "--surface-gap", "30", "--epsilon", "0.05")
    assert all(abs(record["volume_error"]) < 0.01 for record in report["tetmesh"]["labels"])
    assert code in (1, 3) and any("do not pass the gate" in note for note in report["tetmesh"]["notes"])


@pytest.mark.slow
def test_with_air(tmp_path):
    model = write(tmp_path / "model", ball=sphere(10, subdivisions=3))
    code, report = run(model, "-o", tmp_path / "out", "--with-air", "-15,-12,-12,12,12,12", "--edge-length", 10)
    assert code == 0
    air = report["tetmesh"]["air"]
    ball = label(report, "ball")
    assert air["volume_mm3"] + ball["volume_mm3"] == pytest.approx(27 * 24 * 24, rel=2e-3)
    points, tetrahedra, labels = read_vtu(tmp_path / "out" / "model.vtu")
    assert np.abs(points.min(axis=0) - [-15, -12, -12]).max() < 0.2 and np.abs(points.max(axis=0) - 12).max() < 0.2
    assert len(tetrahedra) == air["tets"] + ball["tets"] == report["tetmesh"]["tets"] + air["tets"]
    assert (labels == ball["label"]).sum() == ball["tets"]
    assert {(face["a"], face["b"]) for face in report["tetmesh"]["interfaces"]} == {("air", ""), ("ball", "air")}


def planted(monkeypatch, target, module="process_targets"):
    known = dict(engines.ENGINES)
    known["tetwild-volume"] = replace(known["tetwild-volume"], target=f"{module}:{target}")
    monkeypatch.setattr(engines, "ENGINES", known)


def children_of(parent):
    """Return the processes that a process has started and that are still there, with their command lines."""
    found = {}
    for entry in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if int((entry / "stat").read_text().rpartition(")")[2].split()[1]) == parent:
                found[int(entry.name)] = (entry / "cmdline").read_bytes()
    return found


def workers():
    return {child for child, command in children_of(os.getpid()).items() if b"vhp_cli.processes" in command}


@pytest.fixture
def children_left():
    """Return a function that returns the workers that a test has left behind; other tests may have some of theirs."""
    before = workers()
    return lambda: workers() - before


needs_proc = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="processes are looked up in /proc")


@needs_proc
@pytest.mark.parametrize(
    ("target", "reason"), [("mesh_nothing", "timeout"), ("crash_while_meshing", "crash: "), ("fail_to_mesh", "error: ")]
)
def test_an_engine_that_hangs_or_crashes(tmp_path, monkeypatch, target, reason, children_left):
    planted(monkeypatch, target)
    model = write(tmp_path / "model", ball=sphere(10))
    monkeypatch.chdir(tmp_path)
    started = time.monotonic()
    arguments = ["tetmesh", "model", "-o", "out", "--time-limit", "1.5", "--attempts", "2", "--no-cache"]
    assert main(["--quiet", *arguments]) == 3
    assert time.monotonic() - started < 15
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["tissues"][0]["status"] == "failed" and reason in report["tissues"][0]["reason"]
    assert "F012" in codes(report) and not report["summary"]["passed"]
    attempts = report["tetmesh"]["attempts"]
    # What can't succeed is not tried again, and a crash twice, with something else asked each time.
    assert len(attempts) == {"error: ": 1, "timeout": 2, "crash: ": 3}[reason]
    asked = {(attempt["edge_length_mm"], attempt["epsilon_mm"]) for attempt in attempts}
    assert len(asked) == len(attempts)
    assert not report["tetmesh"]["files"] and report["tetmesh"]["quality"] is None
    jsonschema.Draft202012Validator(schema()).validate(report)
    assert not children_left()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["model", "out"] and model.is_dir()
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["report.json"]


@needs_proc
def test_a_cluster_that_fails_and_the_others(tmp_path, monkeypatch, children_left):
    """Two balls that stand apart, one with a core, a box that makes the engine crash, and one that makes it hang."""
    planted(monkeypatch, "mesh_small_surfaces_only")
    model = write(
        tmp_path / "model",
        hangs=moved(sphere(10), (0, 60, 0)),
        core=sphere(3, (40, 40, 40)),
        crashes=moved(box(), (0, -30, 0)),
        shell=sphere(8, (40, 40, 40)),
        alone=sphere(8),
    )
    out = tmp_path / "out"
    code, report = run(model, "-o", out, "--time-limit", 4, "--edge-length", 8, "--jobs", 2)
    assert code == 3 and not report["summary"]["passed"]
    mesh = report["tetmesh"]
    assert [cluster["tissues"] for cluster in mesh["clusters"]] == [
        ["alone"],
        ["core", "shell"],
        ["crashes"],
        ["hangs"],
    ]
    failures = [cluster["failure"].partition(":")[0] for cluster in mesh["clusters"]]
    assert failures == ["", "", "crash", "timeout"]
    reasons = {record["name"]: record["reason"].partition(":")[0] for record in report["tissues"]}
    assert reasons == {"alone": "", "core": "", "shell": "", "crashes": "crash", "hangs": "timeout"}
    assert {finding["tissues"][0] for finding in report["findings"] if finding["rule"] == "F012"} == {
        "crashes",
        "hangs",
    }
    assert [attempt["cluster"] for attempt in mesh["attempts"]] == [1, 2, 3, 3, 3, 4]
    # What is delivered is as good as if it were all.
    assert {record["name"]: record["label"] for record in mesh["labels"]} == {"alone": 1, "core": 2, "shell": 3}
    assert all(abs(record["volume_error"]) < 0.01 and record["parts"] == 1 for record in mesh["labels"])
    assert mesh["conforming"] and {(face["a"], face["b"]) for face in mesh["interfaces"]} == {
        ("alone", ""), ("core", "shell"), ("shell", "")
    }  # fmt: skip
    points, tetrahedra, labels = read_vtu(out / "model.vtu")
    assert len(np.unique(tetrahedra)) == len(points) and set(labels) == {1, 2, 3}
    assert "3 clusters" not in render(report, "table") and "4 clusters" in render(report, "table")
    jsonschema.Draft202012Validator(schema()).validate(report)
    assert not children_left()


def test_the_number_of_jobs_changes_nothing(tmp_path, monkeypatch):
    planted(monkeypatch, "mesh_by_delaunay", "tetmesh_targets")
    places = {"one": (0, 0, 0), "three": (0, 40, 0), "two": (40, 0, 0)}
    sizes = {"one": 4, "three": 8, "two": 6}
    model = write(tmp_path / "model", **{name: sphere(sizes[name], place) for name, place in places.items()})
    made = {}
    for jobs in (1, 3):
        out = tmp_path / str(jobs)
        _, report = run(model, "-o", out, "--no-fit", "--jobs", jobs)
        assert len(report["tetmesh"]["clusters"]) == 3 and report["tetmesh"]["conforming"]
        made[jobs] = {**report, "run": None}, (out / "model.vtu").read_bytes()
    assert made[1] == made[3]
    for record in made[1][0]["tetmesh"]["labels"]:
        assert record["volume_mm3"] == pytest.approx(record["surface_volume_mm3"], rel=0.05)


@pytest.mark.slow
def test_the_limit_holds_for_all_clusters_together(tmp_path):
    model = write(
        tmp_path / "model", large=sphere(10, subdivisions=3), small=moved(sphere(5, subdivisions=3), (30, 0, 0))
    )
    asked = ("--edge-length", 1.5, "--attempts", 3, "--epsilon", 0.2)
    _, report = run(model, "-o", tmp_path / "free", *asked)
    free = report["tetmesh"]["tets"]
    limit = free // 2
    code, report = run(model, "-o", tmp_path / "out", *asked, "--max-tets", limit)
    mesh = report["tetmesh"]
    assert code == 0 and len(mesh["clusters"]) == 2
    assert mesh["tets"] == sum(cluster["tets"] for cluster in mesh["clusters"]) <= limit
    assert "M014" in codes(report) and len(mesh["relaxed"]) == 2


@pytest.mark.slow
def test_per_tissue_the_rest_goes_on(tmp_path, monkeypatch, children_left):
    planted(monkeypatch, "mesh_small_surfaces_only")
    model = write(tmp_path / "model", hangs=sphere(10, subdivisions=4), crashes=box(), works=sphere(8), also=sphere(5))
    out = tmp_path / "out"
    code, report = run(model, "-o", out, "--per-tissue", "--surfaces", "--time-limit", 4, "--edge-length", "20%")
    assert code == 3
    status = {record["name"]: record["status"] for record in report["tissues"]}
    assert status == {"hangs": "failed", "crashes": "failed", "works": "changed", "also": "changed"}
    reasons = {record["name"]: record["reason"] for record in report["tissues"]}
    assert "timeout" in reasons["hangs"] and "crash" in reasons["crashes"]
    assert sorted(path.relative_to(out).as_posix() for path in out.rglob("*.*")) == [
        "also.vtu", "report.json", "surfaces/also.stl", "surfaces/works.stl", "works.vtu"
    ]  # fmt: skip
    mesh = report["tetmesh"]
    assert mesh["per_tissue"] and [record["file"] for record in mesh["labels"]] == ["also.vtu", "works.vtu"]
    assert mesh["tets"] == sum(len(read_vtu(out / file)[1]) for file in ("also.vtu", "works.vtu"))
    ratios = [record["quality"]["radius_ratio_min"] for record in mesh["labels"]]
    assert mesh["quality"]["radius_ratio_min"] == min(ratios)
    assert {attempt["tissue"] for attempt in mesh["attempts"]} == set(status)
    assert not children_left()


def test_too_many_tetrahedra_are_tried_again_with_longer_edges(tmp_path):
    model = write(tmp_path / "model", ball=sphere(10))
    out = tmp_path / "out"
    arguments = ["tetmesh", str(model), "-o", str(out), "--edge-length", "2", "--max-tets", "1000", "--no-cache"]
    arguments += ["--epsilon", "0.3"]
    code = main(["--quiet", *arguments])
    report = json.loads((out / "report.json").read_text())
    first, second = report["tetmesh"]["attempts"]
    assert code == 0
    assert first["tets"] > 1000 and second["edge_length_mm"] > 2 and second["coarsen"]
    assert second["chosen"] and second["tets"] < first["tets"] and report["tetmesh"]["tets"] == second["tets"]
    assert "M014" in codes(report)
    assert any("edges of" in words for words in report["tetmesh"]["relaxed"])


def test_overwriting_removes_what_the_run_before_wrote_and_nothing_else(tmp_path):
    model = write(tmp_path / "model", ball=sphere(10))
    out = tmp_path / "out"
    run(model, "-o", out, "--format", "msh,vtu", "--edge-length", "15%")
    (out / "mine.txt").write_text("x")
    code, _ = run(model, "-o", out, "--edge-length", "15%", "--overwrite")
    assert code == 0
    assert sorted(path.name for path in out.iterdir()) == ["mine.txt", "model.vtu", "report.json"]


def test_dry_run(nested, tmp_path):
    model = nested[0]
    result = CliRunner().invoke(
        tetmesh, [str(model), "-o", str(tmp_path / "out"), "--dry-run", "--per-tissue", "--format", "msh,msh22"]
    )
    assert [line.split("\t")[0] for line in result.stdout.splitlines()] == [
        name for name in ("organ", "pair", "skin", "vessel") for _ in range(2)
    ]
    files = [Path(line.split("\t")[1]).name for line in result.stdout.splitlines()]
    assert files[:2] == ["organ.msh", "organ-msh22.msh"]
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_kept_surfaces(tmp_path):
    if not (engines.ENGINES["tetgen"].available):
        pytest.skip("tetgen is not installed")
    model = write(tmp_path / "model", skin=sphere(20), organ=sphere(8))
    code, report = run(model, "-o", tmp_path / "out", "--keep-surface", "tetgen", "--surfaces")
    assert code == 0
    assert report["tetmesh"]["engine"].startswith("tetgen") and report["tetmesh"]["reproducible"]
    assert all(abs(record["volume_error"]) < 1e-12 for record in report["tetmesh"]["labels"])
    for name in ("skin", "organ"):
        given, made = (read_mesh(path / f"{name}.stl").mesh for path in (model, tmp_path / "out" / "surfaces"))
        assert {tuple(row) for row in np.sort(given.vertices[given.faces].reshape(-1, 9))} == {
            tuple(row) for row in np.sort(made.vertices[made.faces].reshape(-1, 9))
        }
    crossing = write(tmp_path / "crossing", a=sphere(10), b=moved(sphere(10), (8, 0, 0)))
    code, report = run(crossing, "-o", tmp_path / "refused", "--keep-surface", "tetgen")
    assert code == 3 and "a and b can't be" in report["tissues"][0]["reason"]


@needs_proc
def test_an_interrupt_ends_the_child(tmp_path):
    model = write(tmp_path / "model", ball=sphere(10, subdivisions=5))
    command = [sys.executable, "-m", "vhp_cli", "tetmesh", str(model), "-o", str(tmp_path / "out")]
    running = subprocess.Popen(
        [*command, "--edge-length", "0.4", "--no-cache"], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    children = []
    deadline = time.monotonic() + 20
    while not children and time.monotonic() < deadline:
        time.sleep(0.1)
        children = list(children_of(running.pid))
    assert children
    time.sleep(0.5)
    running.send_signal(signal.SIGINT)
    _, said = running.communicate(timeout=20)
    assert running.returncode == 130 and "interrupted" in said and "Traceback" not in said
    for child in children:
        with pytest.raises(ProcessLookupError):
            os.kill(child, 0)
    assert not any((tmp_path / "out").iterdir())
