"""The page and the curves of a breath."""

from __future__ import annotations

import io
import json
import re
import shutil
import subprocess
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
from browser import page_of
from shapes import box, sphere

from vhp_cli.report.animation import Shown, animation_html
from vhp_cli.report.animation_gif import HEIGHT, LEVELS, WIDTH, animation_gif, delays
from vhp_cli.report.curves import curves_svg
from vhp_cli.report.gif import gif_bytes

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


@pytest.mark.slow
def test_the_page_plays_in_a_browser(tmp_path):
    path = tmp_path / "animation.html"
    path.write_text(page(), encoding="utf-8")
    with page_of(path) as (tab, said):
        tab.wait_for_function("document.getElementById('now').textContent.startsWith('t = ')")
        tab.click("#play")

        def picture(share: float) -> bytes:
            tab.evaluate(
                "share => { const bar = document.getElementById('time'); bar.value = share; "
                "bar.dispatchEvent(new Event('input', { bubbles: true })); }",
                share,
            )
            tab.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
            return tab.locator("#view").screenshot()

        rest, full, again = picture(0.0), picture(0.5), picture(0.0)
        assert tab.locator("#now").inner_text().startswith("t = 0.00")
        assert tab.locator("#say").inner_text() == ""
        # What is hidden leaves the picture.
        tab.locator("#parts input").first.uncheck()
        fewer = picture(0.0)
        assert said == []
    assert rest == again
    assert rest != full and rest != fewer
    image = pytest.importorskip("PIL.Image")
    colours = image.open(io.BytesIO(rest)).convert("RGB").getcolors(1 << 20)
    assert len(colours) > 20 and max(count for count, _ in colours) < 0.95 * sum(count for count, _ in colours)


# ---------------------------------------------------------------- the small picture


def read_gif(data: bytes) -> tuple[np.ndarray, list[int], list[np.ndarray]]:
    """Return palette, times and pictures of a GIF, by the letter of its specification."""
    assert data[:6] == b"GIF89a" and data[10] & 0x80
    width, height = (int.from_bytes(data[i : i + 2], "little") for i in (6, 8))
    n = 3 << ((data[10] & 7) + 1)
    palette, place = np.frombuffer(data[13 : 13 + n], np.uint8).reshape(-1, 3), 13 + n
    times, pictures = [], []
    while data[place] != 0x3B:
        if data[place] == 0x21:
            if data[place + 1] == 0xF9:
                times.append(int.from_bytes(data[place + 4 : place + 6], "little"))
            place += 2
            while data[place]:
                place += 1 + data[place]
            place += 1
            continue
        assert data[place] == 0x2C and data[place + 9] == 0
        bits, place, stream = data[place + 10], place + 11, b""
        while data[place]:
            stream += data[place + 1 : place + 1 + data[place]]
            place += 1 + data[place]
        place += 1
        pictures.append(np.frombuffer(unpacked(stream, bits), np.uint8).reshape(height, width))
    return palette, times, pictures


def unpacked(stream: bytes, bits: int) -> bytes:
    clear, size, place, out = 1 << bits, bits + 1, 0, bytearray()
    table, before = [], b""
    held = int.from_bytes(stream, "little")
    while True:
        code = held >> place & ((1 << size) - 1)
        place += size
        if code == clear:
            table = [bytes([i]) for i in range(clear)] + [b"", b""]
            size, before = bits + 1, b""
            continue
        if code == clear + 1:
            assert place <= 8 * len(stream) < place + 8
            return bytes(out)
        entry = table[code] if code < len(table) else before + before[:1]
        if before and len(table) < 4096:
            table.append(before + entry[:1])
        if len(table) == 1 << size and size < 12:
            size += 1
        out += entry
        before = entry


@pytest.mark.parametrize("colours", [1, 2, 5, 16, 200, 256])
@pytest.mark.parametrize("noise", [False, True])
def test_a_gif_holds_what_it_was_given(colours, noise):
    random = np.random.default_rng(colours)
    palette = random.integers(0, 256, (colours, 3)).astype(np.uint8)
    shape = (61, 43)
    flat = np.arange(shape[0] * shape[1]).reshape(shape) // 97 % colours
    first = (random.integers(0, colours, shape) if noise else flat).astype(np.uint8)
    second = np.zeros(shape, np.uint8)
    data = gif_bytes([(first, 7), (second, 300), (first, 2)], palette)
    table, times, pictures = read_gif(data)
    assert np.array_equal(table[:colours], palette) and times == [7, 300, 2]
    assert [np.array_equal(a, b) for a, b in zip(pictures, (first, second, first), strict=True)] == [True] * 3


def test_a_gif_long_enough_to_fill_its_table():
    pixels = np.random.default_rng(0).integers(0, 256, (200, 150)).astype(np.uint8)
    palette = np.repeat(np.arange(256, dtype=np.uint8)[:, None], 3, axis=1)
    assert np.array_equal(read_gif(gif_bytes([(pixels, 5)], palette))[2][0], pixels)


def test_what_is_no_gif_is_refused():
    black = np.zeros((1, 3), np.uint8)
    for pictures in (
        [],
        [(np.ones((2, 2), np.uint8), 1)],
        [(np.zeros((2, 2), np.uint8), 1), (np.zeros((2, 3), np.uint8), 1)],
    ):
        with pytest.raises(ValueError):
            gif_bytes(pictures, black)


def test_the_small_picture_shows_what_is_solid_as_long_as_the_breath_lasts():
    skin = sphere(120.0)
    tissues = [*shown(), Shown("skin", "skin", skin.faces, skin.vertices[None])]
    data = animation_gif(tissues, period_s=5.0)
    assert data == animation_gif(tissues, period_s=5.0)
    # The skin, which would hide all else, is left out: but for it, there is nothing else to be seen.
    assert data == animation_gif(shown(), period_s=5.0)
    palette, times, pictures = read_gif(data)
    assert len(pictures) == len(times) == 2 * LEVELS - 2
    assert pictures[0].shape == (HEIGHT, WIDTH)
    assert sum(times) == pytest.approx(500, abs=len(times))
    assert all(np.array_equal(pictures[LEVELS - 1 - i], pictures[LEVELS - 1 + i]) for i in range(1, LEVELS - 1))
    # The lung (pink) grows downwards; the bone stays.
    colours = [palette[pictures[i]].astype(int) for i in (0, LEVELS - 1)]
    pink = [colour[..., 0] > colour[..., 1] + 50 for colour in colours]
    assert np.flatnonzero(pink[1].any(axis=1)).max() > np.flatnonzero(pink[0].any(axis=1)).max()
    assert pink[1].sum() > pink[0].sum() > 1000


def test_pictures_stay_as_long_as_the_breath_does():
    for period in (1.0, 5.0, 20.0):
        stays = np.array(delays(period))
        assert stays.sum() == pytest.approx(100 * period, abs=len(stays)) and stays.min() >= 2
        # A breath lingers at exhalation: x is below N/2 for 64 % of the time.
        levels = np.array([*range(LEVELS), *range(LEVELS - 2, 0, -1)]) / (LEVELS - 1)
        assert stays[levels < 0.5].sum() / stays.sum() == pytest.approx(0.64, abs=0.04)
