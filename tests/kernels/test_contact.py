from __future__ import annotations

import numpy as np
from hypothesis import given, reject, settings
from hypothesis import strategies as st

from vhp_cli.kernels.spatial import contact_points


def test_known_points():
    floor = np.array([[0, 0, 0], [10, 0, 0], [0, 10, 0]], float)
    spike = np.array([[2, 2, -3], [2, 2, 3], [20, 2, 40]], float)
    flat = floor + np.array([1, 1, 0])
    corner = np.array([[10, 0, 0], [20, 0, 0], [20, 5, 5]], float)
    points = contact_points(np.array([floor, floor, floor]), np.array([spike, flat, corner]))
    assert abs(points[0, 2]) < 1e-12 and 2 <= points[0, 0] < 4 and abs(points[0, 1] - 2) < 1e-12
    assert abs(points[1, 2]) < 1e-12
    assert np.allclose(points[2], [10, 0, 0])


coordinate = st.floats(-10, 10, allow_nan=False, width=32)


@settings(max_examples=200, deadline=None)
@given(st.lists(coordinate, min_size=15, max_size=15))
def test_crossing_triangles_meet_at_the_point(values):
    """A triangle through an inner point of another: the reported point lies in both planes."""
    numbers = np.array(values, float)
    first = numbers[:9].reshape(3, 3)
    centre, along = first.mean(axis=0), numbers[9:12]
    normal = np.cross(first[1] - first[0], first[2] - first[0])
    if np.linalg.norm(normal) < 1 or abs(along @ normal) < 1 or np.linalg.norm(numbers[12:]) < 1:
        reject()
    second = np.array([centre - along, centre + along, centre + along + numbers[12:]])
    if np.linalg.norm(np.cross(second[1] - second[0], second[2] - second[0])) < 1:
        reject()
    found = contact_points(first[None], second[None])[0]
    for triangle in (first, second):
        n = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
        assert abs((found - triangle[0]) @ n) / np.linalg.norm(n) < 1e-6
