"""Pictures without a screen: the rasteriser against a reference that tries every pixel, and files read back."""

from __future__ import annotations

import io

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapes import box, joined, sphere

from vhp_cli.mesh import Mesh
from vhp_cli.report.pictures.png import png_bytes
from vhp_cli.report.pictures.portraits import model_picture, portrait
from vhp_cli.report.pictures.raster import rasterise
from vhp_cli.report.pictures.views import BACK, FRONT, LEFT, OBLIQUE, TOP, Frame, best_oblique, frame_all

WIDTH, HEIGHT = 24, 18


def reference(points, faces, width, height):
    """Try every pixel with every face: signed areas, and the depth that they weigh."""
    face, depth = np.full((height, width), -1), np.full((height, width), np.inf)
    for number, corners in enumerate(points[faces]):
        (ax, ay, az), (bx, by, bz), (cx, cy, cz) = corners
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0:
            continue
        for row in range(height):
            for column in range(width):
                x, y = column + 0.5, row + 0.5
                u = ((bx - x) * (cy - y) - (by - y) * (cx - x)) / area
                v = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / area
                w = 1 - u - v
                if min(u, v, w) >= 0 and u * az + v * bz + w * cz < depth[row, column]:
                    face[row, column], depth[row, column] = number, u * az + v * bz + w * cz
    return face, depth


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6))
def test_each_pixel_shows_the_nearest_face(seed):
    random = np.random.default_rng(seed)
    points = random.uniform((-8, -8, 0), (WIDTH + 8, HEIGHT + 8, 10), (15, 3))
    faces = random.integers(0, 15, (12, 3)).astype(np.int32)
    seen = rasterise(points, faces, WIDTH, HEIGHT)
    face, depth = reference(points, faces, WIDTH, HEIGHT)
    assert np.array_equal(seen.face >= 0, face >= 0)
    drawn = face >= 0
    assert np.allclose(seen.depth[drawn], depth[drawn], atol=1e-6)
    # Where two are equally deep but for rounding, either may be named.
    for number in np.unique(seen.face[seen.face != face]):
        _, alone = reference(points, faces[number, None], WIDTH, HEIGHT)
        here = (seen.face == number) & drawn
        assert np.allclose(alone[here], depth[here], atol=1e-6)


def test_a_surface_has_no_gaps_and_small_triangles_are_seen():
    mesh = sphere(100.0, subdivisions=5)
    frame = Frame(FRONT, np.zeros(3), 0.4, 100, 100)
    seen = rasterise(frame.project(mesh.vertices), mesh.faces, 100, 100)
    x, y = np.meshgrid(np.arange(100) + 0.5 - 50, np.arange(100) + 0.5 - 50)
    radius = np.hypot(x, y)
    assert (seen.face[radius < 39.5] >= 0).all()
    assert (seen.face[radius > 40.0] < 0).all()
    inside = radius < 35
    assert np.allclose(seen.depth[inside], -np.sqrt(1600 - radius[inside] ** 2), atol=0.1)


def test_a_heap_of_large_faces_is_drawn_with_fewer_pixels():
    corners = np.array([[-1e4, -1e4, 5], [1e4, -1e4, 5], [0, 2e4, 5]], float)
    points = np.concatenate([corners + np.array([0, 0, z]) for z in range(400)])
    faces = np.arange(1200, dtype=np.int32).reshape(-1, 3)
    seen = rasterise(points, faces, 640, 480)
    assert seen.face.shape == (480, 640)
    assert (seen.face == 0).all()


def test_degenerate_faces_and_nothing_at_all():
    flat = np.array([[1, 1, 0], [9, 9, 0], [5, 5, 0]], float)
    assert (rasterise(flat, np.array([[0, 1, 2], [0, 0, 1]], np.int32), 10, 10).face == -1).all()
    assert (rasterise(np.empty((0, 3)), np.empty((0, 3), np.int32), 4, 3).face == -1).all()


def test_views_are_those_of_a_person_who_stands():
    right, down, away = FRONT.axes
    # From the front the person's left is on the right side of the picture, and the head above.
    assert np.allclose(right, (1, 0, 0)) and np.allclose(down, (0, 0, -1)) and np.allclose(away, (0, 1, 0))
    assert np.allclose(BACK.axes[0], (-1, 0, 0)) and np.allclose(LEFT.axes[0], (0, 1, 0))
    for view in (FRONT, BACK, LEFT, TOP, *OBLIQUE):
        assert np.allclose(view.axes @ view.axes.T, np.eye(3))
        assert np.linalg.det(view.axes) == pytest.approx(1)
    assert best_oblique((0.6, 0.8, 0)).name == "back left"
    assert best_oblique(None) is OBLIQUE[0]


def test_a_frame_holds_everything_with_its_margin():
    points = np.random.default_rng(1).uniform(-5, 30, (50, 3))
    seen = frame_all(OBLIQUE[1], points, 200, 100, margin=0.1).project(points)
    assert seen[:, 0].min() >= 20 - 1e-9 and seen[:, 0].max() <= 180 + 1e-9
    assert seen[:, 1].min() >= 10 - 1e-9 and seen[:, 1].max() <= 90 + 1e-9
    assert np.ptp(seen[:, 1]) == pytest.approx(80) or np.ptp(seen[:, 0]) == pytest.approx(160)


def opened(png: bytes) -> np.ndarray:
    image = pytest.importorskip("PIL.Image")
    return np.asarray(image.open(io.BytesIO(png)).convert("RGBA"))


def test_png_files_are_read_by_another_reader():
    random = np.random.default_rng(2)
    pixels = random.integers(0, 256, (7, 5, 4), dtype=np.uint8)
    assert np.array_equal(opened(png_bytes(pixels)), pixels)
    palette = random.integers(0, 256, (200, 4), dtype=np.uint8)
    numbers = random.integers(0, 200, (6, 9), dtype=np.uint8)
    assert np.array_equal(opened(png_bytes(numbers, palette)), palette[numbers])
    with pytest.raises(ValueError, match="shape"):
        png_bytes(numbers)
    with pytest.raises(ValueError, match="colours"):
        png_bytes(numbers, np.zeros((300, 4), np.uint8))


def test_a_portrait_shows_the_tissue_in_its_colour_and_marked_faces_in_red():
    mesh = sphere(10.0, subdivisions=3)
    frame = frame_all(FRONT, mesh.vertices, 80, 60)
    towards = mesh.vertices[mesh.faces].mean(axis=1)[:, 1]
    front = np.argsort(towards)[:60]
    plain, marked = portrait(mesh, frame, (0.3, 0.5, 0.9)), portrait(mesh, frame, (0.3, 0.5, 0.9), front)
    pixels = opened(plain.png)
    assert pixels[0, 0, 3] == 0 and pixels[30, 40, 3] == 255
    red, _, blue, _ = pixels[30, 40].astype(int)
    assert blue > red + 50
    red, _, blue, _ = opened(marked.png)[30, 40].astype(int)
    assert red > blue + 50
    # Light comes from the upper left.
    assert pixels[18, 28, :3].sum() > pixels[42, 52, :3].sum()
    assert not plain.is_hidden((0, -10, 0)) and plain.is_hidden((0, 10, 0)) and plain.is_hidden((0, 0, 500))
    assert portrait(mesh, frame, (0.3, 0.5, 0.9)).png == plain.png
    behind = np.argsort(towards)[-60:]
    assert opened(portrait(mesh, frame, (0.3, 0.5, 0.9), behind).png)[30, 40].tolist() == pixels[30, 40].tolist()


def test_edges_are_drawn_where_they_are():
    mesh = Mesh(
        np.array([[-10, 0, -10], [10, 0, -10], [10, 0, 10], [-10, 0, 10]], float), np.array([[0, 1, 2], [0, 2, 3]])
    )
    frame = Frame(FRONT, np.zeros(3), 3.0, 60, 60)
    bright = opened(portrait(mesh, frame, (0.8, 0.8, 0.8)).png).astype(int)[..., 0]
    lined = opened(portrait(mesh, frame, (0.8, 0.8, 0.8), edges=True).png).astype(int)[..., 0]
    dark = lined < bright - 30
    row, column = np.nonzero(dark)
    inner = (np.minimum(row, column) > 3) & (np.maximum(row, column) < 56)
    assert dark.any() and (np.abs(row + column - 59)[inner] <= 2).all()


def test_the_nearer_tissue_hides_the_other_in_the_picture_of_a_model():
    near, far = box((-5, -20, -5), (5, -15, 5)), box((-10, 10, -10), (10, 20, 10))
    pixels = opened(model_picture([near, far], [(0.9, 0.1, 0.1), (0.1, 0.1, 0.9)], FRONT, 60, 60).png).astype(int)
    assert pixels[30, 30, 0] > pixels[30, 30, 2] and pixels[6, 6, 2] > pixels[6, 6, 0]
    again = model_picture([far, near], [(0.1, 0.1, 0.9), (0.9, 0.1, 0.1)], FRONT, 60, 60).png
    assert np.array_equal(opened(again).astype(int), pixels)


def test_a_tissue_of_needles_and_a_single_face_can_be_drawn():
    needles = joined(*(box((0, 0, i), (100, 1e-6, i + 1e-6)) for i in range(3)))
    assert portrait(needles, frame_all(OBLIQUE[0], needles.vertices, 40, 30), (1, 1, 1)).png.startswith(b"\x89PNG")
    point = Mesh(np.ones((3, 3)), np.array([[0, 1, 2]]))
    assert portrait(point, frame_all(OBLIQUE[0], point.vertices, 40, 30), (1, 1, 1)).png.startswith(b"\x89PNG")
