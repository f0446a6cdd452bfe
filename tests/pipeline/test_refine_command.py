"""``vhp decimate --refine`` from end to end."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from heal_runs import meshes, tissue
from shapes import box, moved, sphere
from smoothing_shapes import tube

from vhp_cli.cli import main
from vhp_cli.commands import refining
from vhp_cli.commands.decimate import decimate
from vhp_cli.formats import read_mesh, write_mesh
from vhp_cli.stages.decimate.options import KEYS as DECIMATE_KEYS
from vhp_cli.stages.refine.options import KEYS, SCENARIOS


def run(*arguments) -> tuple[int, dict]:
    result = CliRunner().invoke(decimate, [*map(str, arguments), "--report", "-"])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, json.loads(result.stdout)


@pytest.fixture
def model(tmp_path: Path) -> Path:
    directory = tmp_path / "model"
    directory.mkdir()
    write_mesh(directory / "liver.stl", sphere(10, subdivisions=2))
    write_mesh(directory / "nerve.stl", moved(tube(rings=60), (0, 30, 0)))
    write_mesh(directory / "rib.stl", moved(box(), (0, -40, 0)))
    return directory


@pytest.fixture
def errors(model: Path, tmp_path: Path) -> Path:
    directory = tmp_path / "errors"
    directory.mkdir()
    for path in model.glob("*.stl"):
        n_faces = len(read_mesh(path).mesh.faces)
        np.save(directory / f"{path.stem}.npy", np.random.default_rng(0).random(n_faces))
    return directory


def messages(record, step):
    return [action["message"] for action in record["actions"] if action["step"] == step]


def write_ply(path, mesh, values, name="error"):
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(mesh.vertices)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {len(mesh.faces)}\nproperty float {name}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.zeros(len(mesh.faces), dtype=[("value", "<f4"), ("count", "u1"), ("corners", "<i4", 3)])
    faces["value"], faces["count"], faces["corners"] = values, 3, mesh.faces
    path.write_bytes(header.encode() + mesh.vertices.astype("<f4").tobytes() + faces.tobytes())


@pytest.mark.parametrize(
    "arguments", [("--by", "size"), ("--by", "size", "--levels", 2), ("--by", "size", "--no-smooth")]
)
def test_by_size(model, tmp_path, arguments):
    code, report = run(model, "-o", tmp_path / "out", "--refine", 15, *arguments, "-j1")
    assert code == 0
    assert report["command"] == "decimate"
    assert report["settings"]["decimate"]["refine"] == 15
    assert report["summary"]["passed"]
    for record in report["tissues"]:
        assert record["status"] == "changed" and record["introduced"] == []
        assert record["triangles"] > record["before"]["triangles"]
        assert record["triangles"] == len(read_mesh(tmp_path / "out" / record["file"]).mesh.faces)
        assert abs(record["volume_change"]) <= 1e-3
        assert len(messages(record, "pick")) == len(messages(record, "split")) == 1
        assert bool(messages(record, "relax")) == ("--no-smooth" not in arguments) or record["name"] == "rib"
    assert messages(tissue(report, "liver"), "pick")[0].startswith("48 of 320 triangles picked (15 %), size")


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_by_errors_in_a_directory(model, errors, tmp_path, scenario):
    arguments = ("--refine", 30, "--errors", errors, "--scenario", scenario, "--no-smooth", "-j1")
    code, report = run(model, "-o", tmp_path / "out", *arguments)
    assert code == 0
    mesh = read_mesh(model / "liver.stl").mesh
    values = np.load(errors / "liver.npy")
    worst = set(np.argsort(-values)[:96].tolist())
    made = read_mesh(tmp_path / "out" / "liver.stl").mesh
    left = {frozenset(map(tuple, corners)) for corners in made.vertices[made.faces].tolist()}
    for face, corners in enumerate(mesh.vertices[mesh.faces].tolist()):
        is_whole = frozenset(map(tuple, corners)) in left
        if scenario == "all-edges" and face in worst:
            assert not is_whole
        if scenario == "shared-edges" and face not in worst:
            assert is_whole
    assert messages(tissue(report, "liver"), "pick")[0].startswith("96 of 320 triangles picked (30 %), error from")


def test_one_file_for_one_tissue(model, errors, tmp_path):
    arguments = ("--refine", 15, "--errors", errors / "nerve.npy")
    code, report = run(model / "nerve.stl", "-o", tmp_path / "out", *arguments)
    assert code == 0 and report["tissues"][0]["status"] == "changed"
    result = CliRunner().invoke(decimate, [str(model), "-o", str(tmp_path / "none"), *map(str, arguments)])
    assert "has 3 tissues" in str(result.exception)


def test_errors_in_ply_files(tmp_path):
    model = tmp_path / "model"
    model.mkdir()
    mesh = sphere(10, subdivisions=2)
    values = np.random.default_rng(1).random(320).astype(np.float32)
    write_ply(model / "a.ply", mesh, values)
    write_mesh(model / "b.stl", moved(mesh, (40, 0, 0)))
    code, report = run(model, "-o", tmp_path / "out", "--refine", 10, "-j1")
    assert code == 3
    assert tissue(report, "b")["status"] == "failed"
    assert "only PLY files" in tissue(report, "b")["reason"]
    assert tissue(report, "a")["status"] == "changed"
    # The same errors beside the file, and under another name in it, give the same surface.
    np.save(tmp_path / "a.npy", values)
    run(model / "a.ply", "-o", tmp_path / "beside", "--refine", 10, "--errors", tmp_path / "a.npy")
    (tmp_path / "other").mkdir()
    write_ply(tmp_path / "other" / "a.ply", mesh, values, "residual")
    code, _ = run(tmp_path / "other", "-o", tmp_path / "named", "--refine", 10, "--error-property", "residual")
    assert code == 0
    first, *others = (read_mesh(tmp_path / name / "a.ply").mesh for name in ("out", "beside", "named"))
    assert len(first.faces) > 320
    for other in others:
        assert (other.vertices == first.vertices).all() and (other.faces == first.faces).all()
    code, report = run(tmp_path / "other", "-o", tmp_path / "none", "--refine", 10)
    assert code == 3 and "have no number 'error'" in report["tissues"][0]["reason"]


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda path: path.unlink(), "no errors: "),
        (lambda path: path.write_bytes(b"abc"), "not a whole NPY file"),
        (lambda path: np.save(path, np.ones(319)), "319 errors for 320 facets"),
        (lambda path: np.save(path, np.full(320, np.nan)), "320 errors negative or not finite"),
    ],
)
def test_what_is_wrong_with_the_errors_of_one_tissue_stays_there(model, errors, tmp_path, spoil, words):
    spoil(errors / "liver.npy")
    code, report = run(model, "-o", tmp_path / "out", "--refine", 15, "--errors", errors, "-j1")
    assert code == 3
    record = tissue(report, "liver")
    assert record["status"] == "failed" and words in record["reason"]
    assert (tmp_path / "out" / "liver.stl").read_bytes() == (model / "liver.stl").read_bytes()
    assert [tissue(report, name)["status"] for name in ("nerve", "rib")] == ["changed", "changed"]


def test_workers_do_not_matter(model, errors, tmp_path):
    for jobs in (1, 2):
        run(model, "-o", tmp_path / f"out{jobs}", "--refine", 15, "--errors", errors, f"-j{jobs}")
    assert meshes(tmp_path / "out1") == meshes(tmp_path / "out2")


def test_other_errors_are_another_run(model, errors, tmp_path):
    arguments = [str(model), "-o", str(tmp_path / "out"), "--refine", "15", "--errors", str(errors), "-j1"]
    assert main(["decimate", *arguments]) == 0
    before = meshes(tmp_path / "out")
    assert run(*arguments)[1]["run"]["reused"] == 3
    np.save(errors / "liver.npy", np.arange(320.0))
    assert main(["decimate", *arguments]) == 2
    assert main(["decimate", *arguments, "--overwrite"]) == 0
    after = meshes(tmp_path / "out")
    assert [name for name in before if before[name] != after[name]] == ["liver.stl"]


def test_neighbours_do_not_meet(tmp_path):
    """Spheres as near as may be: what smoothing can't do more gently is not smoothed, and the gap stays."""
    model = tmp_path / "model"
    model.mkdir()
    write_mesh(model / "outer.stl", sphere(11.0, subdivisions=3))
    write_mesh(model / "inner.stl", sphere(10, subdivisions=3))
    (model / "vhp.toml").write_text("gap-search = 3.0\n")
    code, report = run(model, "-o", tmp_path / "probe", "--refine", 40, "--by", "size", "--gap", 0.1, "-j1")
    assert code == 0
    gap = report["pairs"][0]["min_gap_mm"]
    given = run(model, "-o", tmp_path / "whole", "--refine", 40, "--by", "size", "--gap", 0.1, "--no-smooth", "-j1")
    limit = given[1]["pairs"][0]["min_gap_mm"] - 1e-4
    assert gap < limit
    code, report = run(model, "-o", tmp_path / "out", "--refine", 40, "--by", "size", "--gap", limit, "-j1")
    assert code == 0
    assert report["pairs"][0]["min_gap_mm"] >= limit
    for record in report["tissues"]:
        assert record["introduced"] == []
        assert record["status"] == "changed" and record["triangles"] > 1280
    assert any(messages(record, "contacts") for record in report["tissues"])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--refine", "15", "--ratio", "0.5"), "--refine and --ratio exclude each other"),
        (("--refine", "15", "--by", "size", "--target-q", "0.5"), "exclude each other"),
        (("--levels", "2", "--triangles", "100"), "exclude each other"),
        (("--by", "size"), "--by needs --refine"),
        (("--no-smooth",), "--smooth needs --refine"),
        (("--refine", "15"), "where are the errors"),
        (("--refine", "15", "--error-property", "error"), "where are the errors"),
        (("--refine", "15", "--by", "size", "--errors", "."), "by size, no errors are needed"),
        (("--refine", "15", "--errors", ".", "--error-property", "e"), "not both"),
        (("--refine", "15", "--errors", "missing"), "no such file or directory"),
        (("--refine", "0", "--by", "size"), "0<x<=100"),
        (("--refine", "nan", "--by", "size"), "refine"),
        (("--refine", "15", "--by", "area"), "area"),
        (("--refine", "15", "--by", "size", "--scenario", "a"), "scenario"),
        (("--refine", "15", "--by", "size", "--levels", "0"), "levels"),
    ],
)
def test_wrong_usage(model, tmp_path, capsys, arguments, message):
    assert main(["decimate", str(model), "-o", str(tmp_path / "out"), *arguments]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_settings_file(model, errors, tmp_path, monkeypatch):
    errors.rename(model / "errors")
    (model / "vhp.toml").write_text(
        '[decimate]\nrefine = 10\nerrors = "errors"\nmethod = "midpoint"\n'
        '[[tissue]]\nmatch = "nerve"\ndecimate = { by = "size", refine = 50, scenario = "shared-edges" }\n'
    )
    monkeypatch.chdir(tmp_path)
    code, report = run("model", "-o", "out", "-j1")
    assert code == 0
    assert report["settings"]["decimate"]["errors"] == str(model / "errors")
    assert messages(tissue(report, "liver"), "pick")[0].startswith("32 of 320 triangles picked (10 %), error")
    n_faces = tissue(report, "nerve")["before"]["triangles"]
    assert messages(tissue(report, "nerve"), "pick")[0].startswith(
        f"{n_faces // 2} of {n_faces} triangles picked (50 %), size"
    )
    assert messages(tissue(report, "nerve"), "split")[0].startswith("shared-edges")
    # A flag decides which of the two it is; what the file says of the other takes no part.
    code, report = run("model", "-o", "fewer", "--ratio", 0.8, "-j1")
    assert code == 0
    assert report["settings"]["decimate"]["ratio"] == 0.8 and "refine" not in report["settings"]["decimate"]
    assert tissue(report, "nerve")["triangles"] <= 0.8 * n_faces


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[decimate]\nrefine = 10\nratio = 0.5\n", "refine and ratio exclude each other"),
        ("[decimate]\nrefine = 10\nby = 'area'\n", "'area' is not known"),
        ("[decimate]\nrefine = true\n", "decimate.refine: expected a number"),
        (
            "[decimate]\nrefine = 10\nby = 'size'\n[[tissue]]\nmatch = '*'\ndecimate = { ratio = 0.5 }\n",
            "either refines",
        ),
        ("[decimate]\nratio = 0.5\n[[tissue]]\nmatch = '*'\ndecimate = { refine = 5 }\n", "either refines"),
        ("[decimate]\nrefine = 10\n[[tissue]]\nmatch = '*'\ndecimate = { errors = 'x' }\n", "belongs to the whole run"),
        ("[decimate]\nrefine = 10\nby = 'size'\n[[tissue]]\nmatch = 'no'\ndecimate = { level = 2 }\n", "'levels'"),
    ],
)
def test_wrong_settings(model, tmp_path, capsys, text, words):
    (model / "vhp.toml").write_text(text)
    assert main(["decimate", str(model), "-o", str(tmp_path / "out")]) == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_every_option_is_on_the_command_line_and_explained():
    names = {max(parameter.opts, key=len).removeprefix("--") for parameter in decimate.params}
    assert names >= KEYS.keys()
    page = (Path(__file__).resolve().parents[2] / "docs" / "decimate.md").read_text()
    for key in KEYS:
        assert f"`--{key}" in page, key
    scenario = next(parameter for parameter in decimate.params if parameter.name == "scenario")
    assert tuple(scenario.type.choices) == tuple(SCENARIOS)
    # Every key belongs to one of the two, but for the one that they share.
    assert set(refining.DECIMATING) | {"max-deviation"} == DECIMATE_KEYS.keys()
    assert set(refining.REFINING) | {"max-deviation"} == KEYS.keys()
