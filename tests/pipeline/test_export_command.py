"""``vhp export`` from the command line to the files."""

from __future__ import annotations

import csv
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from importlib.resources import files
from pathlib import Path
from typing import get_type_hints

import jsonschema
import numpy as np
import pytest
import scipy.io
import trimesh
from click.testing import CliRunner
from shapes import flipped, moved, sphere

from vhp_cli import measures
from vhp_cli.cli import main
from vhp_cli.commands.export import export as command
from vhp_cli.formats import read_mesh, write_mesh
from vhp_cli.formats.atomic import refused
from vhp_cli.mesh import Mesh
from vhp_cli.pipeline import export as pipeline
from vhp_cli.report import schema
from vhp_cli.stages.export.dielectric import dielectric

MANIFEST = json.loads(files("vhp_cli.report").joinpath("manifest-1.schema.json").read_text())
BALL = 4 / 3 * np.pi


@pytest.fixture
def body(tmp_path) -> Path:
    """Nested tissues that pass every profile; one has a name that no program takes."""
    directory = tmp_path / "body"
    directory.mkdir()
    write_mesh(directory / "skin.stl", sphere(60, subdivisions=4))
    write_mesh(directory / "liver.stl", sphere(15, (20, 0, 0), subdivisions=3))
    write_mesh(directory / "3rd rib (left).ply", sphere(8, (-20.1, 0.3, 0), subdivisions=3))
    write_mesh(directory / "ureter.stl", sphere(5, (0, 30, 0), subdivisions=2))
    return directory


def run(*arguments) -> tuple[int, dict | None]:
    arguments = [str(argument) for argument in arguments]
    out = Path(arguments[arguments.index("-o") + 1])
    code = main(["--quiet", "export", "-j1", *arguments])
    report = json.loads((out / "report.json").read_text()) if (out / "report.json").is_file() else None
    if report is not None:
        jsonschema.Draft202012Validator(schema()).validate(report)
    return code, report


def manifest(out: Path) -> dict:
    """Return the manifest, after every file that it names was found to be what it says."""
    found = json.loads((out / "manifest.json").read_text())
    jsonschema.Draft202012Validator(MANIFEST).validate(found)
    for file in found["files"]:
        data = (out / file["file"]).read_bytes()
        assert (hashlib.sha256(data).hexdigest(), len(data)) == (file["sha256"], file["bytes"])
    named = {file["file"] for file in found["files"]} | {"manifest.json", "report.json", ".vhp-run.jsonl"}
    assert contents(out) == named
    return found


def contents(out: Path) -> set[str]:
    return {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()}


def data_of(out: Path) -> dict[str, bytes]:
    """Return all files but those that hold times."""
    return {name: (out / name).read_bytes() for name in contents(out) - {"report.json", ".vhp-run.jsonl"}}


EXPECTED = {
    "hfss": {"stl/T3rd_rib_left_.stl", "stl/liver.stl", "stl/skin.stl", "stl/ureter.stl", "import_hfss_pyaedt.py",
             "import_hfss_native.py"},
    "cst": {"stl/T3rd_rib_left_.stl", "stl/liver.stl", "stl/skin.stl", "stl/ureter.stl", "import_cst.bas"},
    "matlab": {"mat/T3rd_rib_left_.mat", "mat/liver.mat", "mat/skin.mat", "mat/ureter.mat", "model.mat",
               "load_model.m"},
    "comsol": {"model.nas"},
    "print": {"stl/T3rd_rib_left_.stl", "stl/liver.stl", "stl/skin.stl", "stl/ureter.stl", "model.3mf"},
    "generic": {"stl/T3rd_rib_left_.stl", "stl/liver.stl", "stl/skin.stl", "stl/ureter.stl", "ply/T3rd_rib_left_.ply",
                "ply/liver.ply", "ply/skin.ply", "ply/ureter.ply", "model.bdf", "model.vtp"},
}  # fmt: skip


@pytest.mark.parametrize("target", EXPECTED)
def test_every_target(target, body, out):
    before = {path.name: path.read_bytes() for path in body.iterdir()}
    code, report = run(body, "-o", out, "--for", target, "--frequency", "300MHz")
    assert code == 0 and report["command"] == "export"
    found = manifest(out)
    assert {file["file"] for file in found["files"]} == EXPECTED[target] | {"materials.csv"}
    assert found["target"] == target and found["unit"] == "mm" and found["gate"] == {
        "profile": target, "passed": True, "forced": False, "counts": {}
    }  # fmt: skip
    export = report["export"]
    assert export["files"] == found["files"] and export["tissues"] == found["tissues"]
    assert {tissue["name"]: tissue["object"] for tissue in export["tissues"]} == {
        "skin": "skin", "liver": "liver", "ureter": "ureter", "3rd rib (left)": "T3rd_rib_left_"
    }  # fmt: skip
    assert export["without_material"] == ["ureter"] == export["without_density"]
    assert {path.name: path.read_bytes() for path in body.iterdir()} == before
    # What is found is found on the files that were given.
    for record in report["tissues"]:
        assert hashlib.sha256((body / record["file"]).read_bytes()).hexdigest() == record["sha256"]
    # The geometry is that of the model, within the rounding that the report names.
    for tissue in export["tissues"]:
        assert tissue["rounding_mm"] <= (2e-6 if tissue["name"].startswith("3rd") else 0)
    for name in EXPECTED[target]:
        if name.startswith("stl/"):
            source = body / name.removeprefix("stl/").replace("T3rd_rib_left_.stl", "3rd rib (left).ply")
            meant = trimesh.load(source, process=False).triangles.astype(np.float32)
            assert np.array_equal(trimesh.load(out / name, process=False).triangles, meant)


def test_materials_and_masses(body, out):
    code, report = run(body, "-o", out, "--for", "hfss", "--frequency", "2.45 GHz")
    assert code == 0
    found = {tissue["name"]: tissue for tissue in report["export"]["tissues"]}
    assert set(get_type_hints(measures.ExportTissue)) == set(found["liver"])
    liver, skin = found["liver"], found["skin"]
    values = dielectric("Liver", 2.45e9)
    assert (liver["material"], liver["density"]) == ("Liver", 1079)
    assert (liver["permittivity"], liver["conductivity"]) == (values.permittivity, values.conductivity)
    assert liver["own_volume_mm3"] == pytest.approx(BALL * 15**3, rel=0.02)
    # The skin without what lies in it.
    volumes = {record["name"]: record["volume_mm3"] for record in report["tissues"]}
    assert skin["own_volume_mm3"] == pytest.approx(2 * volumes["skin"] - sum(volumes.values()))
    assert skin["mass_kg"] == pytest.approx(skin["own_volume_mm3"] * 1109e-9)
    masses = [tissue["mass_kg"] for tissue in found.values()]
    assert masses.count(None) == 1
    assert report["export"]["mass_kg"] == pytest.approx(sum(mass for mass in masses if mass))
    rows = list(csv.DictReader((out / "materials.csv").read_text().splitlines()))
    assert {row["name"]: row["density"] for row in rows} == {
        "3rd rib (left)": "1908.0", "liver": "1079.0", "skin": "1109.0", "ureter": ""
    }  # fmt: skip


def test_materials_of_the_user(body, out, tmp_path):
    (body / "vhp.toml").write_text(
        '[export]\nfor = "hfss"\nfrequency = "300 MHz"\n'
        '[materials."ureter"]\nmaterial = "wall"\npermittivity = 60\nconductivity = 0.8\ndensity = 1050\n'
        '[materials."liver"]\ndensity = 1000\n'
    )
    (tmp_path / "more.toml").write_text('[materials."LIV*"]\ndensity = 1066\nsource = "CT"\n')
    code, report = run(body, "-o", out, "--materials", tmp_path / "more.toml")
    assert code == 0
    found = {tissue["name"]: tissue for tissue in report["export"]["tissues"]}
    assert (found["liver"]["density"], found["liver"]["density_source"]) == (1066, "CT")
    assert (found["ureter"]["material"], found["ureter"]["permittivity"]) == ("wall", 60)
    assert report["export"]["without_material"] == []
    assert [row["match"] for row in report["settings"]["export"]["materials"]] == ["ureter", "liver", "LIV*"]
    assert "vhp_wall_300MHz" in (out / "import_hfss_native.py").read_text()


def test_list_of_materials(body):
    result = CliRunner().invoke(command, [str(body), "--list-materials", "--frequency", "300MHz"])
    assert result.exit_code == 0, result.output
    for text in ("Liver", "1079", "Gabriel et al. 1996: Skin (Dry)", "without a mass: ureter", "at 300 MHz"):
        assert text in result.output
    bare = CliRunner().invoke(command, [str(body), "--list-materials"]).output
    assert "need --frequency" in bare and "1079" in bare
    assert {path.name for path in body.parent.iterdir()} == {"body"}


# ---------------------------------------------------------------- the gate


@pytest.fixture
def broken(body) -> Path:
    """A model that fails: one tissue is inside out, one can't be read."""
    write_mesh(body / "liver.stl", flipped(sphere(15, (20, 0, 0), subdivisions=3)))
    (body / "junk.stl").write_bytes(b"solid no, this is nothing")
    return body


def test_a_failing_model_is_refused(broken, out):
    code, report = run(broken, "-o", out, "--for", "hfss")
    assert code == 1 and contents(out) == {"report.json"}
    export = report["export"]
    assert export["refused"] and not export["passed"] and export["files"] == []
    assert report["summary"]["counts"]["T005"] == 1
    # The report of a refusal is in nobody's way.
    write_mesh(broken / "liver.stl", sphere(15, (20, 0, 0), subdivisions=3))
    (broken / "junk.stl").unlink()
    code, report = run(broken, "-o", out, "--for", "cst")
    assert code == 0 and manifest(out)["gate"]["passed"]


def test_force_exports_a_failing_model_and_says_so(broken, out):
    code, report = run(broken, "-o", out, "--for", "hfss", "--force")
    assert code == 1
    found = manifest(out)
    assert found["gate"]["forced"] and not found["gate"]["passed"] and found["gate"]["counts"]["T005"] == 1
    assert found["left_out"] == ["junk"] == report["export"]["left_out"]
    assert report["export"]["forced"] and not report["export"]["refused"] and not report["summary"]["passed"]
    # As it was: nothing is mended on the way out.
    assert trimesh.load(out / "stl" / "liver.stl", process=False).volume < 0


def test_a_refusal_removes_what_an_earlier_export_wrote(body, out):
    assert run(body, "-o", out, "--for", "hfss")[0] == 0
    (out / "mine.txt").write_text("kept")
    (out / "stl" / "mine.stl").write_text("kept")
    write_mesh(body / "liver.stl", flipped(sphere(15, (20, 0, 0))))
    assert run(body, "-o", out, "--for", "hfss", "--overwrite")[0] == 1
    assert contents(out) == {"report.json", "mine.txt", "stl/mine.stl"}


def test_a_refusal_leaves_the_results_of_other_commands(body, out):
    assert main(["-q", "heal", str(body), "-o", str(out), "-j1"]) == 0
    healed = {path.name: path.read_bytes() for path in out.iterdir() if path.suffix in (".stl", ".ply")}
    assert healed
    write_mesh(body / "liver.stl", flipped(sphere(15, (20, 0, 0))))
    assert run(body, "-o", out, "--for", "hfss", "--overwrite")[0] == 1
    assert {path.name: path.read_bytes() for path in out.iterdir() if path.suffix in (".stl", ".ply")} == healed


def test_profiles_of_the_targets(body, out):
    """Two bodies at 0.5 mm from each other are too near for `strict` and far enough for HFSS."""
    write_mesh(body / "kidney.stl", sphere(5, (0, 40.5, 0), subdivisions=2))
    assert run(body, "-o", out, "--for", "generic")[0] == 1
    assert run(body, "-o", out, "--for", "hfss")[0] == 0
    assert run(body, "-o", out, "--for", "hfss", "--profile", "strict", "--overwrite")[0] == 1
    assert run(body, "-o", out, "--for", "generic", "--gap", "0.2")[0] == 0


def test_features_are_judged_in_units_of_the_target(body, out, capsys):
    """Edges of less than 1 mm are less than 1e-3 m: too small for HFSS in metres, not in millimetres."""
    write_mesh(body / "node.stl", sphere(2, (0, -30, 0), subdivisions=2))
    code, report = run(body, "-o", out, "--for", "hfss", "--out-units", "m")
    assert code == 1 and set(report["summary"]["counts"]) == {"Q002"}
    assert main(["export", str(body), "-o", str(out), "--for", "hfss", "--out-units", "um"]) == 2
    assert "the model reaches to 6e+04 um, hfss takes 10000 at most" in capsys.readouterr().err
    assert run(body, "-o", out, "--for", "generic", "--out-units", "m")[0] == 0


@pytest.mark.parametrize(("unit", "size"), [("um", 1e-3), ("mm", 1.0), ("cm", 10.0), ("in", 25.4), ("m", 1000.0)])
def test_units(unit, size, body, out):
    code, report = run(body, "-o", out, "--for", "generic", "--out-units", unit, "--format", "+mat,+3mf")
    assert code == 0 and (report["export"]["unit"], report["export"]["mm_per_unit"]) == (unit, size)
    liver = trimesh.load(body / "liver.stl").bounds
    for name in ("stl/liver.stl", "ply/liver.ply"):
        assert trimesh.load(out / name).bounds * size == pytest.approx(liver, abs=1e-5)
    read = scipy.io.loadmat(out / "mat" / "liver.mat")
    assert read["P"].min() * size == pytest.approx(liver.min(), abs=1e-5) and read["unit"] == [unit]
    # All formats of an export hold the same numbers.
    single = read_mesh(out / "stl" / "liver.stl").mesh
    assert np.array_equal(read["P"], single.vertices) and np.array_equal(read["t"] - 1, single.faces)
    # The report is in mm, whatever the unit of the files.
    [record] = [record for record in report["tissues"] if record["name"] == "liver"]
    assert record["volume_mm3"] == pytest.approx(BALL * 15**3, rel=0.02)


def test_input_in_centimetres(body, out):
    for path in body.iterdir():
        mesh = read_mesh(path).mesh
        write_mesh(path, Mesh(mesh.vertices / 10, mesh.faces))
    assert run(body, "-o", out, "--units", "cm", "--for", "hfss")[0] == 0
    assert trimesh.load(out / "stl" / "skin.stl").bounds[1] == pytest.approx([60, 60, 60], rel=1e-3)


def test_what_rounding_breaks_is_not_exported(tmp_path, out):
    """Sound as doubles; in float32 the small edges of a body far from the origin collapse."""
    directory = tmp_path / "far"
    directory.mkdir()
    ball = sphere(0.002, subdivisions=2)
    write_mesh(directory / "speck.ply", moved(ball, (9000, 0, 0)))
    options = ("--ignore", "F007,Q002", "--min-q", "0.001")
    code, report = run(directory, "-o", out, "--for", "generic", *options)
    assert code == 1 and contents(out) == {"report.json"} and report["export"]["refused"]
    assert report["export"]["notes"] == [
        "the model passes, and what was written of it, rounded, does not: nothing is kept"
    ]
    assert not report["summary"]["passed"] and report["summary"]["errors"] > 0
    # As doubles it can go out.
    code, report = run(directory, "-o", out, "--for", "generic", "--format", "ply,mat,vtp", *options)
    assert code == 0 and report["export"]["tissues"][0]["rounding_mm"] == 0


def test_nastran_text_is_judged_as_it_is_rounded(tmp_path, out, monkeypatch):
    directory = tmp_path / "model"
    directory.mkdir()
    write_mesh(directory / "a.ply", Mesh(sphere(10).vertices / 3, sphere(10).faces))
    grid = pipeline.judged.__globals__["nastran"].grid_template

    def coarse(points, unit="mm"):
        return grid(points, unit).replace(f".{grid(points, unit).split('%16.')[1].split('f')[0]}f", ".0f")

    monkeypatch.setattr("vhp_cli.formats.surfaces.nastran.grid_template", coarse)
    code, report = run(directory, "-o", out, "--for", "comsol")
    assert code == 1 and contents(out) == {"report.json"}
    assert any("model.nas, rounded to its columns" in note for note in report["export"]["notes"])


def test_a_file_that_is_not_what_was_written_is_noticed(body, out, monkeypatch, capsys):
    write = pipeline.write_surfaces

    def damaged(path, surfaces, form, unit):
        write(path, surfaces, form, unit)
        if path.name == "liver.ply":
            data = bytearray(path.read_bytes())
            data[-40] ^= 1
            path.write_bytes(bytes(data))

    monkeypatch.setattr(pipeline, "write_surfaces", damaged)
    code = main(["export", str(body), "-o", str(out), "--for", "generic"])
    assert code == 2 and "ply/liver.ply does not hold what was written to it" in capsys.readouterr().err
    assert not (out / "manifest.json").exists()


# ---------------------------------------------------------------- running


def test_same_model_same_bytes(body, out, tmp_path):
    options = ("--for", "generic", "--frequency", "1GHz", "--format", "+mat-all,+3mf,+obj")
    assert run(body, "-o", out, *options)[0] == 0
    assert run(body, "-o", tmp_path / "again", *options, "-j2", "--no-cache")[0] == 0
    assert data_of(out) == data_of(tmp_path / "again")


def test_a_second_run_takes_the_first_over(body, out, capsys):
    arguments = ["export", str(body), "-o", str(out), "--for", "hfss"]
    assert main(arguments) == 0
    first, times = data_of(out), {path: path.stat().st_mtime_ns for path in (out / "stl").iterdir()}
    assert main(arguments) == 0
    assert "4 files were taken from the run before" in capsys.readouterr().err
    assert data_of(out) == first and {path: path.stat().st_mtime_ns for path in times} == times
    # Of a changed tissue the file is written anew, and only this.
    write_mesh(body / "liver.stl", sphere(14, (20, 0, 0), subdivisions=3))
    assert main(arguments) == 0
    changed = {path.name for path in times if path.stat().st_mtime_ns != times[path]}
    assert changed == {"liver.stl"}
    manifest(out)


def test_other_settings_need_overwrite(body, out, capsys):
    assert run(body, "-o", out, "--for", "hfss")[0] == 0
    assert main(["export", str(body), "-o", str(out), "--for", "hfss", "--frequency", "1GHz"]) == 2
    assert "with other settings" in capsys.readouterr().err
    assert run(body, "-o", out, "--for", "matlab", "--overwrite")[0] == 0
    # Nothing of the first export is left.
    assert {file["file"] for file in manifest(out)["files"]} == EXPECTED["matlab"] | {"materials.csv"}


DRIVER = """
import sys, time
from vhp_cli.pipeline import export
write = export.write_surfaces
def slow(*arguments):
    write(*arguments)
    time.sleep(0.3)
export.write_surfaces = slow
from vhp_cli.cli import main
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.skipif(os.name == "nt", reason="no SIGKILL")
def test_a_killed_run_is_taken_up(body, out, tmp_path):
    arguments = ["export", str(body), "-o", str(out), "--for", "generic", "-j1"]
    with subprocess.Popen(
        [sys.executable, "-c", DRIVER, *arguments], env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    ) as process:
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline and len(list((out / "stl").glob("*.stl"))) < 2:
            time.sleep(0.01)
        process.send_signal(signal.SIGKILL)
    assert not (out / "manifest.json").exists()
    assert main(["-q", *arguments]) == 0
    assert json.loads((out / "report.json").read_text())["run"]["reused"] >= 1
    assert run(body, "-o", tmp_path / "undisturbed", "--for", "generic")[0] == 0
    assert data_of(out) == data_of(tmp_path / "undisturbed")
    assert not list(out.rglob("*.tmp"))


def test_a_full_disk_is_said(body, out, monkeypatch, capsys):
    def full(path, surfaces, form, unit):
        raise refused(path, OSError(28, "No space left on device"))

    assert run(body, "-o", out, "--for", "hfss")[0] == 0
    write_mesh(body / "liver.stl", sphere(14, (20, 0, 0), subdivisions=3))
    with monkeypatch.context() as patched:
        patched.setattr(pipeline, "write_surfaces", full)
        assert main(["export", str(body), "-o", str(out), "--for", "hfss"]) == 3
    assert "No space left on device" in capsys.readouterr().err
    # A manifest never names files that are not there, or other ones.
    assert not (out / "manifest.json").exists()
    assert run(body, "-o", out, "--for", "hfss")[0] == 0
    assert manifest(out)["gate"]["passed"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([], "--for is needed: one of hfss, cst, matlab, comsol, print, generic"),
        (["--for", "hfss", "--format", "step"], "no such format of surfaces: 'step'"),
        (["--for", "hfss", "--format", "stl,,ply"], "expected formats separated by commas"),
        (["--for", "hfss", "--frequency", "5 Hz"], "expected 10 Hz to 100 GHz"),
        (["--for", "hfss", "--materials", "missing.toml"], "missing.toml: can't be read"),
        (["--for", "abaqus"], "is not one of 'hfss'"),
        (["--list-materials", "--report", "x.json"], "--list-materials writes no report"),
    ],
)
def test_wrong_usage(options, message, body, out, capsys):
    assert main(["export", str(body), "-o", str(out), *options]) == 2
    assert message in capsys.readouterr().err
    assert not out.exists()


def test_frequencies_of_the_settings(body, out, capsys):
    (body / "vhp.toml").write_text('[export]\nfor = "cst"\nfrequency = 3e8\n')
    code, report = run(body, "-o", out)
    assert code == 0 and report["export"]["frequency_hz"] == 3e8 == report["settings"]["export"]["frequency"]
    code, report = run(body, "-o", out, "--frequency", "1GHz", "--overwrite")
    assert code == 0 and report["export"]["frequency_hz"] == 1e9
    (body / "vhp.toml").write_text('[export]\nfor = "cst"\nfrequency = "fast"\n')
    assert main(["export", str(body), "-o", str(out)]) == 2
    assert "frequency 'fast': expected 10 Hz to 100 GHz" in capsys.readouterr().err
    (body / "vhp.toml").write_text('[[tissue]]\nmatch = "liver"\nexport = { for = "cst" }\n')
    assert main(["export", str(body), "-o", str(out), "--for", "cst"]) == 2
    assert "export belongs to the whole run" in capsys.readouterr().err
    (body / "vhp.toml").write_text("materials = 3\n")
    assert main(["export", str(body), "-o", str(out), "--for", "cst"]) == 2
    assert 'write [materials."pattern"] tables' in capsys.readouterr().err
    (body / "vhp.toml").write_text('[export]\nfro = "cst"\n')
    assert main(["export", str(body), "-o", str(out)]) == 2
    assert "export: 'fro' is not known; did you mean 'for'" in capsys.readouterr().err


def test_output_is_needed_and_may_not_be_the_model(body, capsys):
    assert main(["export", str(body), "--for", "hfss"]) == 2
    assert "-o OUT is needed" in capsys.readouterr().err
    assert main(["export", str(body), "-o", str(body / "out"), "--for", "hfss"]) == 2
    assert "overlap" in capsys.readouterr().err


def test_dry_run_names_what_would_be_written(body, out):
    result = CliRunner().invoke(command, [str(body), "-o", str(out), "--for", "cst", "--dry-run"])
    assert result.exit_code == 0 and not out.exists()
    listed = [line.split("\t")[0] for line in result.output.splitlines()]
    code, _ = run(body, "-o", out, "--for", "cst")
    assert code == 0 and {Path(line).relative_to(out).as_posix() for line in listed} == contents(out) - {
        "report.json", ".vhp-run.jsonl"
    }  # fmt: skip


def test_scripts_need_their_format(body, out):
    code, report = run(body, "-o", out, "--for", "hfss", "--format", "ply")
    assert code == 0 and not list(out.glob("*.py"))
    assert any("import_hfss_native.py: it needs the format stl" in note for note in report["export"]["notes"])


def test_tissues_of_one_name_stay_apart(body, out):
    """Stems that differ in case or punctuation only are an error of the gate, and still do not overwrite each other."""
    shutil.copy(body / "ureter.stl", body / "Liver!.stl")
    _, report = run(body, "-o", out, "--for", "hfss", "--force", "--ignore", "F006")
    objects = [tissue["object"] for tissue in report["export"]["tissues"]]
    assert len({name.casefold() for name in objects}) == 5
    assert len(list((out / "stl").iterdir())) == 5


@pytest.mark.slow
def test_real_ribs_for_every_target(shared_data, tmp_path):
    source = shared_data / "bones"
    if not source.is_dir():
        pytest.skip("no bones")
    directory = tmp_path / "bones"
    directory.mkdir()
    for number, path in enumerate(sorted(source.glob("*.stl"))[:3]):
        shutil.copy(path, directory / f"{number}_{path.name}")
    for target in EXPECTED:
        assert run(directory, "-o", tmp_path / target, "--for", target, "--force")[0] in (0, 1)
        assert manifest(tmp_path / target)["tissues"]
