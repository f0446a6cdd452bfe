"""The benchmark of `vhp breathe` runs and counts right; how fast anything is, is not a matter for tests."""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).resolve().parents[1] / "benchmarks"


@pytest.mark.slow
def test_a_small_phantom_breathes(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(BENCHMARKS)
    benchmark = importlib.import_module("breathe")
    arguments = ["--triangles", "20000", "--tissues", "90", "--frames", "3", "--json", str(tmp_path / "rows.json")]
    assert benchmark.main(arguments) == 0
    for name in ("breathe", "check", "models", "peers"):
        sys.modules.pop(name, None)
    full, few = json.loads((tmp_path / "rows.json").read_text())
    assert (full["frames"], few["frames"]) == (23, 3)
    assert full["tissues"] == 90 and full["unproven"] == 0 and full["least gap mm"] >= 1.0
    assert full["pairs"] == few["pairs"] and full["memory MB"] > 10
