"""`vhp heal --clearance`: healed and taken apart, in one result."""

from __future__ import annotations

import numpy as np
import pytest
from heal_runs import meshes, run, tissue
from shapes import flipped, sphere

from vhp_cli.cli import main
from vhp_cli.formats import read_mesh, write_mesh
from vhp_cli.kernels.spatial import Tree, gap
from vhp_cli.mesh import Mesh

SPLEEN = sphere(12, subdivisions=3)


@pytest.fixture
def broken(tmp_path):
    directory = tmp_path / "broken"
    directory.mkdir()
    write_mesh(directory / "spleen.stl", Mesh(SPLEEN.vertices, SPLEEN.faces[1:]))  # a hole
    write_mesh(directory / "kidney.stl", flipped(sphere(12, (23, 0, 0), 3)))
    write_mesh(directory / "rib_1.stl", sphere(8, (0, 40, 0), 3))
    return directory


def test_heal_and_take_apart(broken, out):
    code, report = run(broken, "-o", out, "--clearance")
    assert code == 0 and report["command"] == "heal" and report["summary"]["passed"]
    a, b = (read_mesh(out / f"{name}.stl").mesh for name in ("spleen", "kidney"))
    assert gap(Tree(a.vertices, a.faces), Tree(b.vertices, b.faces)).distance >= 1.0
    record = tissue(report, "spleen")
    assert record["before"]["topology"]["boundary_edges"] == 3 and record["status"] == "changed"
    steps = [action["step"] for action in record["actions"]]
    assert "holes" in " ".join(steps) and steps[-1] in ("move", "cut")
    assert 0.5 < record["deviation_mm"]["max"] < 3
    assert tissue(report, "rib_1")["status"] == "unchanged"
    assert (out / "rib_1.stl").read_bytes() == (broken / "rib_1.stl").read_bytes()
    assert report["clearance"]["close_before"] == 1 and report["clearance"]["close_after"] == 0
    assert {path.name for path in out.parent.iterdir() if path.name.startswith(".")} == set()
    jsonschema = pytest.importorskip("jsonschema")
    from vhp_cli.report import schema

    jsonschema.Draft202012Validator(schema()).validate(report)


@pytest.mark.slow
def test_the_number_is_the_gap(broken, out):
    code, report = run(broken, "-o", out, "--clearance=0.4")
    assert code == 0 and report["settings"]["rules"]["P005"]["limit"] == 0.4
    (pair,) = report["clearance"]["pairs"]
    assert 0.4 <= pair["after"]["min_gap_mm"] < 0.6
    made = meshes(out)
    code, report = run(broken, "-o", out, "--clearance=0.4")
    assert code == 0 and meshes(out) == made


@pytest.mark.parametrize("options", [["--clearance=wide"], ["--clearance=0"], ["--clearance=2", "--gap", "1"]])
def test_wrong_gaps_are_refused(broken, out, options, capsys):
    assert main(["heal", str(broken), "-o", str(out), *options]) == 2
    assert "clearance" in capsys.readouterr().err and not out.exists()


def test_a_directory_in_use_is_left_alone(broken, out, capsys):
    out.mkdir()
    (out / "mine.txt").write_text("x")
    assert main(["heal", str(broken), "-o", str(out), "--clearance"]) == 2
    assert "not empty" in capsys.readouterr().err
    assert np.all([path.name == "mine.txt" for path in out.iterdir()])


@pytest.mark.slow
def test_pairs_are_declared_for_clearance_only(broken, out, tmp_path, capsys):
    (tmp_path / "pairs.toml").write_text('[[may-touch]]\na = "spleen"\nb = "kidney"\n')
    assert main(["heal", str(broken), "-o", str(out), "--declare", str(tmp_path / "pairs.toml")]) == 2
    assert "--clearance" in capsys.readouterr().err and not out.exists()
    code, report = run(broken, "-o", out, "--clearance", "--declare", tmp_path / "pairs.toml")
    (pair,) = report["clearance"]["pairs"]
    # They crossed: now they do not, and may be as near as they like.
    assert code == 0 and pair["reached"] and 0 < pair["after"]["min_gap_mm"] < 0.5


def test_a_dry_run_says_what_would_be_healed(broken, out, capsys):
    arguments = ["heal", str(broken), "-o", str(out), "--clearance", "--dry-run"]
    assert main(arguments) == 0
    assert [line.split("\t")[1] for line in capsys.readouterr().out.splitlines()] == ["heal"] * 3
    assert not out.exists()
    out.mkdir()
    (out / "mine.txt").write_text("x")
    assert main(arguments) == 2
    assert "not empty" in capsys.readouterr().err
