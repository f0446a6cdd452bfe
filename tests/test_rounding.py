"""Coordinates as a file holds them, in the unit of the file."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from shapes import box, joined, moved

from vhp_cli.commands.heal import heal
from vhp_cli.config import UNITS
from vhp_cli.formats import read_mesh, write_mesh
from vhp_cli.kernels.remeshing import remesh
from vhp_cli.kernels.spatial import Tree
from vhp_cli.mesh import Mesh
from vhp_cli.rounding import file_unit, rounded, spacing, unit_mm

POINTS = arrays(np.float64, (5, 3), elements=st.floats(-1e6, 1e6))


def scaled(mesh: Mesh, factor: float) -> Mesh:
    return Mesh(mesh.vertices * factor, mesh.faces)


def near_misses() -> Mesh:
    """Return two turned boxes that touch all over a side, far from the origin."""
    cosine, sine = np.cos(0.3), np.sin(0.3)
    turn = np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]])
    boxes = joined(box((0, 0, 0), (20, 20, 20)), box((20, 1, 1), (30, 19, 19)))
    return moved(Mesh(boxes.vertices @ turn, boxes.faces), (400, 100, 300))


@given(points=POINTS, unit=st.sampled_from(sorted(UNITS)))
def test_rounding_is_what_a_file_does(points, unit):
    with file_unit(UNITS[unit]):
        found = rounded(points)
        written = (found * (1 / UNITS[unit])).astype(np.float32)
        np.testing.assert_array_equal(written.astype(np.float64) * UNITS[unit], found)
        np.testing.assert_array_equal(rounded(found), found)
        assert (np.abs(found - points) <= 0.51 * spacing(points)).all()
    assert unit_mm() == 1.0


def test_the_unit_ends_with_its_block():
    with pytest.raises(ZeroDivisionError), file_unit(25.4):
        assert unit_mm() == 25.4
        _ = 1 / 0
    assert unit_mm() == 1.0


@pytest.mark.parametrize("unit", ["m", "in", "um"])
def test_what_is_remeshed_is_what_the_file_holds(unit):
    with file_unit(UNITS[unit]):
        mesh = Mesh(rounded(moved(box(), (400, 100, 300)).vertices), box().faces)
        vertices, faces, counts = remesh(mesh.vertices, mesh.faces, 3.0, deviation=0.1)
        assert counts.splits and counts.relocations
        np.testing.assert_array_equal(rounded(vertices), vertices)
    assert (rounded(vertices) != vertices).any()
    with pytest.raises(ValueError, match="float32"):
        remesh(vertices, faces, 3.0, deviation=0.1)


@pytest.mark.parametrize("unit", ["mm", "m", "in"])
def test_what_is_healed_is_sound_in_the_unit_of_the_file(tmp_path, unit):
    model, out = tmp_path / "model", tmp_path / "out"
    model.mkdir()
    write_mesh(model / "vertebra.stl", scaled(near_misses(), 1 / UNITS[unit]))
    result = CliRunner().invoke(heal, [str(model), "-o", str(out), "--units", unit, "--report", "-"])
    assert result.exit_code == 0
    (tissue,) = json.loads(result.stdout)["tissues"]
    assert tissue["status"] == "changed"
    mesh = read_mesh(out / "vertebra.stl").mesh
    assert Tree(mesh.vertices, mesh.faces).self_hits(0).n_pairs == 0
