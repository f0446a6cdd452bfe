"""`vhp separate` from end to end: what it writes, says and refuses."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest
from click.testing import CliRunner
from heal_runs import meshes, tissue
from shapes import box, sphere

from vhp_cli.cli import main
from vhp_cli.commands import separate as command
from vhp_cli.formats import read_mesh, write_mesh
from vhp_cli.kernels.spatial import Tree, gap
from vhp_cli.mesh import Mesh
from vhp_cli.phantom import generate, plant_defects
from vhp_cli.pipeline import clearance
from vhp_cli.pipeline.stage import Limits


def run(*arguments) -> tuple[int, dict]:
    options = ["--report", "-", *([] if "-j" in arguments else ["-j1"])]
    result = CliRunner().invoke(command.separate, [*map(str, arguments), *options])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, json.loads(result.stdout)


TISSUES = {
    "skin": sphere(40, subdivisions=3),
    "liver": sphere(12, (30, 0, 0), subdivisions=3),  # through the skin
    "rib_1": sphere(8, (-6, 19, 0), subdivisions=3),
    "spleen": sphere(12, (-6, 0, 0), subdivisions=3),  # into the rib
    "kidney": sphere(10, (-6, -21, 0), subdivisions=3),  # into the spleen
    "marrow": sphere(4, (-6, 19, 0), subdivisions=2),
}


def written(directory, tissues, suffix="stl"):
    directory.mkdir()
    for name, mesh in tissues.items():
        write_mesh(directory / f"{name}.{suffix}", mesh)
    return directory


@pytest.fixture(scope="module")
def torso(tmp_path_factory):
    """A model, what was made of it, and the report; not to be changed."""
    folder = tmp_path_factory.mktemp("torso")
    model = written(folder / "model", TISSUES)
    code, report = run(model, "-o", folder / "out", "--no-cache")
    return model, folder / "out", code, report


def distance(directory, a, b) -> float:
    first, second = (read_mesh(directory / f"{name}.stl").mesh for name in (a, b))
    found = gap(Tree(first.vertices, first.faces), Tree(second.vertices, second.faces))
    return 0.0 if found.contact_kind else found.distance


def test_a_model_comes_apart_and_passes(torso):
    model, out, code, report = torso
    assert code == 0 and report["summary"]["passed"] and report["command"] == "separate"
    assert report == json.loads((out / "report.json").read_text())
    assert set(meshes(out)) == set(meshes(model))
    names = list(TISSUES)
    for index, a in enumerate(names):
        for b in names[index + 1 :]:
            assert distance(out, a, b) >= 1.0
    # Bone stays bit for bit, and so does what nothing is wrong with.
    for name in ("rib_1", "marrow", "skin"):
        assert meshes(out)[f"{name}.stl"] == meshes(model)[f"{name}.stl"]
        assert tissue(report, name)["status"] == "unchanged"


def test_relations_are_kept(torso):
    *_, report = torso
    inside = {(p["a"], p["b"]) if p["inside"] == "a" else (p["b"], p["a"]) for p in report["pairs"] if p["inside"]}
    assert inside == {(name, "skin") for name in TISSUES if name != "skin"} | {("marrow", "rib_1")}


def test_the_report_tells_pairs_and_deformations(torso):
    *_, report = torso
    found = report["clearance"]
    pairs = {(pair["a"], pair["b"]): pair for pair in found["pairs"]}
    assert set(pairs) == {("kidney", "spleen"), ("liver", "skin"), ("rib_1", "spleen")}
    assert (found["close_before"], found["close_after"]) == (3, 0)
    assert (found["crossing_before"], found["crossing_after"], found["unreached"]) == (3, 0, [])
    liver = pairs["liver", "skin"]
    assert (liver["kind"], liver["inner"], liver["gap_mm"], liver["reached"]) == ("nested", "liver", 1.0, True)
    assert liver["before"]["relation"] == "crossing" and liver["before"]["overlap_mm3"] > 100
    assert liver["after"]["relation"] == "a_inside_b" and liver["after"]["min_gap_mm"] >= 1
    assert pairs["rib_1", "spleen"]["share"] == 0 and pairs["kidney", "spleen"]["share"] < 0.5
    tissues = {one["name"]: one for one in found["tissues"]}
    assert set(tissues) == {"kidney", "liver", "spleen"}
    for name, one in tissues.items():
        given, made = (read_mesh(torso[k] / f"{name}.stl").mesh for k in (0, 1))
        near = np.linalg.norm(given.vertices - np.array(one["xyz_mm"]), axis=1).min()
        near = min(near, np.linalg.norm(made.vertices - np.array(one["xyz_mm"]), axis=1).min())
        assert 0.5 < one["max_mm"] < 4 and 0 < one["mean_mm"] < one["max_mm"] and near < 3
        assert -0.1 < one["volume_change"] < 0.0


def test_the_report_validates_against_the_published_schema(torso):
    jsonschema = pytest.importorskip("jsonschema")
    from vhp_cli.report import schema

    report = json.loads(json.dumps(torso[3]))
    jsonschema.Draft202012Validator(schema()).validate(report)
    del report["clearance"]["pairs"][0]["reached"]
    assert not jsonschema.Draft202012Validator(schema()).is_valid(report)


@pytest.mark.slow
def test_any_order_and_number_of_workers_give_the_same_bytes(torso, tmp_path):
    model, out, *_ = torso
    files = [model / f"{name}.stl" for name in reversed(TISSUES)]
    code, _ = run(*files, "-o", tmp_path / "other", "-j", 2)
    assert code == 0
    assert meshes(tmp_path / "other") == meshes(out)


def test_a_second_run_on_the_result_changes_nothing(torso, tmp_path):
    _, out, *_ = torso
    code, report = run(out, "-o", tmp_path / "again")
    assert code == 0 and report["summary"]["status"]["unchanged"] == len(TISSUES)
    assert meshes(tmp_path / "again") == meshes(out)


def test_a_run_is_taken_up_where_it_was(torso, tmp_path):
    model, out, *_ = torso
    shutil.copytree(out, tmp_path / "out")
    journal = tmp_path / "out" / ".vhp-run.jsonl"
    lines = journal.read_bytes().splitlines(keepends=True)
    journal.write_bytes(b"".join(lines[:-2]) + lines[-2][:20])
    result = CliRunner().invoke(command.separate, [str(model), "-o", str(tmp_path / "out"), "-j1"])
    assert result.exit_code == 0 and f"{len(lines) - 3} of {len(TISSUES)} were taken" in result.stderr
    assert meshes(tmp_path / "out") == meshes(out)
    # Another input makes it another run.
    shutil.copytree(model, tmp_path / "model")
    write_mesh(tmp_path / "model" / "marrow.stl", sphere(3, (-6, 19, 0), subdivisions=2))
    result = CliRunner().invoke(command.separate, [str(tmp_path / "model"), "-o", str(tmp_path / "out")])
    assert result.exit_code != 0 and "other settings" in str(result.exception.message)


def test_settings_decide_who_gives_way(tmp_path, out):
    model = written(tmp_path / "pair", {"spleen": sphere(12, subdivisions=3), "kidney": sphere(12, (23, 0, 0), 3)})
    (model / "vhp.toml").write_text('[[tissue]]\nmatch = "kidney"\nclearance = { fixed = true }\n')
    code, report = run(model, "-o", out)
    assert code == 0
    assert tissue(report, "kidney")["status"] == "unchanged" and tissue(report, "spleen")["status"] == "changed"
    (model / "vhp.toml").write_text('[[tissue]]\nmatch = "*"\nclearance = { fixed = true }\n')
    code, report = run(model, "-o", out, "--overwrite")
    (pair,) = report["clearance"]["unreached"]
    assert code == 1 and pair["reason"] == "both are fixed" and pair["places"]
    assert meshes(out) == meshes(model)


def test_of_rigid_tissues_that_cross_one_gives_way_by_the_least_or_both_share_the_way_or_both_stay(tmp_path, out):
    bones = {
        "rib_1": sphere(12, subdivisions=3),
        "rib_2": sphere(13, (24, 0, 0), 3),  # into the first
        "rib_3": sphere(9, (0, -21.5, 0), 3),  # near the first, but not in contact
    }
    model = written(tmp_path / "bones", bones)
    for settings, gap_mm in (("", 1.0), ("[clearance]\nrigid-gap = 0.3\n", 0.3)):
        (model / "vhp.toml").write_text(settings)
        code, report = run(model, "-o", out, "--overwrite")
        assert code == 1 and report["clearance"]["crossing_after"] == 0
        assert [tissue(report, name)["status"] for name in bones] == ["unchanged", "changed", "unchanged"]
        assert gap_mm <= distance(out, "rib_1", "rib_2") < gap_mm + 0.2
        reasons = {(pair["a"], pair["b"]): pair["reason"] for pair in report["clearance"]["unreached"]}
        assert ("rib_1", "rib_2") not in reasons or "rib_2 gives way" in reasons["rib_1", "rib_2"]
        assert len(reasons) == (1 if gap_mm == 1 else 2)
        assert "neither cross nor touch" in reasons["rib_1", "rib_3"]
        code, _ = run(out, "-o", tmp_path / "again", "--overwrite")
        assert code == 1 and meshes(tmp_path / "again") == meshes(out)
    code, report = run(model, "-o", out, "--overwrite", "--rigid-pairs", "share")
    assert code == 0 and distance(out, "rib_1", "rib_2") >= 1 and distance(out, "rib_1", "rib_3") >= 1
    code, report = run(model, "-o", out, "--overwrite", "--rigid-pairs", "keep")
    assert code == 1 and meshes(out) == meshes(model)
    assert {pair["reason"] for pair in report["clearance"]["unreached"]} == {"both are rigid"}


@pytest.mark.slow
def test_a_conflict_of_labels_is_settled_and_told(tmp_path, out):
    model = written(tmp_path / "pair", {"spleen": sphere(12, subdivisions=3), "bone": sphere(12, (10, 0, 0), 3)})
    code, report = run(model, "-o", out)
    (pair,) = report["clearance"]["pairs"]
    assert code == 0 and (pair["kind"], pair["winner"], pair["reached"]) == ("conflict", "bone", True)
    assert report["clearance"]["conflicts"] == [pair["reason"]] and "bone keeps it" in pair["reason"]
    assert meshes(out)["bone.stl"] == meshes(model)["bone.stl"]
    assert tissue(report, "spleen")["volume_change"] < -0.3


@pytest.mark.slow
def test_what_can_not_be_had_is_told_with_its_place(tmp_path, out):
    plates = {
        "rib_1": box((-20, -20, -9), (20, 20, 0)),
        "rib_2": box((-20, -20, 1.6), (20, 20, 11)),
        "nerve": box((-10, -10, 0.1), (10, 10, 1.5)),
    }
    code, report = run(written(tmp_path / "press", plates), "-o", out, "--rounds", 1)
    assert code == 1 and report["summary"]["counts"].keys() == {"P005"}
    unreached = report["clearance"]["unreached"]
    assert {(pair["a"], pair["b"]) for pair in unreached} == {("nerve", "rib_1"), ("nerve", "rib_2")}
    for pair in unreached:
        assert 0 < pair["after"]["min_gap_mm"] < 1 and pair["reason"] and len(pair["places"]) == 2
    assert meshes(out)["rib_1.stl"] == meshes(tmp_path / "press")["rib_1.stl"]
    # Nor can another run have it: what was squeezed once is not squeezed more.
    code, again = run(out, "-o", tmp_path / "again", "--rounds", 1)
    assert code == 1 and meshes(tmp_path / "again") == meshes(out)
    assert tissue(again, "nerve")["status"] == "refused"
    assert "squeezed" in again["clearance"]["unreached"][0]["reason"]


@pytest.mark.slow
def test_the_same_surface_twice_and_open_surfaces_are_left_and_told(tmp_path, out):
    cup = sphere(12, subdivisions=3)
    cup = Mesh(cup.vertices, cup.faces[cup.vertices[cup.faces].mean(axis=1)[:, 2] < 8])
    other = sphere(10, (60, 0, 0), subdivisions=2)
    tissues = {"spleen": cup, "kidney": sphere(12, (19, 0, 0), 3), "liver": other, "copy": other}
    code, report = run(written(tmp_path / "odd", tissues), "-o", out)
    assert code == 1 and {"P004", "T001"} <= report["summary"]["counts"].keys()
    reasons = {(pair["a"], pair["b"]): pair["reason"] for pair in report["clearance"]["unreached"]}
    assert "the same surface" in reasons["copy", "liver"]
    assert meshes(out)["liver.stl"] == meshes(tmp_path / "odd")["liver.stl"]


def test_a_file_that_can_not_be_read_does_not_stop_the_others(tmp_path, out):
    model = written(tmp_path / "pair", {"spleen": sphere(12, subdivisions=3), "kidney": sphere(12, (23, 0, 0), 3)})
    (model / "broken.stl").write_bytes(b"solid nothing")
    code, report = run(model, "-o", out)
    assert code == 1 or code == 3
    assert distance(out, "spleen", "kidney") >= 1.0
    assert tissue(report, "broken")["status"] in ("failed", "unchanged")
    assert (out / "broken.stl").read_bytes() == b"solid nothing"


def test_other_formats_and_units(tmp_path, out):
    metres = {name: Mesh(mesh.vertices / 1000, mesh.faces) for name, mesh in TISSUES.items() if name != "skin"}
    code, report = run(written(tmp_path / "ply", metres, "ply"), "-o", out, "--units", "m")
    assert code == 0 and report["summary"]["counts"] == {}
    assert {pair["relation"] for pair in report["pairs"]} <= {"disjoint", "a_inside_b", "b_inside_a"}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--grid", "0"], "grid"),
        (["--method", "pull"], "pull"),
        (["--rounds", "9"], "rounds"),
    ],
)
def test_wrong_options_are_refused(tmp_path, out, options, message, capsys):
    model = written(tmp_path / "one", {"spleen": sphere(12)})
    assert main(["separate", str(model), "-o", str(out), *options]) == 2
    assert message in capsys.readouterr().err and not out.exists()


@pytest.mark.parametrize(
    "text",
    ['[clearance]\nmethods = "cut"', '[clearance]\nmethod = "x"', '[[tissue]]\nmatch = "x"\nclearance = {yields = 1}'],
)
def test_wrong_settings_are_refused(tmp_path, out, text, capsys):
    model = written(tmp_path / "one", {"spleen": sphere(12)})
    (model / "vhp.toml").write_text(text)
    assert main(["separate", str(model), "-o", str(out)]) == 2
    assert "clearance" in capsys.readouterr().err and not out.exists()


def test_dry_run_writes_nothing(tmp_path, out):
    model = written(tmp_path / "one", {"spleen": sphere(12)})
    result = CliRunner().invoke(command.separate, [str(model), "-o", str(out), "--dry-run"])
    assert result.exit_code == 0 and "separate" in result.stdout and not out.exists()


def test_dry_run_knows_what_is_finished(torso, capsys):
    model, out, *_ = torso
    before = meshes(out)
    assert main(["separate", str(model), "-o", str(out), "--dry-run"]) == 0
    assert [line.split("\t")[1] for line in capsys.readouterr().out.splitlines()] == ["keep"] * len(TISSUES)
    assert main(["separate", str(model), "-o", str(out), "--dry-run", "--overwrite"]) == 0
    assert [line.split("\t")[1] for line in capsys.readouterr().out.splitlines()] == ["separate"] * len(TISSUES)
    assert main(["separate", str(model), "-o", str(out), "--dry-run", "--gap", "2"]) == 2
    assert "other settings" in capsys.readouterr().err and meshes(out) == before


def test_large_tissues_have_more_time_unless_a_limit_is_given():
    assert Limits(120, 4).timeout_for(10**7) == 120
    assert Limits(120, 4, bytes_per_second=5e3).timeout_for(10**5) == 120
    assert Limits(120, 4, bytes_per_second=5e3).timeout_for(5 * 10**6) == 1000


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3])
def test_planted_contacts_are_gone(tmp_path, seed):
    tissues, planted = plant_defects(generate(12_000, 24), seed, kinds=["P001", "P002", "P003", "P005"])
    assert planted
    model = written(tmp_path / "phantom", tissues)
    code, report = run(model, "-o", tmp_path / "out")
    assert code == 0, report["clearance"]["unreached"]
    assert report["clearance"]["close_before"] >= len(planted) and report["clearance"]["close_after"] == 0
    changes = [abs(one["volume_change"]) for one in report["clearance"]["tissues"]]
    assert float(np.median(changes)) < 0.02
    for record in report["tissues"]:
        assert record["introduced"] == []
        if record["tissue_type"] == "bone":
            assert record["status"] == "unchanged"
    before = dict(report["nesting"].items())
    assert before == nesting_of(model)


def nesting_of(model) -> dict:
    """Return the nesting of the sound phantom; contacts do not change it here."""
    from vhp_cli.config import load_settings
    from vhp_cli.model import find_model
    from vhp_cli.pipeline.check import check_model

    sound = generate(12_000, 24)
    for name, mesh in sound.items():
        write_mesh(model / f"{name}.stl", mesh)
    return check_model(find_model([model]), load_settings()).report["nesting"]


@pytest.mark.slow
def test_what_fails_when_done_more_finely_stays_as_it_was(tmp_path, out, monkeypatch):
    monkeypatch.setattr(clearance, "TARGET", "clearance_targets:only_coarse")
    model = written(tmp_path / "pair", {"spleen": sphere(12, subdivisions=3), "kidney": sphere(12, (23, 0, 0), 3)})
    code, report = run(model, "-o", out)
    assert code == 1 and 0.5 <= distance(out, "spleen", "kidney") < 1.0
    (pair,) = report["clearance"]["unreached"]
    assert "no finer" in pair["reason"]
    for record in report["tissues"]:
        assert record["status"] == "changed" and record["actions"][0]["step"] in ("move", "cut")
    assert {one["level"] for one in report["clearance"]["tissues"]} == {1}


@pytest.mark.slow
def test_others_give_way_for_what_does_not_but_bone_never(tmp_path, out, monkeypatch):
    monkeypatch.setattr(clearance, "TARGET", "clearance_targets:stubborn_spleen")
    tissues = {"spleen": sphere(12, subdivisions=3), "kidney": sphere(12, (23, 0, 0), 3)}
    code, report = run(written(tmp_path / "pair", tissues), "-o", out)
    assert code == 0 and distance(out, "spleen", "kidney") >= 1.0
    assert tissue(report, "spleen")["status"] == "refused" and tissue(report, "kidney")["status"] == "changed"
    tissues = {"spleen": sphere(12, subdivisions=3), "rib_1": sphere(12, (23, 0, 0), 3)}
    code, report = run(written(tmp_path / "bone", tissues), "-o", out, "--overwrite")
    assert code == 1 and meshes(out)["rib_1.stl"] == meshes(tmp_path / "bone")["rib_1.stl"]
    assert "stubborn" in report["clearance"]["unreached"][0]["reason"]


@pytest.mark.slow
def test_others_give_way_for_what_failed(tmp_path, out, monkeypatch):
    monkeypatch.setattr(clearance, "TARGET", "clearance_targets:failing_spleen")
    tissues = {"spleen": sphere(12, subdivisions=3), "kidney": sphere(12, (23, 0, 0), 3)}
    code, report = run(written(tmp_path / "pair", tissues), "-o", out)
    assert code == 3 and "it broke" in tissue(report, "spleen")["reason"]
    assert distance(out, "spleen", "kidney") >= 1.0 and tissue(report, "kidney")["status"] == "changed"
    assert report["clearance"]["unreached"] == []
