"""Pairs of tissues that are declared to touch or to lie inside each other, and who is told."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner
from shapes import box

from vhp_cli.cli import main
from vhp_cli.commands import separate as command
from vhp_cli.formats import read_mesh, write_mesh
from vhp_cli.kernels.spatial import Tree, gap


def run(*arguments) -> tuple[int, dict]:
    result = CliRunner().invoke(command.separate, [*map(str, arguments), "--report", "-", "-j1"])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, json.loads(result.stdout)


@pytest.fixture
def model(tmp_path):
    """Return the directory of two tissues that share a face."""
    directory = tmp_path / "pair"
    directory.mkdir()
    write_mesh(directory / "rib.stl", box((0, 0, 0), (9, 9, 9)))
    write_mesh(directory / "cartilage.stl", box((9, 0, 0), (18, 9, 9)))
    return directory


def test_pairs_are_declared_in_a_file_of_their_own(model, tmp_path, out, capsys):
    (tmp_path / "pairs.toml").write_text(
        '[[may-touch]]\na = "rib"\nb = "cart*"\n[[nested]]\ninner = "x"\nouter = "y"\n'
    )
    code, report = run(model, "-o", out, "--declare", tmp_path / "pairs.toml")
    # What is declared counts, and what can't be had, as there is no such tissue, is an error.
    assert code == 1 and set(report["summary"]["counts"]) == {"P006"}
    assert report["summary"]["status"]["unchanged"] == 2
    assert report["settings"]["may-touch"] == [{"a": "rib", "b": "cart*"}]
    assert report["settings"]["nested"] == [{"inner": "x", "outer": "y"}]
    (tmp_path / "pairs.toml").write_text('[[may-touch]]\na = "rib"\nb = "cart*"\n[rules]\nP005 = 2\n')
    other = str(tmp_path / "other")
    assert main(["separate", str(model), "-o", other, "--declare", str(tmp_path / "pairs.toml")]) == 2
    assert "'rules' is no declaration" in capsys.readouterr().err
    (tmp_path / "pairs.toml").write_text('[[may-touch]]\na = "rib"\n')
    assert main(["separate", str(model), "-o", other, "--declare", str(tmp_path / "pairs.toml")]) == 2
    assert "pairs.toml" in capsys.readouterr().err


@pytest.mark.parametrize("settings", ["", '[rules]\nP005 = 2.0\n[[tissue]]\nmatch = "x*"\n', "may-touch = []\n"])
def test_a_check_of_the_result_knows_what_was_declared(model, tmp_path, out, settings, capsys):
    if settings:
        (model / "vhp.toml").write_text(settings)
    declare = tmp_path / "pairs.toml"
    declare.write_text('may-touch = [{ a = "rib", b = "*t\\"*" }, { a = "r*", b = "cartilage" }]\n')
    code, report = run(model, "-o", out, "--declare", declare)
    assert code == 0 and report["summary"]["passed"]
    if settings.startswith("may-touch"):
        # An array in brackets takes no more tables.
        assert main(["separate", str(model), "-o", str(out), "--overwrite", "--declare", str(declare)]) == 0
        assert "give --declare to vhp check" in capsys.readouterr().err
        assert (out / "vhp.toml").read_text() == settings
        assert main(["check", str(out)]) == 1
    else:
        assert main(["check", str(out)]) == 0
        assert (out / "vhp.toml").read_text().startswith(settings)
    # It can be told anyway; and what an earlier run declared is forgotten by one that does not.
    assert main(["check", str(model), "--declare", str(declare)]) == 0
    assert main(["check", str(model)]) == 1
    code, _ = run(model, "-o", out, "--overwrite", "--rounds", 0)
    assert (out / "vhp.toml").is_file() == bool(settings)
    if settings:
        assert (out / "vhp.toml").read_text() == settings


def test_settings_from_elsewhere_are_not_copied_and_declarations_with_them_neither(model, tmp_path, out, capsys):
    (tmp_path / "mine.toml").write_text("[rules]\nP005 = 0.5\n")
    (tmp_path / "pairs.toml").write_text('[[may-touch]]\na = "rib"\nb = "cart*"\n')
    told = ["--config", str(tmp_path / "mine.toml"), "--declare", str(tmp_path / "pairs.toml")]
    assert main(["separate", str(model), "-o", str(out), *told]) == 0
    assert "give --declare to vhp check" in capsys.readouterr().err and not (out / "vhp.toml").exists()
    assert main(["check", str(out), *told]) == 0


def test_pairs_that_may_touch_are_only_kept_from_crossing(model, out):
    (model / "vhp.toml").write_text('[[may-touch]]\na = "rib"\nb = "cartilage"\n')
    code, report = run(model, "-o", out)
    assert code == 0 and report["summary"]["status"]["unchanged"] == 2
    write_mesh(model / "cartilage.stl", box((8.8, 1, 1), (18, 8, 8)))
    code, report = run(model, "-o", out, "--overwrite")
    assert code == 0 and report["summary"]["status"]["changed"] == 1
    first, second = (read_mesh(out / f"{name}.stl").mesh for name in ("rib", "cartilage"))
    found = gap(Tree(first.vertices, first.faces), Tree(second.vertices, second.faces))
    assert not found.contact_kind and 0 < found.distance < 0.5


def test_a_pipeline_hands_declared_pairs_on_to_its_surfaces(model, tmp_path, out):
    (tmp_path / "pairs.toml").write_text('[[may-touch]]\na = "rib"\nb = "cart*"\n')
    stages = '[[stage]]\ncommand = "separate"\ndeclare = "pairs.toml"\n[[stage]]\ncommand = "smooth"\n'
    (tmp_path / "pipeline.toml").write_text(stages + '[[stage]]\ncommand = "check"\n')
    assert main(["run", str(tmp_path / "pipeline.toml"), str(model), "-o", str(out), "-j1"]) == 0
    assert main(["check", str(out / "surfaces")]) == 0
    (out / "surfaces" / "vhp.toml").unlink()
    assert main(["check", str(out / "surfaces")]) == 1
