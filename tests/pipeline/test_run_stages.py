"""Which stages of a pipeline run, on what, and when they run again; stand-ins take the place of the commands."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from shapes import box, sphere

from vhp_cli.errors import UsageError
from vhp_cli.formats import write_mesh
from vhp_cli.pipeline.run import PipelineDone, Step, run_pipeline
from vhp_cli.pipeline.run_report import exit_code, pipeline_report
from vhp_cli.report import render


class Commands:
    """Stand-ins for the commands: they copy surfaces and write a report."""

    def __init__(self) -> None:
        self.calls: list[list[str]] = []
        self.codes: dict[str, int] = {}
        self.before: Callable[[str, Path], None] = lambda command, out: None

    def __call__(self, arguments: Sequence[str]) -> int:
        self.calls.append(list(arguments))
        where = arguments.index("-o")
        command, models, out = arguments[0], [Path(path) for path in arguments[1:where]], Path(arguments[where + 1])
        self.before(command, out)
        out.mkdir(parents=True, exist_ok=True)
        code = self.codes.get(command, 0)
        if code not in (0, 1, 3):
            return code
        if command in ("heal", "smooth", "separate", "decimate"):
            suffix = " ".join(arguments[where + 2 :]).encode()
            for model in models:
                for path in model.rglob("*.stl"):
                    place = out / path.relative_to(model.parent if len(models) > 1 else model)
                    place.parent.mkdir(parents=True, exist_ok=True)
                    place.write_bytes(path.read_bytes() + suffix)
        (out / "report.json").write_text(json.dumps(report_of(command, passed=code == 0)))
        return code

    @property
    def names(self) -> list[str]:
        return [call[0] for call in self.calls]


def report_of(command: str, *, passed: bool) -> dict:
    finding = {
        "rule": "T001", "level": "error", "tissues": [], "count": 1, "message": "", "places": [], "hint": "",
    }  # fmt: skip
    return {
        "schema": "vhp-report/1",
        "tool": {"name": "vhp", "version": "0"},
        "command": command,
        "settings": {},
        "model": {"paths": ["?"], "units": "mm"},
        "summary": {
            "passed": passed, "tissues": 0, "triangles": 0, "pairs": 0, "errors": 0, "warnings": 0, "notes": 0,
            "counts": {},
        },
        "tissues": [],
        "pairs": [],
        "nesting": {},
        "findings": [] if passed else [finding],
        "run": {},
    }  # fmt: skip


@pytest.fixture
def commands() -> Commands:
    return Commands()


@pytest.fixture
def liver(tmp_path) -> Path:
    model = tmp_path / "liver_model"
    model.mkdir()
    write_mesh(model / "liver.stl", sphere(10, subdivisions=1))
    return model


def step(number: int, command: str, *arguments: str, **other) -> Step:
    return Step(f"{number:02d}-{command}", (command,), {}, arguments, **other)


STEPS = [step(1, "heal"), step(2, "smooth", "--iterations=3"), step(3, "check"), step(4, "tetmesh")]


def go(commands: Commands, model, out, steps: Sequence[Step] = STEPS, **how) -> PipelineDone:
    commands.calls.clear()
    paths = model if isinstance(model, list) else [model]
    how.setdefault("recursive", False)
    return run_pipeline(steps, paths, out, execute=commands, **how)


def test_each_stage_works_on_the_surfaces_of_the_one_before(commands, liver, out) -> None:
    done = go(commands, liver, out)
    assert [call[:4] for call in commands.calls] == [
        ["heal", str(liver), "-o", str(out / "01-heal")],
        ["smooth", str(out / "01-heal"), "-o", str(out / "02-smooth")],
        ["check", str(out / "02-smooth"), "-o", str(out / "03-check")],
        ["tetmesh", str(out / "02-smooth"), "-o", str(out / "04-tetmesh")],
    ]
    assert done.surfaces == "02-smooth"
    assert (out / "surfaces" / "liver.stl").read_bytes() == (out / "02-smooth" / "liver.stl").read_bytes()
    assert exit_code(done.stages) == 0


def test_nothing_runs_twice(commands, liver, out) -> None:
    go(commands, liver, out)
    done = go(commands, liver, out)
    assert commands.calls == []
    assert all(stage.reused for stage in done.stages)
    assert exit_code(done.stages) == 0


def test_a_changed_option_runs_from_that_stage_on(commands, liver, out) -> None:
    go(commands, liver, out)
    steps = [STEPS[0], step(2, "smooth", "--iterations=4"), *STEPS[2:]]
    go(commands, liver, out, steps)
    assert commands.names == ["smooth", "check", "tetmesh"]


def test_what_was_changed_by_hand_is_made_anew_and_keeps_what_came_after(commands, liver, out) -> None:
    go(commands, liver, out)
    (out / "02-smooth" / "liver.stl").write_bytes(b"changed by hand")
    go(commands, liver, out)
    assert commands.names == ["smooth"]


def test_a_changed_input_runs_all(commands, liver, out) -> None:
    go(commands, liver, out)
    write_mesh(liver / "liver.stl", sphere(11, subdivisions=1))
    go(commands, liver, out)
    assert commands.names == ["heal", "smooth", "check", "tetmesh"]


def test_speed_is_no_reason_to_run_again(commands, liver, out) -> None:
    go(commands, liver, out)
    go(commands, liver, out, [step(1, "heal", speed=("--jobs=2",)), *STEPS[1:]])
    assert commands.calls == []


def test_files_named_by_options_count(commands, liver, out, tmp_path) -> None:
    config = tmp_path / "settings.toml"
    config.write_text("profile = 'cst'\n")
    steps = [step(1, "heal", f"--config={config}", files=(config,)), *STEPS[1:]]
    go(commands, liver, out, steps)
    config.write_text("profile = 'hfss'\n")
    go(commands, liver, out, steps)
    assert commands.names[0] == "heal"


@pytest.mark.parametrize("damage", ["lost file", "lost report", "cut report", "more"])
def test_damaged_results_are_made_anew(commands, liver, out, damage) -> None:
    go(commands, liver, out)
    if damage == "lost file":
        (out / "01-heal" / "liver.stl").unlink()
    elif damage == "lost report":
        (out / "01-heal" / "report.json").unlink()
    elif damage == "cut report":
        (out / "01-heal" / "report.json").write_text("{")
    else:
        (out / "01-heal" / "spleen.stl").write_bytes(b"foreign")
    go(commands, liver, out)
    assert commands.names[0] == "heal"


def test_overwrite_runs_all(commands, liver, out) -> None:
    go(commands, liver, out)
    go(commands, liver, out, overwrite=True)
    assert commands.names == ["heal", "smooth", "check", "tetmesh"]


def test_a_stopped_stage_that_can_go_on_finds_its_results(commands, liver, out) -> None:
    def stop(command: str, place: Path) -> None:
        if command in ("smooth", "tetmesh"):
            place.mkdir(parents=True, exist_ok=True)
            (place / "half").write_text("done so far")
            raise KeyboardInterrupt

    commands.before = stop
    with pytest.raises(KeyboardInterrupt):
        go(commands, liver, out)
    assert not (out / "report.json").exists()
    seen: dict[str, bool] = {}

    def look(command: str, place: Path) -> None:
        seen[command] = (place / "half").exists()

    commands.before = look
    go(commands, liver, out)
    assert commands.names == ["smooth", "check", "tetmesh"]
    # Only the commands that keep an account of their own find what they had done.
    assert seen == {"smooth": True, "check": False, "tetmesh": False}


def test_a_stage_stopped_with_other_options_starts_from_nothing(commands, liver, out) -> None:
    def stop(command: str, place: Path) -> None:
        place.mkdir(parents=True, exist_ok=True)
        (place / "half").write_text("done so far")
        (out / ".01-heal.healed").mkdir()
        raise KeyboardInterrupt

    commands.before = stop
    with pytest.raises(KeyboardInterrupt):
        go(commands, liver, out)
    commands.before = lambda command, place: None
    go(commands, liver, out, [step(1, "heal", "--max-deviation=1"), *STEPS[1:]])
    assert not (out / "01-heal" / "half").exists()
    assert not (out / ".01-heal.healed").exists()


@pytest.mark.parametrize(
    ("command", "arguments", "kept"),
    [("heal", (), True), ("smooth", (), True), ("separate", (), False), ("decimate", ("--ratio=1",), False),
     ("heal", ("--clearance",), False)],
)  # fmt: skip
def test_other_inputs_are_taken_up_where_each_tissue_stands_alone(
    commands, liver, out, command, arguments, kept
) -> None:
    steps = [step(1, command, *arguments)]
    go(commands, liver, out, steps)
    write_mesh(liver / "liver.stl", sphere(11, subdivisions=1))
    seen = []
    commands.before = lambda command, place: seen.append((place / "liver.stl").exists())
    go(commands, liver, out, steps)
    assert seen == [kept]


def test_a_child_that_was_interrupted_interrupts_the_run(commands, liver, out) -> None:
    commands.codes["smooth"] = 130
    with pytest.raises(KeyboardInterrupt):
        go(commands, liver, out)


def test_errors_on_the_way_may_be_cured(commands, liver, out) -> None:
    commands.codes["heal"] = 1
    done = go(commands, liver, out)
    assert commands.names == ["heal", "smooth", "check", "tetmesh"]
    assert exit_code(done.stages) == 0


def test_a_check_that_fails_ends_the_pipeline(commands, liver, out) -> None:
    commands.codes["check"] = 1
    done = go(commands, liver, out, [*STEPS[:2], step(3, "check", on_error="stop"), STEPS[3]])
    assert commands.names == ["heal", "smooth", "check"]
    assert [stage.exit_code for stage in done.stages] == [0, 0, 1, None]
    assert exit_code(done.stages) == 1
    # What was made is there all the same.
    assert done.surfaces == "02-smooth"


def test_an_early_check_that_fails_and_goes_on_is_overruled(commands, liver, out) -> None:
    steps = [step(1, "check"), step(2, "heal"), step(3, "export")]
    commands.codes["check"] = 1
    assert exit_code(go(commands, liver, out, steps).stages) == 0
    stopping = [step(1, "check", on_error="stop"), *steps[1:]]
    done = go(commands, liver, out, stopping)
    assert [stage.exit_code for stage in done.stages] == [1, None, None]
    assert exit_code(done.stages) == 1
    assert done.surfaces is None


def test_a_result_that_fails_counts(commands, liver, out) -> None:
    commands.codes["tetmesh"] = 1
    done = go(commands, liver, out)
    assert exit_code(done.stages) == 1
    report = pipeline_report(done, "test", [liver], {})
    assert not report["summary"]["passed"]
    assert report["pipeline"]["exit_code"] == 1


def test_a_result_on_the_way_counts_too(commands, liver, out) -> None:
    commands.codes["export"] = 1
    done = go(commands, liver, out, [step(1, "heal"), step(2, "export"), step(3, "smooth"), step(4, "check")])
    assert commands.names == ["heal", "export", "smooth", "check"]
    assert exit_code(done.stages) == 1


def test_what_could_not_be_processed_is_never_forgotten_and_tried_again(commands, liver, out) -> None:
    commands.codes["heal"] = 3
    done = go(commands, liver, out)
    assert commands.names == ["heal", "smooth", "check", "tetmesh"]
    assert exit_code(done.stages) == 3
    done = go(commands, liver, out)
    assert commands.names == ["heal"]
    assert exit_code(done.stages) == 3
    del commands.codes["heal"]
    assert exit_code(go(commands, liver, out).stages) == 0
    assert commands.names == ["heal"]


@pytest.mark.parametrize(("code", "expected"), [(-11, 3), (2, 2), (141, 3), (7, 3)])
def test_a_stage_without_surfaces_ends_the_pipeline(commands, liver, out, code, expected) -> None:
    go(commands, liver, out)
    commands.codes["smooth"] = code
    steps = [STEPS[0], step(2, "smooth", "--iterations=9"), *STEPS[2:]]
    done = go(commands, liver, out, steps)
    assert [stage.exit_code for stage in done.stages] == [0, expected, None, None]
    assert exit_code(done.stages) == expected
    # The surfaces of the earlier run would be taken for those of this one.
    assert done.surfaces is None
    assert not (out / "surfaces").exists()


def test_an_old_report_is_not_taken_for_that_of_a_stage_that_crashed(commands, liver, out) -> None:
    go(commands, liver, out)
    write_mesh(liver / "liver.stl", sphere(12, subdivisions=1))
    commands.codes["heal"] = -9
    done = go(commands, liver, out)
    assert done.stages[0].exit_code == 3
    assert done.stages[0].report is None
    report = pipeline_report(done, "test", [liver], {})
    assert not report["summary"]["passed"]
    assert json.loads(render(report, "json"))["pipeline"]["stages"][0]["outcome"] == "failed"
    assert [(one["rule"], one["level"]) for one in report["findings"]] == [("F012", "error")]
    # A reader of JUnit sees no exit code.
    assert 'failures="1"' in render(report, "junit")


def test_a_stage_that_says_it_passed_and_has_no_report_has_failed(commands, liver, out) -> None:
    def quiet(arguments: Sequence[str]) -> int:
        return 0

    done = run_pipeline([step(1, "check")], [liver], out, recursive=False, execute=quiet)
    assert exit_code(done.stages) == 3


def test_without_a_stage_that_makes_surfaces_there_are_no_new_ones(commands, liver, out) -> None:
    done = go(commands, liver, out, [step(1, "check"), step(2, "export")])
    assert not done.surfaces
    assert not (out / "surfaces").exists()
    assert pipeline_report(done, "test", [liver], {})["pipeline"]["surfaces"] is None


def test_surfaces_of_several_directories_stay_apart(commands, liver, out, tmp_path) -> None:
    other = tmp_path / "other"
    other.mkdir()
    write_mesh(other / "spleen.stl", box())
    go(commands, [liver, other], out)
    assert "--recursive" not in commands.calls[0]
    assert all("--recursive" in call for call in commands.calls[1:])
    assert sorted(path.relative_to(out / "surfaces").as_posix() for path in (out / "surfaces").rglob("*.stl")) == [
        "liver_model/liver.stl",
        "other/spleen.stl",
    ]


def test_surfaces_lose_what_the_model_lost_and_carry_the_settings(commands, liver, out, tmp_path) -> None:
    config = tmp_path / "some.toml"
    config.write_text("profile = 'cst'\n")
    write_mesh(liver / "spleen.stl", box())
    go(commands, liver, out, config=config)
    assert (out / "surfaces" / "vhp.toml").read_text() == config.read_text()
    (liver / "spleen.stl").unlink()
    commands.before = lambda command, place: (place / "spleen.stl").unlink(missing_ok=True)
    go(commands, liver, out)
    assert sorted(path.name for path in (out / "surfaces").iterdir()) == ["liver.stl"]


def test_a_stage_that_the_pipeline_has_no_longer_is_left_alone_and_told(commands, liver, out) -> None:
    go(commands, liver, out)
    done = go(commands, liver, out, STEPS[:3])
    assert done.left_over == ("04-tetmesh",)
    assert (out / "04-tetmesh" / "report.json").exists()


def test_foreign_directories_are_never_emptied(commands, liver, out) -> None:
    out.mkdir()
    (out / "thesis.txt").write_text("mine")
    with pytest.raises(UsageError, match="holds no run of a pipeline"):
        go(commands, liver, out)
    (out / "thesis.txt").unlink()
    go(commands, liver, out, STEPS[:1])
    for mine in ("02-smooth", "surfaces"):
        folder = out / mine
        if mine == "surfaces":
            for path in sorted(folder.iterdir()):
                path.unlink()
            (out / ".vhp-run" / "surfaces.json").unlink()
        folder.mkdir(exist_ok=True)
        (folder / "thesis.txt").write_text("mine")
        with pytest.raises(UsageError, match="not made by this pipeline"):
            go(commands, liver, out, STEPS[:2])
        assert (folder / "thesis.txt").read_text() == "mine"
        (folder / "thesis.txt").unlink()
        folder.rmdir()


def test_the_model_is_never_written_to(commands, liver) -> None:
    for bad in (liver, liver / "out", liver.parent):
        with pytest.raises(UsageError):
            go(commands, liver, bad)
    assert commands.calls == []


def test_a_record_that_was_cut_short_counts_as_none(commands, liver, out) -> None:
    go(commands, liver, out, STEPS[:3])
    record = out / ".vhp-run" / "03-check.json"
    record.write_bytes(record.read_bytes()[:40])
    with pytest.raises(UsageError, match="not made by this pipeline"):
        go(commands, liver, out, STEPS[:3])
