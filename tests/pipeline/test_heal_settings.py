"""How flags and `vhp.toml` reach the stage."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner
from heal_runs import DRIVER, run

from vhp_cli.cli import main
from vhp_cli.commands.check import check


def reasons(report: dict) -> dict[str, str]:
    return {record["name"]: record["reason"] for record in report["tissues"]}


def test_flags_and_settings_reach_the_stage(stage, model, out, tmp_path):
    stage("report_options")
    (model / "vhp.toml").write_text(
        "[heal]\nmax-deviation = 0.05\ntarget-q = 0.2\nthicken = 1\n"
        '[rules]\nQ002 = 0.02\n[[tissue]]\nmatch = "ner*"\nheal = { max-deviation = 0.01, cap-openings = false }\n'
    )
    _, report = run(model, "-o", out, "--target-q", "0.25", "--max-triangles", "5000", "--only-topology")
    assert report["settings"]["heal"] == {
        "max-deviation": 0.05, "target-q": 0.25, "min-edge": 0.01, "edge-length": None, "max-triangles": 5000,
        "cap-openings": True, "min-component": None, "only-topology": True, "thicken": 1.0, "engine-timeout": 30.0,
        "engine-memory": 4.0,
    }  # fmt: skip
    assert report["settings"]["tissue"][0]["heal"] == {"max-deviation": 0.01, "cap-openings": False}
    skin, nerve = reasons(report)["skin"], reasons(report)["nerve"]
    assert "max_deviation_mm=0.05" in skin and "cap_openings=True" in skin and "only_topology=True" in skin
    assert "max_deviation_mm=0.01" in nerve and "cap_openings=False" in nerve
    assert "target_quality=0.25" in nerve and "min_edge_mm=0.02" in nerve  # the gate asks for more than the default


def test_min_edge_is_for_the_stage_and_the_gate(stage, model, out):
    stage("report_options")
    _, report = run(model, "-o", out, "--min-edge", "0.5", "--min-q", "0.4", "--keep-openings")
    assert report["settings"]["rules"]["Q002"]["limit"] == 0.5 and report["settings"]["heal"]["min-edge"] == 0.5
    assert "min_edge_mm=0.5" in reasons(report)["skin"] and "cap_openings=False" in reasons(report)["skin"]
    assert "target_quality=0.4" in reasons(report)["skin"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[heal]\nmax-deviatoin = 1\n", "heal: 'max-deviatoin' is not known; did you mean 'max-deviation'?"),
        ("[heal]\nmax-deviation = true\n", "heal.max-deviation: expected a number, not True"),
        ("[heal]\nmax-deviation = -1\n", "heal: max-deviation: expected a finite number above 0, not -1"),
        ("[heal]\nonly-topology = 1\n", "heal.only-topology: expected true or false, not 1"),
        ("[heal]\nmax-triangles = 10.5\n", "heal.max-triangles: expected a whole number, not 10.5"),
        ("[heal]\nmin-edge = [1]\n", "heal.min-edge: expected a single value"),
        ("heal = 3\n", "heal: expected a table"),
        ('[[tissue]]\nmatch = "x"\nheal = { thick = 1 }\n', "'thick' is not known; did you mean 'thicken'?"),
    ],
)
def test_wrong_settings_are_refused(stage, model, out, capsys, text, words):
    (model / "vhp.toml").write_text(text)
    assert main(["heal", str(model), "-o", str(out)]) == 2
    assert words in capsys.readouterr().err and not out.exists()


def test_check_accepts_a_file_with_settings_for_heal(model):
    (model / "vhp.toml").write_text('[heal]\nmax-deviation = 0.05\n[[tissue]]\nmatch="*"\nheal = { thicken = 1 }\n')
    result = CliRunner().invoke(check, [str(model), "--report", "-"])
    assert result.exit_code == 1 and json.loads(result.stdout)["settings"]["heal"] == {"max-deviation": 0.05}


def test_engines_are_loaded_in_child_processes_only(model, out):
    """One that crashes on import must not take the run with it."""
    heavy = ("pymeshlab", "pytetwild", "trimesh", "scipy", "manifold3d", "pymeshfix", "pyvista")
    code = f"{DRIVER[: DRIVER.index('sys.exit')]}assert main(sys.argv[1:]) == 0\nprint(*sys.modules)"
    path = os.pathsep.join([str(Path(__file__).parents[1]), *sys.path])
    done = subprocess.run(
        [sys.executable, "-c", code, "heal", str(model), "-o", str(out), "-j1"],
        env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True, check=False, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    loaded = set(done.stdout.splitlines()[-1].split())
    assert "vhp_cli.stages.heal.options" in loaded and not loaded & set(heavy)
