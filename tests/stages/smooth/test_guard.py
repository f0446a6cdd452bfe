"""Proposed positions are taken only as far as the surface stays sound."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal
from shapes import box, joined, moved, sphere
from smoothing_shapes import assert_as_sound, defects, q_of, rough_sphere, single, tube, volume

from vhp_cli.inspection.deviation import deviation
from vhp_cli.kernels.spatial import Tree
from vhp_cli.mesh import Mesh
from vhp_cli.stages.smooth.guard import Guard, Limits, volumes_of


def guard_of(mesh, deviation_mm=1.0, quality=0.3, min_edge_mm=0.0, fixed=None):
    return Guard(mesh, Limits(deviation_mm, quality, min_edge_mm), fixed)


def test_what_breaks_no_guard_is_taken_as_it_is():
    mesh = sphere(10, subdivisions=2)
    targets = mesh.vertices * 1.01
    settled = guard_of(mesh).settle(mesh, targets)
    assert settled.moved == len(mesh.vertices) and settled.held == 0
    assert_array_equal(settled.mesh.vertices, single(targets))
    assert_array_equal(settled.mesh.faces, mesh.faces)


def test_nothing_to_do():
    mesh = sphere(10, subdivisions=1)
    settled = guard_of(mesh).settle(mesh, mesh.vertices * (1 + 1e-12))
    assert settled.mesh is mesh and settled.moved == 0


def test_only_the_vertices_around_an_offence_are_held():
    mesh = sphere(10, subdivisions=3)
    targets = mesh.vertices * 1.01
    targets[0] *= -1  # through the whole sphere
    settled = guard_of(mesh).settle(mesh, targets)
    around = np.unique(mesh.faces[(mesh.faces == 0).any(axis=1)])
    far = np.setdiff1d(np.arange(len(mesh.vertices)), around)
    assert_array_equal(settled.mesh.vertices[far], single(targets)[far])
    assert_array_equal(settled.mesh.vertices[0], mesh.vertices[0])
    assert 0 < settled.held <= len(around)
    assert_as_sound(mesh, settled.mesh)


def test_a_contact_is_refused_and_the_rest_moves():
    """Two balls 0.1 mm apart, blown up until they would meet: they stop before, where they face each other only."""
    ball = sphere(10, subdivisions=3)
    mesh = joined(ball, moved(ball, (20.1, 0, 0)))
    mesh = Mesh(single(mesh.vertices), mesh.faces)
    centres = np.repeat([[0, 0, 0], [20.1, 0, 0]], len(ball.vertices), axis=0)
    targets = centres + 1.02 * (mesh.vertices - centres)
    assert Tree(single(targets), mesh.faces).self_hits(0).n_pairs > 0
    settled = guard_of(mesh).settle(mesh, targets)
    assert_as_sound(mesh, settled.mesh)
    assert 0 < settled.held < 0.1 * len(mesh.vertices)
    far = abs(mesh.vertices[:, 0] - 10.05) > 5
    assert_array_equal(settled.mesh.vertices[far], single(targets)[far])


def test_the_deviation_holds_both_ways():
    mesh = tube(sides=12)
    middle = np.array([0.0, 0.0, 0.0])
    for factor in (1.02, 0.9):
        targets = middle + factor * (mesh.vertices - middle)
        settled = guard_of(mesh, deviation_mm=0.05, quality=0.1).settle(mesh, targets)
        found = deviation(mesh, settled.mesh, lost_limit_mm=0.05)
        assert 0 < found["to_output"]["max"] <= 0.05
        assert 0 < found["to_input"]["max"] <= 0.05
        assert settled.held > 0


def test_a_point_of_the_surface_may_not_be_uncovered():
    """A thin spike that slides down keeps its vertices on the surface, but its tip would be lost."""
    mesh = sphere(10, subdivisions=3)
    vertices = np.array(mesh.vertices)
    vertices[0] *= 1.2
    spiked = Mesh(single(vertices), mesh.faces)
    targets = np.array(spiked.vertices)
    targets[0] = spiked.vertices[spiked.faces[(spiked.faces == 0).any(axis=1)]].reshape(-1, 3).mean(axis=0)
    settled = guard_of(spiked, deviation_mm=0.2).settle(spiked, targets)
    assert np.linalg.norm(settled.mesh.vertices[0] - spiked.vertices[0]) <= 0.2
    free = guard_of(spiked, deviation_mm=2.0).settle(spiked, targets)
    assert_array_equal(free.mesh.vertices[0], single(targets)[0])


def test_quality_does_not_sink():
    mesh = rough_sphere(1, 0.1)
    floor = 0.5
    targets = mesh.vertices + np.random.default_rng(0).normal(scale=0.4, size=mesh.vertices.shape)
    settled = guard_of(mesh, quality=floor).settle(mesh, targets)
    assert settled.moved > 0 and settled.held > 0
    before, after = q_of(mesh), q_of(settled.mesh)
    assert (after >= np.minimum(before, floor) - 1e-12).all()
    assert (q_of(Mesh(single(targets), mesh.faces)) < np.minimum(before, floor)).any()


def test_edges_do_not_shrink_below_the_limit():
    mesh = sphere(1, subdivisions=2)
    lengths = np.linalg.norm(mesh.vertices[mesh.faces[:, 0]] - mesh.vertices[mesh.faces[:, 1]], axis=1)
    limit = 0.9 * lengths.min()
    settled = guard_of(mesh, min_edge_mm=limit).settle(mesh, 0.8 * mesh.vertices)
    corners = settled.mesh.vertices[mesh.faces]
    assert np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).min() >= limit
    assert settled.held > 0


def test_boundaries_contacts_and_given_vertices_are_fixed():
    ball = sphere(10, subdivisions=3)
    opened = Mesh(ball.vertices, ball.faces[5:])
    crossing = joined(ball, sphere(4, (10, 0, 0)))
    for mesh in (opened, crossing):
        fixed = np.zeros(len(mesh.vertices), bool)
        fixed[-3:] = True
        guard = guard_of(mesh, fixed=fixed)
        crossed = np.unique(mesh.faces[Tree(mesh.vertices, mesh.faces).self_hits(9999).pairs])
        assert guard.fixed[-3:].all() and guard.fixed[crossed].all()
        assert not guard.fixed.all()
        settled = guard.settle(mesh, mesh.vertices * 1.01)
        assert_array_equal(settled.mesh.vertices[guard.fixed], mesh.vertices[guard.fixed])
        assert (settled.mesh.vertices[~guard.fixed] != mesh.vertices[~guard.fixed]).any()
        assert_as_sound(mesh, settled.mesh)
    hole = set(ball.faces[:5].ravel()) & set(opened.faces.ravel())
    assert set(np.flatnonzero(guard_of(opened).fixed)) == hole


def test_volumes_of_components():
    ball = sphere(10, subdivisions=3)
    opened = moved(Mesh(ball.vertices, ball.faces[1:]), (50, 0, 0))
    mesh = joined(ball, box((-2, -2, -2), (2, 2, 2)), opened)
    found = volumes_of(mesh)
    assert found.closed.tolist() == [True, True, False]
    assert found.volumes == pytest.approx([volume(ball), 64.0, 0.0], rel=1e-12)


def test_volume_is_restored_component_by_component():
    ball = sphere(10, subdivisions=3)
    mesh = joined(ball, moved(sphere(3, subdivisions=2), (20, 0, 0)))
    mesh = Mesh(single(mesh.vertices), mesh.faces)
    guard = guard_of(mesh)
    shrunk = Mesh(
        single(np.concatenate([mesh.vertices[: len(ball.vertices)] * 0.99, mesh.vertices[len(ball.vertices) :]])),
        mesh.faces,
    )
    assert guard.volume_error(shrunk) == pytest.approx(1 - 0.99**3, rel=0.05)
    restored = guard.restore_volume(shrunk, 1e-4)
    assert guard.volume_error(restored) <= 1e-5
    assert_array_equal(restored.vertices[len(ball.vertices) :], mesh.vertices[len(ball.vertices) :])
    assert_as_sound(mesh, restored)


def test_too_many_contacts_are_told():
    assert guard_of(sphere()).complete


@settings(max_examples=25, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([0.01, 0.1, 0.5, 2.0]),
    st.sampled_from(["sphere", "tube", "box", "open", "crossing"]),
)
def test_whatever_is_proposed_nothing_breaks(seed, scale, shape):
    ball = sphere(5, subdivisions=2)
    mesh = {
        "sphere": ball,
        "tube": tube(rings=20, length=10, sides=6, bend=3),
        "box": box((0, 0, 0), (1, 2, 3)),
        "open": Mesh(ball.vertices, ball.faces[:-9]),
        "crossing": joined(ball, moved(ball, (4, 0, 0))),
    }[shape]
    rng = np.random.default_rng(seed)
    targets = mesh.vertices + rng.normal(scale=scale, size=mesh.vertices.shape)
    limit = 0.3
    settled = guard_of(mesh, deviation_mm=limit).settle(mesh, targets)
    assert defects(settled.mesh) == defects(mesh)
    assert (q_of(settled.mesh) >= np.minimum(q_of(mesh), 0.3) - 1e-12).all()
    found = deviation(mesh, settled.mesh, lost_limit_mm=limit)
    assert found["max"] <= 1.3 * limit
    again = guard_of(mesh, deviation_mm=limit).settle(mesh, targets)
    assert_array_equal(again.mesh.vertices, settled.mesh.vertices)
