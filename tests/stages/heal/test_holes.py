from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from repair_shapes import area, flaws, tube, volume, without
from shapes import box, joined, sphere

from vhp_cli.mesh import Mesh
from vhp_cli.stages.heal.clean import clean, compact
from vhp_cli.stages.heal.holes import fill_holes, holes
from vhp_cli.stages.heal.manifold import make_manifold
from vhp_cli.stages.heal.separation import separate


def test_a_closed_mesh_comes_back_as_it_is():
    same, actions, caps = fill_holes(box())
    assert same.faces is not None and not holes(box()) and not actions and not caps.any()
    mesh = sphere()
    assert fill_holes(mesh)[0] is mesh


def test_the_ends_of_a_tube_are_described():
    first, second = sorted(holes(tube()), key=lambda hole: hole.centre[0])
    side = 2 * 5 * np.sin(np.pi / 12)
    for hole, x in ((first, 0), (second, 30)):
        assert hole.edges == 12
        assert hole.length_mm == pytest.approx(12 * side, rel=1e-6)
        assert hole.area_mm2 == pytest.approx(6 * 25 * np.sin(np.pi / 6), rel=1e-6)
        assert hole.planarity == pytest.approx(0, abs=1e-7)
        assert hole.centre == pytest.approx([x, 0, 0], abs=1e-6)
    # Caps look out of the tube.
    assert first.normal == pytest.approx([-1, 0, 0]) and second.normal == pytest.approx([1, 0, 0])


def test_the_ends_of_a_tube_are_closed():
    closed, actions, caps = fill_holes(tube())
    assert flaws(closed) == {}
    cross_section = 6 * 25 * np.sin(np.pi / 6)
    assert volume(closed) == pytest.approx(30 * cross_section, rel=1e-6)
    assert caps.sum() == 20 and not caps[: len(tube().faces)].any()
    assert [action["area_mm2"] for action in actions] == [pytest.approx(cross_section, rel=1e-6)] * 2
    assert area(Mesh(closed.vertices, closed.faces[caps])) == pytest.approx(2 * cross_section, rel=1e-6)


def test_only_the_chosen_holes_are_closed():
    mesh = tube()
    chosen = [hole for hole in holes(mesh) if hole.centre[0] > 15]
    closed, actions, _ = fill_holes(mesh, chosen)
    assert len(actions) == 1
    (left,) = holes(closed)
    assert left.centre[0] == pytest.approx(0)


@given(st.sets(st.integers(0, 319), min_size=1, max_size=150))
@settings(max_examples=40, deadline=None)
def test_any_holes_in_a_sphere_are_closed(gone):
    # Whatever is left is manifold apart from vertices where holes or parts touch; faces of their own go.
    mesh, _ = clean(without(sphere(), sorted(gone)))
    closed, _, _ = fill_holes(mesh)
    closed, _ = make_manifold(closed)
    found = flaws(separate(closed)[0])
    assert "open" not in found and "crowded" not in found and "inconsistent" not in found


@pytest.mark.parametrize("gone", [[0], [0, 1], list(range(40)), list(range(0, 320, 5)), list(range(100, 150))])
def test_holes_in_a_sphere_are_closed_without_meeting_it(gone):
    mesh = compact(without(sphere(), gone))
    closed, actions, _ = fill_holes(mesh)
    assert flaws(closed) == {}
    assert not any("meets" in action["message"] for action in actions)
    assert 0.8 * volume(sphere()) < volume(closed) <= volume(sphere()) + 1e-9


def test_two_holes_that_touch_in_a_vertex_are_two_loops():
    mesh = sphere()
    around = np.flatnonzero((mesh.faces == 0).any(axis=1))
    # Two faces at vertex 0 that share no edge.
    pair = next((f, g) for f in around for g in around if len(set(mesh.faces[f]) & set(mesh.faces[g])) == 1)
    open_mesh = without(mesh, list(pair))
    found = holes(open_mesh)
    assert sorted(hole.edges for hole in found) == [3, 3]
    closed, _, _ = fill_holes(open_mesh)
    assert flaws(closed) == {} and volume(closed) == pytest.approx(volume(mesh))


def test_a_cap_avoids_what_stands_in_the_mouth():
    # A spike from the wall passes through the plane of the opening: the flat cap would cross it.
    cup = without(box((0, 0, 0), (10, 10, 10)), [])
    top = np.flatnonzero((cup.vertices[cup.faces][:, :, 2] == 10).all(axis=1))
    cup = compact(without(cup, top))
    spike = box((4, 4, 2), (4.5, 4.5, 12))
    _, (action,), _ = fill_holes(joined(cup, spike))
    assert "meets" in action["message"]  # no cap without new vertices off the plane can avoid it: it is said
    low = box((4, 4, 2), (4.5, 4.5, 9.9))
    _, (action,), _ = fill_holes(joined(cup, low))
    assert "meets" not in action["message"]


def test_a_chord_that_is_an_edge_already_is_not_used():
    # Four faces round a square hole, two opposite corners of which are joined by a handle of the surface.
    mesh = box()
    top = np.flatnonzero((mesh.vertices[mesh.faces][:, :, 2] == 10).all(axis=1))
    cup = without(mesh, top)
    (hole,) = holes(cup)
    a, c = hole.loop[0], hole.loop[2]
    apex = np.array([[5, 5, 30.0]])
    handle = Mesh(np.vstack([cup.vertices, apex]), np.vstack([cup.faces, [[a, c, 8]]]))
    main = next(h for h in holes(handle) if h.edges == 4)
    closed, _, caps = fill_holes(handle, [main])
    assert not any({a, c} <= set(face) for face in closed.faces[caps].tolist())


def test_a_lone_face_is_not_closed_onto_itself():
    mesh = Mesh(np.eye(3), np.array([[0, 1, 2]]))
    same, (action,), caps = fill_holes(mesh)
    assert same is mesh and action["count"] == 0 and not caps.any()
    assert "can't be closed" in action["message"]


def test_a_loop_of_thousands_of_edges():
    n = 5000
    t = np.arange(n) * 2 * np.pi / n
    rim = np.stack([50 * np.cos(t), 50 * np.sin(t), 2 * np.sin(5 * t)], axis=1)
    cone = Mesh(np.vstack([rim, [[0, 0, -60]]]), np.array([((i + 1) % n, i, n) for i in range(n)]))
    closed, (action,), _ = fill_holes(cone)
    assert flaws(closed) == {}
    assert action["area_mm2"] < 1.1 * np.pi * 2500
