"""Surfaces made lighter for the mesher."""

from __future__ import annotations

import numpy as np
from shapes import box, sphere

from vhp_cli.inspection.deviation import deviation
from vhp_cli.mesh import Mesh
from vhp_cli.stages.tetmesh.lightening import lightened
from vhp_cli.stages.tetmesh.tissues import Tissue


def test_dense_surfaces_lose_triangles_within_the_deviation():
    dense, light = sphere(20.0, subdivisions=5), box()
    found = lightened([Tissue("ball", dense, 1.0, priority=3), Tissue("box", light, 1.0)], 0.05)
    ball = found[0].mesh
    assert len(ball.faces) < 0.3 * len(dense.faces)
    assert deviation(dense, ball, lost_limit_mm=1)["max"] <= 0.06
    assert found[0].priority == 3
    # What has none to spare stays as it is, coordinates included.
    assert found[1].mesh is light


def test_the_number_of_threads_plays_no_part():
    given = [Tissue(str(size), sphere(size, subdivisions=4), 1.0) for size in (5, 8, 11)]
    one, other = lightened(given, 0.1), lightened(given, 0.1, threads=3)
    assert all(a.mesh.vertices.tobytes() == b.mesh.vertices.tobytes() for a, b in zip(one, other, strict=True))


def test_rims_stay_and_nothing_is_lost_of_what_is_no_solid():
    ball = sphere(20.0, subdivisions=4)
    opened = Mesh(ball.vertices * 1.00000001, ball.faces[40:])
    (found,) = lightened([Tissue("opened", opened, None)], 0.2)
    assert len(found.mesh.faces) < 0.5 * len(opened.faces)
    edges = np.sort(found.mesh.faces[:, [(0, 1), (1, 2), (2, 0)]].reshape(-1, 2), axis=1)
    rim = np.unique(edges, axis=0, return_counts=True)[1] == 1
    given = np.sort(opened.faces[:, [(0, 1), (1, 2), (2, 0)]].reshape(-1, 2), axis=1)
    assert rim.sum() == (np.unique(given, axis=0, return_counts=True)[1] == 1).sum() > 0
    nothing = Tissue("nothing", Mesh(np.empty((0, 3)), np.empty((0, 3), np.int32)), None)
    assert lightened([nothing], 0.2) == [nothing]
    assert lightened([found], 0.0) == [found]
