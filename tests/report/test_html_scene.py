"""What the viewer of the page gets: surfaces thin enough, packed, and the places of findings."""

from __future__ import annotations

import base64
import zlib

import numpy as np
import pytest
from example_report import build, finding, tissue
from hypothesis import given, settings
from hypothesis import strategies as st
from shapes import box, joined, sphere

from vhp_cli.kernels import surface
from vhp_cli.mesh import Mesh
from vhp_cli.report.html import Shown
from vhp_cli.report.html.packing import pack
from vhp_cli.report.html.scene import build_scene
from vhp_cli.report.html.thinning import Thinned, qualities, shares, thin
from vhp_cli.report.verdict import tissue_verdicts

NONE = np.empty(0, np.int64)


def unpacked(packed):
    """Decode as the documentation of the packing says: vertices (V, 3), faces (F, 3) and qualities of each tissue."""
    raw = np.frombuffer(zlib.decompress(base64.b64decode(packed.text)), np.uint8)
    n_vertices = sum(each["vertices"] for each in packed.tissues)
    n_faces = sum(each["faces"] for each in packed.tissues)
    places, rest = raw[: 6 * n_vertices].reshape(6, -1).astype(int), raw[6 * n_vertices :]
    corners, q = rest[: 9 * n_faces].reshape(3, -1).astype(int), rest[9 * n_faces :]
    assert len(q) == n_faces
    made, v, f = [], 0, 0
    for each in packed.tissues:
        code = places[:3, v : v + each["vertices"]] + 256 * places[3:, v : v + each["vertices"]]
        change = np.where(code % 2, -(code + 1) // 2, code // 2)
        levels = np.cumsum(change, axis=1) % 65536
        faces, free = [], 0
        for low, middle, high in corners[:, 3 * f : 3 * (f + each["faces"])].T:
            back = int(low + 256 * middle + 65536 * high)
            faces.append(free - back)
            free += back == 0
        made.append(
            (
                np.array(each["low"]) + each["step"] * levels.T,
                np.array(faces, int).reshape(-1, 3),
                (q[f : f + each["faces"]] / 255.0) ** 2,
            )
        )
        v, f = v + each["vertices"], f + each["faces"]
    return made


def whole(mesh: Mesh) -> Thinned:
    return thin(mesh, len(mesh.faces), NONE)


def canonical(vertices, faces):
    """Triangles as sorted rows of coordinates, each beginning at its least corner, orientation kept."""
    corners = vertices[faces].round(3) + 0.0
    turned = []
    for triangle in corners.tolist():
        first = min(range(3), key=lambda index: triangle[index])
        turned.append(triangle[first:] + triangle[:first])
    return np.array(sorted(turned))


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 3))
def test_what_is_packed_comes_out_again(seed, tissues):
    random = np.random.default_rng(seed)
    surfaces = []
    for _ in range(tissues):
        n = int(random.integers(3, 40))
        vertices = random.integers(-1000, 1000, (n, 3)).astype(float)
        faces = random.integers(0, n, (int(random.integers(0, 60)), 3)).astype(np.int32)
        surfaces.append(whole(Mesh(vertices, faces)))
    for (vertices, faces, q), given_ in zip(unpacked(pack(surfaces)), surfaces, strict=True):
        assert len(faces) == len(given_.faces)
        if len(faces):
            span = float(np.ptp(given_.vertices[given_.faces].reshape(-1, 3), axis=0).max())
            assert np.allclose(
                canonical(vertices, faces), canonical(given_.vertices, given_.faces), atol=span / 65535 + 2e-3
            )
            assert np.allclose(np.sort(q), np.sort(given_.q), atol=1 / 128)


def test_the_same_surface_packs_to_the_same_text_whatever_comes_with_it():
    ball = whole(sphere(10.0))
    assert pack([ball]).text == pack([ball]).text
    assert pack([]).tissues == []
    alone, beside = pack([ball]).tissues[0], pack([whole(box()), ball]).tissues[1]
    assert alone == beside


def test_surfaces_of_a_body_take_few_bytes():
    ball = whole(sphere(100.0, subdivisions=5))
    # 6 bytes for a vertex and 12 for a triangle, as in a file of plain indices, would be 15 for a triangle.
    assert len(pack([ball]).text) < 7 * len(ball.faces)


@given(st.lists(st.integers(0, 50_000), min_size=1, max_size=30), st.integers(1, 400_000))
def test_shares_keep_to_the_budget_and_never_exceed_what_there_is(counts, budget):
    given_ = shares(counts, budget)
    assert all(0 <= share <= count for share, count in zip(given_, counts, strict=True))
    if sum(counts) <= budget:
        assert given_ == counts
    else:
        assert budget - len(counts) <= sum(given_) <= budget
        floor = min(2000, budget // len(counts))
        assert all(share >= min(count, floor) for share, count in zip(given_, counts, strict=True))


def test_qualities_are_those_that_are_reported():
    random = np.random.default_rng(3)
    vertices = random.normal(size=(60, 3))
    faces = np.array([random.choice(60, 3, replace=False) for _ in range(200)], np.int32)
    expected = surface.quality(vertices, faces, np.zeros(200, np.int32), 1).q
    assert np.allclose(qualities(vertices, faces), expected, atol=1e-12)
    assert qualities(np.zeros((3, 3)), np.array([[0, 1, 2]], np.int32)).tolist() == [0.0]


@pytest.mark.parametrize("target", [300, 2000, 6000])
def test_thinning_reaches_its_target_and_stays_near_the_surface(target):
    mesh = sphere(50.0, subdivisions=5)  # 20,480 triangles
    thinned = thin(mesh, target, NONE)
    assert not thinned.is_whole
    assert 0.4 * target <= len(thinned.faces) <= 1.1 * target
    # An edge of the cells is about that of the triangles; a middle lies within one.
    edge = np.sqrt(4 * np.pi * 50.0**2 / (target / 2))
    radius = np.linalg.norm(thinned.vertices[np.unique(thinned.faces)], axis=1)
    assert radius.max() <= 50.0 + 1e-5 and radius.min() > 50.0 - edge
    # The surface is closed still: each edge has a fellow the other way round.
    edges = {(a, b) for face in thinned.faces.tolist() for a, b in zip(face, face[1:] + face[:1], strict=True)}
    assert np.mean([(b, a) in edges for a, b in edges]) > 0.95
    assert (thinned.q >= 0).all() and (thinned.q <= 1).all()


def test_what_is_kept_stays_as_it_is():
    mesh = sphere(50.0, subdivisions=5)
    kept = np.array([7, 9000])
    thinned = thin(mesh, 1000, kept)
    present = {tuple(map(tuple, triangle)) for triangle in canonical(thinned.vertices, thinned.faces).tolist()}
    touched = np.isin(mesh.faces, mesh.faces[kept]).any(axis=1)
    around = canonical(mesh.vertices, mesh.faces[touched]).tolist()
    assert len(around) > 20
    assert all(tuple(map(tuple, triangle)) in present for triangle in around)


def test_the_two_sides_of_a_thin_wall_stay_apart():
    flat = joined(sphere(50.0, subdivisions=5))
    wall = Mesh(flat.vertices * [1, 1, 0.002], flat.faces)
    thinned = thin(wall, 2000, NONE)
    corners = thinned.vertices[thinned.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2]
    up, down = 0.5 * normals[normals > 0].sum(), -0.5 * normals[normals < 0].sum()
    assert up == pytest.approx(np.pi * 2500, rel=0.05) and down == pytest.approx(np.pi * 2500, rel=0.05)


def test_the_worst_triangle_is_seen_in_what_took_its_place():
    mesh = sphere(50.0, subdivisions=5)
    vertices = mesh.vertices.copy()
    a, b, c = mesh.faces[5000]
    vertices[a] = 0.5 * (vertices[b] + vertices[c]) + 1e-5 * (vertices[a] - vertices[b])
    thinned = thin(Mesh(vertices, mesh.faces), 1000, NONE)
    assert thinned.q.min() < 0.01
    assert (thinned.q < 0.01).sum() < 60


@pytest.mark.parametrize(
    "mesh",
    [
        Mesh(np.zeros((4, 3)), np.tile([[0, 1, 2], [1, 2, 3]], (3000, 1))),
        Mesh(np.random.default_rng(4).uniform(0, 1e30, (9000, 3)), np.arange(9000).reshape(-1, 3)),
        Mesh(np.column_stack((np.arange(9000.0), np.zeros((9000, 2)))), np.arange(9000).reshape(-1, 3)),
    ],
    ids=["points", "huge", "line"],
)
def test_surfaces_of_no_shape_do_no_harm(mesh):
    thinned = thin(mesh, 2000, np.array([0, 5]))
    assert np.isfinite(thinned.vertices).all() and len(thinned.faces) <= len(mesh.faces)
    ((vertices, _, _),) = unpacked(pack([thinned]))
    assert np.isfinite(vertices).all()


def test_a_place_has_its_face_and_a_fitting_view():
    mesh = sphere(10.0, (100, -50, 20), subdivisions=3)
    centre = mesh.vertices[mesh.faces[17]].mean(axis=0)
    place = {"xyz_mm": centre.tolist(), "face": 1017, "value": 0.1}
    lost = {"xyz_mm": [1.0, 2.0, 3.0], "face": None}
    numbers = np.arange(1000, 1000 + len(mesh.faces))
    findings = [finding("Q001", ["ball"], places=[place, lost]), finding("T001", ["gone"], places=[lost])]
    report = build(
        [tissue("ball", "ball.stl", "organ", 1280, 0.5, 1.0), tissue("gone", "g.stl", "bone", 4, 0.5, 1.0)],
        [],
        findings,
        {},
    )
    scene = build_scene(report, findings, tissue_verdicts(report), {"ball": Shown(mesh, numbers)})
    first, second = scene.data["findings"]
    assert (first["rule"], first["tissues"], second["tissues"]) == ("Q001", [0], [1])
    here = first["places"][0]
    assert here["at"] == centre.tolist() and here["face"] == 1017 and here["tissue"] == 0
    assert np.allclose(np.reshape(here["corners"], (3, 3)) + centre, mesh.vertices[mesh.faces[17]], atol=1e-6)
    corners = mesh.vertices[mesh.faces[17]]
    edge = np.linalg.norm(corners - corners[[1, 2, 0]], axis=1).mean()
    assert 4 * edge < here["reach"] < 12 * edge
    assert "corners" not in first["places"][1] and "corners" not in second["places"][0]
    assert scene.triangles == scene.of_triangles == 1280
    assert [each["faces"] for each in scene.data["tissues"]] == [1280, 0]


def test_numbers_of_faces_are_those_of_the_file():
    shown = Shown(box(), np.arange(12) * 2 + 1)
    assert [shown.face(number) for number in (1, 7, 23, 0, 25, None, -1)] == [0, 3, 11, None, None, None, None]
    plain = Shown(box())
    assert [plain.face(number) for number in (0, 11, 12, None, -1)] == [0, 11, None, None, None]
