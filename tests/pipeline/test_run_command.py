"""`vhp run` as a user calls it: what it refuses, what it says, and that it can be killed."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import jsonschema
import pytest
from click.testing import CliRunner
from shapes import box, flipped, sphere

from vhp_cli.cli import main
from vhp_cli.commands import run as command
from vhp_cli.commands.recipe_options import arguments_of, find_command, option_names
from vhp_cli.errors import UsageError
from vhp_cli.formats import read_mesh, write_mesh
from vhp_cli.pipeline import journal, recipe
from vhp_cli.pipeline.recipe import COMMANDS, PRESETS, parse_recipe, preset_text, read_preset
from vhp_cli.report import schema

HEAL = '[[stage]]\ncommand = "heal"\n'
SHORT = """
[options]
gap = 0.5

[[stage]]
command = "heal"
clearance = true

[[stage]]
command = "smooth"
iterations = 3

[[stage]]
command = "decimate"
ratio = 0.7
"""
WITH_EXPORT = f'{SHORT}\n[[stage]]\ncommand = "export"\nfor = "hfss"\n'


def dry(*arguments) -> list[str]:
    result = CliRunner().invoke(command.run, [*map(str, arguments), "--dry-run"])
    if isinstance(result.exception, UsageError):
        raise result.exception
    assert result.exit_code == 0, result.output
    return result.output.splitlines()


def pipeline(directory: Path, text: str) -> Path:
    path = directory / "pipeline.toml"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("stage = 3", r"\[\[stage\]\]"),
        ("", "no stage"),
        ("[[stage]", "not valid TOML"),
        ('[[stages]]\ncommand = "heal"', "unknown key 'stages'"),
        ("options = 1\n" + HEAL, r"\[options\]"),
        ("[[stage]]\nratio = 1", "which command"),
        ('[[stage]]\ncommand = "heel"', "no stage can be 'heel'"),
        ('[[stage]]\ncommand = "phantom"', "no stage can be 'phantom'"),
        (HEAL + 'name = "../x"', "name must be"),
        (HEAL + 'on-error = "ignore"', "on-error must be"),
    ],
)
def test_a_file_that_is_no_pipeline_is_refused(text, words) -> None:
    with pytest.raises(UsageError, match=words):
        parse_recipe(text, "x.toml", Path())


def test_surfaces_go_on_and_results_stop_unless_told() -> None:
    found = parse_recipe("".join(f'[[stage]]\ncommand = "{name}"\n' for name in COMMANDS), "x", Path())
    assert {stage.command: stage.on_error for stage in found.stages} == {
        "heal": "continue", "separate": "continue", "smooth": "continue", "decimate": "continue",
        "check": "stop", "tetmesh": "stop", "breathe": "stop", "export": "stop",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("name", "values", "expected"),
    [
        ("heal", {"max-deviation": 0.1, "only-topology": True}, ["--max-deviation=0.1", "--only-topology"]),
        ("heal", {"only-topology": False}, []),
        ("heal", {"cap-openings": False}, ["--keep-openings"]),
        ("heal", {"keep-openings": True}, ["--keep-openings"]),
        ("heal", {"clearance": True}, ["--clearance"]),
        ("heal", {"clearance": 0.5}, ["--clearance=0.5"]),
        ("heal", {"select": ["T", "X"]}, ["--select=T,X"]),
        ("smooth", {"method": "cvt", "flips": True}, ["--method=cvt", "--flips"]),
        (
            "tetmesh",
            {"format": ["vtu", "msh"], "keep-surface": "tetgen"},
            ["--format=vtu,msh", "--keep-surface=tetgen"],
        ),
    ],
)
def test_options_become_arguments(name, values, expected) -> None:
    click_command, _ = find_command(name)
    assert list(arguments_of(click_command, values, Path(), "here").deciding) == expected


def test_limits_decide_where_the_command_makes_the_best_of_them() -> None:
    heal, tetmesh = (find_command(name)[0] for name in ("heal", "tetmesh"))
    found = arguments_of(heal, {"timeout": 600, "memory": 2, "jobs": 1, "target-q": 0.4}, Path(), "here")
    assert (found.deciding, found.speed) == (("--target-q=0.4",), ("--timeout=600", "--memory=2", "--jobs=1"))
    found = arguments_of(tetmesh, {"memory": 2, "jobs": 1}, Path(), "here")
    assert (found.deciding, found.speed) == (("--memory=2",), ("--jobs=1",))


@pytest.mark.parametrize(
    ("name", "values", "words", "hint"),
    [
        ("smooth", {"itterations": 5}, "here: no option 'itterations'", "did you mean 'iterations'"),
        ("smooth", {"xyz": 5}, "no option 'xyz'", "options: cache"),
        ("heal", {"output": "x"}, "decided by `vhp run`", ""),
        ("heal", {"report": "x.json"}, "decided by `vhp run`", ""),
        ("heal", {"format": "json"}, "decided by `vhp run`", ""),
        ("heal", {"overwrite": True}, "decided by `vhp run`", ""),
        ("heal", {"only-topology": "yes"}, "true or false", ""),
        ("heal", {"max-deviation": True}, "expected a value", ""),
        ("heal", {"max-deviation": {"mm": 1}}, "expected a number", ""),
    ],
)
def test_options_that_do_not_fit_are_refused(name, values, words, hint) -> None:
    click_command, _ = find_command(name)
    with pytest.raises(UsageError, match=words) as raised:
        arguments_of(click_command, values, Path(), "here")
    assert hint in raised.value.hint


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_options_for_a_pipeline(name) -> None:
    click_command, words = find_command(name)
    assert words[0] == name
    assert {"config", "recursive", "units"} <= option_names(click_command).keys()
    assert not {"output", "overwrite", "dry-run", "report", "list-materials"} & option_names(click_command).keys()


def test_paths_are_relative_to_the_pipeline_file(tmp_path) -> None:
    click_command, _ = find_command("decimate")
    found = arguments_of(click_command, {"errors": "errors"}, tmp_path, "here")
    assert found.files == (tmp_path / "errors",)
    assert list(found.deciding) == [f"--errors={tmp_path / 'errors'}"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (HEAL + "max-deviation = -1", r"stage 1 \(heal\): .*max-deviation"),
        (HEAL + '[[stage]]\ncommand = "decimate"\n', r"stage 2 \(decimate\): how far"),
        (HEAL + '[[stage]]\ncommand = "decimate"\nrefine = 5\nratio = 0.5', "exclude each other"),
        (HEAL + '[[stage]]\ncommand = "smooth"\nmethod = "cvt"\nunguarded = true\nmethods = 1', "no option 'methods'"),
        (HEAL + '[[stage]]\ncommand = "smooth"\nunguarded = true', r"stage 2 \(smooth\)"),
        (HEAL + '[[stage]]\ncommand = "check"\nprofile = "nastran"', "no profile 'nastran'"),
        (HEAL + '[[stage]]\ncommand = "tetmesh"\nformat = "dwg"', r"stage 2 \(tetmesh\)"),
        (HEAL + '[[stage]]\ncommand = "export"', r"stage 2 \(export\): --for is needed"),
        (HEAL + '[[stage]]\ncommand = "breathe"\nsequence = "other"', r"stage 2 \(breathe\): other: can't read"),
        (HEAL + '[[stage]]\ncommand = "check"\nbaseline = "gone.json"', "gone.json: no such file"),
        (HEAL + "units = 'cm'", r"units belongs to all stages"),
        (HEAL + "cap-openings = true\nkeep-openings = true", "the same option"),
        ("[options]\nratio = 0.5\n" + HEAL, r"\[options\]: no option 'ratio'"),
        ("[options]\nprofil = 'cst'\n" + HEAL, r"\[options\]: no option 'profil'"),
    ],
)
def test_every_setting_is_checked_before_the_first_stage(tmp_path, model, out, text, words) -> None:
    with pytest.raises(UsageError, match=words):
        dry(pipeline(tmp_path, text), model, "-o", out)
    assert not out.exists()


def test_flags_come_before_stages_and_these_before_options_of_all(tmp_path, model, out) -> None:
    text = f'[options]\ngap = 0.3\nprofile = "cst"\n{HEAL}gap = 0.4\n[[stage]]\ncommand = "check"\n'
    file = pipeline(tmp_path, text)
    assert dry(file, model, "-o", out) == [
        "01-heal heal --gap=0.4 --profile=cst",
        "02-check check --gap=0.3 --profile=cst",
    ]
    assert dry(file, model, "-o", out, "--gap", "0.7", "--profile", "hfss", "-j2") == [
        "01-heal heal --gap=0.7 --profile=hfss --jobs=2",
        "02-check check --gap=0.7 --profile=hfss --jobs=2",
    ]


def test_a_check_is_added_where_none_judges_the_result(tmp_path, model, out) -> None:
    def stages(*names: str) -> list[str]:
        text = "".join(f'[[stage]]\ncommand = "{name}"\n' for name in names)
        return [line.split()[0] for line in dry(pipeline(tmp_path, text), model, "-o", out)]

    assert stages("heal", "tetmesh") == ["01-heal", "02-check", "03-tetmesh"]
    assert stages("tetmesh") == ["01-check", "02-tetmesh"]
    assert stages("check", "heal") == ["01-check", "02-heal", "03-check"]
    assert stages("heal", "tetmesh", "check") == ["01-heal", "02-tetmesh", "03-check"]


@pytest.mark.parametrize("name", PRESETS)
def test_presets_are_pipelines(name, model, out) -> None:
    commands = [stage.command for stage in read_preset(name).stages]
    assert commands[:2] == ["heal", "separate"]
    assert commands[-1] == "check"
    assert dry("--preset", name, model, "-o", out)
    shown = CliRunner().invoke(command.run, ["--show-preset", name])
    assert shown.exit_code == 0
    assert tomllib.loads(shown.output) == tomllib.loads(preset_text(name))


def test_there_is_a_file_for_every_preset() -> None:
    folder = Path(recipe.__file__).parents[1] / "data" / "presets"
    assert sorted(path.stem for path in folder.glob("*.toml")) == sorted(PRESETS)


def test_settings_of_the_model_reach_every_stage(tmp_path, model, out) -> None:
    (model / "vhp.toml").write_text('profile = "cst"\n')
    assert all(f"--config={model / 'vhp.toml'}" in line for line in dry("--preset", "base", model, "-o", out))
    (model / "vhp.toml").rename(model / "pyproject.toml")
    assert dry("--preset", "base", model, "-o", out)  # says nothing of vhp
    (model / "pyproject.toml").write_text('[tool.vhp]\nprofile = "cst"\n')
    with pytest.raises(UsageError, match=r"pyproject.toml: a pipeline can't"):
        dry("--preset", "base", model, "-o", out)


def test_a_model_in_subdirectories_is_found_as_its_settings_say(tmp_path, model, out) -> None:
    (model / "deeper").mkdir()
    for path in model.glob("*.stl"):
        path.rename(model / "deeper" / path.name)
    with pytest.raises(UsageError, match="no mesh file"):
        dry("--preset", "base", model, "-o", out)
    assert dry("--preset", "base", model, "-o", out, "--recursive")
    (model / "vhp.toml").write_text("recursive = true\n")
    file = pipeline(tmp_path, '[[stage]]\ncommand = "check"\n')
    assert main(["-q", "run", str(file), str(model), "-o", str(out)]) == 1  # the liver is inside out
    assert json.loads((out / "report.json").read_text())["summary"]["tissues"] == 3


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["MODEL"], "which pipeline"),
        (["FILE"], "which model"),
        (["FILE", "MODEL", "--preset", "base"], "exclude each other"),
        (["gone.toml", "MODEL"], "can't read the pipeline"),
    ],
)
def test_usage(tmp_path, model, out, arguments, words) -> None:
    named = {"MODEL": model, "FILE": pipeline(tmp_path, HEAL)}
    with pytest.raises(UsageError, match=words):
        dry(*(named.get(word, word) for word in arguments), "-o", out)


def test_from_end_to_end(tmp_path, model, out, capsys, monkeypatch) -> None:
    # A checkout that is being worked on is other code from one moment to the next.
    monkeypatch.setattr(journal, "_code_stamp", lambda: "this code")
    file = pipeline(tmp_path, SHORT)
    arguments = ["run", str(file), str(model), "-o", str(out), "-j1"]
    assert main([*arguments, "--report", str(tmp_path / "report.xml")]) == 0
    said = capsys.readouterr()
    assert "03-decimate" in said.out
    assert "04-check runs" in said.err
    assert f"surfaces: {out / 'surfaces'}" in said.err
    report = json.loads((out / "report.json").read_text())
    jsonschema.Draft202012Validator(schema()).validate(report)
    assert [stage["directory"] for stage in report["pipeline"]["stages"]] == [
        "01-heal", "02-smooth", "03-decimate", "04-check",
    ]  # fmt: skip
    assert report["pipeline"]["stages"][0]["options"] == {"gap": 0.5, "clearance": True}
    assert report["pipeline"]["surfaces_of"] == "03-decimate"
    assert report["summary"]["passed"]
    assert report["model"]["paths"] == [model.as_posix()]
    assert {path.name for path in (out / "surfaces").iterdir()} == {"liver.stl", "nerve.stl", "skin.stl"}
    liver = read_mesh(out / "surfaces" / "liver.stl").mesh
    assert len(liver.faces) < 0.75 * len(read_mesh(model / "liver.stl").mesh.faces)
    before = contents(out)
    assert main(arguments) == 0
    assert "01-heal is as before" in capsys.readouterr().err
    assert contents(out) == before


def test_a_model_that_does_not_pass_exits_1(tmp_path, out) -> None:
    directory = tmp_path / "twins"
    directory.mkdir()
    for name in ("a", "b"):
        write_mesh(directory / f"{name}.stl", sphere(10, subdivisions=1))
    file = pipeline(tmp_path, '[[stage]]\ncommand = "check"\n[[stage]]\ncommand = "heal"\n')
    assert main(["--quiet", "run", str(file), str(directory), "-o", str(out)]) == 1
    report = json.loads((out / "report.json").read_text())
    assert [stage["outcome"] for stage in report["pipeline"]["stages"]] == ["errors", "not run", "not run"]
    assert not (out / "surfaces").exists()


def contents(out: Path) -> dict[str, object]:
    """Return every file of a run but for its account of itself, and for times and facts of the host."""
    found: dict[str, object] = {}
    for path in sorted(out.rglob("*")):
        name = path.relative_to(out).as_posix()
        if not path.is_file() or any(part.startswith(".vhp-run") for part in path.relative_to(out).parts):
            continue
        if path.name == "report.json":
            report = json.loads(path.read_text())
            del report["run"]
            found[name] = report
        else:
            found[name] = path.read_bytes()
    return found


def start(directory: Path, *arguments: str) -> subprocess.Popen[bytes]:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "VHP_CACHE_DIR": str(directory / "cache")}
    # In jobs that a shell runs in the background SIGINT is ignored, and children would inherit that.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    return subprocess.Popen(
        [sys.executable, "-m", "vhp_cli", "-q", "run", *arguments],
        cwd=directory,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )


def crowd(directory: Path) -> None:
    """Write a model in which every stage of `SHORT` has something to do."""
    directory.mkdir(parents=True)
    write_mesh(directory / "skin.stl", sphere(40, subdivisions=3))
    write_mesh(directory / "liver.stl", flipped(sphere(12, (24, 0, 0), subdivisions=2)))
    write_mesh(directory / "spleen.stl", sphere(9, (-8, 0, 0), subdivisions=2))
    write_mesh(directory / "kidney.stl", sphere(9, (-8, -15, 0), subdivisions=2))
    write_mesh(directory / "nerve.stl", box((-2, 14, -3), (2, 18, 3)))


def group_of(process: subprocess.Popen[bytes]) -> list[int]:
    """Return the processes of the session that a process leads, and those they started."""
    parents: dict[int, list[int]] = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            if fields[0] != "Z":
                parents.setdefault(int(fields[1]), []).append(int(entry.name))
    found, queue = [], [process.pid]
    while queue:
        found.append(queue.pop())
        queue += parents.get(found[-1], [])
    return found


def running(out: Path) -> str:
    """Return the stage that a run is at; empty before the first one."""
    found = ""
    for path in sorted((out / ".vhp-run").glob("*.json")):
        if json.loads(path.read_text())["state"] != "ended":
            found = path.stem
    return found


def alive(pid: int) -> bool:
    try:
        return (Path("/proc") / str(pid) / "stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="looks processes up in /proc")
def test_killed_ten_times_it_gives_the_same_bytes(tmp_path) -> None:
    for name in ("undisturbed", "killed"):
        crowd(tmp_path / name / "model")
        pipeline(tmp_path / name, WITH_EXPORT)
    arguments = ("pipeline.toml", "model", "-o", "out", "-j2")
    process = start(tmp_path / "undisturbed", *arguments)
    assert process.communicate()[1] == b""
    code = process.returncode
    report = json.loads((tmp_path / "undisturbed" / "out" / "report.json").read_text())
    seconds = {name: time for name, time in report["run"]["seconds"].items() if name != "total"}
    stages, out = sorted(seconds), tmp_path / "killed" / "out"
    moments = random.Random(20161118)
    hit = []
    while len(hit) < 10:
        process = start(tmp_path / "killed", *arguments)
        # Some in every stage, whatever else the machine is doing.
        aim = stages[len(hit) * len(stages) // 10]
        while process.poll() is None and running(out) < aim:
            time.sleep(0.02)
        time.sleep(moments.random() * seconds[aim])
        if process.poll() is not None:
            shutil.rmtree(out)
            continue
        family = group_of(process)
        hit.append(running(out))
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        deadline = time.monotonic() + 10
        while any(alive(pid) for pid in family) and time.monotonic() < deadline:
            time.sleep(0.02)
        assert not [pid for pid in family if alive(pid)]
    assert len(set(hit)) >= 3, hit
    process = start(tmp_path / "killed", *arguments)
    assert process.communicate()[1] == b""
    assert process.returncode == code
    expected, found = (contents(tmp_path / name / "out") for name in ("undisturbed", "killed"))
    assert found.keys() == expected.keys()
    assert [name for name in expected if expected[name] != found[name]] == []


def busy_family(process: subprocess.Popen[bytes], out: Path) -> list[int]:
    """Return a run's processes once those that heal are among them."""
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        family = group_of(process)
        if len(family) >= 3 and running(out) == "01-heal":
            return family
        time.sleep(0.05)
    pytest.fail("no worker was started")


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="looks processes up in /proc")
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_whatever_ends_it_ends_all_that_it_started(tmp_path, number) -> None:
    crowd(tmp_path / "model")
    pipeline(tmp_path, SHORT)
    process = start(tmp_path, "pipeline.toml", "model", "-o", "out", "-j2")
    family = busy_family(process, tmp_path / "out")
    os.kill(process.pid, number)
    process.communicate(timeout=30)
    assert process.returncode == -number
    deadline = time.monotonic() + 10
    while any(alive(pid) for pid in family) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not [pid for pid in family if alive(pid)]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="looks processes up in /proc")
def test_interrupted_it_stops_everything_and_goes_on_later(tmp_path) -> None:
    crowd(tmp_path / "model")
    pipeline(tmp_path, SHORT)
    arguments = ("pipeline.toml", "model", "-o", "out", "-j2")
    process = start(tmp_path, *arguments)
    family = busy_family(process, tmp_path / "out")
    # To the first process alone, as `kill -INT` sends it; Ctrl-C reaches the whole group.
    process.send_signal(signal.SIGINT)
    said = process.communicate(timeout=30)[1]
    assert process.returncode == 130
    assert b"Traceback" not in said
    assert not [pid for pid in family if alive(pid)]
    assert not (tmp_path / "out" / "report.json").exists()
    again = start(tmp_path, *arguments)
    again.communicate()
    assert again.returncode in (0, 1)
    assert (tmp_path / "out" / "report.json").exists()


@pytest.mark.slow
def test_after_a_change_it_gives_what_a_new_run_gives(tmp_path) -> None:
    text = "".join(f'[[stage]]\ncommand = "{name}"\n' for name in ("heal", "separate", "decimate")) + "ratio = 0.7\n"
    for name in ("changed", "new"):
        (tmp_path / name / "model").mkdir(parents=True)
        pipeline(tmp_path / name, text)
    for name, meshes in (("changed", (9, 9)), ("new", (9, 8))):
        for tissue, radius, x in (("spleen", meshes[0], -8), ("kidney", meshes[1], 8)):
            write_mesh(tmp_path / name / "model" / f"{tissue}.stl", sphere(radius, (x, 0, 0), subdivisions=2))
    arguments = ("pipeline.toml", "model", "-o", "out", "-j1")
    codes = []
    for name in ("changed", "new"):
        process = start(tmp_path / name, *arguments)
        assert process.communicate()[1] == b""
        codes.append(process.returncode)
    write_mesh(tmp_path / "changed" / "model" / "kidney.stl", sphere(8, (8, 0, 0), subdivisions=2))
    process = start(tmp_path / "changed", *arguments)
    assert process.communicate()[1] == b""
    assert [process.returncode, *codes] == [0, 0, 0]
    assert contents(tmp_path / "changed" / "out") == contents(tmp_path / "new" / "out")
