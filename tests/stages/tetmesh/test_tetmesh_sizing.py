"""Edge lengths and envelopes."""

from __future__ import annotations

import numpy as np
import pytest
from shapes import box, flipped, joined, moved, sphere

from vhp_cli.errors import UsageError, VhpError
from vhp_cli.mesh import Mesh
from vhp_cli.stages.tetmesh.options import TetmeshOptions, absolute_length
from vhp_cli.stages.tetmesh.sizing import envelope, sizing_field, wall_thickness
from vhp_cli.stages.tetmesh.tissues import Tissue, bounds, diagonal, soup, trees
from vhp_cli.volume import volumes


def tissues(*meshes):
    found = [Tissue(str(number), mesh, 1.0) for number, mesh in enumerate(meshes)]
    return found, trees(found)


def test_lengths():
    assert absolute_length("2.5", 100) == 2.5
    assert absolute_length(" 5%", 200) == pytest.approx(10)
    for wrong in ("0", "-1", "5 %%", "many", "nan", "inf", "", "%"):
        with pytest.raises(UsageError, match="edge-length"):
            absolute_length(wrong, 100)


def test_options_are_checked():
    assert TetmeshOptions().changed({"edge-length": 3}, "here").edge_length == "3"
    for key, value in (("edge-length", True), ("edge-length", "x"), ("with-air", "1,2"), ("with-air", "-3")):
        with pytest.raises(UsageError, match=key):
            TetmeshOptions().changed({key: value}, "here")
    for key, value in (("stop-energy", 3), ("attempts", 0), ("attempts", 1.5), ("epsilon", 0), ("keep-surface", "x")):
        with pytest.raises(UsageError, match=key):
            TetmeshOptions().changed({key: value}, "here")


def test_air():
    lower, upper = np.zeros(3), np.full(3, 10.0)
    assert TetmeshOptions().air_box(lower, upper) is None
    margin = TetmeshOptions(air="5").air_box(lower, upper)
    assert margin[0].tolist() == [-5] * 3 and margin[1].tolist() == [15] * 3
    explicit = TetmeshOptions(air="-1,-2,-3,11,12,13").air_box(lower, upper)
    assert explicit[0].tolist() == [-1, -2, -3] and explicit[1].tolist() == [11, 12, 13]
    with pytest.raises(UsageError, match="does not hold the model"):
        TetmeshOptions(air="1,-2,-3,11,12,13").air_box(lower, upper)
    with pytest.raises(UsageError, match="with-air"):
        TetmeshOptions(air="1,1,1,0,2,2")


def chosen_envelope(found, *others, **named):
    return envelope(found, [wall_thickness(tissue) for tissue in found], *others, **named)


def test_the_envelope_is_below_half_of_what_is_thin():
    found, _ = tissues(box((0, 0, 0), (1000, 1000, 1000)))
    assert chosen_envelope(found, None, diagonal(found)).mm == 0.25
    chosen, reason = chosen_envelope(found, 0.3, diagonal(found))
    assert chosen == pytest.approx(0.12) and "gap" in reason
    plate, _ = tissues(box((0, 0, 0), (1000, 1000, 1000)), box((0, 0, 2000), (1000, 1000, 2000.4)))
    chosen, reason = chosen_envelope(plate, None, diagonal(plate))
    assert chosen == pytest.approx(0.16, rel=0.01) and "walls of 1" in reason
    # A part of the diagonal, at most; and not so small that nothing comes of it.
    small, _ = tissues(sphere(10, subdivisions=3))
    assert chosen_envelope(small, None, 30.0).mm == pytest.approx(0.03)
    chosen, reason = chosen_envelope(small, None, 1000.0, own_diagonal_mm=30.0)
    assert chosen == pytest.approx(0.15) and "of these tissues" in reason
    chosen, reason = chosen_envelope(found, 1e-6, 1000.0)
    assert chosen == pytest.approx(0.02) and "least" in reason
    # Tissues that lie beside each other are kept apart where that does not cost too much.
    chosen, reason = chosen_envelope(found, None, diagonal(found), 0.5)
    assert chosen == pytest.approx(0.2) and "distance" in reason
    chosen, reason = chosen_envelope(found, None, diagonal(found), 0.01)
    assert chosen == 0.25 and "may touch" in reason
    assert chosen_envelope(found, None, diagonal(found), 0.7).mm == 0.25


def test_walls():
    shell = joined(sphere(10, subdivisions=4), flipped(sphere(9, subdivisions=4)))
    assert wall_thickness(Tissue("x", shell, 1.0)) == pytest.approx(1.0, abs=0.05)
    opened = Mesh(shell.vertices, shell.faces[20:])
    assert wall_thickness(Tissue("x", opened, None)) == pytest.approx(1.0, abs=0.05)
    inward = Tissue("x", flipped(sphere(10, subdivisions=3)), -1.0)
    assert wall_thickness(inward) == pytest.approx(19.8, rel=0.02)


def test_no_field_where_all_edges_are_alike():
    found, surfaces = tissues(sphere(10), sphere(5))
    assert sizing_field(surfaces, [0, 1], *bounds(found), [None, 4.0], 4.0) is None


def test_the_field_has_the_length_of_each_tissue():
    found, surfaces = tissues(sphere(40), sphere(20), moved(sphere(0.3), (0, 0, 33)))
    points, tetrahedra, lengths = sizing_field(surfaces, [0, 1, 2], *bounds(found), [8.0, 4.0, 1.0], 10.0)
    sizes = volumes(points, tetrahedra)
    assert sizes.min() > 0
    assert sizes.sum() == pytest.approx(np.prod(np.ptp(points, axis=0)))
    lower, upper = bounds(found)
    assert (points.min(axis=0) < lower).all() and (points.max(axis=0) > upper).all()
    distance = np.linalg.norm(points, axis=1)
    cell = 80 / 32
    assert set(lengths[distance < 19]) == {4.0}
    near_nerve = np.linalg.norm(points - [0, 0, 33], axis=1)
    assert set(lengths[(distance > 26) & (distance < 35) & (near_nerve > 3 * cell)]) == {8.0}
    assert set(lengths[distance > 47]) == {10.0}
    # Though it lies between the points of the grid, the small one is not missed.
    assert (lengths[near_nerve < cell] == 1.0).all()


def test_soup_has_no_flat_faces_and_no_air_without_a_box():
    flat = Mesh(box().vertices, np.concatenate((box().faces, [[0, 0, 1], [0, 1, 0]])))
    found, _ = tissues(flat, sphere(3))
    assert len(soup(found).faces) == 12 + len(sphere(3).faces)
    boxed = soup(found, (np.full(3, -20.0), np.full(3, 20.0)))
    assert len(boxed.faces) == 24 + len(sphere(3).faces) and boxed.vertices.max() == 20
    with pytest.raises(VhpError):
        soup([Tissue("x", Mesh(box().vertices, np.array([[0, 0, 1]])), None)])
