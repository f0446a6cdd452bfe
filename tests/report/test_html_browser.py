"""The page in a real browser: the viewer, the way from a finding to its place, light and dark."""

from __future__ import annotations

import copy
import json
import math

import numpy as np
import pytest
from browser import SOFTWARE, WITHOUT_WEBGL, page_of

from vhp_cli.cli import main
from vhp_cli.report.html import html_page

pytestmark = pytest.mark.slow

NASTY = "a<!--<script><img src=x onerror=alert(1)>"


@pytest.fixture(scope="module")
def page_file(tmp_path_factory):
    """Page of a small phantom with defects of many kinds, one of its tissues with a name that could do harm."""
    directory = tmp_path_factory.mktemp("page")
    model = directory / "model"
    assert main(["phantom", str(model), "--tissues", "30", "--triangles", "20000", "--defects", "3"]) == 0
    (model / "heart.stl").rename(model / f"{NASTY}.stl")
    assert (
        main(["check", str(model), "--no-cache", "-o", str(directory), "--report-html", str(directory / "p.html")]) == 1
    )
    return directory / "p.html"


@pytest.fixture(scope="module")
def report(page_file):
    return json.loads((page_file.parent / "report.json").read_text())


@pytest.fixture(scope="module")
def opened(page_file):
    with page_of(page_file) as (page, said):
        page.wait_for_function("window.vhp && (vhp.ready || vhp.failed)")
        assert page.evaluate("vhp.failed") == ""
        yield page, said


@pytest.fixture(autouse=True)
def afresh(request):
    if "opened" in request.fixturenames:
        page, said = request.getfixturevalue("opened")
        page.evaluate("vhp.letGo(); document.getElementById('all').click(); vhp.fit()")
        yield
        # Neither errors, nor warnings, nor a request.
        assert said == []
    else:
        yield


def pixels(page) -> np.ndarray:
    """Return what the canvas shows (H, W, 4), drawn in the same moment as it is read."""
    text = page.evaluate(
        """() => new Promise(done => { vhp.setShown(vhp.tissues[0], vhp.tissues[0].shown);
          requestAnimationFrame(() => { const canvas = document.getElementById('canvas');
            const copy = Object.assign(document.createElement('canvas'), { width: 120, height: 96 });
            const plane = copy.getContext('2d'); plane.drawImage(canvas, 0, 0, 120, 96);
            done([...plane.getImageData(0, 0, 120, 96).data]); }); })"""
    )
    return np.array(text, dtype=np.uint8).reshape(96, 120, 4)


def test_the_model_is_drawn(opened):
    page, _ = opened
    shown = pixels(page).astype(int)
    ground = shown[2, 2, :3]
    different = np.abs(shown[..., :3] - ground).sum(axis=2) > 12
    assert 0.15 < different.mean() < 0.95
    assert len(page.evaluate("vhp.shown")) == len(page.evaluate("vhp.tissues"))


def test_each_finding_leads_to_its_place(opened, report):
    page, _ = opened
    order = page.evaluate("vhp.findings.map(f => [f.rule, f.message, ...f.tissues.map(t => vhp.tissues[t].name)])")
    places = {(item["rule"], item["message"], *item["tissues"]): item["places"] for item in report["findings"]}
    assert len(order) == len(places) == len(report["findings"]) > 8
    # The lists that are folded up are opened, as a person would.
    page.evaluate("document.querySelectorAll('#findings details').forEach(each => { each.open = true; })")
    for index, key in enumerate(map(tuple, order)):
        if not places[key]:
            continue
        page.locator(f".go[data-finding='{index}']").click()
        state = page.evaluate("[vhp.target, vhp.state.finding, vhp.selected, vhp.flying]")
        assert state[0] == pytest.approx(places[key][0]["xyz_mm"], abs=1e-9)
        assert state[1] == index and state[3] is False
        named = page.locator("#chip-name").inner_text()
        assert all(name in named for name in key[2:])
        x, y, z = places[key][0]["xyz_mm"]
        assert page.locator("#chip-place").inner_text() == f"{x:.3f}, {y:.3f}, {z:.3f} mm"
        # The ring is in the middle of the canvas, once it is drawn.
        page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
        ring = page.locator("#rings circle.ring[r='16']").first
        size = page.evaluate("[canvas.clientWidth / 2, canvas.clientHeight / 2]")
        assert [float(ring.get_attribute(key)) for key in ("cx", "cy")] == pytest.approx(size, abs=0.6)


def test_the_face_of_a_finding_is_marked_red(opened):
    page, _ = opened
    index = page.evaluate("vhp.findings.findIndex(f => f.rule === 'T004')")
    page.evaluate("document.getElementById('rings').style.display = 'none'")
    page.evaluate(f"vhp.show({index})")
    page.evaluate("vhp.camera.reach /= 3")
    middle = pixels(page)[44:52, 55:65, :3].astype(int)
    page.evaluate("document.getElementById('rings').style.display = ''")
    red = (middle[..., 0] > 150) & (middle[..., 0] > 2 * middle[..., 1]) & (middle[..., 0] > 2 * middle[..., 2])
    assert red.mean() > 0.2


def test_another_place_of_a_finding(opened):
    page, _ = opened
    index = page.evaluate("vhp.findings.findIndex(f => f.places.length > 1)")
    page.locator(f".spot[data-finding='{index}'][data-place='1']").click()
    assert page.evaluate("vhp.target") == pytest.approx(page.evaluate(f"vhp.findings[{index}].places[1].at"))
    assert page.evaluate("vhp.state.place") == 1


def test_hiding_and_showing_tissues(opened):
    page, _ = opened
    page.locator("#dots").uncheck()
    full = pixels(page).astype(int)
    page.locator("#list-toggle").click()
    page.locator("#search").fill("skin")
    assert page.locator("#names li:visible").count() == 1
    page.locator("#names li:visible input").uncheck()
    assert "skin" not in page.evaluate("vhp.shown")
    assert (pixels(page).astype(int) != full).any(axis=2).mean() > 0.05
    page.locator("#none").click()
    assert page.evaluate("vhp.shown") == []
    empty = pixels(page).astype(int)
    assert (np.abs(empty - empty[0, 0]).sum(axis=2) > 6).mean() == 0
    page.locator("#all").click()
    assert "skin" in page.evaluate("vhp.shown")
    page.locator("#search").fill("")
    page.locator("#list-toggle").click()
    assert (np.abs(pixels(page).astype(int) - full).sum(axis=2) > 30).mean() < 0.01
    page.locator("#dots").check()


def test_a_tissue_of_the_table_is_selected_and_alone_if_asked(opened):
    page, _ = opened
    page.locator("table.tissues .name", has_text="lung_left").click()
    assert page.evaluate("vhp.selected") == "lung_left"
    lung = page.evaluate("vhp.tissues.find(t => t.name === 'lung_left')")
    assert page.evaluate("vhp.target") == pytest.approx(
        [(a + b) / 2 for a, b in zip(lung["min"], lung["max"], strict=True)]
    )
    page.locator("#chip-only").click()
    assert page.evaluate("vhp.shown") == ["lung_left"]
    page.locator("#chip-card").click()
    card = page.locator("article.card", has_text="lung_left").first
    assert card.locator("details").first.evaluate("each => each.open")


def test_a_click_on_the_model_names_the_tissue_and_the_point(opened):
    page, _ = opened
    page.evaluate("vhp.showOnly(new Set([vhp.tissues.findIndex(t => t.name === 'lung_right')]))")
    page.evaluate("vhp.fit()")
    hit = page.evaluate("vhp.pick(document.getElementById('canvas').clientWidth / 2, canvas.clientHeight / 2)")
    lung = page.evaluate("vhp.tissues.find(t => t.name === 'lung_right')")
    assert hit["tissue"] == lung["index"]
    assert all(a - 0.5 <= value <= b + 0.5 for a, value, b in zip(lung["min"], hit["at"], lung["max"], strict=True))
    page.locator("#canvas").click()
    assert page.evaluate("vhp.selected") == "lung_right"
    shown = [float(part) for part in page.locator("#chip-place").inner_text().removesuffix(" mm").split(", ")]
    assert shown == pytest.approx(hit["at"], abs=0.5)
    page.locator("#canvas").click(position={"x": 3, "y": 3})
    assert page.evaluate("vhp.selected") is None


def test_turning_moving_and_zooming_by_mouse_and_keys(opened):
    page, _ = opened
    before = page.evaluate("({...vhp.camera})")
    page.locator("#canvas").focus()
    for key in ("ArrowLeft", "ArrowUp", "+", "Shift+ArrowRight"):
        page.keyboard.press(key)
    after = page.evaluate("({...vhp.camera})")
    assert after["turn"] != before["turn"] and after["lean"] != before["lean"]
    assert after["reach"] == pytest.approx(0.8 * before["reach"]) and after["target"] != before["target"]
    page.keyboard.press("f")
    assert page.evaluate("vhp.camera.reach") > after["reach"]
    box = page.locator("#canvas").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    turn = page.evaluate("vhp.camera.turn")
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 100, y)
    page.mouse.up()
    assert page.evaluate("vhp.camera.turn") == pytest.approx(turn - 0.8)
    reach = page.evaluate("vhp.camera.reach")
    page.mouse.wheel(0, -200)
    page.wait_for_function(f"vhp.camera.reach < {reach}")
    # The views from four sides: the person's left is on the right side of the front view.
    page.locator("[data-view=front]").click()
    assert math.sin(page.evaluate("vhp.camera.turn")) == pytest.approx(0)
    page.locator("[data-view=top]").click()
    assert page.evaluate("vhp.camera.lean") == pytest.approx(math.pi / 2)


def test_colours_cut_edges_and_opacity_change_the_picture(opened):
    page, _ = opened
    last = pixels(page).astype(int)
    for change, undo in (
        (lambda: page.select_option("#colour", "q"), lambda: page.select_option("#colour", "type")),
        (lambda: page.select_option("#cut", "1"), lambda: page.select_option("#cut", "")),
        (lambda: page.locator("#edges").check(), lambda: page.locator("#edges").uncheck()),
        (lambda: page.locator("#dots").uncheck(), lambda: page.locator("#dots").check()),
    ):
        change()
        assert (np.abs(pixels(page).astype(int) - last).sum(axis=2) > 20).any()
        undo()
        assert (np.abs(pixels(page).astype(int) - last).sum(axis=2) > 20).mean() < 0.005


def test_tables_sort_and_filter(opened):
    page, _ = opened

    def names():
        return page.evaluate(
            "[...document.querySelectorAll('table.tissues tbody tr:not([hidden]) .name')].map(e => e.textContent)"
        )

    def numbers():
        return page.evaluate(
            "[...document.querySelectorAll('table.tissues tbody tr')].map(row => +row.cells[2].dataset.v)"
        )

    original = names()
    heading = page.locator("table.tissues th", has_text="Triangles")
    heading.locator("button").click()
    triangles = numbers()
    assert (
        len(set(triangles)) > 10
        and triangles == sorted(triangles)
        and heading.get_attribute("aria-sort") == "ascending"
    )
    heading.locator("button").click()
    assert numbers() == triangles[::-1] and heading.get_attribute("aria-sort") == "descending"
    page.locator("table.tissues th", has_text="No").first.locator("button").click()
    assert names() == original
    page.locator("#filter").fill("lung")
    assert sorted(names()) == ["lung_left", "lung_right"]
    page.locator("#filter").fill("")
    page.select_option("#verdict", "error")
    assert 0 < len(names()) < len(original)
    page.select_option("#verdict", "")
    assert names() == original


def test_a_name_stays_text(opened):
    page, _ = opened
    assert NASTY in page.evaluate("vhp.shown")
    assert page.locator("img").count() == 0
    page.locator("table.tissues .name", has_text="onerror").click()
    assert page.locator("#chip-name").inner_text() == NASTY


def test_light_and_dark(page_file):
    grounds = {}
    for scheme in ("light", "dark"):
        with page_of(page_file, scheme=scheme) as (page, said):
            page.wait_for_function("window.vhp && vhp.ready")
            read = "getComputedStyle(document.body).backgroundColor"
            grounds[scheme] = page.evaluate(read), pixels(page)[2, 2, :3].astype(int)
            page.locator("#theme").click()
            switched = page.evaluate(read), pixels(page)[2, 2, :3].astype(int)
            assert switched[0] != grounds[scheme][0]
            page.locator("#theme").click()
            assert page.evaluate(read) == grounds[scheme][0]
            assert said == []
            assert (switched[1].mean() > 128) == (scheme == "dark")
    assert grounds["light"][1].mean() > 200 and grounds["dark"][1].mean() < 60
    assert grounds["light"][0] != grounds["dark"][0]


def test_without_webgl_pictures_are_shown(page_file):
    with page_of(page_file, arguments=WITHOUT_WEBGL) as (page, said):
        page.wait_for_function("window.vhp && (vhp.failed || vhp.ready)")
        assert "no WebGL" in page.evaluate("vhp.failed")
        assert page.locator("#fallback image").count() == 3
        assert page.locator("#fallback").is_visible() and not page.locator(".tools").is_visible()
        assert page.locator("#fallback-words").inner_text().endswith("Pictures are shown instead.")
        page.locator(".go").first.click()
        assert not [line for line in said if "WebGL" not in line]


def test_a_narrow_window(page_file):
    with page_of(page_file, size=(420, 800)) as (page, said):
        page.wait_for_function("window.vhp && vhp.ready")
        assert page.evaluate("document.documentElement.scrollWidth") <= 420
        assert said == []


def test_a_report_without_surfaces_works(report, tmp_path):
    path = tmp_path / "bare.html"
    path.write_text(html_page(copy.deepcopy(report)), encoding="utf-8")
    with page_of(path, arguments=SOFTWARE) as (page, said):
        page.locator("table.tissues .name").first.click()
        assert page.locator(".card details[open]").count() == 1
        assert page.evaluate("window.vhp") is None
        assert said == []
