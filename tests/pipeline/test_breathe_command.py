"""`vhp breathe` from end to end: what it writes, proves, says and refuses."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import fcl
import jsonschema
import manifold3d
import numpy as np
import pytest
import trimesh
from click.testing import CliRunner
from shapes import box, sphere

from vhp_cli.cli import main
from vhp_cli.commands.breathe import breathe
from vhp_cli.formats import read_mesh, write_mesh
from vhp_cli.formats.stl import RECORD
from vhp_cli.mesh import Mesh
from vhp_cli.phantom import generate
from vhp_cli.report import schema
from vhp_cli.stages.breathe.blend import Blend, Holder
from vhp_cli.stages.breathe.curves import Polynomial
from vhp_cli.stages.breathe.operations import LocalFrame, Move, Parameter
from vhp_cli.stages.breathe.options import KEYS
from vhp_cli.stages.breathe.sequence import Motion, Sequence, Targets
from vhp_cli.stages.breathe.sequence_file import format_sequence, parse_sequence

BONES = ("rib", "sternum", "clavicle", "vertebra")


def run(*arguments) -> tuple[int, dict]:
    result = CliRunner().invoke(breathe, [*map(str, arguments), "--report", "-", "-j2"])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, json.loads(result.stdout) if result.stdout else {}


def refused(capsys, *arguments) -> str:
    assert main(["breathe", *map(str, arguments)]) == 2
    return capsys.readouterr().err


def corners(path: Path) -> np.ndarray:
    """Return the corners of the facets of a binary STL, as they are in the file."""
    return np.frombuffer(path.read_bytes()[84:], dtype=RECORD)["corners"]


def write_model(directory: Path, meshes: dict[str, Mesh]) -> Path:
    directory.mkdir(exist_ok=True)
    for name, mesh in meshes.items():
        write_mesh(directory / f"{name}.stl", mesh)
    return directory


@pytest.fixture(scope="module")
def phantom() -> dict[str, Mesh]:
    return generate(20_000)


@pytest.fixture(scope="module")
def chest(phantom) -> dict[str, Mesh]:
    """Lungs, cage and diaphragm alone, which is less to do."""
    kept = ("lung", "rib", "costal", "sternum", "vertebra", "diaphragm", "liver", "skin")
    return {name: mesh for name, mesh in phantom.items() if name.startswith(kept)}


@pytest.fixture(scope="module")
def model(phantom, tmp_path_factory) -> Path:
    return write_model(tmp_path_factory.mktemp("model") / "phantom", phantom)


@pytest.fixture(scope="module")
def done(model, tmp_path_factory) -> tuple[Path, dict]:
    out = tmp_path_factory.mktemp("breathing") / "out"
    code, report = run(model, "-o", out, "--no-cache")
    assert code == 0
    return out, report


def test_every_frame_is_written_under_the_names_of_the_input(model, done):
    out, report = done
    names = sorted(path.name for path in model.iterdir())
    frames = report["breathe"]["frames"]
    assert [frame["x"] for frame in frames] == [*range(12), *range(10, -1, -1)]
    assert len({frame["directory"] for frame in frames}) == 23
    for frame in frames:
        assert sorted(path.name for path in (out / frame["directory"]).iterdir()) == names
    rows = list(csv.DictReader((out / "frames" / "index.csv").read_text().splitlines()))
    assert [f"frames/{row['directory']}" for row in rows] == [frame["directory"] for frame in frames]
    assert [float(row["x"]) for row in rows] == [frame["x"] for frame in frames]
    assert sorted(path.name for path in out.iterdir()) == [
        "animation.gif", "animation.html", "curves.svg", "frames", "report.json", "scripts", "sequence.toml",
    ]  # fmt: skip


def test_the_first_frame_is_the_model_and_the_last_one_the_first(model, done):
    out, report = done
    first, last = (out / report["breathe"]["frames"][index]["directory"] for index in (0, -1))
    moved = 0
    for path in model.iterdir():
        assert corners(first / path.name).tobytes() == corners(path).tobytes()
        assert (last / path.name).read_bytes() == (first / path.name).read_bytes()
        full = out / report["breathe"]["frames"][11]["directory"] / path.name
        assert len(corners(full)) == len(corners(path))
        moved += corners(full).tobytes() != corners(path).tobytes()
    assert moved > 50


def test_written_frames_have_the_vertex_order_and_the_faces_of_the_input(model, done):
    out, report = done
    for name in ("lung_left", "rib_right_07", "skin", "aorta", "costal_cartilage_left_08"):
        before = read_mesh(model / f"{name}.stl").mesh
        for frame in report["breathe"]["frames"][:12]:
            after = read_mesh(out / frame["directory"] / f"{name}.stl").mesh
            assert np.array_equal(after.faces, before.faces)


def test_what_the_report_says_of_lungs_is_so_on_the_written_files(model, done):
    out, report = done
    section = report["breathe"]

    def lungs(folder: Path) -> tuple[float, float]:
        found = [trimesh.load_mesh(folder / f"lung_{side}.stl") for side in ("left", "right")]
        return sum(mesh.volume for mesh in found) / 1e6, min(mesh.bounds[0, 2] for mesh in found)

    rest_volume, rest_low = lungs(model)
    for frame in section["frames"][:12]:
        volume, low = lungs(out / frame["directory"])
        assert frame["lung_volume_l"] == pytest.approx(volume, abs=1e-6)
        assert frame["diaphragm_travel_mm"] == pytest.approx(rest_low - low, abs=1e-4)
    full = section["frames"][11]
    assert full["lung_volume_l"] - rest_volume == pytest.approx(0.320, abs=1e-3)
    assert full["diaphragm_travel_mm"] == pytest.approx(20.0, abs=0.1)


def test_no_tissue_crosses_another_in_any_written_frame(model, done):
    # By fcl, which shares nothing with what wrote them.
    out, report = done
    names = sorted(path.stem for path in model.iterdir())

    def body(mesh: Mesh) -> fcl.CollisionObject:
        made = fcl.BVHModel()
        made.beginModel(len(mesh.vertices), len(mesh.faces))
        made.addSubModel(mesh.vertices.copy(), mesh.faces.astype(np.int64))
        made.endModel()
        return fcl.CollisionObject(made)

    for frame in report["breathe"]["frames"][2:12:3]:
        assert frame["crossings"] == 0 and frame["passed"]
        meshes = {name: read_mesh(out / frame["directory"] / f"{name}.stl").mesh for name in names}
        bodies = {name: body(mesh) for name, mesh in meshes.items()}
        low = np.array([meshes[name].vertices.min(axis=0) for name in names])
        high = np.array([meshes[name].vertices.max(axis=0) for name in names])
        near = ((low[:, None] <= high[None]) & (high[:, None] >= low[None])).all(axis=2)
        for i, j in np.argwhere(np.triu(near, 1)):
            pair = bodies[names[i]], bodies[names[j]]
            assert not fcl.collide(*pair, fcl.CollisionRequest(), fcl.CollisionResult()), (names[i], names[j])


def test_bones_keep_their_edges_within_what_float32_can_hold(model, done):
    out, report = done
    full = out / report["breathe"]["frames"][11]["directory"]
    for path in sorted(model.iterdir()):
        if not path.name.startswith(BONES):
            continue
        before, after = (corners(folder / path.name).astype(float) for folder in (model, full))
        lengths = [np.linalg.norm(np.roll(part, -1, axis=1) - part, axis=2) for part in (before, after)]
        # Half a unit in the last place of 300 mm for each coordinate of both ends.
        assert np.abs(lengths[1] - lengths[0]).max() < 6e-5


def test_the_mass_stays_and_everything_else_is_within_its_limits(done):
    _, report = done
    section = report["breathe"]
    assert report["summary"]["passed"] and section["passed"] and report["command"] == "breathe"
    assert not report["findings"]
    assert max(abs(frame["mass_change"]) for frame in section["frames"]) < 1e-4
    assert section["mass"]["held"] and section["mass"]["convention"] == "fixed-mass"
    assert min(frame["min_gap_mm"] for frame in section["frames"]) >= 1.0 - 1e-4
    assert section["proof"]["unproven"] == [] and section["proof"]["excused"] == []
    assert section["proof"]["least_gap_mm"] > 0
    assert section["infeasible"] == []
    assert section["roles"]["rib_left_06"] == "left rib 6"
    assert {"lung_left", "rib_left_06", "skin", "liver"} <= set(section["motions"])
    displacement = section["frames"][11]["tissues"]["lung_left"]["displacement_mm"]
    assert 19.0 < displacement["max"] < 22.0
    assert report["settings"]["breathe"].keys() == KEYS.keys()


def test_the_report_keeps_to_its_schema_and_is_the_one_in_the_file(done):
    out, report = done
    jsonschema.validate(report, schema())
    assert json.loads((out / "report.json").read_text()) == report


def test_a_stored_sequence_gives_the_same_frames(model, done, tmp_path):
    out, report = done
    code, again = run("play", model, "--sequence", out / "sequence.toml", "-o", tmp_path / "out", "--frames", "3")
    assert code == 0
    assert [frame["x"] for frame in again["breathe"]["frames"]] == [0, 11, 0]
    full = report["breathe"]["frames"][11]["directory"]
    for name in ("lung_right", "skin", "costal_cartilage_right_05", "stomach"):
        ours = tmp_path / "out" / again["breathe"]["frames"][1]["directory"] / f"{name}.stl"
        assert ours.read_bytes() == (out / full / f"{name}.stl").read_bytes()
    assert (tmp_path / "out" / "sequence.toml").read_bytes() == (out / "sequence.toml").read_bytes()
    # Without a frame at every step, there are no scripts.
    assert not (tmp_path / "out" / "scripts").exists()


def test_two_runs_differ_in_their_times_alone(model, done, tmp_path):
    out, report = done
    code, again = run("fit", model, "-o", tmp_path / "out", "--no-cache")
    assert code == 0
    assert (tmp_path / "out" / "sequence.toml").read_bytes() == (out / "sequence.toml").read_bytes()
    assert not (tmp_path / "out" / "frames").exists()
    for kept in (report, again):
        kept = dict(kept)
        kept.pop("run")
    assert again["breathe"]["proof"] == report["breathe"]["proof"]
    assert [{**f, "directory": ""} for f in report["breathe"]["frames"]] == again["breathe"]["frames"]


def test_verify_writes_nothing(model, done, tmp_path, monkeypatch):
    out, _ = done
    monkeypatch.chdir(tmp_path)
    code, report = run("verify", model, "--sequence", out / "sequence.toml", "--times", "0,1.2,2.5")
    assert code == 0
    assert list(tmp_path.iterdir()) == []
    assert [frame["directory"] for frame in report["breathe"]["frames"]] == ["", "", ""]
    assert report["breathe"]["frames"][2]["x"] == pytest.approx(11.0)


def test_scripts_name_the_frames_and_every_tissue(model, done):
    out, report = done
    assert sorted(path.name for path in (out / "scripts").iterdir()) == [
        "aedt_native.py", "aedt_pyaedt.py", "breathe_apply.m", "breathe_frame.m", "cst_breathe.bas",
    ]  # fmt: skip
    text = (out / "scripts" / "aedt_pyaedt.py").read_text()
    for path in model.iterdir():
        assert path.name in text
    assert report["breathe"]["frames"][11]["directory"] in text


def test_scripts_alone(chest, tmp_path, done):
    model = write_model(tmp_path / "model", chest)
    code, _ = run("script", model, "--sequence", done[0] / "sequence.toml", "--for", "cst", "-o", tmp_path / "out")
    assert [path.name for path in (tmp_path / "out" / "scripts").iterdir()] == ["cst_breathe.bas"]
    assert code in (0, 1)


# ---------------------------------------------------------------- failures


def colliding(done, tmp_path) -> Path:
    """Return the fitted sequence with the left lung moved further by 12 mm."""
    text = (done[0] / "sequence.toml").read_text()
    start = text.index('name = "lung_left"')
    end = text.index("[[motion]]", start)
    block = (
        text[start:end] + '  [[motion.operation]]\n  kind = "move"\n  x = { polynomial = [0.0, 1.1], unit = "mm" }\n\n'
    )
    path = tmp_path / "colliding.toml"
    path.write_text(text[:start] + block + text[end:])
    parse_sequence(path.read_text())
    return path


def test_frames_with_a_collision_are_rejected(model, done, tmp_path):
    out = tmp_path / "out"
    code, report = run("play", model, "--sequence", colliding(done, tmp_path), "-o", out, "--frames", "8")
    assert code == 1 and not report["summary"]["passed"] and not report["breathe"]["passed"]
    frames = report["breathe"]["frames"]
    rejected = [frame for frame in frames if not frame["passed"]]
    assert 0 < len(rejected) < len(frames)
    assert {frame["directory"].split("/")[0] for frame in rejected} == {"rejected"}
    written = {f"frames/{path.name}" for path in (out / "frames").iterdir() if path.is_dir()}
    assert written == {frame["directory"] for frame in frames if frame["passed"]}
    named = {tuple(finding["tissues"]) for finding in report["findings"] if finding["rule"] == "B001"}
    assert any("lung_left" in pair and any(name.startswith("rib_left") for name in pair) for pair in named)
    unproven = {tuple(finding["tissues"]) for finding in report["findings"] if finding["rule"] == "B003"}
    assert named <= unproven
    assert all("B001" in frame["reasons"] for frame in frames if frame["crossings"])
    assert not (out / "scripts").exists()


def test_a_tissue_that_is_bent_through_itself_is_named_and_rejected(tmp_path):
    model = write_model(tmp_path / "model", {"lungs": sphere(60.0, subdivisions=3), "strip": sphere(9.0, (0, 0, 120))})
    tangled = [
        Holder("up", (Move(LocalFrame(), z=Parameter(Polynomial((0.0, 3.0)))),), ((0.0, 0.0, 112.0, 3.0),)),
        Holder(
            "wall",
            (),
            tuple((x, y, z, 3.0) for x, y, z in [(0, 0, 128), (8, 0, 120), (-8, 0, 120), (0, 8, 120), (0, -8, 120)]),
        ),
    ]
    motions = (Motion("strip", fields=(Blend("strip", tuple(tangled)),), tissues=("strip",)),)
    path = tmp_path / "sequence.toml"
    path.write_text(format_sequence(Sequence("tangled", motions, targets=Targets(0.0, 0.0))))
    code, report = run("play", model, "--sequence", path, "-o", tmp_path / "out", "--frames", "3")
    assert code == 1
    [finding] = [finding for finding in report["findings"] if finding["rule"] == "B001"]
    assert finding["tissues"] == ["strip"] and "crosses itself" in finding["message"]
    assert [frame["passed"] for frame in report["breathe"]["frames"]] == [True, False, True]


def test_an_infeasible_model_ends_with_1_and_names_the_pair(chest, tmp_path):
    lung = chest["lung_left"].vertices
    lowest = lung[lung[:, 2].argmin()]
    meshes = {name: mesh for name, mesh in chest.items() if not name.startswith(("skin", "diaphragm", "liver"))}
    post = box(np.add(lowest, [-3, -3, -12]), np.add(lowest, [3, 3, -5]))
    model = write_model(tmp_path / "model", meshes | {"humerus": post})
    code, report = run(model, "-o", tmp_path / "out", "--frames", "3")
    assert code == 1
    assert {"humerus", "lung_left"} in [{item["a"], item["b"]} for item in report["breathe"]["infeasible"]]
    assert {"humerus", "lung_left"} in [set(f["tissues"]) for f in report["findings"] if f["rule"] == "B001"]
    assert (tmp_path / "out" / "rejected" / "index.csv").is_file()


@pytest.mark.slow
def test_the_published_sequence_on_a_strange_model_fails_by_name(model, tmp_path):
    code, report = run("verify", model, "--sequence", "vhp-female")
    assert code == 1
    assert {"B001", "B004", "B005"} <= set(report["summary"]["counts"])
    code, report = run("verify", model, "--sequence", "vhp-female", "--as-printed", "--frames", "3")
    assert code == 1 and "B009" in report["summary"]["counts"]


def test_a_pair_in_contact_at_rest_is_listed_and_may_stay(chest, tmp_path):
    meshes = {name: mesh for name, mesh in chest.items() if not name.startswith(("diaphragm", "liver", "skin"))}
    spine = chest["vertebra_t08"].vertices
    back = spine[spine[:, 1].argmax()]
    meshes["scapula"] = box(np.add(back, [-4, -2, -4]), np.add(back, [4, 10, 4]))
    code, report = run(write_model(tmp_path / "model", meshes), "-o", tmp_path / "out", "--frames", "3")
    assert code == 0
    contacts = report["breathe"]["rest_contacts"]
    assert [{item["a"], item["b"]} for item in contacts] == [{"scapula", "vertebra_t08"}]
    assert report["summary"]["counts"] == {"B011": 1}


# ---------------------------------------------------------------- usage


def test_what_makes_no_sense_is_refused(chest, model, done, tmp_path, capsys):
    organs = write_model(tmp_path / "organs", {"liver": sphere(40.0)})
    assert "no lungs" in refused(capsys, organs, "-o", tmp_path / "a")
    mirrored = {name: Mesh(mesh.vertices * [-1, 1, 1], mesh.faces[:, ::-1]) for name, mesh in chest.items()}
    assert "mirror image" in refused(capsys, write_model(tmp_path / "mirrored", mirrored), "-o", tmp_path / "b")
    small = {name: Mesh(mesh.vertices * 0.001, mesh.faces) for name, mesh in chest.items()}
    assert "--units" in refused(capsys, write_model(tmp_path / "small", small), "-o", tmp_path / "c")
    assert "is not empty" in refused(capsys, model, "-o", done[0])
    assert "overlap" in refused(capsys, model, "-o", model / "frames")
    assert "can't read the sequence" in refused(capsys, "verify", model, "--sequence", tmp_path / "none.toml")
    assert "vhp-female" in refused(capsys, "verify", model, "--sequence", "vhp-male")
    assert "not both" in refused(capsys, "verify", model, "--sequence", "vhp-female", "--frames", 5, "--times", "0,1")
    assert "seconds with commas" in refused(capsys, "verify", model, "--sequence", "vhp-female", "--times", "0;1")
    assert "no such program" in refused(
        capsys, "script", model, "--sequence", "vhp-female", "--for", "excel", "-o", tmp_path / "d"
    )
    (organs / "lung.stl").write_bytes(b"nothing")
    assert "must be readable" in refused(capsys, organs, "-o", tmp_path / "e")


def test_an_old_result_is_replaced_when_asked_and_nothing_else(chest, tmp_path):
    model, out = write_model(tmp_path / "model", chest), tmp_path / "out"
    assert run(model, "-o", out, "--steps", "2")[0] == 0
    (out / "notes.txt").write_text("mine")
    code, _ = run("fit", model, "-o", out, "--overwrite")
    assert code == 0
    assert sorted(path.name for path in out.iterdir()) == ["notes.txt", "report.json", "scripts", "sequence.toml"]
    assert list((out / "scripts").iterdir()) == []


def test_settings_of_the_model_and_of_tissues_are_taken(chest, tmp_path):
    meshes = {name.replace("lung_left", "object_1"): mesh for name, mesh in chest.items()}
    model = write_model(tmp_path / "model", meshes)
    (model / "vhp.toml").write_text(
        '[breathe]\npreset = "shallow"\nsteps = 4\n\n[[tissue]]\nmatch = "object_1"\n'
        'breathe = { role = "lung", side = "left", density = 300 }\n'
    )
    code, report = run(model, "-o", tmp_path / "out", "--period", "4")
    section = report["breathe"]
    assert code == 0
    assert section["roles"]["object_1"] == "left lung"
    assert section["mass"]["densities"]["object_1"] == {"kg_per_m3": 300.0, "source": "settings"}
    assert section["lungs"]["volume_change_l"] == pytest.approx(0.16, abs=1e-3)
    assert len(section["frames"]) == 9 and section["sequence"]["period_s"] == 4.0


def test_a_wrong_setting_of_a_tissue_is_refused(chest, tmp_path, capsys):
    model = write_model(tmp_path / "model", chest)
    (model / "vhp.toml").write_text('[[tissue]]\nmatch = "lung*"\nbreathe = { rolle = "lung" }\n')
    assert "did you mean 'role'?" in refused(capsys, model, "-o", tmp_path / "out")


@pytest.mark.slow
def test_a_turned_model_in_other_units_breathes_in_its_own_frame(chest, tmp_path):
    # RAS in cm: x and y negated, a tenth of the size.
    straight = write_model(tmp_path / "straight", chest)
    turned = write_model(
        tmp_path / "turned", {name: Mesh(mesh.vertices * [-0.1, -0.1, 0.1], mesh.faces) for name, mesh in chest.items()}
    )
    code, expected = run(straight, "-o", tmp_path / "a", "--frames", "3")
    assert code == 0
    code, report = run(turned, "-o", tmp_path / "b", "--frames", "3", "--units", "cm")
    assert code == 0
    assert report["breathe"]["axes"]["name"] == "RAS"
    for name in ("lung_left", "rib_right_05", "skin"):
        ours, theirs = (
            corners(tmp_path / folder / result["breathe"]["frames"][1]["directory"] / f"{name}.stl")
            for folder, result in (("a", expected), ("b", report))
        )
        assert np.allclose(theirs * [-10.0, -10.0, 10.0], ours, atol=2e-2)
        assert (
            corners(tmp_path / "b" / report["breathe"]["frames"][0]["directory"] / f"{name}.stl").tobytes()
            == corners(turned / f"{name}.stl").tobytes()
        )


@pytest.mark.parametrize("suffix", ["ply", pytest.param("obj", marks=pytest.mark.slow)])
def test_other_formats_keep_all_digits(chest, tmp_path, suffix):
    model = tmp_path / "model"
    model.mkdir()
    for name, mesh in chest.items():
        write_mesh(model / f"{name}.{suffix}", mesh)
    code, report = run(model, "-o", tmp_path / "out", "--frames", "3")
    assert code == 0
    first, full = (tmp_path / "out" / report["breathe"]["frames"][index]["directory"] for index in (0, 1))
    for name in ("lung_left", "rib_left_04"):
        rest, moved = (read_mesh(folder / f"{name}.{suffix}").mesh for folder in (first, full))
        assert np.array_equal(rest.vertices, read_mesh(model / f"{name}.{suffix}").mesh.vertices)
        assert np.array_equal(rest.faces, moved.faces)
    before, after = (
        np.linalg.norm(np.diff(mesh.vertices[mesh.faces[:, :2]], axis=1), axis=2) for mesh in (rest, moved)
    )
    assert np.abs(after / before - 1).max() < 1e-6


def test_the_table_says_what_became_of_each_frame(model, done, capsys):
    assert main(["breathe", "verify", str(model), "--sequence", str(done[0] / "sequence.toml"), "--frames", "3"]) == 0
    text = capsys.readouterr().out
    assert "passed: 3 frames" in text and "pairs proven apart at every moment" in " ".join(text.split())
    arguments = ["verify", str(model), "--sequence", str(done[0] / "sequence.toml"), "--frames", "3"]
    assert main(["--quiet", "breathe", *arguments]) == 0
    assert capsys.readouterr().out == ""


def test_the_short_form_runs_everything(capsys):
    runner = CliRunner()
    for arguments in (["--help"], ["run", "--help"], ["fit", "-h"]):
        result = runner.invoke(breathe, arguments)
        assert result.exit_code == 0 or arguments == ["fit", "-h"]
    assert main(["breathe", "--help"]) == 0
    text = capsys.readouterr().out
    for name in ("run", "fit", "play", "verify", "script"):
        assert f"  {name} " in text
    assert main(["breathe"]) == 2


def with_lungs(model: Path) -> Path:
    """Add two smooth bodies that fit into the real rib cage."""
    for side, sign in (("left", 1.0), ("right", -1.0)):
        body = sphere(1.0, subdivisions=4)
        placed = body.vertices * [22, 30, 60] + [sign * 72 - 1.7, -100, 1245]
        write_mesh(model / f"{side}_lung.stl", Mesh(placed, body.faces))
    return model


@pytest.mark.slow
def test_the_real_rib_cage_as_published(shared_data, tmp_path):
    """Open surfaces in contact at many joints: what can't be measured must not be moved against what it touches."""
    model = tmp_path / "model"
    model.mkdir()
    kept = ("rib", "costal_cartilage", "vertebra", "clavicle", "sternum", "manubrium")
    for path in sorted((shared_data / "thorax_r3").glob("*.stl")):
        if any(k in path.stem for k in kept) and "disk" not in path.stem:
            shutil.copy(path, model)
    breath = ("--travel", "8", "--volume-change", "0.05", "--frames", "3")
    code, report = run(with_lungs(model), "-o", tmp_path / "out", *breath)
    section = report["breathe"]
    assert len(section["rest_contacts"]) > 20
    listed = {frozenset((item["a"], item["b"])) for item in section["rest_contacts"]}
    assert {frozenset(pair) for key in ("joined", "bounded", "excused") for pair in section["proof"][key]} <= listed
    assert code == 0, report["findings"]
    assert section["proof"]["unproven"] == []
    assert {"left_lung", "right_lung"} <= set(section["motions"])


@pytest.mark.slow
def test_real_ribs_lift_in_their_joints_once_healed(shared_data, tmp_path):
    """Two pairs of ribs with their vertebrae, cartilages and sternum, healed: they cross where they are joined."""
    raw, model = tmp_path / "raw", tmp_path / "model"
    raw.mkdir()
    names = ["fifth_thoracic_vertebra", "sixth_thoracic_vertebra", "body_of_sternum"]
    names += [
        f"{s}_{n}_{k}" for s in ("left", "right") for n in ("fifth", "sixth") for k in ("rib", "costal_cartilage")
    ]
    for name in names:
        shutil.copy(shared_data / "thorax_r3" / f"{name}.stl", raw)
    assert main(["--quiet", "heal", str(raw), "-o", str(model), "-j2"]) in (0, 1)
    (model / "report.json").unlink()
    breath = ("--travel", "8", "--volume-change", "0.05", "--frames", "5")
    code, report = run(with_lungs(model), "-o", tmp_path / "out", *breath)
    section = report["breathe"]
    assert code == 0, report["findings"]
    assert section["infeasible"] == []
    assert min(section["rib_angles_deg"][number][0] for number in ("5", "6")) > 0.5
    proof = section["proof"]
    assert proof["excused"] == [] and proof["unproven"] == []
    assert len(proof["joined"]) == 8 and len(proof["bounded"]) >= 2
    assert len(section["rest_contacts"]) == len(proof["joined"]) + len(proof["bounded"])
    # Independently: the volumes in common of the frame at full inhalation, by manifold3d.
    full = tmp_path / "out" / section["frames"][2]["directory"]
    for pair in (*proof["joined"], *proof["bounded"]):
        before, after = (common_volume(folder, *pair) for folder in (model, full))
        assert after <= max(1.01 * before, before + 0.02)


def common_volume(folder: Path, *names: str) -> float:
    solids = []
    for name in names:
        mesh = read_mesh(folder / f"{name}.stl").mesh
        content = manifold3d.Mesh(mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32))
        solids.append(manifold3d.Manifold(content))
        assert solids[-1].status() == manifold3d.Error.NoError
    return (solids[0] ^ solids[1]).volume()
