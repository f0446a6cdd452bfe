"""The benchmark of `vhp tetmesh` runs and counts right; how fast anything is, is not a matter for tests."""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from tetrahedron_grids import grid

from vhp_cli.formats import read_mesh
from vhp_cli.stages.heal.candidate import judge

BENCHMARKS = Path(__file__).resolve().parents[1] / "benchmarks"

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="the benchmark measures with os.wait4")


@pytest.fixture
def benchmark(monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    yield importlib.import_module("tetmesh")
    for name in ("tetmesh", "check", "models", "peers"):
        sys.modules.pop(name, None)


def run(benchmark, monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", ["tetmesh.py", *map(str, arguments)])
    return benchmark.main()


def test_bodies_are_sound_and_have_the_volumes_that_they_are_said_to_have(benchmark, tmp_path):
    model = benchmark.bodies_model(tmp_path / "bodies", subdivisions=4)
    for body in benchmark.BODIES:
        found = judge(read_mesh(model / f"{body.name}.stl").mesh)
        assert found.sound, body.name
        assert found.min_quality > 0.7
        assert found.measures["volume_mm3"] == pytest.approx(body.volume, rel=1e-6)
        vertices = found.mesh.vertices - body.start
        vertices[:, 2] -= np.clip(vertices[:, 2], 0, body.length)
        assert np.linalg.norm(vertices, axis=1) == pytest.approx(body.radius, rel=0.005)
    total = sum(benchmark.label_volume(body) for body in benchmark.BODIES)
    assert total == pytest.approx(4 / 3 * np.pi * benchmark.BODIES[0].radius ** 3)


def test_tetrahedra_belong_to_the_innermost_body(benchmark):
    places = [(0, 0, 23), (0, 0, -20), (8, 0, 8), (-9, 0, 9), (8, 0, -15), (9, 0, 4.9), (9, 0, 5.1), (30, 0, 0)]
    corners = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]) * 1e-6
    points = np.concatenate([corners + place for place in places])
    tetrahedra = np.arange(len(points)).reshape(-1, 4)
    names = benchmark.named_by_bodies(points, tetrahedra).tolist()
    assert names == ["skin", "fat", "liver", "kidney", "tumor", "vessel", "liver", ""]


def test_a_mesh_is_judged(benchmark):
    points, tetrahedra = grid(20, edge=50.0)
    row = benchmark.judged(points - 25.0, tetrahedra[:, [1, 0, 2, 3]], None, known=True)
    assert row["conforming"] and row["min_dihedral"] == pytest.approx(45)
    # The corners of the box lie outside of all bodies.
    assert row["tets"] < len(tetrahedra)
    assert abs(row["errors"]["skin"]) < 0.05
    doubled = np.concatenate((tetrahedra, tetrahedra[:1]))
    assert not benchmark.judged(points, doubled, None, known=False)["conforming"]
    names = np.where(np.arange(len(tetrahedra)) % 2, "skin", "").astype(object)
    half = benchmark.judged(points, tetrahedra, names, known=True)
    assert half["errors"]["liver"] == -1.0
    assert half["tets"] == len(tetrahedra) // 2


@pytest.mark.parametrize("peer", ["tetgen", "gmsh"])
def test_engines_are_measured_from_the_command_line(benchmark, peer, tmp_path, monkeypatch, capsys):
    try:
        importlib.import_module("tetgen" if peer == "tetgen" else "meshio")
    except ImportError as error:
        pytest.skip(str(error))
    arguments = ("--only", peer, "--edge-lengths", "6", "--subdivisions", "3", "--json", tmp_path / "rows.json")
    code = run(benchmark, monkeypatch, *arguments)
    (row,) = json.loads((tmp_path / "rows.json").read_text())
    printed = capsys.readouterr().out
    if peer == "gmsh" and "cannot open shared object file" in row.get("error", ""):
        pytest.skip("gmsh lacks libraries of the system")
    assert code == 0
    assert row["by"] == peer and row["conforming"] and row["tets"] > 1000
    assert row["wall_s"] > 0 and row["memory_mb"] > 1
    # What the coarse surfaces enclose, and no tetrahedron of one label in another.
    assert all(-0.03 < error < 0.03 for error in row["errors"].values())
    assert f"| {peer}" in printed


def test_one_that_fails_is_named(benchmark, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(benchmark.PEERS, "broken", ("numpy", None))
    assert run(benchmark, monkeypatch, "--only", "broken", "--subdivisions", "1", "--edge-lengths", "9") == 1
    printed = capsys.readouterr().out
    assert "failed" in printed
    assert "- broken, 9 mm: " in printed and "KeyError" in printed


def test_overhead_is_that_over_the_engine_alone(benchmark):
    rows = [
        {"by": name, "edge_mm": 2.0, "cpu_s": seconds}
        for name, seconds in (("vhp", 11.0), ("vhp", 13.0), ("pytetwild", 10.0), ("pytetwild", 10.0))
    ]
    assert benchmark.overheads(rows).splitlines()[-1].split("|")[-2].strip() == "+20"
    assert "vhp" not in benchmark.overheads([{**row, "error": "no"} for row in rows])[40:].replace("vhp, CPU s", "")
