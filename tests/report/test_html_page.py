"""The page: whole, with nothing to load, the same bytes each time, and no name breaks it."""

from __future__ import annotations

import copy
import json
import re
from html.parser import HTMLParser
from itertools import pairwise

import numpy as np
import pytest
from example_report import build, empty, example, finding, healed, many, pair, renamed, sound, tissue
from shapes import box, sphere
from test_report_formats import NASTY, is_safe

from vhp_cli.mesh import Mesh
from vhp_cli.report import PAGE, render
from vhp_cli.report.html import Shown, html_page
from vhp_cli.report.html.colours import tissue_colours
from vhp_cli.report.text import visible
from vhp_cli.rules import RULES

VOID = {"meta", "input", "br", "wbr", "image", "rect", "circle", "path", "line", "polyline", "img"}


class Page(HTMLParser):
    """Elements of a page with their attributes and the text in them; refuses elements that are not closed in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[tuple[str, str]] = []
        self.open: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        if tag not in VOID:
            assert self.open.pop() == tag, self.getpos()

    def handle_data(self, data):
        self.texts.append((self.open[-1] if self.open else "", data))

    def content(self, tag: str, **wanted: str) -> str:
        """Return all text within elements of this tag, however deep; with these attributes, of the first alone."""
        return "".join(text for where, text in self.texts if where == tag)

    def of(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.elements if name == tag]

    def with_class(self, name: str) -> list[dict[str, str | None]]:
        return [attributes for _, attributes in self.elements if name in (attributes.get("class") or "").split()]


def surfaces(record):
    """Give every readable tissue a ball of its own; one of them has its faces numbered otherwise in the file."""
    if not record["sha256"]:
        return "could not be read"
    mesh = sphere(10.0, (len(record["name"]) * 3.0, 0, 0), subdivisions=1)
    return Shown(mesh, np.arange(80) + 2 if record["name"].startswith("VHP") else None)


def scene_of(text: str) -> dict:
    found = re.search(r'<script type="application/json" id="scene">(.*?)</script>', text, re.DOTALL)
    assert found
    return json.loads(found[1])


REPORTS = {"example": example, "healed": healed, "empty": empty, "sound": sound, "many": lambda: many(12)}


@pytest.mark.parametrize("name", REPORTS)
@pytest.mark.parametrize("given", [None, surfaces], ids=["no surfaces", "surfaces"])
def test_the_page_loads_nothing(name, given):
    text = html_page(REPORTS[name](), given)
    page = Page(text)
    assert text.startswith("<!doctype html>\n") and text.endswith("</html>\n")
    assert not {tag for tag, _ in page.elements} & {"link", "iframe", "object", "embed", "img", "base"}
    for tag, attributes in page.elements:
        for key in ("src", "href", "xlink:href", "action", "poster", "data", "srcset"):
            value = attributes.get(key)
            assert value is None or value.startswith(("#", "data:image/png;base64,")), (tag, key, value)
        assert not {key for key in attributes if key.startswith("on")}
    styles = page.content("style")
    assert "@import" not in styles and "url(" not in styles
    script = page.content("script")
    assert not re.search(r"\b(fetch|XMLHttpRequest|importScripts|WebSocket|eval)\b", script)
    policy = next(each["content"] for each in page.of("meta") if each.get("http-equiv") == "Content-Security-Policy")
    assert policy.startswith("default-src 'none';") and "http" not in policy
    # Every link within the page has its target.
    ids = [attributes["id"] for _, attributes in page.elements if attributes.get("id")]
    assert len(ids) == len(set(ids))
    assert {each["href"][1:] for each in page.of("a")} <= set(ids)


@pytest.mark.parametrize(("first", "second"), list(pairwise(NASTY)))
def test_no_name_breaks_the_page(first, second, monkeypatch):
    # The pictures of the whole model name nothing.
    monkeypatch.setattr("vhp_cli.report.html.page.model_figures", lambda *_: "")
    plain, text = html_page(example(), surfaces), html_page(renamed(first, second), surfaces)
    assert is_safe(text.replace("\n", " "))
    page, usual = Page(text), Page(plain)
    # The same elements, whatever they are called; names may be broken at underscores, and titles gone if empty.
    assert [tag for tag, _ in page.elements if tag != "wbr"] == [tag for tag, _ in usual.elements if tag != "wbr"]
    named = [tissue_["name"] for tissue_ in scene_of(text)["tissues"]]
    assert named[0] == visible(first) and named[2] == visible(second)
    assert text.count("<script") == plain.count("<script")


def test_the_page_says_what_the_report_says():
    report = example()
    page = Page(html_page(report, surfaces))
    said = "".join(text for _, text in page.texts)
    assert "failed" in page.content("span")
    for item in report["findings"]:
        assert visible(item["message"]) in said
        rule = RULES[item["rule"]]
        assert f"{item['rule']} {rule.name}" in said and rule.why in said and rule.fix in said
    rows = said[said.index("Mesh quality") :]
    for record in report["tissues"]:
        assert record["name"] in rows and f"{record['triangles']:,}" in rows
    assert "0.561" in rows and "1.30" in rows and "1 error T001" in rows
    assert "12.346, -7.800, 1023.000" in said
    assert "709,656" in said
    # The settings, the version and the time of the run.
    about = said[said.index("Settings and versions", said.index("Crossing faces")) :]
    assert "strict" in about and "0.1.0" in about and "2024-05-06T07:08:09+00:00" in about


def test_buttons_lead_to_the_findings_of_the_scene():
    text = html_page(example(), surfaces)
    page, scene = Page(text), scene_of(text)
    assert [item["rule"] for item in scene["findings"]][:3] == ["F001", "P001", "T001"]
    for each in page.with_class("go") + page.with_class("spot") + page.with_class("ring"):
        item = scene["findings"][int(each["data-finding"])]
        assert item["places"]
        assert int(each.get("data-place") or 0) < len(item["places"])
    with_places = [index for index, item in enumerate(scene["findings"]) if item["places"]]
    assert sorted(int(each["data-finding"]) for each in page.with_class("go")) == with_places
    # Known findings are listed, but not marked in the pictures.
    known = {str(index) for index, item in enumerate(scene["findings"]) if item["known"]}
    assert known and not known & {each["data-finding"] for each in page.with_class("ring")}
    buttons = [each["data-tissue"] for each in page.with_class("name") if each.get("data-tissue")]
    assert buttons == ["0", "1", "2", "3", "4"]
    # The file of the nerve counts its faces from 2: its face 17 is face 15 of the mesh.
    nerve = next(item for item in scene["findings"] if item["rule"] == "T001")["places"][0]
    mesh = surfaces(example()["tissues"][1]).mesh
    corners = np.reshape(nerve["corners"], (3, 3)) + nerve["at"]
    assert np.allclose(corners, mesh.vertices[mesh.faces[15]], atol=1e-3)


def test_the_same_report_gives_the_same_page_whatever_the_order_of_keys():
    def reverse(value):
        if isinstance(value, dict):
            return {key: reverse(value[key]) for key in reversed(value)}
        return [reverse(item) for item in value] if isinstance(value, list) else value

    text = html_page(healed(), surfaces)
    assert html_page(reverse(healed()), surfaces) == text
    assert render(copy.deepcopy(healed()), PAGE, surfaces=surfaces) == text


def test_two_runs_differ_in_the_block_of_the_run_alone():
    other = example()
    other["run"] = {"started": "2030-01-01T00:00:00+00:00", "seconds": {"read": 9.0}}
    first, second = html_page(example(), surfaces), html_page(other, surfaces)
    assert first != second
    cut = '<section id="about">'
    assert first.split(cut)[0] == second.split(cut)[0]
    assert first.split(cut)[1].split("</section>")[1] == second.split(cut)[1].split("</section>")[1]


def test_a_stage_shows_before_and_after():
    report = healed()
    record = report["tissues"][1]
    record["before"]["quality"] = {**record["quality"], "histogram": [520] + [0] * 19, "min": 0.0}
    record["history"] = [
        {"iteration": n, "step": "relax", "min_q": 0.1 * n, "mean_q": 0.5 + 0.1 * n, "volume_mm3": 1.0,
         "max_turn_deg": None, "flips": 0, "moves": 3, "held": 0} for n in range(4)
    ]  # fmt: skip
    text = html_page(report, surfaces)
    page = Page(text)
    said = "".join(text for _, text in page.texts)
    assert "closed 2 holes" in said and "holds 0.01 mm of [sheet]; thicken it" in said and "0.0213" in said
    assert "New defects" in said and "0 before, 3 after" in said
    assert len(page.with_class("was")) == sum(bool(each["quality"]) for each in report["tissues"])
    # The plot of the history, for the tissue and for the model: two lines of four points.
    lines = [each["points"].split() for each in page.with_class("line")]
    assert [len(line) for line in lines] == [4, 4, 4, 4]
    for line in lines:
        heights = [float(point.split(",")[1]) for point in line]
        assert heights == sorted(heights, reverse=True) and heights[0] > heights[-1]
    assert "0.5" in said and "relax: mean q 0.800" in said
    assert "greatest change of volume" in said and "-0.025 %" in said
    assert "Before and after" not in html_page(example())


def test_pairs_are_sorted_and_only_near_ones_are_in_the_matrix():
    report = many(300)
    report["pairs"].append(pair("Tissue 010", "Tissue 200", "crossing", 0.0, crossing_faces=5, overlap_mm3=2.5))
    report["pairs"].append(pair("Tissue 001", "Tissue 299", "a_inside_b", None, inside="a"))
    report["pairs"].append(pair("Tissue 002", "Tissue 100", "touching", 0.0))
    page = Page(html_page(report))
    cells = page.with_class("cell")
    assert len(cells) == 301
    kinds = [each["class"] for each in cells]
    assert kinds.count("cell error") == 1 and kinds.count("cell warning") == 1
    names = [each["data-pair"] for each in page.with_class("name") if "data-pair" in each]
    assert names[0] == "10,200" and names[2] == "2,100" and names[4] == "0,1"
    for each in cells:
        assert float(each["x"]) + float(each["width"]) <= 660 and float(each["y"]) <= 660
        assert float(each["width"]) > 1.5
    said = "".join(text for _, text in page.texts)
    assert "Tissue 010 and Tissue 200: crossing, gap 0 mm, overlap 2.50 mm3" in said
    assert "1 pair, one within the other" in said


def test_a_flood_of_findings_is_cut_and_the_page_says_so():
    places = [{"xyz_mm": [1.0, 2.0, 3.0 + no], "face": no} for no in range(20)]
    findings = [finding("Q001", ["ball"], 1, f"bad {no}", places=places) for no in range(5000)]
    findings += [finding("T001", ["ball"], 1, "6 open edges", places=places)]
    report = build([tissue("ball", "ball.stl", "organ", 80, 0.5, 1.0)], [], findings, {"ball": None})
    text = html_page(report, surfaces)
    scene = scene_of(text)
    assert 2000 <= len(scene["findings"]) <= 4000
    assert {item["rule"] for item in scene["findings"]} == {"Q001", "T001"}
    assert all(item["places"] for item in scene["findings"])
    assert f"{5001 - len(scene['findings']):,} findings more" in text
    assert len(text) < 8_000_000


def test_surfaces_that_are_missing_are_named_with_the_reason():
    def some(record):
        return "its file is another one by now" if record["name"] == "Liver" else surfaces(record)

    text = html_page(example(), some)
    assert "its file is another one by now" in text and "could not be read" in text
    assert [bool(each["faces"]) for each in scene_of(text)["tissues"]] == [False, True, True, True, False]
    nothing = html_page(example())
    assert 'id="viewer"' not in nothing and "the surface was not given" in nothing


def test_a_surface_without_faces_and_one_of_a_single_point():
    def odd(record):
        if record["name"] == "Liver":
            return Shown(Mesh(np.empty((0, 3)), np.empty((0, 3), np.int32)))
        return Shown(Mesh(np.ones((3, 3)), np.array([[0, 1, 2]])))

    Page(html_page(example(), odd))


def test_thinning_is_said(monkeypatch):
    from vhp_cli.report.html import scene

    assert "Shown: all 320 triangles" in html_page(example(), surfaces)
    monkeypatch.setattr(scene, "BUDGET", 200)
    text = html_page(example(), surfaces)
    shown = sum(each["faces"] for each in scene_of(text)["tissues"])
    assert shown < 320 and f"Shown: {shown} of 320 triangles: thinned for viewing" in text


def test_tissues_that_hold_others_let_them_show_through():
    report = example()
    scene = scene_of(html_page(report, surfaces))
    report["tissues"][2]["tissue_type"] = "shell"
    shell = scene_of(html_page(report, surfaces))
    assert [each["opacity"] for each in scene["tissues"]] == [1.0, 1.0, 0.4, 1.0, 1.0]
    assert shell["tissues"][2]["opacity"] < 0.2
    colours = tissue_colours(["organ", "bone"] * 30)
    assert len(set(colours)) > 50 and colours == tissue_colours(["organ", "bone"] * 30)


def test_pictures_carry_the_marks_of_their_findings():
    def boxes(record):
        return Shown(box()) if record["sha256"] else "could not be read"

    report = build(
        [tissue("a", "a.stl", "organ", 12, 0.5, 1.0)],
        [],
        [finding("Q001", ["a"], places=[{"xyz_mm": [10.0 / 3, 0.0, 10.0 / 3], "face": 4, "value": 0.1}])],
        {"a": None},
    )
    page = Page(html_page(report, boxes))
    rings = page.with_class("ring")
    assert len(rings) == 2  # in the picture of the tissue, and in the close-up
    # The close-up has its place in the middle.
    assert (float(rings[1]["cx"]), float(rings[1]["cy"])) == pytest.approx((120, 90))
    assert all("hidden" not in each["class"] for each in rings)
    assert 10 < float(rings[0]["cx"]) < 230 and 10 < float(rings[0]["cy"]) < 170


def test_any_section_that_a_command_adds_is_shown():
    report = example()
    report["harvest"] = {"apples": [1, 2, 3], "<b>": {"deep": None, "good": True}}
    text = html_page(report)
    report["harvest"]["files"] = [{"name": "x", "sha256": "0123456789abcdef" * 4}, {"name": "y", "size": 7}]
    text = html_page(report)
    cells = [data for where, data in Page(text).texts if where == "td"][-6:]
    assert "<th>name</th><th>sha256</th><th>size</th>" in text and "x" in cells and "7" in cells
    assert "Harvest" in text and "1, 2, 3" in text and "&lt;b&gt;" in text and "<b>deep" not in text
    Page(text)


SHAPE = {
    "min_dihedral_deg": 10.0, "min_dihedral_p01_deg": 20.0, "max_dihedral_deg": 150.0, "radius_ratio_min": 0.1,
    "radius_ratio_p01": 0.35, "radius_ratio_p05": 0.4, "radius_ratio_p50": 0.7, "scaled_jacobian_min": 0.01,
    "inverted": 0, "mean_edge_mm": 2.0,
}  # fmt: skip


def test_the_tetrahedra_are_shown():
    label = {"name": "Liver", "tets": 1234, "volume_mm3": 99000.0, "volume_error": -0.0123, "quality": SHAPE}
    none = {"name": "=cut off", "tets": 0, "volume_mm3": 0.0, "volume_error": None, "quality": None}
    report = example()
    report["tetmesh"] = {
        "engine": "fTetWild", "reproducible": False, "per_tissue": False, "tets": 1234, "points": 400,
        "edge_length_mm": 2.0, "epsilon_mm": 0.1, "epsilon_reason": "half the gap", "air": None,
        "labels": [label, none],
        "quality": SHAPE, "conforming": True, "notes": ["a note <1>"],
        "input": {"passed": True, "counts": {}},
    }  # fmt: skip
    text = html_page(report)
    said = "".join(data for _, data in Page(text).texts)
    assert "a note <1>" in said and "conforming" in said and "half the gap" in said
    row = said[said.index("Radius ratio 1 %") :]
    assert "1,234" in row and "99.0" in row and "-1.23" in row and "0.350" in row


def test_a_breath_is_shown():
    frame = {
        "index": 1, "x": 5.5, "time_over_T": 0.25, "passed": False, "reasons": ["crossing"], "lung_volume_l": 4.25,
        "diaphragm_travel_mm": 12.5, "mass_change": 0.00002, "crossings": 3, "min_gap_mm": None,
    }  # fmt: skip
    proof = {
        "pairs": 1200,
        "far_pairs": 800,
        "intervals": 10,
        "least_gap_mm": 0.75,
        "unproven": [],
        "excused": [["a", "b"]],
    }
    report = example()
    report["breathe"] = {"frames": [frame], "proof": proof, "notes": ["ribs <b>"]}
    said = "".join(data for _, data in Page(html_page(report)).texts)
    assert "rejected: crossing" in said and "4.25" in said and "12.5" in said and "0.00200" in said
    assert "1,200, of which 800" in said and "0.750 mm" in said and "ribs <b>" in said and "lung volume in l" in said


def test_the_clearance_of_pairs_is_shown():
    state = {"relation": "crossing", "min_gap_mm": 0.0, "overlap_mm3": 3.0}
    pairs = [
        {"a": "Liver", "b": "Ulna_Radius_left", "gap_mm": 1.0, "before": state,
         "after": {"relation": "disjoint", "min_gap_mm": 1.02, "overlap_mm3": 0.0}, "reached": True, "reason": ""},
        {"a": "Liver", "b": "x<y", "gap_mm": 1.0, "before": state, "after": state, "reached": False,
         "reason": "no room"},
    ]  # fmt: skip
    report = example()
    report["clearance"] = {
        "pairs": pairs, "tissues": [], "close_before": 2, "close_after": 1, "crossing_before": 2, "crossing_after": 1,
    }  # fmt: skip
    said = "".join(data for _, data in Page(html_page(report)).texts)
    assert "no room" in said and "reached" in said and "1.02" in said and "x<y" in said
    assert said.count("2 before, 1 after") == 2
