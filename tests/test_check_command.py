"""``vhp check`` as a user runs it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from shapes import box, moved, sphere

from vhp_cli.cli import main
from vhp_cli.commands.check import check
from vhp_cli.formats import write_mesh
from vhp_cli.mesh import Mesh


@pytest.fixture(autouse=True)
def _own_cache(tmp_path_factory, monkeypatch):
    monkeypatch.setenv("VHP_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))


@pytest.fixture
def model(tmp_path) -> Path:
    directory = tmp_path / "model"
    directory.mkdir()
    write_mesh(directory / "skin.stl", sphere(60, subdivisions=3))
    write_mesh(directory / "liver.stl", sphere(15, (20, 0, 0), subdivisions=3))
    write_mesh(directory / "optic_nerve_left.stl", box((-12, -3, -3), (-6, 3, 3)))
    return directory


def run(*arguments) -> tuple[int, dict]:
    """Return exit code and JSON report."""
    result = CliRunner().invoke(check, [str(argument) for argument in arguments] + ["--report", "-"])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, json.loads(result.stdout)


def rules(report) -> set[str]:
    return {finding["rule"] for finding in report["findings"]}


def test_a_sound_model_passes(model):
    code, report = run(model)
    assert code == 0 and report["findings"] == [] and report["summary"]["passed"]
    assert report["summary"]["tissues"] == 3
    assert report["nesting"] == {"liver": "skin", "optic_nerve_left": "skin", "skin": None}
    assert [tissue["tissue_type"] for tissue in report["tissues"]] == ["organ", "nerve", "shell"]


def test_every_fixed_key_is_there(model):
    write_mesh(model / "spleen.stl", sphere(10, (20, 14, 0)))
    _, report = run(model)
    assert {"passed", "tissues", "triangles", "counts"} <= report["summary"].keys()
    for tissue in report["tissues"]:
        assert {
            "name", "file", "triangles", "vertices", "components", "genus", "closed", "manifold", "oriented",
            "outward", "volume_mm3", "area_mm2", "topology", "quality", "edge_mm", "self_intersections", "findings",
        } <= tissue.keys()  # fmt: skip
        assert {
            "boundary_edges", "nonmanifold_edges", "nonmanifold_vertices", "inconsistent_edges", "duplicate_faces",
            "degenerate_faces",
        } <= tissue["topology"].keys()  # fmt: skip
        assert {"min", "mean", "p01", "histogram"} <= tissue["quality"].keys()
        assert {"min", "mean", "max"} <= tissue["edge_mm"].keys()
        assert {"faces", "pairs"} <= tissue["self_intersections"].keys()
    assert report["pairs"]
    for pair in report["pairs"]:
        assert {"a", "b", "relation", "min_gap_mm", "crossing_faces", "overlap_mm3"} <= pair.keys()
    for finding in report["findings"]:
        assert {"rule", "level", "tissues", "count", "message", "places"} <= finding.keys()
        assert all({"xyz_mm", "face"} <= place.keys() for place in finding["places"])


def test_crossing_tissues_fail(model):
    write_mesh(model / "spleen.stl", sphere(10, (20, 20, 0)))
    code, report = run(model)
    assert code == 1 and "P001" in rules(report)
    finding = next(finding for finding in report["findings"] if finding["rule"] == "P001")
    assert finding["tissues"] == ["liver", "spleen"]
    assert report["summary"]["counts"]["P001"] == 1


def test_gap_limit(model):
    write_mesh(model / "stone.stl", box((-12, 4.5, -3), (-6, 10, 3)))
    assert run(model)[0] == 0
    code, report = run(model, "--gap", "2")
    assert code == 1 and rules(report) == {"P005"}
    gaps = [pair["min_gap_mm"] for pair in report["pairs"] if pair["min_gap_mm"]]
    assert gaps == pytest.approx([1.5])
    assert run(model, "--gap", "2", "--ignore", "P005")[0] == 0
    _, wide = run(model, "--gap-search", "inf")
    assert all(pair["min_gap_mm"] is not None for pair in wide["pairs"]) and len(wide["pairs"]) == 6


def test_gap_search_never_looks_less_far_than_the_rule(model):
    write_mesh(model / "stone.stl", box((-12, 3.5, -3), (-6, 9, 3)))
    assert run(model)[0] == 1
    code, report = run(model, "--gap-search", "0.1")
    assert code == 1 and rules(report) == {"P005"}


def test_gap_of_zero_is_below_any_limit(model):
    from vhp_cli.config import load_settings
    from vhp_cli.gate import pair_findings

    pair = run(model)[1]["pairs"][0] | {"relation": "disjoint", "min_gap_mm": 0.0}
    assert [finding["rule"] for finding in pair_findings(pair, load_settings())] == ["P005"]


def test_faces_of_pairs_are_numbered_as_in_the_file(model):
    quads = "".join(f"v {x} {y} {z}\n" for z in (0, 6) for y in (0, 6) for x in (-12, -6))
    quads += "f 1 3 4 2\nf 5 6 8 7\nf 1 2 6 5\nf 3 7 8 4\nf 1 5 7 3\nf 2 4 8 6\n"
    (model / "stone.obj").write_text(quads.replace("v -12 0", "v -12 3.5").replace("v -6 0", "v -6 3.5"))
    for _ in range(2):  # the second time from the cache
        _, report = run(model, "--gap-search", "5")
        pair = next(p for p in report["pairs"] if "stone" in (p["a"], p["b"]) and p["min_gap_mm"])
        assert pair["faces"][[pair["a"], pair["b"]].index("stone")] < 6


def test_same_bytes_in_two_formats_are_two_tissues(model):
    """The cache tells files apart by content and format."""
    mesh = (model / "liver.stl").read_bytes()
    (model / "copy.obj").write_bytes(mesh)
    first, second = run(model)[1], run(model)[1]
    assert first["tissues"] == second["tissues"] and first["pairs"] == second["pairs"]


def test_unreadable_file_is_a_finding_and_the_rest_is_checked(model):
    (model / "heart.stl").write_bytes(b"this is no mesh")
    (model / "kidney.stl").write_bytes(b"")
    code, report = run(model)
    assert code == 1
    assert {finding["tissues"][0] for finding in report["findings"] if finding["rule"] in ("F001", "F005")} == {
        "heart",
        "kidney",
    }
    assert report["summary"]["tissues"] == 5
    liver = next(tissue for tissue in report["tissues"] if tissue["name"] == "liver")
    assert liver["outward"]


def test_nothing_readable_is_a_usage_error(tmp_path, capsys):
    (tmp_path / "a.stl").write_bytes(b"garbage")
    assert main(["check", str(tmp_path)]) == 2
    message = capsys.readouterr().err
    assert "a.stl" in message and "Traceback" not in message


@pytest.mark.parametrize(
    "arguments",
    [
        ["nowhere"],
        ["--profile", "lenient", "."],
        ["--min-q", "2", "."],
        ["--select", "Z", "."],
        ["--config", "no.toml", "."],
        [],
    ],
)
def test_wrong_usage(arguments, capsys):
    assert main(["check", *arguments]) == 2
    assert "Traceback" not in capsys.readouterr().err


def test_jobs_and_cache_do_not_change_the_report(model):
    write_mesh(model / "spleen.stl", sphere(10, (20, 20, 0)))
    reports = [run(model, *options)[1] for options in (["-j1", "--no-cache"], ["-j3", "--no-cache"], [], [], ["-j2"])]
    for report in reports:
        report.pop("run")
    assert all(report == reports[0] for report in reports)


def test_cache_sees_every_change(model):
    assert run(model)[0] == 0
    write_mesh(model / "liver.stl", moved(sphere(15, (20, 0, 0), subdivisions=3), (-44, 0, 0)))
    code, report = run(model)
    assert code == 1 and rules(report) == {"P001"}
    data = bytearray((model / "skin.stl").read_bytes())
    data[80:84] = np.uint32(5000).tobytes()
    (model / "skin.stl").write_bytes(data)
    assert "F002" in rules(run(model)[1]) or "F003" in rules(run(model)[1])


def test_a_damaged_cache_costs_time_only(model, monkeypatch):
    directory = Path(os.environ["VHP_CACHE_DIR"])
    first = run(model)[1]
    whole = {file: file.read_bytes() for file in directory.glob("*.json")}
    assert whole
    for damage in (
        lambda d: b"",
        lambda d: d[:-1],
        lambda d: d[: len(d) // 2],
        lambda d: d.replace(b"true", b"null", 1),
    ):
        for file, data in whole.items():
            file.write_bytes(damage(data))
        again = run(model)[1]
        assert again["tissues"] == first["tissues"]


def test_an_edit_that_keeps_size_and_modification_time_is_seen(model):
    path = model / "liver.stl"
    old = time.time() - 1000
    for file in model.iterdir():
        os.utime(file, (old, old))
    time.sleep(2.1)  # change times settle
    assert run(model)[0] == 0
    stat = path.stat()
    data = bytearray(path.read_bytes())
    data[84 + 12 : 84 + 24] = np.float32([0, 0, 0]).tobytes()
    with path.open("r+b") as file:
        file.write(data)
    os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))
    assert run(model)[0] == 1


def test_a_cache_that_cannot_be_written_costs_nothing(model, monkeypatch, tmp_path):
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("VHP_CACHE_DIR", str(tmp_path / "file"))
    assert run(model)[0] == 0


def test_reports_in_every_form(model, tmp_path):
    targets = [tmp_path / name for name in ("r.json", "r.jsonl", "r.csv", "r.md", "r.xml", "r.sarif", "r.txt")]
    options = [text for target in targets for text in ("--report", str(target))]
    result = CliRunner().invoke(check, [str(model), *options, "-o", str(tmp_path / "out")])
    assert result.exit_code == 0
    assert all(target.stat().st_size > 100 for target in targets)
    assert json.loads((tmp_path / "out" / "report.json").read_text())["summary"]["passed"]
    assert CliRunner().invoke(check, [str(model), "--report", "r.pdf"]).exit_code != 0


def test_report_validates_against_the_published_schema(model):
    jsonschema = pytest.importorskip("jsonschema")
    from vhp_cli.report import schema

    write_mesh(model / "spleen.stl", sphere(10, (20, 20, 0)))
    (model / "heart.stl").write_bytes(b"this is no mesh")
    jsonschema.Draft202012Validator(schema()).validate(run(model)[1])


def test_baseline_lets_old_findings_pass(model, tmp_path):
    write_mesh(model / "spleen.stl", sphere(10, (20, 20, 0)))
    old = tmp_path / "old.json"
    _, report = run(model)
    old.write_text(json.dumps(report))
    code, report = run(model, "--baseline", old)
    assert code == 0 and report["findings"][0]["known"]
    write_mesh(model / "stone.stl", box((-8, -2, -2), (-4, 2, 2)))
    code, report = run(model, "--baseline", old)
    assert code == 1 and not next(f for f in report["findings"] if "stone" in f["tissues"]).get("known")


def test_units(model, tmp_path):
    metres = tmp_path / "metres"
    metres.mkdir()
    for path in model.glob("*.stl"):
        from vhp_cli.formats import read_mesh

        mesh = read_mesh(path).mesh
        write_mesh(metres / path.name, Mesh(mesh.vertices / 1000, mesh.faces))
    code, report = run(metres, "--units", "m")
    assert code == 0
    skin = next(tissue for tissue in report["tissues"] if tissue["name"] == "skin")
    assert skin["volume_mm3"] == pytest.approx(4 / 3 * np.pi * 60**3, rel=0.03)
    assert "F007" in rules(run(metres)[1])


def test_declared_nesting_and_contact(model):
    (model / "vhp.toml").write_text(
        '[[nested]]\ninner = "liver"\nouter = "skin"\n[[nested]]\ninner = "optic*"\nouter = "liver"\n'
    )
    code, report = run(model)
    assert code == 1 and rules(report) == {"P006"} and len(report["findings"]) == 1
    (model / "vhp.toml").write_text('[[nested]]\ninner = "livr"\nouter = "skin"\n')
    code, report = run(model)
    assert code == 1 and rules(report) == {"P006"} and "'livr'" in report["findings"][0]["message"]
    (model / "vhp.toml").write_text('[[may-touch]]\na = "disc"\nb = "optic*"\n')
    write_mesh(model / "disc.stl", box((-12, 3, -3), (-6, 8, 3)))
    assert run(model)[0] == 0
    (model / "vhp.toml").unlink()
    code, report = run(model)
    assert code == 1 and rules(report) == {"P003"}


def test_patterns_that_match_nothing_are_named(model):
    (model / "vhp.toml").write_text('[[tissue]]\nmatch = "livr*"\n[[may-touch]]\na = "liver"\nb = "spleem"\n')
    result = CliRunner().invoke(check, [str(model)])
    assert result.exit_code == 0 and "'livr*'" in result.stderr and "'spleem'" in result.stderr


def test_inputs_are_never_touched(model):
    before = {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in model.iterdir()}
    run(model)
    assert before == {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in model.iterdir()}


def test_from_the_shell(model):
    """Exit code, pure JSON on stdout, nothing on stderr."""
    (model / "bad.stl").write_bytes((model / "liver.stl").read_bytes()[:-30])
    done = subprocess.run(
        [sys.executable, "-m", "vhp_cli", "check", str(model), "--report", "-"], capture_output=True, check=False
    )
    assert done.returncode == 1 and done.stderr == b""
    assert "F002" in rules(json.loads(done.stdout))


def test_dry_run_lists_tissues(model):
    result = CliRunner().invoke(check, [str(model), "--dry-run"])
    assert result.exit_code == 0 and result.stdout.splitlines()[0].split("\t")[:2] == ["liver", "organ"]


def test_memory_limit_is_an_error_of_that_tissue_alone(model):
    """A tissue that needs more memory than there is fails; the others are still checked."""
    pytest.importorskip("resource")
    rows = 400
    x, y = np.meshgrid(np.arange(float(rows)), np.arange(float(rows)))
    corner = np.arange(rows * rows).reshape(rows, rows)[:-1, :-1].ravel()
    faces = np.concatenate([corner[:, None] + [0, 1, rows + 1], corner[:, None] + [0, rows + 1, rows]])
    write_mesh(model / "huge.stl", Mesh(np.stack((x, y, x * 0), -1).reshape(-1, 3), faces))
    code = (
        "import resource, sys; import numpy, vhp_cli.pipeline.check, vhp_cli.report.as_json;"
        "used = int(open('/proc/self/statm').read().split()[0]) * resource.getpagesize();"
        "resource.setrlimit(resource.RLIMIT_AS, (used + 40_000_000,) * 2);"
        "from vhp_cli.cli import main; sys.exit(main(sys.argv[1:]))"
    )
    if not Path("/proc/self/statm").exists():
        pytest.skip("needs /proc")
    done = subprocess.run(
        [sys.executable, "-c", code, "check", str(model), "--report", "-", "-j1", "--no-cache"],
        capture_output=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == 3, done.stderr.decode()
    report = json.loads(done.stdout)
    assert [f["tissues"] for f in report["findings"] if f["rule"] == "F012"] == [["huge"]]
    assert next(t for t in report["tissues"] if t["name"] == "liver")["outward"]


def test_a_model_of_which_nothing_could_be_processed_has_failed(model, monkeypatch):
    """Out of memory is no wrong usage, even if it hits every tissue."""
    import vhp_cli.pipeline.measuring as pipeline

    def exhausted(*_: object, **__: object) -> None:
        raise MemoryError

    monkeypatch.setattr(pipeline, "inspect_tissue", exhausted)
    code, report = run(model, "--no-cache")
    assert code == 3 and rules(report) == {"F012"}


def test_interruption_keeps_what_is_done(tmp_path):
    """A run that is interrupted says so, and the next one goes on from its cache."""
    import signal

    model = tmp_path / "large"
    model.mkdir()
    for number in range(40):
        write_mesh(model / f"ball_{number}.stl", moved(sphere(10, subdivisions=5), (25.0 * number, 0, 0)))
    environment = {**os.environ, "VHP_CACHE_DIR": str(tmp_path / "cache")}
    command = [sys.executable, "-m", "vhp_cli", "check", str(model), "-j1", "--report", "-"]
    for _ in range(5):  # the moment is a matter of luck
        running = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        time.sleep(0.5)
        running.send_signal(signal.SIGINT)
        _, errors = running.communicate(timeout=60)
        assert b"Traceback" not in errors
        if running.returncode == 130:
            break
    done = subprocess.run(command, env=environment, capture_output=True, check=False, timeout=60)
    fresh = subprocess.run([*command, "--no-cache"], env=environment, capture_output=True, check=False, timeout=60)
    reports = [json.loads(output) | {"run": {}} for output in (done.stdout, fresh.stdout)]
    assert done.returncode == fresh.returncode == 0 and reports[0] == reports[1]
