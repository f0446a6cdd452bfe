"""What `vhp heal` writes and says, whatever its stage does."""

from __future__ import annotations

import hashlib
import json

import numpy as np
import pytest
import stage_targets
from click.testing import CliRunner
from heal_runs import JOURNAL, meshes, rules, run, tissue
from shapes import flipped, moved, sphere

from vhp_cli.cli import main
from vhp_cli.commands.check import check
from vhp_cli.formats import read_mesh, write_mesh
from vhp_cli.mesh import Mesh


def test_a_defect_is_healed_and_the_rest_is_copied(stage, model, out):
    before = meshes(model)
    code, report = run(model, "-o", out)
    after = meshes(out)
    assert code == 0 and report["summary"]["passed"]
    assert meshes(model) == before and after.keys() == before.keys()
    assert [name for name in before if before[name] != after[name]] == ["liver.stl"]
    assert report["command"] == "heal"
    assert report["summary"]["status"] == {"changed": 1, "unchanged": 2, "refused": 0, "failed": 0}
    liver = tissue(report, "liver")
    assert liver["status"] == "changed" and liver["introduced"] == [] and liver["reason"] == ""
    assert liver["actions"][0]["step"] == "orient"
    assert liver["deviation_mm"]["max"] == 0
    assert liver["volume_change"] == pytest.approx(0, abs=1e-12)
    assert rules(liver["before"]["findings"]) == {"T005"} and not liver["findings"]
    assert not liver["before"]["outward"] and liver["outward"]
    for name, data in after.items():
        record = next(record for record in report["tissues"] if record["file"] == name)
        assert record["sha256"] == hashlib.sha256(data).hexdigest()
        assert record["before"]["sha256"] == hashlib.sha256(before[name]).hexdigest()
    skin = tissue(report, "skin")
    assert skin["status"] == "unchanged" and skin["deviation_mm"]["max"] == 0 and skin["actions"] == []


def test_the_verdict_is_that_of_check(stage, model, out):
    write_mesh(model / "spleen.stl", sphere(10, (20, 20, 0)))
    (model / "vhp.toml").write_text('gap-search = 5.0\n[rules]\nQ001 = { limit = 0.9, level = "warning" }\n')
    code, healed = run(model, "-o", out)
    result = CliRunner().invoke(check, [str(out), "--report", "-"])
    checked = json.loads(result.stdout)
    assert code == result.exit_code == 1 and "P001" in rules(checked["findings"])
    assert "Q001" in rules(checked["findings"])
    for key in ("pairs", "nesting", "findings"):
        assert healed[key] == checked[key]
    assert healed["summary"].items() >= checked["summary"].items()
    for mine, theirs in zip(healed["tissues"], checked["tissues"], strict=True):
        assert mine.items() >= theirs.items()


def test_the_report_validates_against_the_published_schema(stage, model, out):
    jsonschema = pytest.importorskip("jsonschema")
    from vhp_cli.report import schema

    (model / "heart.stl").write_bytes(b"this is no mesh")
    stage("refuse")
    _, report = run(model, "-o", out)
    jsonschema.Draft202012Validator(schema()).validate(report)


@pytest.mark.parametrize("suffix", ["ply", "obj"])
def test_formats_stay(stage, tmp_path, out, suffix):
    (tmp_path / "m").mkdir()
    ball = flipped(sphere(15, subdivisions=2))
    write_mesh(tmp_path / "m" / f"liver.{suffix}", ball)
    assert run(tmp_path / "m", "-o", out)[0] == 0
    written = read_mesh(out / f"liver.{suffix}")
    assert written.format.startswith(suffix)
    assert len(written.mesh.faces) == len(ball.faces)
    assert set(map(tuple, written.mesh.vertices)) == set(map(tuple, ball.vertices))


def test_units_stay(stage, tmp_path, out):
    (tmp_path / "m").mkdir()
    ball = flipped(sphere(0.15, subdivisions=2))
    write_mesh(tmp_path / "m" / "liver.ply", ball)
    code, report = run(tmp_path / "m", "-o", out, "--units", "m")
    assert code == 0 and report["tissues"][0]["status"] == "changed"
    assert read_mesh(out / "liver.ply").mesh.vertices == pytest.approx(ball.vertices, rel=1e-14)


def test_subdirectories_and_equal_names(stage, tmp_path, out):
    model = tmp_path / "m"
    for side, x in (("left", -50), ("right", 50)):
        (model / side).mkdir(parents=True)
        write_mesh(model / side / "kidney.stl", flipped(sphere(15, (x, 0, 0), subdivisions=2)))
    code, report = run(model, "-o", out, "--recursive")
    assert code == 1 and rules(report["findings"]) == {"F006"}
    assert meshes(out).keys() == {"left/kidney.stl", "right/kidney.stl"}
    assert meshes(out) != meshes(model)
    assert {record["status"] for record in report["tissues"]} == {"changed"}
    single = [model / "left" / "kidney.stl", model / "right" / "kidney.stl"]
    assert main(["heal", *map(str, single), "-o", str(tmp_path / "two")]) == 2
    assert not (tmp_path / "two").exists()
    assert run(single[0], "-o", tmp_path / "one")[0] == 0
    assert meshes(tmp_path / "one").keys() == {"kidney.stl"}
    assert run(model / "left", model / "right", "-o", tmp_path / "three")[0] == 1
    assert meshes(tmp_path / "three") == meshes(out)


def test_a_file_that_is_not_in_order_is_written_anew(stage, model, out):
    data = (model / "skin.stl").read_bytes()
    (model / "skin.stl").write_bytes(data[:80] + np.uint32(len(data)).tobytes() + data[84:])
    (model / "nerve.stl").write_bytes((model / "nerve.stl").read_bytes() + b"tail")
    code, report = run(model, "-o", out)
    assert code == 0
    assert (out / "skin.stl").read_bytes()[80:84] == data[80:84]
    skin, nerve = tissue(report, "skin"), tissue(report, "nerve")
    assert skin["status"] == nerve["status"] == "changed"
    assert "F003" in skin["actions"][0]["message"] and "F010" in nerve["actions"][0]["message"]
    assert skin["deviation_mm"]["max"] == 0


# What can't be healed


def test_damaged_files_are_listed_and_copied(stage, model, out):
    ball = (model / "skin.stl").read_bytes()
    (model / "heart.stl").write_bytes(b"this is no mesh")
    (model / "lung.stl").write_bytes(ball[:84].replace(ball[80:84], b"\0\0\0\0"))
    (model / "colon.stl").write_bytes(ball[:-1000])
    cut = len(ball) - 50 * 20
    (model / "femur.stl").write_bytes(ball[:cut])
    code, report = run(model, "-o", out)
    assert code == 3
    assert tissue(report, "heart")["status"] == "failed" and "F001" in tissue(report, "heart")["reason"]
    for name, rule in (("lung", "F005"), ("colon", "F003"), ("femur", "F003")):
        assert tissue(report, name)["status"] == "refused", name
        assert rule in tissue(report, name)["reason"]
    assert tissue(report, "liver")["status"] == "changed"
    for name in ("heart", "lung", "colon", "femur"):
        assert (out / f"{name}.stl").read_bytes() == (model / f"{name}.stl").read_bytes()
    (model / "heart.stl").unlink()
    assert run(model, "-o", out)[0] == 1
    assert not (out / "heart.stl").exists()


def test_a_truncated_file_is_not_healed(stage, model, out):
    (model / "liver.stl").write_bytes((model / "liver.stl").read_bytes()[:-30])
    code, report = run(model, "-o", out)
    assert code == 1 and tissue(report, "liver")["status"] == "refused"
    assert "F002" in tissue(report, "liver")["reason"]


def test_a_path_that_is_no_file(stage, model, out):
    (model / "gone.stl").symlink_to(model / "nowhere")
    code, report = run(model, "-o", out)
    gone = tissue(report, "gone")
    assert code == 3 and gone["status"] == "failed" and "F001" in gone["reason"] and gone["deviation_mm"] is None
    assert "gone.stl" not in meshes(out)
    (model / "gone.stl").unlink()
    write_mesh(model / "gone.stl", moved(sphere(5), (0, 30, 0)))
    assert run(model, "-o", out)[0] == 0
    assert "gone.stl" in meshes(out)


def test_nothing_readable(stage, tmp_path, out, capsys):
    (tmp_path / "a.stl").write_bytes(b"garbage")
    assert main(["heal", str(tmp_path / "a.stl"), "-o", str(out)]) == 2
    assert "a.stl" in capsys.readouterr().err and not out.exists()


@pytest.mark.parametrize(
    ("name", "status", "code", "words"),
    [
        pytest.param("hang", "failed", 3, "time limit", marks=pytest.mark.slow),
        ("crash", "failed", 3, "crash"),
        ("eat", "failed", 3, "memory limit"),
        ("fail", "failed", 3, "ZeroDivisionError: nothing is left"),
        ("tear", "failed", 3, "worse than the input: T001 0 -> 1"),
        ("squash", "failed", 3, "worse than the input: Q001 0 -> 2"),
        ("no_surface", "failed", 3, "no surface"),
        ("refuse", "refused", 0, "a sheet is no solid"),
    ],
)
def test_what_goes_wrong_in_one_tissue_stays_there(stage, model, out, name, status, code, words):
    stage(name)
    limits = ["--timeout", 5 if name == "hang" else 60, "--memory", 0.5]
    found, report = run(model, "-o", out, *limits)
    nerve = tissue(report, "nerve")
    assert (nerve["status"], found) == (status, code)
    assert words in nerve["reason"]
    assert nerve["introduced"] == [] and nerve["deviation_mm"]["max"] == 0
    assert (out / "nerve.stl").read_bytes() == (model / "nerve.stl").read_bytes()
    assert tissue(report, "liver")["status"] == "changed" and tissue(report, "skin")["status"] == "unchanged"


def test_poor_triangles_are_no_reason_to_keep_a_hole(stage, model, out):
    """Shapes count only where nothing worse was mended."""
    stage("squash")
    nerve = read_mesh(model / "nerve.stl").mesh
    write_mesh(model / "nerve.stl", Mesh(nerve.vertices, nerve.faces[[0, 0, *range(1, 12)]]))
    from vhp_cli.config import load_settings
    from vhp_cli.pipeline.measuring import measure, shape_limits
    from vhp_cli.pipeline.regressions import Measured, regressions

    settings = load_settings()

    def measured(mesh: Mesh) -> Measured:
        from vhp_cli.formats.reading import Reading

        measures, defects, _ = measure(Reading(mesh, "stl-binary", (), 0, 0), shape_limits(settings, "nerve"))
        return Measured(measures, defects, ())

    sound, needle = measured(nerve), measured(stage_targets.squash(nerve, None).mesh)
    holed = measured(Mesh(nerve.vertices, nerve.faces[1:]))
    assert [one["rule"] for one in regressions("nerve", sound, needle, settings)] == ["Q001", "Q002"]
    assert regressions("nerve", holed, needle, settings) == []
    assert [one["rule"] for one in regressions("nerve", needle, holed, settings)] == ["T001"]
    assert regressions("nerve", needle, sound, settings) == regressions("nerve", sound, sound, settings) == []


def test_new_contacts_between_tissues_are_named(stage, model, out):
    stage("move")
    write_mesh(model / "stone.stl", sphere(2, (-1.5, 0, 0), subdivisions=2))
    code, report = run(model, "-o", out)
    assert code == 1 and rules(report["findings"]) == {"P001"}
    assert [one["rule"] for one in tissue(report, "nerve")["introduced"]] == ["P001"]
    assert tissue(report, "stone")["introduced"] == []


def test_a_tissue_that_would_meet_a_neighbour_is_moved_less(stage, model, out):
    stage("move_within")
    write_mesh(model / "stone.stl", sphere(2, (-1.5, 0, 0), subdivisions=2))
    code, report = run(model, "-o", out, "--max-deviation", "8")
    nerve = tissue(report, "nerve")
    assert code == 0 and nerve["introduced"] == [] and nerve["actions"][-1]["step"] == "contacts"
    assert nerve["bounds_mm"]["min"][0] == -12 + 8 / 16
    again = run(model, "-o", out, "--max-deviation", "8")[1]
    assert again["run"]["reused"] == 4 and again | {"run": {}} == report | {"run": {}}
    # Stopped in the midst of the second attempt.
    lines = (out / JOURNAL).read_bytes().splitlines(keepends=True)
    (out / JOURNAL).write_bytes(b"".join(line for line in lines if b"nerve" not in line or b"vhp-run" in line))
    again = run(model, "-o", out, "--max-deviation", "8")[1]
    assert again["run"]["reused"] == 3 and again | {"run": {}} == report | {"run": {}}
    # What was decided for these tissues does not hold for others.
    (model / "stone.stl").unlink()
    code, report = run(model, "-o", out, "--max-deviation", "8")
    assert code == 0 and tissue(report, "nerve")["bounds_mm"]["min"][0] == -4
    assert tissue(report, "nerve")["actions"] == []
