"""`vhp smooth` from end to end: what it writes, says and refuses."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner
from heal_runs import meshes, tissue
from shapes import moved, sphere
from smoothing_shapes import defects, q_of, rough_sphere, single, tube, volume

from vhp_cli.cli import main
from vhp_cli.commands import smooth as command
from vhp_cli.formats import read_mesh, write_mesh
from vhp_cli.kernels.smoothing import smooth_vertices
from vhp_cli.mesh import Mesh
from vhp_cli.stages.smooth.options import KEYS, METHODS


def run(*arguments) -> tuple[int, dict]:
    options = ["--report", "-", *([] if "-j" in arguments else ["-j1"])]
    result = CliRunner().invoke(command.smooth, [*map(str, arguments), *options])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, json.loads(result.stdout)


def nerve():
    return moved(tube(seed=0, noise=0.5, rings=60, length=15, bend=4), (20, 0, 0))


@pytest.fixture
def model(tmp_path):
    directory = tmp_path / "model"
    directory.mkdir()
    write_mesh(directory / "skin.stl", sphere(60, subdivisions=3))
    write_mesh(directory / "liver.stl", rough_sphere(0, 0.15))
    write_mesh(directory / "nerve.stl", nerve())
    return directory


def test_quality_rises_and_the_report_tells_how(model, out):
    before = meshes(model)
    code, report = run(model, "-o", out)
    assert code == 0 and report["summary"]["passed"] and report["command"] == "smooth"
    assert meshes(model) == before
    assert report == json.loads((out / "report.json").read_text())
    assert report["settings"]["smooth"].keys() == KEYS.keys()
    for name in ("liver", "nerve"):
        record = tissue(report, name)
        given, made = read_mesh(model / f"{name}.stl").mesh, read_mesh(out / f"{name}.stl").mesh
        assert record["status"] == "changed" and record["introduced"] == []
        assert record["quality"]["mean"] > record["before"]["quality"]["mean"]
        assert record["quality"]["min"] >= record["before"]["quality"]["min"]
        assert abs(record["volume_change"]) <= 1e-3
        assert 0 < record["deviation_mm"]["max"] <= 0.1
        assert defects(made) == defects(given)
        history = record["history"]
        assert history[0]["step"] == "input" and history[0]["moves"] == 0
        assert history[0]["min_q"] == pytest.approx(q_of(given).min(), rel=1e-6)
        assert history[-1]["mean_q"] == pytest.approx(q_of(made).mean(), rel=1e-6)
        assert history[-1]["volume_mm3"] == pytest.approx(volume(made), rel=1e-6)
        # The angle between the faces, and by how much the surface turns there.
        for entry, measures in ((history[0], record["before"]), (history[-1], record)):
            assert entry["max_turn_deg"] == pytest.approx(180 - measures["min_dihedral_deg"], abs=1e-6)
        assert record["actions"][0]["step"] == "relax" and "mean q" in record["actions"][0]["message"]


def test_the_report_validates_against_the_published_schema(model, out):
    jsonschema = pytest.importorskip("jsonschema")
    from vhp_cli.report import schema

    _, report = run(model, "-o", out)
    jsonschema.Draft202012Validator(schema()).validate(report)
    del tissue(report, "liver")["history"][0]["min_q"]
    assert not jsonschema.Draft202012Validator(schema()).is_valid(report)


def test_any_number_of_workers_gives_the_same_bytes(model, tmp_path):
    outputs = []
    for jobs in (1, 2):
        code, _ = run(model, "-o", tmp_path / f"out{jobs}", "-j", jobs, "--no-cache")
        assert code == 0
        outputs.append(meshes(tmp_path / f"out{jobs}"))
    assert outputs[0] == outputs[1]


def test_a_second_run_does_nothing_and_other_options_are_refused(model, out):
    run(model, "-o", out)
    first = meshes(out)
    code, report = run(model, "-o", out)
    assert code == 0 and report["run"]["reused"] == 3 and meshes(out) == first
    assert tissue(report, "nerve")["history"]
    assert main(["smooth", str(model), "-o", str(out), "--method", "cvt"]) == 2
    assert main(["smooth", str(model), "-o", str(model)]) == 2


def test_dry_run(model, out):
    result = CliRunner().invoke(command.smooth, [str(model), "-o", str(out), "--dry-run"])
    assert [line.split("\t")[1] for line in result.stdout.splitlines()] == ["smooth"] * 3
    assert not out.exists()


def test_unguarded_is_written_whatever_it_is(tmp_path, out):
    """What the standard method does to a nerve: worse, but asked for, and the gate has the last word."""
    (tmp_path / "model").mkdir()
    thin = tube(sides=6, seed=3, noise=0.9, rings=40, length=10, bend=6, radius=0.4)
    write_mesh(tmp_path / "model" / "nerve.stl", thin)
    given = read_mesh(tmp_path / "model" / "nerve.stl").mesh
    code, report = run(tmp_path / "model", "-o", out, "--method", "standard", "--unguarded", "--iterations", 40)
    made = read_mesh(out / "nerve.stl").mesh
    expected = smooth_vertices(given.vertices, given.faces, iterations=40)
    corners = {tuple(face) for face in single(expected)[given.faces].reshape(-1, 9)}
    assert {tuple(face) for face in made.vertices[made.faces].reshape(-1, 9)} <= corners
    record = tissue(report, "nerve")
    assert record["status"] == "changed"
    assert {entry["rule"] for entry in record["introduced"]} and code == 1
    guarded = run(tmp_path / "model", "-o", tmp_path / "guarded", "--method", "standard", "--iterations", 40)
    assert not tissue(guarded[1], "nerve")["introduced"]


def test_neighbours_keep_their_gap(tmp_path, out):
    """Two rough spheres whose gap would fall below the limit if one moved: what can't be done more gently is left."""
    (tmp_path / "model").mkdir()
    left = rough_sphere(0, 0.15)
    right = moved(rough_sphere(1, 0.15), (21.5, 0, 0))
    for name, mesh in (("left", left), ("right", right)):
        write_mesh(tmp_path / "model" / f"{name}.stl", mesh)
    code, report = run(tmp_path / "model", "-o", tmp_path / "probe", "--gap", 0.5, "--gap-search", 5)
    assert code == 0
    gap = report["pairs"][0]["min_gap_mm"]
    before = run(tmp_path / "model", "-o", tmp_path / "same", "--gap", 0.5, "--gap-search", 5, "--iterations", 0)
    given = before[1]["pairs"][0]["min_gap_mm"]
    assert gap != given
    # A limit between the two, or just below what there is.
    limit = (gap + given) / 2 if gap < given else given - 1e-7
    code, report = run(tmp_path / "model", "-o", out, "--gap", limit, "--gap-search", 5)
    assert code == 0
    assert report["pairs"][0]["min_gap_mm"] >= limit
    assert all(record["introduced"] == [] for record in report["tissues"])


def test_a_tissue_that_always_meets_its_neighbour_is_left(tmp_path, out, monkeypatch):
    (tmp_path / "model").mkdir()
    write_mesh(tmp_path / "model" / "skin.stl", sphere(20, subdivisions=3))
    write_mesh(tmp_path / "model" / "box.stl", box_at(10))
    monkeypatch.setattr(command, "TARGET", "stage_targets:move_out")
    code, report = run(tmp_path / "model", "-o", out)
    record = tissue(report, "box")
    assert record["status"] == "refused" and "neighbour" in record["reason"]
    assert (out / "box.stl").read_bytes() == (tmp_path / "model" / "box.stl").read_bytes()
    assert code == 0 and record["introduced"] == []


def box_at(x):
    from shapes import box

    return box((x, 0, 0), (x + 2, 2, 2))


@pytest.mark.parametrize(
    "arguments",
    [
        ("--unguarded",),
        ("--method", "cvt", "--unguarded", "--max-dihedral", "40"),
        ("--max-dihedral", "40", "--feature-angle", "30"),
        ("--volume-tolerance", "0"),
        ("--max-deviation", "0"),
        ("--method", "best"),
        ("--until-q", "1.5"),
        ("--iterations", "-1"),
    ],
)
def test_wrong_usage(model, out, arguments):
    assert main(["smooth", str(model), "-o", str(out), *arguments]) == 2
    assert not out.exists()


@pytest.mark.parametrize(
    "text",
    [
        "[smooth]\nmethod = 'best'",
        "[smooth]\nmethods = 'cvt'",
        "[smooth]\niterations = 2.5",
        "[smooth]\nflips = 1",
        "[smooth]\nuntil-q = 'high'",
        "[smooth]\nupdate = 3",
        "[[tissue]]\nmatch = '*'\nsmooth = { unguarded = true }",
        "[[tissue]]\nmatch = '*'\nsmooth = { max-dihedral = 20, feature-angle = 20 }",
    ],
)
def test_wrong_settings(model, out, text, capsys):
    (model / "vhp.toml").write_text(text)
    assert main(["smooth", str(model), "-o", str(out)]) == 2
    assert "smooth" in capsys.readouterr().err
    assert not out.exists()


def test_settings_by_tissue(model, out):
    (model / "vhp.toml").write_text(
        "[smooth]\niterations = 1\nmax-deviation = 0.05\n"
        "[[tissue]]\nmatch = '*nerve*'\nsmooth = { method = 'standard', iterations = 2 }\n"
    )
    code, report = run(model, "-o", out, "--volume-tolerance", 0.01)
    assert code == 0
    assert report["settings"]["smooth"]["iterations"] == 1
    assert report["settings"]["smooth"]["volume-tolerance"] == 0.01
    steps = {name: {entry["step"] for entry in tissue(report, name)["history"]} for name in ("nerve", "liver")}
    assert "standard" in steps["nerve"] and "relax" in steps["liver"]
    assert max(entry["iteration"] for entry in tissue(report, "nerve")["history"]) == 2
    assert (out / "vhp.toml").read_bytes() == (model / "vhp.toml").read_bytes()


def test_methods_on_the_command_line_are_those_of_the_stage():
    option = next(parameter for parameter in command.smooth.params if parameter.name == "method")
    assert tuple(option.type.choices) == METHODS
    names = {max(parameter.opts, key=len).removeprefix("--") for parameter in command.smooth.params}
    assert names >= KEYS.keys()


def test_a_defective_tissue_keeps_its_defects(tmp_path, out):
    (tmp_path / "model").mkdir()
    ball = rough_sphere(2, 0.15)
    write_mesh(tmp_path / "model" / "liver.stl", Mesh(ball.vertices, ball.faces[9:]))
    code, report = run(tmp_path / "model", "-o", out)
    record = tissue(report, "liver")
    assert code == 1 and record["status"] == "changed" and record["introduced"] == []
    for key, count in record["topology"].items():
        assert count == record["before"]["topology"][key]
    assert np.isclose(record["volume_mm3"], record["before"]["volume_mm3"], rtol=0.01)
