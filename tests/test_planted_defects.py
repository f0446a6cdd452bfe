"""Every defect that the phantom plants is found, in the right tissue and at the right place."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from vhp_cli.commands.check import check
from vhp_cli.commands.phantom import phantom

# Farthest that a reported place may lie from where the defect was planted.
NEAR_MM = 6.0


def checked(directory: Path) -> tuple[int, dict]:
    result = CliRunner().invoke(check, [str(directory), "--report", "-", "--no-cache"])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, json.loads(result.stdout)


def written(directory: Path, *options: str) -> Path:
    result = CliRunner().invoke(phantom, [str(directory), *options])
    assert result.exit_code == 0, result.output
    return directory


def missed(directory: Path) -> list[str]:
    """Return the planted defects that the check did not report as planted."""
    code, report = checked(directory)
    planted = json.loads((directory / "planted.json").read_text())["planted"]
    assert planted
    assert code == 1 and not report["summary"]["passed"]
    problems = []
    for defect in planted:
        names = sorted(defect["tissues"])
        found = [f for f in report["findings"] if f["rule"] == defect["rule"] and sorted(f["tissues"]) == names]
        places = [place["xyz_mm"] for finding in found for place in finding["places"]]
        if not found:
            problems.append(f"{directory.name}: {defect} not found")
        elif defect["xyz_mm"] is not None and not defect["rule"].startswith(("F", "P004", "T005", "P006")):
            distance = min((np.linalg.norm(np.subtract(xyz, defect["xyz_mm"])) for xyz in places), default=np.inf)
            if distance > NEAR_MM:
                problems.append(f"{directory.name}: {defect} found {distance:.3g} mm away")
    return problems


@pytest.mark.parametrize("triangles", [20_000, 60_000])
def test_clean_phantoms_give_no_finding(tmp_path, triangles):
    code, report = checked(written(tmp_path / "clean", "--triangles", str(triangles)))
    assert report["findings"] == [] and code == 0 and report["summary"]["passed"]
    assert abs(report["summary"]["triangles"] - triangles) < 0.1 * triangles


@pytest.mark.slow
@pytest.mark.parametrize(("triangles", "tissues"), [(100_000, 60), (300_000, 110), (700_000, 250), (1_000_000, 110)])
def test_clean_phantoms_at_any_size(tmp_path, triangles, tissues):
    options = ("--triangles", str(triangles), "--tissues", str(tissues))
    code, report = checked(written(tmp_path / "clean", *options))
    assert report["findings"] == [] and code == 0


@pytest.mark.parametrize("seed", range(6))
def test_planted_defects_are_found(tmp_path, seed):
    directory = written(tmp_path / f"seed_{seed}", "--triangles", "20000", "--defects", str(seed))
    assert missed(directory) == []


@pytest.mark.slow
@pytest.mark.parametrize("tens", range(10))
def test_planted_defects_of_a_hundred_phantoms_are_found(tmp_path, tens):
    problems = []
    for seed in range(10 * tens, 10 * tens + 10):
        directory = written(tmp_path / f"seed_{seed}", "--triangles", "20000", "--defects", str(seed))
        problems += missed(directory)
    assert problems == []
