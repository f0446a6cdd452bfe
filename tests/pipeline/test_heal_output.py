"""The output directory of `vhp heal`, and runs that are stopped and taken up."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from click.testing import CliRunner
from heal_runs import DRIVER, JOURNAL, ended, many, meshes, run, started, tissue
from shapes import box, flipped, moved, sphere

from vhp_cli.cli import main
from vhp_cli.commands import heal as command
from vhp_cli.formats import write_mesh


def test_the_output_may_not_overlap_the_model(stage, model, tmp_path, capsys):
    before = meshes(model)
    (tmp_path / "link").symlink_to(model)
    for target in (model, model / "healed", tmp_path, tmp_path / "link", tmp_path / "link" / "healed"):
        assert main(["heal", str(model), "-o", str(target)]) == 2, target
        assert "overlap" in capsys.readouterr().err
    assert main(["heal", str(model / "skin.stl"), "-o", str(model)]) == 2
    assert meshes(model) == before and not (model / "healed").exists()


def test_a_directory_that_holds_anything_else_is_left_alone(stage, model, out, capsys):
    out.mkdir()
    (out / "thesis.txt").write_text("precious")
    assert main(["heal", str(model), "-o", str(out)]) == 2
    assert "not empty" in capsys.readouterr().err and not meshes(out)
    code, _ = run(model, "-o", out, "--overwrite")
    assert code == 0 and (out / "thesis.txt").read_text() == "precious"
    assert main(["heal", str(model), "-o", str(model / "skin.stl")]) == 2


def test_other_settings_need_overwrite(stage, model, out, capsys):
    assert run(model, "-o", out)[0] == 0
    assert main(["heal", str(model), "-o", str(out), "--max-deviation", "0.5"]) == 2
    assert "other settings" in capsys.readouterr().err
    assert run(model, "-o", out, "--max-deviation", "0.5", "--overwrite")[0] == 0
    (model / "skin.stl").unlink()
    assert run(model, "-o", out, "--overwrite")[0] == 0
    assert meshes(out).keys() == {"liver.stl", "nerve.stl"}


def test_dry_run_writes_nothing(stage, model, out):
    result = CliRunner().invoke(command.heal, [str(model), "-o", str(out), "--dry-run"])
    assert result.exit_code == 0 and not out.exists()
    assert [line.split("\t")[:2] for line in result.stdout.splitlines()] == [
        ["liver", "heal"],
        ["nerve", "heal"],
        ["skin", "heal"],
    ]
    run(model, "-o", out)
    write_mesh(model / "nerve.stl", box((-12, -3, -3), (-6, 3, 4)))
    result = CliRunner().invoke(command.heal, [str(model), "-o", str(out), "--dry-run"])
    assert [line.split("\t")[1] for line in result.stdout.splitlines()] == ["keep", "heal", "keep"]


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["-o", "out", "nowhere"],
        ["-o", "out", "--target-q", "1.5"],
        ["-o", "out", "--max-deviation", "0"],
        ["-o", "out", "--max-deviation", "nan"],
        ["-o", "out", "--memory", "0"],
        ["-o", "out", "--report", "r.pdf"],
    ],
)
def test_wrong_usage(stage, model, tmp_path, monkeypatch, capsys, arguments):
    monkeypatch.chdir(tmp_path)
    assert main(["heal", str(model), *arguments]) == 2
    assert "Traceback" not in capsys.readouterr().err and not (tmp_path / "out").exists()


# Running again


def test_a_second_run_does_only_what_is_missing(stage, model, out):
    first = run(model, "-o", out)[1]
    times = {path.name: path.stat().st_mtime_ns for path in out.glob("*.stl")}
    write_mesh(model / "nerve.stl", flipped(box((-12, -3, -3), (-6, 3, 4))))
    (out / "skin.stl").write_bytes(b"spoilt")
    code, second = run(model, "-o", out)
    assert code == 0
    assert (out / "liver.stl").stat().st_mtime_ns == times["liver.stl"]
    assert tissue(second, "nerve")["status"] == "changed"
    assert (out / "skin.stl").read_bytes() == (model / "skin.stl").read_bytes()
    assert tissue(second, "liver") == tissue(first, "liver")
    stage("crash")  # another stage is another run
    assert main(["heal", str(model), "-o", str(out)]) == 2


@pytest.mark.slow
def test_what_failed_is_tried_again(stage, model, out):
    stage("hang")
    assert run(model, "-o", out, "--timeout", 3)[0] == 3
    lines = (out / JOURNAL).read_text().count("\n")
    assert run(model, "-o", out, "--timeout", 3)[0] == 3
    assert (out / JOURNAL).read_text().count("\n") == lines


def test_jobs_do_not_change_anything(stage, model, tmp_path):
    for number in range(6):
        write_mesh(model / f"ball_{number}.stl", flipped(moved(sphere(3), (0, 12.0 * (number - 3), 40))))
    reports = []
    for jobs in (1, 2, 3):
        _, report = run(model, "-o", tmp_path / f"out{jobs}", "-j", jobs)
        report.pop("run")
        reports.append(report)
        assert meshes(tmp_path / f"out{jobs}") == meshes(tmp_path / "out1")
    assert reports[0] == reports[1] == reports[2]


@pytest.mark.parametrize("damage", ["", "garbage\n", "cut", "foreign"])
def test_a_damaged_journal_is_never_believed(stage, model, out, damage, capsys):
    run(model, "-o", out)
    whole = (out / JOURNAL).read_bytes()
    if damage == "cut":
        (out / JOURNAL).write_bytes(whole[:-20])
        assert run(model, "-o", out)[0] == 0
        assert (out / JOURNAL).read_bytes().count(b"\n") == 4
        return
    (out / JOURNAL).write_text(json.dumps({"vhp-run": 1}) if damage == "foreign" else damage)
    assert main(["heal", str(model), "-o", str(out)]) == 2
    assert "not empty" in capsys.readouterr().err


@pytest.mark.skipif(sys.platform == "win32", reason="signals are another matter there")
@pytest.mark.slow
def test_killed_at_any_moment_the_next_run_gives_the_same(tmp_path):
    model = many(tmp_path / "many")
    code, output, _ = ended(started(model, tmp_path / "whole"))
    expected = json.loads(output)
    assert code == 0
    chance = random.Random(4)
    out = tmp_path / "out"
    for _ in range(4):
        running = started(model, out)
        time.sleep(0.5 + 0.9 * chance.random())
        running.kill()
        ended(running)
        for path in out.glob("*.stl"):  # whole or not there
            assert path.read_bytes() == (tmp_path / "whole" / path.name).read_bytes()
        assert not (out / "report.json").exists() or len(meshes(out)) == 20
    code, output, _ = ended(started(model, out))
    assert code == 0 and meshes(out) == meshes(tmp_path / "whole")
    assert json.loads(output) | {"run": {}} == expected | {"run": {}}
    assert not list(out.rglob("*.tmp"))


@pytest.mark.skipif(sys.platform == "win32", reason="signals are another matter there")
def test_interruption_keeps_what_is_finished(tmp_path):
    model = many(tmp_path / "many", 60)
    out = tmp_path / "out"
    running = started(model, out)
    deadline = time.monotonic() + 30
    while len(meshes(out)) < 3 and time.monotonic() < deadline:
        time.sleep(0.02)
    running.send_signal(signal.SIGINT)
    code, _, errors = ended(running)
    assert code == 130 and errors.split() == [b"interrupted"]
    done = len(meshes(out))
    assert 3 <= done < 60 and not (out / "report.json").exists() and not list(out.rglob("*.tmp"))
    code, _, errors = ended(started(model, out))
    assert code == 0 and f"{done} of 60 were taken".encode() in errors


@pytest.mark.skipif(sys.platform == "win32", reason="needs locks on directories")
@pytest.mark.slow
def test_two_runs_at_a_time_do_not_mix(tmp_path):
    model, out = many(tmp_path / "many", 60), tmp_path / "out"
    first = started(model, out)
    deadline = time.monotonic() + 30
    while not meshes(out) and time.monotonic() < deadline:
        time.sleep(0.02)
    code, _, errors = ended(started(model, out))
    assert code == 2 and b"another run" in errors
    assert ended(first)[0] == 0


def test_a_full_disk_ends_the_run_and_keeps_what_is_whole(tmp_path):
    """A limit on the size of files stands for the end of the disk."""
    resource = pytest.importorskip("resource")
    model, out = many(tmp_path / "many", 6), tmp_path / "out"
    write_mesh(model / "skin.stl", flipped(sphere(300, subdivisions=4)))
    limit = (model / "skin.stl").stat().st_size - 1
    code = f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit}))\n{DRIVER}"
    assert resource
    path = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    done = subprocess.run(
        [sys.executable, "-c", code, "heal", str(model), "-o", str(out), "-j1"],
        env={**os.environ, "PYTHONPATH": path}, capture_output=True, check=False, timeout=60,
    )  # fmt: skip
    assert done.returncode == 3, done.stderr
    assert done.stderr.startswith(b"error: can't write ") and b"skin.stl: File too large" in done.stderr
    assert b"Traceback" not in done.stderr
    assert not (out / "skin.stl").exists() and not list(out.rglob("*.tmp"))
    assert ended(started(model, out))[0] == 0
