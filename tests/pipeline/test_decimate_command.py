"""``vhp decimate`` from end to end."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from heal_runs import meshes, tissue
from shapes import joined, moved, sphere

from vhp_cli.commands.decimate import decimate
from vhp_cli.config import load_settings
from vhp_cli.formats import read_mesh, write_mesh
from vhp_cli.mesh import Mesh
from vhp_cli.model import find_model
from vhp_cli.pipeline.sharing import share_triangles, shares


def run(*arguments) -> tuple[int, dict]:
    result = CliRunner().invoke(decimate, [*map(str, arguments), "--report", "-"])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, json.loads(result.stdout)


def bumpy(amount: float, subdivisions: int = 3) -> Mesh:
    ball = sphere(10, subdivisions=subdivisions)
    x, y, z = ball.vertices.T
    return Mesh(ball.vertices * (1 + amount * np.sin(x) * np.cos(y + 0.5 * z))[:, None], ball.faces)


@pytest.fixture
def model(tmp_path: Path) -> Path:
    directory = tmp_path / "model"
    directory.mkdir()
    for number, amount in enumerate((0.0, 0.03, 0.08)):
        write_mesh(directory / f"organ_{number}.stl", moved(bumpy(amount), (30.0 * number, 0, 0)))
    write_mesh(directory / "small.stl", moved(sphere(5, subdivisions=2), (0, 40, 0)))
    return directory


def test_ratio(model, tmp_path):
    code, report = run(model, "-o", tmp_path / "out", "--ratio", 0.34, "-j1")
    assert code == 0
    assert report["command"] == "decimate"
    assert report["settings"]["decimate"]["ratio"] == 0.34
    for record in report["tissues"]:
        assert record["status"] == "changed"
        assert record["reason"] == ""
        assert record["triangles"] <= round(0.34 * record["before"]["triangles"])
        assert abs(record["volume_change"]) <= 1e-3
        assert record["quality"]["min"] >= 0.3
        assert record["triangles"] == len(read_mesh(tmp_path / "out" / record["file"]).mesh.faces)


def test_triangles_go_where_error_is_least(model, tmp_path):
    code, report = run(model, "-o", tmp_path / "out", "--triangles", 1600, "-j1")
    assert code == 0
    counts = [tissue(report, f"organ_{number}")["triangles"] for number in range(3)]
    assert counts[2] > 1.3 * max(counts[:2])
    assert 1500 <= sum(record["triangles"] for record in report["tissues"]) <= 1600
    assert sum(report["settings"]["decimate"]["shares"].values()) in (1599, 1600)


def test_workers_do_not_matter(model, tmp_path):
    for jobs in (1, 2):
        run(model, "-o", tmp_path / f"out{jobs}", "--triangles", 1500, f"-j{jobs}")
    assert meshes(tmp_path / "out1") == meshes(tmp_path / "out2")


def test_resumed(model, tmp_path):
    run(model, "-o", tmp_path / "out", "--triangles", 1500, "-j1")
    before = meshes(tmp_path / "out")
    (tmp_path / "out" / "organ_1.stl").unlink()
    _, report = run(model, "-o", tmp_path / "out", "--triangles", 1500, "-j1")
    assert report["run"]["reused"] == 3
    assert meshes(tmp_path / "out") == before


def test_settings_of_tissues(model, tmp_path):
    (model / "vhp.toml").write_text(
        '[decimate]\ntriangles = 1000\n\n[[tissue]]\nmatch = "organ_2"\ndecimate = { ratio = 0.9 }\n'
    )
    code, report = run(model, "-o", tmp_path / "out", "-j1")
    assert code == 0
    assert set(report["settings"]["decimate"]["shares"]) == {"organ_0", "organ_1", "small"}
    assert 0.8 * 1280 < tissue(report, "organ_2")["triangles"] <= 1152
    rest = sum(record["triangles"] for record in report["tissues"] if record["name"] != "organ_2")
    assert 900 <= rest <= 1000


def test_neighbours_do_not_meet(tmp_path):
    directory = tmp_path / "model"
    directory.mkdir()
    # 1.05 mm apart: as coarse as asked for, they would come nearer than 1 mm.
    write_mesh(directory / "outer.stl", sphere(11.05, subdivisions=4))
    write_mesh(directory / "inner.stl", sphere(10, subdivisions=4))
    code, report = run(directory, "-o", tmp_path / "out", "--ratio", 0.05, "-j1")
    assert code == 0
    assert not any(record["introduced"] for record in report["tissues"])
    assert any(action["step"] == "contacts" for record in report["tissues"] for action in record["actions"]) or any(
        record["status"] == "refused" for record in report["tissues"]
    )


def test_dry_run_writes_nothing(model, tmp_path):
    result = CliRunner().invoke(decimate, [str(model), "-o", str(tmp_path / "out"), "--ratio", "0.5", "--dry-run"])
    assert result.exit_code == 0
    assert result.stdout.count("\tdecimate\t") == 4
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "how far"),
        (("--ratio", 0.5, "--triangles", 100), "exclude each other"),
        (("--ratio", 1.5), "ratio"),
        (("--method", "best"), "method"),
    ],
)
def test_wrong_usage(model, tmp_path, arguments, message):
    result = CliRunner().invoke(decimate, [str(model), "-o", str(tmp_path / "out"), *map(str, arguments)])
    assert result.exit_code != 0
    assert message in (result.output + str(result.exception))
    assert not (tmp_path / "out").exists()


def test_shares_are_exact():
    curves = {
        "a": (100, np.array([0.1, 0.2, 0.3, 0.4])),
        "b": (50, np.array([0.05, 0.35])),
        "unread": (0, np.empty(0)),
    }
    assert shares(curves, 200) == {"a": 100, "b": 50}
    assert shares(curves, 149) == {"a": 100, "b": 48}
    assert shares(curves, 145) == {"a": 96, "b": 48}
    assert shares(curves, 140) == {"a": 94, "b": 46}
    assert shares(curves, 4) == {"a": 92, "b": 46}


def test_what_can_not_be_read_has_no_share(model):
    (model / "broken.stl").write_bytes(b"solid")
    found = share_triangles(find_model([model]).tissues, 1000, load_settings(), jobs=2)
    assert "broken" not in found
    assert sum(found.values()) in (999, 1000)


def test_separate_parts_share_by_error_too(tmp_path):
    directory = tmp_path / "model"
    directory.mkdir()
    write_mesh(directory / "two.stl", joined(bumpy(0.0), moved(bumpy(0.08), (30, 0, 0))))
    code, _ = run(directory, "-o", tmp_path / "out", "--ratio", 0.4, "-j1")
    assert code == 0
    mesh = read_mesh(tmp_path / "out" / "two.stl").mesh
    right = mesh.vertices[mesh.faces].mean(axis=1)[:, 0] > 15
    assert right.sum() > 1.2 * (~right).sum()
