"""The benchmark of `vhp separate`: its phantoms overlap, it counts right, and vhp keeps its promises there."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest
from shapes import box

from vhp_cli.formats import write_mesh
from vhp_cli.stages.heal.candidate import judge

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="the benchmark measures with the resource module")


@pytest.fixture
def benchmark(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(BENCHMARKS)
    names = ("clearance", "check", "models", "peers")
    found = importlib.import_module("clearance")
    monkeypatch.setattr(found, "WORK", tmp_path / "work")
    yield found
    for name in names:
        sys.modules.pop(name, None)


def written(directory, tissues):
    directory.mkdir()
    for name, mesh in tissues.items():
        write_mesh(directory / f"{name}.stl", mesh)
    return directory


def test_phantoms_overlap_and_are_the_same_every_time(benchmark, tmp_path):
    first, second = (benchmark.overlapping_phantom(5, 11_000, 30) for _ in range(2))
    assert list(first) == list(second)
    assert all(np.array_equal(first[name].vertices, second[name].vertices) for name in first)
    assert all(judge(mesh).sound for mesh in first.values())
    row = benchmark.judged(*[benchmark.written(first, tmp_path / "model")] * 2)
    assert row["tissues"] == 30 and row["crossing"] >= 5
    assert row["crossing_before"] == row["crossing"] and row["volume_worst"] == 0
    assert (row["bones_moved"], row["worse"], row["nesting_lost"]) == (0, 0, 0)


def test_a_result_is_judged(benchmark, tmp_path):
    given = {
        "rib_1": box((0, 0, 0), (9, 9, 9)),
        "rib_2": box((20, 0, 0), (29, 9, 9)),
        "liver": box((8, 0, 0), (18, 9, 9)),
    }
    made = {**given, "liver": box((9.5, 0, 0), (18, 9, 9)), "rib_2": box((20.5, 0, 0), (29, 9, 9))}
    row = benchmark.judged(written(tmp_path / "given", given), written(tmp_path / "made", made))
    assert (row["crossing_before"], row["crossing"], row["pairs"]) == (1, 0, 2)
    assert (row["wide"], row["soft_wide"], row["low"], row["bones"], row["bones_moved"]) == (1, 1, 0, 2, 1)
    assert row["volume_worst"] == pytest.approx(0.15) and row["worse"] == 0


@pytest.mark.parametrize("peer", ["inward offset", "subtraction (manifold3d)"])
def test_peers_do_what_they_say(benchmark, peer):
    given = {"rib_1": box((0, 0, 0), (9, 9, 9)), "liver": box((8, 1, 1), (18, 8, 8))}
    made = benchmark.PEERS[peer][1](given)
    assert np.array_equal(made["rib_1"].vertices, given["rib_1"].vertices)
    volume = judge(made["liver"]).measures["volume_mm3"]
    if peer == "inward offset":
        assert 250 < volume < 350
    else:
        assert volume == pytest.approx(7 * 7 * 9, rel=1e-6)


@pytest.mark.slow
def test_a_phantom_with_tissues_pushed_into_each_other_comes_apart(benchmark, tmp_path):
    model = benchmark.written(benchmark.overlapping_phantom(2, 11_000, 30), tmp_path / "model")
    row = benchmark.run("vhp separate", model, tmp_path / "out", ["-j1"])
    assert row["crossing_before"] >= 5 and row["crossing"] == 0
    assert row["wide"] >= 0.99 * row["pairs"] and row["low"] == 0
    assert (row["bones_moved"], row["worse"], row["nesting_lost"]) == (0, 0, 0)
    assert row["volume_median"] < 0.02
