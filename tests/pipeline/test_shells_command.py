"""`vhp shells` from end to end."""

from __future__ import annotations

import json
from dataclasses import replace

import jsonschema
import numpy as np
import pytest
from heal_runs import meshes
from shapes import box, sphere

from vhp_cli.cli import main
from vhp_cli.formats import write_mesh
from vhp_cli.pipeline import shells as pipeline
from vhp_cli.report import schema


@pytest.fixture
def skin(tmp_path):
    write_mesh(tmp_path / "body.stl", sphere(9, subdivisions=3))
    return tmp_path / "body.stl"


def test_three_shells_that_pass(skin, out):
    assert main(["-q", "shells", str(skin), "-o", str(out), "--fat", "3", "-j1"]) == 0
    report = json.loads((out / "report.json").read_text())
    assert report["command"] == "shells" and report["settings"]["shells"]["fat"] == "3"
    assert report["nesting"] == {"skin": None, "fat": "skin", "average_body": "fat"}
    gaps = {(pair["a"], pair["b"]): pair["min_gap_mm"] for pair in report["pairs"]}
    assert all(found is None or found >= 1 for found in gaps.values())
    assert (out / "skin.stl").read_bytes() == skin.read_bytes()
    jsonschema.Draft202012Validator(schema()).validate(report)
    fat, body = report["shells"]
    assert (fat["name"], body["name"]) == ("fat", "average_body")
    assert fat["gap_mm"] >= 1 and body["gap_mm"] >= 3
    assert fat["ends"] == body["ends"] == fat["dropped"] == []
    first = meshes(out)
    assert main(["-q", "shells", str(skin), "-o", str(out), "--fat", "3", "--overwrite"]) == 0
    assert meshes(out) == first


@pytest.mark.slow
def test_maps_and_arrays(skin, out, tmp_path):
    (tmp_path / "fat.toml").write_text(
        'age = "30-39"\n[[point]]\nplace = "Medial Arm"\nxyz = [9, 0, 0]\n[[point]]\nthickness = 3\nxyz = [-9, 0, 0]\n'
    )
    assert main(["-q", "shells", str(skin), "-o", str(out), "--fat", str(tmp_path / "fat.toml")]) == 0
    np.save(tmp_path / "fat.npy", np.full(1280, 2.5))
    code = main(["-q", "shells", str(skin), "-o", str(out), "--fat", str(tmp_path / "fat.npy"), "--overwrite"])
    assert code == 0


@pytest.mark.parametrize(
    ("fat", "message"),
    [("thick", "expected a number"), ("0", "above 0"), ("40", "nothing of the body is left"), ("no.npy", "no.npy")],
)
def test_what_can_not_be_done_is_said(skin, out, fat, message, capsys):
    assert main(["-q", "shells", str(skin), "-o", str(out), "--fat", fat]) == 2
    assert message in capsys.readouterr().err
    assert not out.exists() or not meshes(out)


def test_an_open_skin_is_sent_to_be_healed(tmp_path, out, capsys):
    mesh = box((0, 0, 0), (30, 30, 30))
    write_mesh(tmp_path / "open.stl", type(mesh)(mesh.vertices, mesh.faces[:-2]))
    assert main(["-q", "shells", str(tmp_path / "open.stl"), "-o", str(out), "--fat", "2"]) == 2
    told = capsys.readouterr().err
    assert "no sound solid" in told and "vhp heal" in told


def test_a_shell_that_is_nearer_than_asked_fails(skin, out, monkeypatch, capsys):
    made = pipeline.make_shells

    def nearer(*arguments, **settings):
        found = made(*arguments, **settings)
        return replace(found, shells=[replace(shell, gap_mm=0.9) for shell in found.shells])

    monkeypatch.setattr(pipeline, "make_shells", nearer)
    assert main(["shells", str(skin), "-o", str(out), "--fat", "3"]) == 1
    assert "nearer than 1 mm at" in capsys.readouterr().err


def test_what_lies_there_is_not_written_over(skin, out, capsys):
    out.mkdir()
    (out / "mine.txt").write_text("x")
    assert main(["-q", "shells", str(skin), "-o", str(out), "--fat", "2"]) == 2
    assert "not empty" in capsys.readouterr().err
    assert main(["-q", "shells", str(skin), "-o", str(skin.parent), "--fat", "2"]) == 2
