"""The page and the curves of a breath."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
from shapes import box, sphere

from vhp_cli.report.animation import Shown, animation_html
from vhp_cli.report.curves import curves_svg

SVG = "{http://www.w3.org/2000/svg}"


def frame(index: int, share: float, volume: float, gap: float | None = 1.2, *, passed=True) -> dict:
    return {
        "index": index, "x": 11 * np.sin(np.pi * share) ** 4, "time_over_T": share, "passed": passed,
        "lung_volume_l": volume, "diaphragm_travel_mm": 20 * np.sin(np.pi * share) ** 4, "mass_change": 1e-9,
        "min_gap_mm": gap,
    }  # fmt: skip


def section(**changes) -> dict:
    frames = [frame(0, 0.0, 4.0), frame(1, 0.25, 4.1, passed=False), frame(2, 0.5, 4.32, None), frame(3, 1.0, 4.0)]
    return {"frames": frames, **changes}


def shown() -> list[Shown]:
    lung, bone = sphere(40.0, (20, 5, -30)), box((-80, -10, 0), (-60, 30, 40))
    moved = np.stack([lung.vertices, lung.vertices * [1, 1, 1.05], lung.vertices * [1, 1, 1.1]])
    return [Shown("lung </script>", "lung", lung.faces, moved), Shown("bone", "bone", bone.faces, bone.vertices[None])]


def test_curves_show_every_frame_and_mark_the_rejected():
    root = ElementTree.fromstring(curves_svg(section()))
    dots = list(root.iter(f"{SVG}circle"))
    # Four panels of four frames; one gap was not measured.
    assert len(dots) == 15
    assert sum(dot.get("fill") == "#c22" for dot in dots) == 4
    assert [text.text for text in root.iter(f"{SVG}text") if text.text and " in " in text.text] == [
        "lung volume in l", "diaphragm travel in mm", "change of mass in %", "smallest gap in mm",
    ]  # fmt: skip
    volume = next(root.iter(f"{SVG}polyline")).get("points").split()
    heights = [float(point.split(",")[1]) for point in volume]
    assert heights[2] < heights[1] < heights[0] == heights[3]  # y points down
    for panel in root.iter(f"{SVG}g"):
        for dot in panel.iter(f"{SVG}circle"):
            assert 0 < float(dot.get("cx")) < 360 and 0 < float(dot.get("cy")) < 190


def test_curves_without_a_gap_and_with_one_frame():
    root = ElementTree.fromstring(curves_svg({"frames": [frame(0, 0.0, 4.0, None)]}))
    assert "none measured" in [text.text for text in root.iter(f"{SVG}text")]


def page() -> str:
    return animation_html("model <1>", shown(), section(), steps=11, period_s=5.0)


def test_the_page_is_whole_and_no_name_breaks_it():
    text = page()
    assert "@" not in re.sub(r"@media", "", text.split("<script>")[0])
    assert "model &lt;1&gt;" in text
    assert text.count("</script>") == 1 and text.rstrip().endswith("</html>")
    assert "http://" not in text.replace("http://www.w3.org/2000/svg", "") and "https://" not in text
    assert page() == text


NODE = shutil.which("node")

# Enough of a browser to run the page: every call of WebGL answers something, and the frame loop runs three times.
BROWSER = """
const gl = new Proxy({}, { get: (_, name) => {
  if (name === "drawElements") return (mode, count) => { drawn.push(count); };
  if (name === "uniformMatrix4fv") return (place, turned, matrix) => { cameras.push(Array.from(matrix)); };
  return typeof name === "string" && name === name.toUpperCase() ? 1 : () => ({});
} });
const drawn = [], cameras = [];
let loops = 0;
const element = () => ({ append() {}, clientWidth: 800, clientHeight: 600, getContext: () => gl });
const elements = {};
globalThis.document = { getElementById: id => (elements[id] ??= element()), createElement: element };
globalThis.devicePixelRatio = 1;
globalThis.requestAnimationFrame = f => { if (loops++ < 3) f(performance.now()); };
"""


@pytest.mark.skipif(NODE is None, reason="needs node to run the page's script")
def test_the_script_runs_and_places_vertices_where_they_are(tmp_path):
    script = page().split("<script>")[1].split("</script>")[0]
    ask = """
const out = MODEL.tissues.map(decode).map(t => [0, 0.5, 1].map(s => [0, 7].map(v => place(t, v, s))));
console.log(JSON.stringify({ out, drawn, cameras, faces: MODEL.tissues.map(decode).map(t => Array.from(t.faces)),
  now: elements.now.textContent, sweep: [0, 0.25, 0.5, 1].map(sweep) }));
"""
    path = tmp_path / "page.js"
    path.write_text(BROWSER + script + ask)
    done = subprocess.run([NODE, path], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    for tissue, places in zip(shown(), said["out"], strict=True):
        for index, state in enumerate((0, len(tissue.states) // 2, len(tissue.states) - 1)):
            assert np.allclose(places[index], tissue.states[state][[0, 7]], atol=3e-3)
    assert said["faces"] == [tissue.faces.reshape(-1).tolist() for tissue in shown()]
    assert said["drawn"][:2] == [3 * len(tissue.faces) for tissue in shown()] and len(said["drawn"]) == 6
    assert said["sweep"] == pytest.approx([0, 0.25, 1, 0], abs=1e-12)
    assert said["now"].startswith("t = 0.0")
    # The camera keeps every vertex on the screen and between near and far.
    matrix = np.array(said["cameras"][0]).reshape(4, 4).T
    points = np.concatenate([tissue.states.reshape(-1, 3) for tissue in shown()])
    seen = points @ matrix[:3, :3].T + matrix[:3, 3]
    assert np.abs(seen).max() < 1.0
    assert np.abs(seen).max() > 0.3
    # z is up on the screen.
    assert matrix[1, 2] > 0.0
