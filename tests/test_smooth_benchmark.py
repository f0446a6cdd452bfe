"""The benchmark of `vhp smooth` runs and counts right; how fast anything is, is not a matter for tests."""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from shapes import sphere
from smoothing_shapes import rough_sphere, tube

from vhp_cli.formats import write_mesh
from vhp_cli.mesh import Mesh
from vhp_cli.stages.heal.candidate import judge

BENCHMARKS = Path(__file__).resolve().parents[1] / "benchmarks"


@pytest.fixture
def benchmark(monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    yield importlib.import_module("smooth")
    for name in ("smooth", "check", "models", "peers"):
        sys.modules.pop(name, None)


def test_sound_files_are_compared_from_the_command_line(benchmark, tmp_path, monkeypatch, capsys):
    write_mesh(tmp_path / "liver.stl", rough_sphere(0, 0.3, subdivisions=2))
    ball = sphere(10, subdivisions=3)
    write_mesh(tmp_path / "open.stl", Mesh(ball.vertices, ball.faces[1:]))
    arguments = ["smooth.py", "--data", tmp_path, "--every", "1", "--groups", "real", "--json", tmp_path / "rows.json"]
    monkeypatch.setattr(sys, "argv", [*map(str, arguments), "--only", "guarded"])
    assert benchmark.main() == 0
    rows = {row["by"]: row for row in json.loads((tmp_path / "rows.json").read_text())}
    chosen = {name for name in benchmark.SMOOTHERS if "guarded" in name}
    assert rows.keys() == {"input", *chosen}
    guarded, plain = rows["vhp guarded"], rows["standard, unguarded"]
    assert guarded["sound"] and guarded["mean_rises"] and not guarded["min_falls"]
    assert abs(guarded["volume"]) < 1e-3 < abs(plain["volume"])
    assert guarded["max_mm"] < 0.05 < plain["max_mm"]
    assert "| vhp guarded" in capsys.readouterr().out


def test_bad_results_are_told(benchmark):
    before = judge(tube(rings=20, length=5, bend=1))
    crossed = np.array(before.mesh.vertices)
    crossed[100] -= (0, 3.0, 0)  # through the wall on the other side
    row = benchmark.judged(before, Mesh(crossed, before.mesh.faces))
    assert not row["sound"] and row["crossing"] and row["min_falls"] and row["max_mm"] > 1
    assert benchmark.judged(before, Mesh(before.mesh.vertices * np.nan, before.mesh.faces)).keys() == {"error"}


def test_updates_are_counted(benchmark):
    lines = benchmark.speed(iterations=1).splitlines()[2:]
    rates = {cells[1].strip(): float(cells[2]) for cells in (line.split("|") for line in lines)}
    assert rates.keys() == set(benchmark.METHODS)
    assert all(rate > 0 for rate in rates.values())
