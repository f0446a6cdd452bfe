from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from repair_shapes import flaws, tube, volume, without
from shapes import box, flipped, joined, sphere

from vhp_cli.mesh import Mesh
from vhp_cli.stages.heal.orientation import orient


def mixed(mesh: Mesh, turned) -> Mesh:
    return Mesh(mesh.vertices, np.where(np.asarray(turned)[:, None], mesh.faces[:, ::-1], mesh.faces))


@given(st.lists(st.booleans(), min_size=80, max_size=80))
@settings(max_examples=40, deadline=None)
def test_a_sphere_with_faces_either_way_ends_outward(turned):
    mesh = sphere(subdivisions=1)
    oriented, actions = orient(mixed(mesh, turned))
    assert volume(oriented) == pytest.approx(volume(mesh))
    assert flaws(oriented) == {}
    assert sum(action["count"] for action in actions) == sum(turned)


def test_an_outward_mesh_comes_back_as_it_is():
    for mesh in (box(), joined(sphere(), flipped(sphere(5)), sphere(2))):
        same, actions = orient(mesh)
        assert same is mesh and actions == []


def test_nested_shells_alternate():
    shells = [sphere(10), sphere(8), sphere(6), sphere(4)]
    for turned in range(16):
        given_ = joined(*(flipped(s) if turned >> i & 1 else s for i, s in enumerate(shells)))
        oriented, _ = orient(given_)
        expected = sum((-1) ** i * volume(s) for i, s in enumerate(shells))
        assert volume(oriented) == pytest.approx(expected)


def test_parts_that_cross_both_face_outward():
    parts = sphere(10), sphere(6, (9.1, 0.3, 0.2))
    oriented, _ = orient(joined(flipped(parts[0]), flipped(parts[1])))
    assert volume(oriented) == pytest.approx(sum(map(volume, parts)))


def test_an_open_patch_faces_outward_as_if_it_were_closed():
    for mesh in (tube(), without(sphere(), range(100))):
        for shift in (0, 1000):
            away = Mesh(mesh.vertices + shift, mesh.faces)
            oriented, _ = orient(flipped(away))
            assert (np.sort(oriented.faces) == np.sort(away.faces)).all()
            assert (orient(away)[0]) is away
            # Each face turns the way it did.
            assert all(
                sorted(np.roll(face, k).tolist() for k in range(3))
                == sorted(np.roll(was, k).tolist() for k in range(3))
                for face, was in zip(oriented.faces, away.faces, strict=True)
            )


def test_a_flat_sheet_follows_the_majority():
    sheet = Mesh(np.array([[x, y, 0.0] for x in range(4) for y in range(4)]), np.array(
        [f for x in range(3) for y in range(3) for a in [4 * x + y] for f in ((a, a + 4, a + 5), (a, a + 5, a + 1))]
    ))  # fmt: skip
    turned = np.zeros(18, bool)
    turned[[0, 5, 6]] = True
    oriented, (action,) = orient(mixed(sheet, turned))
    assert (oriented.faces == sheet.faces).all() and action["count"] == 3


def test_a_moebius_strip_is_named_and_left_alone():
    n = 20
    t = np.arange(n) * 2 * np.pi / n
    rails = [
        np.stack([(10 + w * np.cos(t / 2)) * np.cos(t), (10 + w * np.cos(t / 2)) * np.sin(t), w * np.sin(t / 2)], 1)
        for w in (-2, 2)
    ]
    faces = []
    for i in range(n):
        a, b, c, d = i, n + i, (i + 1) % n, n + (i + 1) % n
        if i == n - 1:
            c, d = d, c
        faces += [(a, c, b), (b, c, d)]
    strip = Mesh(np.concatenate(rails), np.array(faces))
    same, (action,) = orient(strip)
    assert same is strip
    assert "one-sided" in action["message"]
