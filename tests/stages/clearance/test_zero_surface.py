"""Marching tetrahedra: closed surfaces in the right place, whatever the function."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vhp_cli.kernels import surface
from vhp_cli.stages.clearance.zero_surface import TooFineError, zero_surface


def ball(points, centre, radius):
    return np.linalg.norm(points - np.asarray(centre, float), axis=1) - radius


def volume_of(mesh) -> float:
    corners = mesh.vertices[mesh.faces]
    return float(np.einsum("fi,fi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6)


def assert_closed(mesh):
    found = surface.topology(mesh.vertices, mesh.faces)
    for defect in (found.boundary_edges, found.nonmanifold_edges, found.nonmanifold_vertices, found.inconsistent_edges):
        assert len(defect) == 0
    return found


def test_a_ball_is_closed_outward_and_of_the_right_size():
    mesh = zero_surface(lambda points, _: ball(points, (0, 0, 0), 10), [-12.0] * 3, [12.0] * 3, 0.5)
    assert assert_closed(mesh).euler == 2
    assert volume_of(mesh) == pytest.approx(4 / 3 * math.pi * 1000, rel=3e-3)
    # No vertex is farther off than a chord of a cell's diagonal.
    assert np.abs(ball(mesh.vertices, (0, 0, 0), 10)).max() < 0.75 * 0.5**2 / 10


def test_what_two_balls_have_in_common():
    def common(points, _):
        return np.maximum(ball(points, (0, 0, 0), 10), ball(points, (0, 0, 12), 10))

    mesh = zero_surface(common, [-12.0] * 3, [12.0, 12.0, 24.0], 0.4)
    assert_closed(mesh)
    # The lens of two balls of radius r whose centres are d apart: pi (4 r + d) (2 r - d)^2 / 12.
    assert volume_of(mesh) == pytest.approx(math.pi * 52 * 64 / 12, rel=1e-2)


def test_a_ring_has_its_hole():
    def ring(points, _):
        return np.hypot(np.hypot(points[:, 0], points[:, 1]) - 8, points[:, 2]) - 3

    mesh = zero_surface(ring, [-13.0] * 3, [13.0] * 3, 0.7)
    assert assert_closed(mesh).euler == 0
    assert volume_of(mesh) == pytest.approx(2 * math.pi**2 * 8 * 9, rel=1e-2)


@settings(max_examples=25, deadline=None)
@given(
    st.lists(
        st.tuples(*[st.floats(-6, 6)] * 3, st.floats(0.5, 5)),
        min_size=1,
        max_size=4,
    ),
    st.floats(0.4, 1.3),
)
def test_any_union_of_balls_is_closed_and_only_its_own_cells_are_looked_at(balls, cell):
    def union(points, reach):
        exact = np.min([ball(points, b[:3], b[3]) for b in balls], axis=0)
        # Beyond the reach any value of the same sign will do.
        return np.where(np.abs(exact) > reach, np.sign(exact) * (reach + 7.0), exact)

    mesh = zero_surface(union, [-13.0] * 3, [13.0] * 3, cell)
    assert_closed(mesh)
    exact = np.min([ball(mesh.vertices, b[:3], b[3]) for b in balls], axis=0)
    assert (np.abs(exact) < cell * 3**0.5).all()


def test_nothing_where_nothing_is_negative():
    assert len(zero_surface(lambda points, _: ball(points, (0, 0, 0), 3) + 10, [-4.0] * 3, [4.0] * 3, 0.5).faces) == 0


def test_a_grid_that_is_too_fine_is_refused():
    with pytest.raises(TooFineError, match="too fine"):
        zero_surface(lambda points, _: ball(points, (0, 0, 0), 3), [-1e4] * 3, [1e4] * 3, 0.01)
    with pytest.raises(TooFineError, match="more than 1000 cells"):
        zero_surface(lambda points, _: ball(points, (0, 0, 0), 10), [-12.0] * 3, [12.0] * 3, 0.5, most_cells=1000)
