from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from repair_shapes import area, flaws, soup, volume, without
from shapes import box, flipped, joined, moved, sphere

from vhp_cli.mesh import Mesh
from vhp_cli.stages.heal import clean


def with_faces(mesh, *faces):
    return Mesh(mesh.vertices, np.concatenate([mesh.faces, np.array(faces)]))


@pytest.mark.parametrize("mesh", [box(), sphere(), joined(box(), sphere(centre=(50, 0, 0)))])
def test_a_sound_mesh_comes_back_as_it_is(mesh):
    same, actions = clean.clean(mesh)
    assert same is mesh and actions == []


def test_collapsed_faces_and_unused_vertices_go():
    mesh = sphere()
    spoilt = Mesh(np.vstack([mesh.vertices, [[500, 0, 0]]]), np.vstack([mesh.faces, [[1, 1, 2], [3, 3, 3]]]))
    cleaned, actions = clean.clean(spoilt)
    assert (cleaned.faces == mesh.faces).all() and (cleaned.vertices == mesh.vertices).all()
    assert [action["count"] for action in actions] == [2, 1]


@given(st.lists(st.integers(0, 79), min_size=1, max_size=30), st.integers(0, 2))
@settings(max_examples=30, deadline=None)
def test_double_faces_go_and_the_sphere_stays(again, shift):
    mesh = sphere(subdivisions=1)
    doubled = with_faces(mesh, *np.roll(mesh.faces[again], shift, axis=1))
    cleaned, (action,) = clean.remove_duplicates(doubled)
    assert flaws(cleaned) == {}
    assert volume(cleaned) == pytest.approx(volume(mesh))
    assert action["count"] == len(again)
    assert action["area_mm2"] == pytest.approx(area(doubled) - area(mesh))


def test_the_wall_between_two_welded_boxes_goes_on_both_sides():
    second = moved(box(), (10, 0, 0))
    # Vertices 0, 2, 4, 6 of the second box are 1, 3, 5, 7 of the first.
    number = np.array([1, 8, 3, 9, 5, 10, 7, 11])
    pair = Mesh(
        np.vstack([box().vertices, second.vertices[[1, 3, 5, 7]]]), np.vstack([box().faces, number[second.faces]])
    )
    # The shared square must be cut along the same diagonal on both sides.
    wall = np.isin(pair.faces, [1, 3, 5, 7]).all(axis=1)
    faces = np.vstack([pair.faces[~wall], [[1, 3, 7], [1, 7, 5], [1, 7, 3], [1, 5, 7]]])
    cleaned, (action,) = clean.remove_duplicates(Mesh(pair.vertices, faces))
    assert flaws(cleaned) == {}
    assert volume(cleaned) == pytest.approx(2000)
    assert action["area_mm2"] == pytest.approx(200)


def test_a_sphere_meshed_on_both_sides_keeps_one():
    mesh = sphere()
    both = Mesh(mesh.vertices, np.concatenate([mesh.faces, mesh.faces[:, ::-1]]))
    cleaned, _ = clean.clean(both)
    assert flaws(cleaned) == {}
    assert abs(volume(cleaned)) == pytest.approx(volume(mesh))


def test_a_sheet_meshed_on_both_sides_keeps_one():
    sheet = Mesh(box().vertices, box().faces[:2])
    both = Mesh(sheet.vertices, np.concatenate([sheet.faces, sheet.faces[:, ::-1]]))
    cleaned, _ = clean.remove_duplicates(both)
    assert area(cleaned) == pytest.approx(area(sheet))


def test_a_flat_face_is_flipped_away():
    # Vertex 8 in the middle of edge 0-3 of the box: on one side of the edge only, the gap filled by a flat face.
    mesh = box()
    face = next(f for f in range(12) if {0, 3} <= set(mesh.faces[f].tolist()))
    turns = [np.roll(mesh.faces[face], -k) for k in range(3)]
    a, b, c = next(corners for corners in turns if {corners[0], corners[1]} == {0, 3})
    vertices = np.vstack([mesh.vertices, [(mesh.vertices[0] + mesh.vertices[3]) / 2]])
    faces = np.vstack([np.delete(mesh.faces, face, axis=0), [[a, 8, c], [8, b, c], [a, b, 8]]])
    flat = Mesh(vertices, faces)
    assert set(flaws(flat)) == {"hits"}  # closed, but the middle of the edge lies on the other side
    cleaned, (action,) = clean.flip_flat(flat)
    assert action["count"] == 1
    assert flaws(cleaned) == {}
    corners = cleaned.vertices[cleaned.faces]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    assert areas.min() > 1 and len(cleaned.faces) == 14
    assert volume(cleaned) == pytest.approx(1000)


def test_a_jittered_soup_is_welded():
    mesh = sphere(subdivisions=3)
    jittered = soup(mesh)
    jitter = np.random.default_rng(1).uniform(-1e-6, 1e-6, jittered.vertices.shape)
    cleaned, actions = clean.clean(Mesh(jittered.vertices + jitter, jittered.faces))
    assert flaws(cleaned) == {}
    assert len(cleaned.vertices) == len(mesh.vertices)
    assert actions[0]["step"] == "weld" and actions[0]["count"] == len(jittered.vertices) - len(mesh.vertices)
    assert volume(cleaned) == pytest.approx(volume(mesh), rel=1e-6)


def test_a_soup_of_faces_that_are_apart_is_not_welded():
    mesh = soup(sphere())
    centres = mesh.vertices[mesh.faces].mean(axis=1)
    shrunk = Mesh((mesh.vertices - np.repeat(centres, 3, axis=0)) * 0.5 + np.repeat(centres, 3, axis=0), mesh.faces)
    same, actions = clean.weld_soup(shrunk)
    assert same is shrunk and not actions


def test_every_speck_is_named():
    mesh = joined(sphere(), sphere(0.01, (20, 0, 0), 0), sphere(0.015, (0, 20, 0), 0), sphere(1, (0, 0, 20), 0))
    cleaned, actions = clean.clean(mesh)
    assert volume(cleaned) == pytest.approx(volume(joined(sphere(), sphere(1, (0, 0, 20), 0))))
    assert [action["places"][0]["xyz_mm"][:2] for action in actions[:2]] == [
        pytest.approx([20, 0], abs=0.02), pytest.approx([0, 20], abs=0.02)
    ]  # fmt: skip
    assert actions[0]["places"][0]["value"] == pytest.approx(0.02 * 3**0.5 * 0.85, rel=0.2)
    bare, _ = clean.remove_specks(mesh, 5.0)
    assert volume(bare) == pytest.approx(volume(sphere()))
    kept, none = clean.remove_specks(mesh, 0.0)
    assert kept is mesh and not none


def test_the_largest_part_stays_whatever_the_limit():
    mesh = joined(sphere(1), sphere(2, (10, 0, 0)))
    cleaned, _ = clean.remove_specks(mesh, 1000.0)
    assert volume(cleaned) == pytest.approx(volume(sphere(2)))


def test_a_face_of_its_own_goes():
    alone = Mesh(np.array([[30, 0, 0], [31, 0, 0], [30, 1, 0.0]]), np.array([[0, 1, 2]]))
    cleaned, actions = clean.clean(joined(sphere(), alone))
    assert flaws(cleaned) == {}
    assert actions[0]["area_mm2"] == pytest.approx(0.5)


def test_cavities_and_open_parts_are_kept():
    mesh = joined(sphere(), flipped(sphere(5)), without(sphere(3, (40, 0, 0)), [0]))
    same, _ = clean.clean(mesh)
    assert same is mesh


def test_plugs_without_thickness_are_removed_and_thin_plates_kept() -> None:
    plug, plate = box((20, 0, 0), (21, 1, 0.001)), box((30, 0, 0), (40, 10, 0.5))
    left, actions = clean.remove_plugs(joined(box(), plug, plate), 0.02)
    assert len(left.faces) == 24
    (action,) = actions
    assert action["volume_mm3"] == pytest.approx(-0.001, rel=1e-3)
    assert np.linalg.norm(np.subtract(action["places"][0]["xyz_mm"], [20.5, 0.5, 0.0])) < 1
