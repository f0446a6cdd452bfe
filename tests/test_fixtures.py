"""The reports on the fixture models, to the byte."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from vhp_cli.commands.check import check
from vhp_cli.report import render

ROOT = Path(__file__).resolve().parents[1]
GOLDEN = Path(__file__).with_name("golden")


@pytest.mark.parametrize(("name", "code"), [("sound", 0), ("broken", 1)])
def test_report_on_fixture_model(name, code, request, monkeypatch):
    monkeypatch.chdir(ROOT)
    result = CliRunner().invoke(check, [f"fixtures/{name}", "--report", "-", "--no-cache"])
    assert result.exit_code == code
    report = json.loads(result.stdout)
    # The rest must not depend on the machine or the release.
    report["run"], report["tool"]["version"] = {}, "0"
    text = render(report, "json")
    golden = GOLDEN / f"{name}.json"
    if request.config.getoption("--update-golden"):
        golden.write_text(text, encoding="utf-8")
    assert text == golden.read_text(encoding="utf-8")


def test_every_defect_of_the_broken_model_is_named():
    report = json.loads((GOLDEN / "broken.json").read_text(encoding="utf-8"))
    errors = {(f["rule"], *f["tissues"]) for f in report["findings"] if f["level"] == "error"}
    assert errors == {
        ("F001", "nerve_garbage"),
        ("F002", "aorta_truncated"),
        ("F005", "vein_empty"),
        ("T001", "aorta_truncated"),
        ("T001", "bladder_open"),
        ("T002", "tongue_doubled"),
        ("T003", "tongue_doubled"),
        ("T005", "spleen_inside_out"),
        ("T006", "tongue_doubled"),
        ("P001", "kidney_left", "kidney_right"),
        ("P003", "rib_01", "rib_01_cartilage"),
        ("P004", "thyroid", "thyroid_copy"),
        ("P005", "ophthalmic_artery", "optic_nerve"),
    }
