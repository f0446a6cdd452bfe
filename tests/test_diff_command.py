"""`vhp diff`: what it tells of two models or reports, and when it says that something is worse."""

from __future__ import annotations

import copy
import json
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner
from shapes import box, flipped, moved, sphere

from vhp_cli.cli import main
from vhp_cli.commands.diff import diff
from vhp_cli.errors import UsageError
from vhp_cli.formats import write_mesh
from vhp_cli.mesh import Mesh
from vhp_cli.pipeline.check import check_model
from vhp_cli.report.compare import compare, parse_report
from vhp_cli.report.compare_text import render_difference


@pytest.fixture(autouse=True)
def _own_cache(tmp_path_factory, monkeypatch):
    monkeypatch.setenv("VHP_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))


def written(directory: Path, **tissues: Mesh) -> Path:
    directory.mkdir()
    for name, mesh in tissues.items():
        write_mesh(directory / f"{name}.stl", mesh)
    return directory


LIVER, SPLEEN = sphere(10, subdivisions=2), sphere(6, (30, 0, 0), subdivisions=2)


@pytest.fixture
def old(tmp_path) -> Path:
    return written(tmp_path / "old", liver=LIVER, spleen=SPLEEN)


def run(*arguments) -> tuple[int, dict]:
    result = CliRunner().invoke(diff, [*map(str, arguments), "--report", "-", "-j1"])
    if isinstance(result.exception, UsageError):
        raise result.exception
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, json.loads(result.stdout)


def test_equal_models_are_equal(tmp_path, old) -> None:
    code, found = run(old, written(tmp_path / "new", liver=LIVER, spleen=SPLEEN), "--fail-on", "changes")
    assert code == 0
    assert found["equal"]
    assert found["tissues"]["unchanged"] == 2


def test_a_new_defect_is_worse(tmp_path, old) -> None:
    code, found = run(old, written(tmp_path / "new", liver=flipped(LIVER), spleen=SPLEEN))
    assert code == 1
    assert found["worse"] == ["passed before, fails now", "1 new error"]
    assert [(one["rule"], one["tissues"]) for one in found["findings"]["new"]] == [("T005", ["liver"])]
    (liver,) = found["tissues"]["changed"]
    assert liver["name"] == "liver"
    assert liver["measures"]["outward"] == {"before": True, "after": False}
    assert liver["measures"]["volume_mm3"]["after"] == -liver["measures"]["volume_mm3"]["before"]
    assert liver["volume_change"] == 0.0


def test_a_defect_that_went_is_fixed_and_nothing_is_worse(tmp_path, old) -> None:
    broken = written(tmp_path / "broken", liver=Mesh(LIVER.vertices, LIVER.faces[1:]), spleen=SPLEEN)
    code, found = run(broken, old)
    assert code == 0
    assert not found["worse"]
    assert [one["rule"] for one in found["findings"]["fixed"]] == ["T001"]
    assert found["passed"] == {"before": False, "after": True}


def test_more_of_a_defect_is_worse_and_less_is_eased(tmp_path) -> None:
    one = written(tmp_path / "one", liver=Mesh(LIVER.vertices, LIVER.faces[1:]))
    two = written(tmp_path / "two", liver=Mesh(LIVER.vertices, LIVER.faces[4:]))
    code, found = run(one, two)
    assert code == 1
    assert found["worse"] == ["1 worse error"]
    assert found["findings"]["by_rule"] == {"T001": {"new": 0, "worse": 1, "eased": 0, "fixed": 0}}
    code, found = run(two, one)
    assert code == 0
    assert found["findings"]["by_rule"] == {"T001": {"new": 0, "worse": 0, "eased": 1, "fixed": 0}}


def test_tissues_come_go_and_change_their_names(tmp_path, old) -> None:
    new = written(tmp_path / "new", hepar=LIVER, kidney=sphere(5, (0, 40, 0), subdivisions=2))
    code, found = run(old, new)
    tissues = found["tissues"]
    assert (tissues["added"], tissues["removed"]) == (["kidney"], ["spleen"])
    assert tissues["renamed"] == [{"before": "liver", "after": "hepar"}]
    assert (code, found["worse"]) == (1, ["gone: spleen"])
    assert run(old, new, "--fail-on", "errors")[0] == 0


def test_findings_follow_a_new_name(tmp_path) -> None:
    old = written(tmp_path / "old", liver=flipped(LIVER))
    code, found = run(old, written(tmp_path / "new", hepar=flipped(LIVER)))
    assert code == 0
    assert found["findings"]["by_rule"] == {}


def test_pairs_that_meet(tmp_path, old) -> None:
    new = written(tmp_path / "new", liver=LIVER, spleen=moved(SPLEEN, (-15, 0, 0)))
    code, found = run(old, new)
    assert code == 1
    (pair,) = found["pairs"]
    assert (pair["a"], pair["b"]) == ("liver", "spleen")
    assert pair["relation"] == {"before": "apart", "after": "crossing"}
    assert pair["overlap_mm3"]["after"] > 0


def test_a_pair_is_the_same_whatever_comes_first(tmp_path) -> None:
    inside = {"a": box((1, 1, 1), (2, 2, 2)), "z": box()}
    old, new = written(tmp_path / "old", **inside), written(tmp_path / "new", **inside)
    first, second = (parse_report(json.dumps(check([path])), "x") for path in (old, new))
    for pair in second["pairs"]:
        pair["a"], pair["b"] = pair["b"], pair["a"]
        pair["relation"] = "b_inside_a" if pair["relation"] == "a_inside_b" else "a_inside_b"
    assert compare(first, second)["pairs"] == []


def check(paths) -> dict:
    from vhp_cli.config import load_settings
    from vhp_cli.model import find_model

    return copy.deepcopy(check_model(find_model(paths), load_settings(), paths=paths, jobs=1).report)


def test_volumes_have_a_limit_if_asked(tmp_path, old) -> None:
    larger = written(tmp_path / "new", liver=sphere(10.1, subdivisions=2), spleen=SPLEEN)
    assert run(old, larger)[0] == 0
    assert run(old, larger, "--max-volume-change", "0.04")[0] == 0
    code, found = run(old, larger, "--max-volume-change", "0.02")
    assert (code, found["worse"]) == (1, ["liver: volume +3.03%"])
    opened = written(tmp_path / "open", liver=Mesh(LIVER.vertices, LIVER.faces[1:]), spleen=SPLEEN)
    assert "liver: volume not defined" in run(old, opened, "--max-volume-change", "0.02")[1]["worse"]


def test_fail_on(tmp_path, old) -> None:
    larger = written(tmp_path / "new", liver=sphere(10.1, subdivisions=2), spleen=SPLEEN)
    assert run(old, larger, "--fail-on", "changes")[0] == 1
    broken = written(tmp_path / "broken", liver=flipped(LIVER), spleen=SPLEEN)
    assert run(old, broken, "--fail-on", "errors")[0] == 1
    assert run(old, broken, "--fail-on", "never")[0] == 0


def test_reports_and_directories_with_one_are_read(tmp_path, old) -> None:
    report = tmp_path / "out" / "report.json"
    assert main(["-q", "check", str(old), "-o", str(report.parent)]) == 0
    for one, other in ((report, old), (report.parent, report), (old, report.parent)):
        code, found = run(one, other)
        assert (code, found["equal"]) == (0, True)


def test_both_are_judged_by_the_same_settings(tmp_path, old) -> None:
    near = written(tmp_path / "near", liver=LIVER, spleen=moved(SPLEEN, (-13.5, 0, 0)))
    assert run(old, near)[0] == 1  # 0.5 mm apart
    (near / "vhp.toml").write_text("[rules]\nP005 = 0.1\n")
    code, found = run(old, near)
    assert (code, found["settings_differ"]) == (0, [])
    assert run(old, near, "--gap", "1")[0] == 1


def test_other_settings_are_told(tmp_path, old) -> None:
    for name, profile in (("one", "strict"), ("two", "cst")):
        assert main(["-q", "check", str(old), "-o", str(tmp_path / name), "--profile", profile]) == 0
    found = run(tmp_path / "one", tmp_path / "two")[1]
    assert found["settings_differ"] == ["profile", "rules"]
    assert "judged by different settings: profile, rules" in render_difference(found, "text")


def test_forms(tmp_path, old) -> None:
    new = written(tmp_path / "new", liver=flipped(LIVER), kidney=sphere(5, (0, 40, 0), subdivisions=2))
    targets = [tmp_path / f"diff.{suffix}" for suffix in ("json", "md", "txt")]
    result = CliRunner().invoke(diff, [str(old), str(new), *(f"--report={target}" for target in targets)])
    assert result.exit_code == 1
    for words in ("+ kidney", "- spleen", "~ liver", "error T005 inward", "worse: passed before"):
        assert words in result.stdout
    assert json.loads(targets[0].read_text())["tissues"]["added"] == ["kidney"]
    assert "| T005 " in targets[1].read_text()
    assert "| kidney | added |" in targets[1].read_text()
    assert targets[2].read_text() == result.stdout


def test_names_can_not_break_the_text(tmp_path) -> None:
    old = written(tmp_path / "old", **{"liver\x1b[31m|x": LIVER})
    new = written(tmp_path / "new", **{"liver\x1b[31m|x": SPLEEN, "\x07": box()})
    found = run(old, new)[1]
    for form in ("text", "markdown"):
        assert "\x1b" not in render_difference(found, form, verbose=True)
        assert "\x07" not in render_difference(found, form, verbose=True)


def test_long_lists_are_cut_unless_asked(tmp_path) -> None:
    old = written(tmp_path / "old", liver=LIVER)
    new = written(
        tmp_path / "new", liver=LIVER, **{f"node_{i}": box((20 * i + 20, 0, 0), (20 * i + 30, 9, 9)) for i in range(30)}
    )
    found = run(old, new)[1]
    assert "and 11 more (--verbose)" in render_difference(found, "text")
    assert "node_29" in render_difference(found, "text", verbose=True)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "not a JSON document"),
        ("[]", "not a report"),
        ('{"schema": "vhp-report/2"}', "not a report"),
        ('{"schema": "vhp-report/1"}', "summary"),
        ("no tissues", "without tissues"),
        ("broken tissue", r"tissues\[0\] lacks sha256"),
    ],
)
def test_what_is_no_report_is_refused(tmp_path, old, text, words) -> None:
    if " " in text and not text.startswith("{"):
        report = check([old])
        if text == "no tissues":
            del report["tissues"]
        else:
            del report["tissues"][0]["sha256"]
        text = json.dumps(report)
    path = tmp_path / "report.json"
    path.write_text(text)
    with pytest.raises(UsageError, match=words):
        run(path, old)


def test_usage(tmp_path, old) -> None:
    with pytest.raises(UsageError, match="no such file"):
        run(old, tmp_path / "gone")
    with pytest.raises(UsageError, match="no form of a difference"):
        run(old, old, "--report", "diff.sarif")
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(UsageError, match="no mesh file"):
        run(old, empty)
    shutil.rmtree(empty)
