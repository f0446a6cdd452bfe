"""The benchmark runs and counts right; how fast anything is, is not a matter for tests."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from shapes import box, moved, sphere

from vhp_cli.mesh import Mesh

BENCHMARKS = Path(__file__).resolve().parents[1] / "benchmarks"

FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="the benchmark measures with os.wait4")


@pytest.fixture
def benchmark_modules(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    names = ("check", "models", "peers")
    yield {name: importlib.import_module(name) for name in names}
    for name in names:
        sys.modules.pop(name, None)


@pytest.fixture
def check(benchmark_modules: dict[str, ModuleType]) -> ModuleType:
    return benchmark_modules["check"]


@pytest.fixture
def models(benchmark_modules: dict[str, ModuleType]) -> ModuleType:
    return benchmark_modules["models"]


def write_stl(path: Path, mesh: Mesh) -> None:
    facets = np.zeros(len(mesh.faces), FACET)
    facets["corners"] = mesh.vertices[mesh.faces]
    path.write_bytes(bytes(80) + np.uint32(len(facets)).tobytes() + facets.tobytes())


@pytest.fixture
def model(tmp_path: Path) -> Path:
    """Five tissues with one defect of each sort."""
    directory = tmp_path / "model"
    directory.mkdir()
    ball = sphere(10, (115, 6, 7), subdivisions=1)
    spike = ball.vertices.copy()
    spike[spike[:, 0].argmax()] = (101, 5.5, 6.5)
    opened = box((100, 0, 0), (110, 10, 10))
    tissues = {
        "outer": sphere(60, subdivisions=3),
        "left": box((-10, -10, -10), (10, 10, 10)),
        "right": box((10.5, -10, -10), (30, 10, 10)),
        "open": Mesh(opened.vertices, opened.faces[1:]),
        # Crosses itself, and the open one.
        "spike": Mesh(spike, ball.faces),
    }
    for name, mesh in tissues.items():
        write_stl(directory / f"{name}.stl", mesh)
    return directory


EXPECTED = {
    "tissues": 5,
    "triangles": 20 * 4**3 + 12 + 12 + 11 + 80,
    "not_closed": 1,
    "not_manifold": 0,
    "misoriented": 0,
    "self_intersecting": 1,
    "poor_triangles": 0,
    "short_edges": 0,
    "contacts": 1,
    "narrow_gaps": 1,
    "nested": 2,
}


def test_every_contestant_finds_what_is_there(
    model: Path, tmp_path: Path, check: ModuleType, pymeshlab: ModuleType
) -> None:
    target = tmp_path / "figures.json"
    command = [
        sys.executable,
        str(BENCHMARKS / "check.py"),
        "--models",
        str(model),
        "--rounds",
        "1",
        "--json",
        str(target),
    ]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    results = json.loads(target.read_text())["models"][str(model)]
    present = [name for name in check.peers.STACKS if check.installed(name)]
    assert list(results) == ["vhp", *present]
    for name, result in results.items():
        assert result["found"] == EXPECTED, name
        (used,) = result["runs"]
        assert used["cpu_s"] > 0 and used["wall_s"] > 0 and used["memory_mb"] > 1
    for name in set(check.peers.STACKS) - set(present):
        assert f"{name}: not installed" in done.stdout


def test_a_failing_contestant_is_named_and_fails_the_run(model: Path) -> None:
    (model / "left.stl").write_bytes(b"")
    command = [
        sys.executable,
        str(BENCHMARKS / "check.py"),
        "--models",
        str(model),
        "--rounds",
        "1",
        "--peers",
        "igl+fcl",
    ]
    if not all(importlib.util.find_spec(module) for module in ("igl", "fcl")):
        pytest.skip("libigl or python-fcl is not installed")
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 1
    assert "igl+fcl failed: " in done.stdout


def test_checking_again_is_measured_on_a_copy(model: Path, tmp_path: Path, check: ModuleType) -> None:
    before = {file.name: file.read_bytes() for file in model.iterdir()}
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    result = check.warm(model, 1, scratch)
    assert {len(runs) for runs in result.values()} == {1}
    assert {file.name: file.read_bytes() for file in model.iterdir()} == before
    assert "unchanged" in check.warm_table(result)


def test_a_missing_stack_is_reported(check: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    stack = check.peers.Stack(check.peers.by_igl, ("no_such_module",), ("no-such-package",))
    monkeypatch.setitem(check.peers.STACKS, "absent", stack)
    monkeypatch.setattr(sys, "argv", ["check.py", "--models", "", "--peers", "absent"])
    assert check.main() == 0
    assert "absent: not installed (pip install no-such-package)" in capsys.readouterr().out


def test_a_missing_model_is_skipped(check: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys, tmp_path: Path) -> None:
    monkeypatch.setattr(sys, "argv", ["check.py", "--models", str(tmp_path), "--peers", ""])
    assert check.main() == 0
    assert f"skipped: no STL files in {tmp_path}" in capsys.readouterr().out


def test_measure_counts_the_work_and_memory_of_the_child(check: ModuleType) -> None:
    busy = check.measure([sys.executable, "-c", "import time\nwhile time.process_time() < 0.3: pass"])
    assert busy.cpu_s >= 0.3
    assert busy.wall_s >= 0.3
    # Linux counts the peak of the process that measures as the child's own: measure in a small one.
    code = (
        f"import sys; sys.path.insert(0, {str(BENCHMARKS)!r}); import check;"
        """print(check.measure([sys.executable, "-c", "b'x' * (200 * 2**20)"]).memory_mb)"""
    )
    assert len(b"x" * (300 * 2**20)) > 0  # this process is a large one
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert 200 < float(done.stdout) < 250


def test_measure_refuses_other_exit_codes(check: ModuleType) -> None:
    command = [sys.executable, "-c", "import sys; sys.exit('no luck')"]
    with pytest.raises(check.RunFailed, match="no luck"):
        check.measure(command)
    assert check.measure(command, accept=(1,)).code == 1


def test_ratios_are_taken_within_a_round(check: ModuleType) -> None:
    peer = [{"wall_s": 4.0}, {"wall_s": 30.0}, {"wall_s": 9.0}]
    vhp = [{"wall_s": 1.0}, {"wall_s": 10.0}, {"wall_s": 4.5}]
    assert check.ratios(peer, vhp, "wall_s") == [2.0, 3.0, 4.0]
    assert check.spread([2.0, 3.0, 4.0], 1) == "3.0 (2.0-4.0)"


@pytest.mark.parametrize("power", [0.5, 1.0, 2.0])
def test_exponent_is_that_of_a_power_law(check: ModuleType, power: float) -> None:
    sizes = [1e5, 3e5, 1e6, 5e6]
    assert check.exponent(sizes, [3 * size**power for size in sizes]) == pytest.approx(power)


def test_table_is_markdown(check: ModuleType) -> None:
    assert check.table(["", "s"], [["vhp", "1"], ["another", "10"]]).splitlines() == [
        "|         |   s |",
        "|---------|----:|",
        "| vhp     |   1 |",
        "| another |  10 |",
    ]


def test_a_moved_tissue_replaces_the_link_and_not_its_target(models: ModuleType, tmp_path: Path) -> None:
    mesh = box()
    original, place = tmp_path / "box.stl", tmp_path / "link.stl"
    write_stl(original, mesh)
    content = original.read_bytes()
    place.symlink_to(original)
    models.write_moved(original, place, (0.5, 0.0, -2.0))
    assert original.read_bytes() == content
    assert not place.is_symlink()
    corners = np.frombuffer(place.read_bytes(), FACET, offset=84)["corners"]
    assert np.array_equal(corners, moved(mesh, (0.5, 0, -2)).vertices[mesh.faces].astype("f4"))


def test_copies_lie_side_by_side(models: ModuleType, model: Path, tmp_path: Path) -> None:
    models.write_copies(model, 3, tmp_path / "copies")
    assert models.triangle_count(tmp_path / "copies") == 3 * EXPECTED["triangles"]
    assert len(models.stl_files(tmp_path / "copies")) == 15


@pytest.fixture
def healing(monkeypatch: pytest.MonkeyPatch):
    """The modules of the benchmark of `vhp heal`."""
    monkeypatch.syspath_prepend(BENCHMARKS)
    names = ("check", "damage", "heal", "models", "peers", "referee", "repairers")
    yield {name: importlib.import_module(name) for name in names}
    for name in names:
        sys.modules.pop(name, None)


def arrays(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    return mesh.vertices, mesh.faces


def test_made_defects_are_defects_of_sound_shapes(healing: dict[str, ModuleType]) -> None:
    damage, referee = healing["damage"], healing["referee"]
    assert len(damage.CASES) >= 30
    touching = {"two spheres, joined at a vertex", "two boxes, joined at an edge"}
    for name in damage.CASES:
        if damage.needs_union(name) and not importlib.util.find_spec("manifold3d"):
            continue
        case = damage.case(name)
        given = referee.judge(case.damaged)
        assert not given.sound or given.min_quality < 0.01, name
        if case.clean is not None and name not in touching:
            assert referee.judge(case.clean).sound, name
    again = damage.case("sphere, noise").damaged
    assert again.vertices.tobytes() == damage.case("sphere, noise").damaged.vertices.tobytes()


def test_damage_lies_where_its_kind_says(healing: dict[str, ModuleType]) -> None:
    damage, referee = healing["damage"], healing["referee"]
    for name in ("sphere, holes", "torus, flipped faces", "sphere, inner wall", "plate, noise"):
        case = damage.case(name)
        apart = referee.deviation(case.damaged, case.clean, lost_limit_mm=0.0)
        beyond, missing = apart["to_output"]["max"] > 1e-6, apart["to_input"]["max"] > 1e-6
        assert (beyond, missing) == {
            "missing": (False, True),
            "topology": (False, False),
            "extra": (True, False),
            "moved": (True, True),
        }[case.kind], name


def test_the_referee_sees_what_is_wrong(healing: dict[str, ModuleType]) -> None:
    referee = healing["referee"]
    ball, opened = sphere(10, subdivisions=2), box()
    same = referee.judged(arrays(ball), arrays(ball), arrays(ball))
    assert same["sound"] and same["independent"] and same["flaws"] == same["new_flaws"] == []
    assert same["to_output_mm"] < 1e-6 and same["outside_mm"] == 0
    assert same["volume_change"] == pytest.approx(0, abs=1e-12)
    assert same["truth"]["output_mm"] < 1e-6

    larger = sphere(11, subdivisions=2)
    moved_out = referee.judged(arrays(ball), arrays(larger), None)
    assert moved_out["to_output_mm"] == pytest.approx(1, abs=0.1)
    # What lies within the output is not gone.
    assert moved_out["outside_mm"] == 0 and moved_out["truth"] is None
    assert moved_out["volume_change"] == pytest.approx(1.1**3 - 1, rel=1e-5)
    shrunk = referee.judged(arrays(larger), arrays(ball), None)
    assert shrunk["outside_mm"] == pytest.approx(1, abs=0.1)

    hole = referee.judged(arrays(opened), (opened.vertices, opened.faces[1:]), None)
    assert not hole["sound"] and not hole["independent"]
    assert hole["new_flaws"] == ["boundary_edges"]
    assert "trimesh: not watertight" in hole["flaws"]
    inward = referee.judged(arrays(opened), (opened.vertices, opened.faces[:, ::-1]), None)
    assert inward["new_flaws"] == ["inward_components"]
    assert "trimesh: no positive volume" in inward["flaws"]

    crossed = damage_of_two_boxes()
    crossing = referee.judged(arrays(opened), arrays(crossed), None)
    assert crossing["new_flaws"] == ["self_intersections"]
    assert any(flaw.endswith(": self-intersections") for flaw in crossing["flaws"])
    broken = opened.vertices.copy()
    broken[0, 0] = np.nan
    assert not referee.judged(arrays(opened), (broken, opened.faces), None)["sound"]
    assert referee.judged(arrays(opened), (opened.vertices, opened.faces[:0]), None)["flaws"] == ["no faces"]


def damage_of_two_boxes() -> Mesh:
    second = moved(box(), (5.1, 4.2, 3.3))
    first = box()
    faces = np.concatenate((first.faces, second.faces + len(first.vertices)))
    return Mesh(np.concatenate((first.vertices, second.vertices)), faces)


def test_repairers_answer_like_each_other(healing: dict[str, ModuleType], pymeshlab: ModuleType) -> None:
    repairers, referee = healing["repairers"], healing["referee"]
    opened = Mesh(box().vertices, box().faces[1:])
    for name in repairers.REPAIRERS:
        # Wrapping takes seconds; the last line of the test below runs vhp.
        if not healing["heal"].installed(name) or name == "pymeshlab wrap" or name.startswith("vhp"):
            continue
        repairers.warm_up(name)
        made, wall, cpu = repairers.timed(name, *arrays(opened))
        assert made["status"] == "changed" and wall > 0 and cpu >= 0
        row = referee.judged(arrays(opened), (made["vertices"], made["faces"]), arrays(box()))
        assert row["sound"] and row["independent"], (name, row["flaws"])
        assert row["truth"]["volume_error"] == pytest.approx(0, abs=1e-6), name


def test_healing_is_compared_from_the_command_line(tmp_path: Path, pymeshlab: ModuleType) -> None:
    data, target = tmp_path / "data", tmp_path / "rows.json"
    (data / "part").mkdir(parents=True)
    write_stl(data / "a.stl", box())
    write_stl(data / "b.stl", sphere(10, subdivisions=1))
    write_stl(data / "part" / "c.stl", Mesh(box().vertices, box().faces[1:]))
    command = [sys.executable, str(BENCHMARKS / "heal.py"), "--groups", "real", "--data", str(data), "--every", "2"]
    command += ["--peers", "vhp --only-topology,trimesh.repair", "--json", str(target), "--timeout", "30"]
    if not importlib.util.find_spec("networkx"):
        pytest.skip("trimesh can't repair without networkx")
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "## real: 2 meshes" in done.stdout
    rows = json.loads(target.read_text())["rows"]
    assert {row["mesh"] for row in rows} == {"a.stl", "part/c.stl"}
    assert len(rows) == 4
    for row in rows:
        assert row["sound"] and row["independent"] and row["triangles"] == 12
        assert row["cpu_s"] >= 0 and row["wall_s"] > 0
    assert {row["status"] for row in rows if row["mesh"] == "a.stl"} == {"unchanged", "changed"}
    shown = subprocess.run([*command[:2], "--from-json", str(target)], capture_output=True, text=True)
    assert shown.stdout.strip() in done.stdout


def test_a_repairer_that_does_not_end_is_stopped(
    healing: dict[str, ModuleType], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    heal = healing["heal"]
    # Children load their own modules: a slow one is put in the way of the real one.
    (tmp_path / "repairers.py").write_text(
        "import time\n"
        "def one_core(core): pass\n"
        "def warm_up(name): pass\n"
        "def timed(name, vertices, faces): time.sleep(60)\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    contestant = heal.Contestant("trimesh.repair", 2.0, 0)
    try:
        row, made = contestant.run(arrays(box()), 0.5)
    finally:
        contestant.close()
    assert made is None and row["error"] == "timeout"


def test_invalid_outputs_count_for_nothing(healing: dict[str, ModuleType]) -> None:
    heal = healing["heal"]
    good = {
        "group": "real", "mesh": "a", "repairer": "vhp", "status": "changed", "reason": "", "sound": True,
        "independent": True, "flaws": [], "new_flaws": [], "triangles": 20, "triangles_in": 10, "min_quality": 0.5,
        "mean_quality": 0.9, "min_edge_mm": 0.5, "limit_mm": 0.1, "lost_limit_mm": 0.2, "to_output_mm": 0.15,
        "outside_mm": 0.0, "outside_at_mm": None, "volume_change": -0.001, "truth": None, "cpu_s": 2.0, "wall_s": 3.0,
    }  # fmt: skip
    rows = [
        good,
        {**good, "mesh": "b", "min_quality": 0.1, "to_output_mm": 0.5, "outside_mm": 0.5, "outside_at_mm": [1, 2, 3]},
        {**good, "mesh": "c", "independent": False, "flaws": ["trimesh: not watertight"]},
        {"group": "real", "mesh": "d", "repairer": "vhp", "triangles_in": 10, "error": "timeout", "reason": "60 s"},
    ]
    line = heal.summary_table(rows, ["vhp"]).splitlines()[2]
    cells = [cell.strip() for cell in line.strip("|").split("|")]
    assert cells[:6] == ["vhp", "50.0", "0.300", "25.0", "50.0", "50.0"]
    assert cells[6:12] == ["0.325", "2", "1", "1", "0.100 (0.100)", "0"]
    assert cells[12:] == ["2.00", "2.00", "2.0", "3.0+", "10"]
    failures = heal.failure_table(rows, ["vhp"]).splitlines()[2]
    assert [cell.strip() for cell in failures.strip("|").split("|")] == ["vhp", "2", "0", "1", "0", "0", "0", "0", "1"]
    assert list(heal.remarks(rows, "vhp")) == [
        "- b: material lost: 0.50 mm away at (1.0, 2.0, 3.0)",
        "- c: not valid: changed: trimesh: not watertight",
        "- d: not valid: timeout: 60 s",
    ]
