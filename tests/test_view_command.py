"""``vhp view``, and the page that every command can write."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from shapes import box, moved, sphere

from vhp_cli.cli import main
from vhp_cli.commands.view import page_in_cache
from vhp_cli.formats import write_mesh
from vhp_cli.mesh import Mesh


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("VHP_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.delenv("BROWSER", raising=False)


@pytest.fixture
def model(tmp_path):
    directory = tmp_path / "model"
    directory.mkdir()
    write_mesh(directory / "ball.stl", sphere(10.0))
    cube = box((30, 0, 0), (40, 10, 10))
    write_mesh(directory / "open_box.ply", Mesh(cube.vertices, cube.faces[:-1]))
    return directory


def scene_of(path) -> dict:
    text = path.read_text(encoding="utf-8")
    found = re.search(r'<script type="application/json" id="scene">(.*?)</script>', text, re.DOTALL)
    return json.loads(found[1])


def faces_of(path) -> dict[str, int]:
    return {each["name"]: each["faces"] for each in scene_of(path)["tissues"]}


def test_the_page_is_made_in_the_cache_and_opened(model, capsys, monkeypatch):
    opened = []
    monkeypatch.setattr("click.launch", lambda address: opened.append(address) or 0)
    assert main(["view", str(model)]) == 0
    page = page_in_cache((model,))
    assert capsys.readouterr().out == f"{page}\n"
    assert opened == [page.as_uri()]
    assert faces_of(page) == {"ball": 320, "open_box": 11}
    # The next page takes its place.
    assert main(["view", str(model), "--no-open"]) == 0
    assert len(opened) == 1
    assert len(list(page.parent.iterdir())) == 1


def test_no_browser_is_no_failure(model, capsys, monkeypatch):
    monkeypatch.setattr("click.launch", lambda address: 1)
    assert main(["view", str(model)]) == 0
    assert "no browser" in capsys.readouterr().err


def test_the_page_goes_where_it_is_asked_to(model, tmp_path, capsys):
    page = tmp_path / "new" / "page.html"
    assert main(["view", str(model), "--no-open", "-o", str(page)]) == 0
    assert capsys.readouterr().out == f"{page}\n"
    findings = scene_of(page)["findings"]
    assert [item["rule"] for item in findings] == ["T001"]
    assert findings[0]["places"][0]["at"][0] >= 30


def test_view_and_check_make_the_same_page(model, tmp_path):
    first, second, third, fourth = (tmp_path / f"{name}.html" for name in "abcd")
    assert main(["check", str(model), "--report", str(first), "--report-html", str(second)]) == 1
    assert main(["check", str(model), "-o", str(tmp_path)]) == 1
    assert main(["view", str(model), "--no-open", "-o", str(third)]) == 0
    assert main(["view", str(tmp_path / "report.json"), "--no-open", "-o", str(fourth)]) == 0

    def without_run(path):
        text = path.read_text(encoding="utf-8")
        start = text.index('<section id="about">')
        return text[:start] + text[text.index("</section>", start) :]

    assert first.read_bytes() == second.read_bytes()
    assert without_run(first) == without_run(third) == without_run(fourth)
    assert faces_of(fourth) == {"ball": 320, "open_box": 11}


def test_the_page_of_a_stage_shows_the_result(model, tmp_path):
    page, out = tmp_path / "page.html", tmp_path / "out"
    assert main(["smooth", str(model), "-o", str(out), "--report-html", str(page)]) == 1
    scene = scene_of(page)
    assert {each["name"]: each["whole"] for each in scene["tissues"]} == {"ball": True, "open_box": True}
    assert 'id="change"' in page.read_text(encoding="utf-8")
    # From its report alone, too.
    again = tmp_path / "again.html"
    assert main(["view", str(out / "report.json"), "--no-open", "-o", str(again)]) == 0
    assert again.read_bytes() == page.read_bytes()


def test_other_units_are_shown_in_mm(tmp_path):
    directory, page = tmp_path / "m", tmp_path / "page.html"
    directory.mkdir()
    ball = sphere(10.0)
    write_mesh(directory / "ball.ply", Mesh(ball.vertices / 1000, ball.faces))
    assert main(["view", str(directory), "--units", "m", "--no-open", "-o", str(page)]) == 0
    (tissue,) = scene_of(page)["tissues"]
    assert tissue["step"] * 65535 == pytest.approx(20.0, rel=0.01)
    assert np.allclose(tissue["low"], -10, atol=0.2)


def test_a_file_that_changed_since_is_not_shown(model, tmp_path):
    page = tmp_path / "page.html"
    assert main(["check", str(model), "-o", str(tmp_path)]) == 1
    write_mesh(model / "ball.stl", moved(sphere(10.0), (0, 0, 1)))
    (model / "open_box.ply").unlink()
    assert main(["view", str(tmp_path / "report.json"), "--no-open", "-o", str(page)]) == 0
    text = page.read_text(encoding="utf-8")
    assert "its file is another one by now" in text and "its file was not found" in text
    assert 'id="viewer"' not in text


def test_several_paths_and_directories_within_are_found(model, tmp_path):
    deep = model / "deep"
    deep.mkdir()
    write_mesh(deep / "bead.stl", sphere(1.0, (0, 0, 50)))
    page = tmp_path / "page.html"
    assert main(["view", str(model), "--recursive", "--no-open", "-o", str(page)]) == 0
    assert faces_of(page) == {"ball": 320, "bead": 320, "open_box": 11}
    assert main(["view", str(deep), str(model / "ball.stl"), "--no-open", "-o", str(page)]) == 0
    assert faces_of(page) == {"ball": 320, "bead": 320}


def test_html_on_stdout(model, capsys):
    assert main(["check", str(model), "--format", "html"]) == 1
    out = capsys.readouterr().out
    assert out.startswith("<!doctype html>") and '"faces":320' in out


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "not JSON"),
        ("[]", "no report"),
        ('{"schema": "vhp-report/2"}', "no report"),
        ('{"schema": "vhp-report/1"}', "damaged"),
        ('{"schema": "vhp-report/1", "tissues": 3, "settings": {}, "model": {}, "findings": []}', "damaged"),
        ("\x80\x81", "not JSON"),
    ],
)
def test_what_is_no_report_is_told(tmp_path, capsys, text, said):
    path = tmp_path / "report.json"
    path.write_bytes(text.encode("latin-1"))
    assert main(["view", str(path), "--no-open"]) == 2
    error = capsys.readouterr().err
    assert said in error and "Traceback" not in error


def test_nothing_to_view(tmp_path, capsys):
    assert main(["view", str(tmp_path / "gone"), "--no-open"]) == 2
    assert main(["view", str(tmp_path / "gone.json"), "--no-open"]) == 2
    assert "gone.json" in capsys.readouterr().err
