"""How finely and how often a tissue is cut, and what is made of one that no cut leaves whole."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
from shapes import box, sphere

from vhp_cli.kernels.spatial import Tree, gap
from vhp_cli.mesh import Mesh
from vhp_cli.stages.clearance import cutting, separate
from vhp_cli.stages.clearance.attempt import Attempt
from vhp_cli.stages.clearance.cell import Bound, Cell
from vhp_cli.stages.clearance.cutting import SQUEEZED, Cutter
from vhp_cli.stages.clearance.distance import SignedDistance
from vhp_cli.stages.clearance.options import ClearanceOptions
from vhp_cli.stages.heal.candidate import judge

BALL = sphere(12, subdivisions=3)


def beside(mesh: Mesh, other: Mesh, gap_mm: float, share: float) -> Cell:
    return Cell(SignedDistance(mesh), [Bound("apart", SignedDistance(other), gap_mm, share)])


def volume(mesh: Mesh) -> float:
    return judge(mesh).measures["volume_mm3"]


@pytest.fixture
def cuts(monkeypatch):
    """Return the gap and the cells of each cut as they are made."""
    made = []

    def carved(mesh, cell, *, grid_mm, **how):
        made.append((cell.gap_mm, grid_mm))
        return real(mesh, cell, grid_mm=grid_mm, **how)

    real = cutting.carved
    monkeypatch.setattr(cutting, "carved", carved)
    return made


def test_what_the_smallest_gap_takes_apart_is_not_cut_for_those_between(cuts):
    plate = box((-1, -20, -20), (1, 20, 20))
    found = Cutter(BALL, beside(BALL, plate, 0.8, 1.0), ClearanceOptions(), Attempt(), may_shrink=False).cut(BALL)
    assert sorted({gap_mm for gap_mm, _ in cuts}) == pytest.approx([0.12, 0.8])
    assert not found.good and found.parts == 1 and found.candidate.sound
    assert any(action["step"] == "parts" for action in found.actions)
    # What is harmed alike keeps the whole gap.
    assert found.scale == 1 and not any(action["step"] == SQUEEZED for action in found.actions)
    lens = math.pi * (12 - 1.8) ** 2 * (3 * 12 - (12 - 1.8)) / 3
    assert found.candidate.measures["volume_mm3"] == pytest.approx(2 * lens, rel=0.05)


def test_a_gap_of_micrometres_is_cut_on_cells_that_go_with_the_tissue(cuts):
    """Two balls of 12 mm, 16 mm apart: each loses a cap 4 mm high, on cells that do not follow the gap."""
    other = sphere(12, (16, 0, 0), subdivisions=3)
    outcomes = [
        separate(mesh, beside(mesh, near, 0.01, 0.5), ClearanceOptions(), Attempt(), may_shrink=False)
        for mesh, near in ((BALL, other), (other, BALL))
    ]
    assert {grid for _, grid in cuts} == {0.4}
    first, second = (outcome.mesh for outcome in outcomes)
    found = gap(Tree(first.vertices, first.faces), Tree(second.vertices, second.faces))
    assert not found.contact_kind and 0.01 <= found.distance < 0.3
    for made in (first, second):
        assert judge(made).sound and judge(made).min_quality > 0.1
        assert volume(BALL) - volume(made) == pytest.approx(math.pi * 16 * (36 - 4) / 3, rel=0.05)


def test_cells_go_with_the_gap_the_thickness_and_the_attempt():
    options = ClearanceOptions()
    grids = [Attempt().grid_mm(options, *sizes) for sizes in ((1.0, 50.0), (0.01, 50.0), (0.01, 2.4), (0.01, 0.1))]
    assert grids == pytest.approx([0.8, 0.4, 0.2, 0.05])
    assert Attempt().grid_mm(ClearanceOptions(grid_mm=0.1), 1.0, 50.0) == 0.1
    later = [Attempt(level).grid_mm(options, 1.0, 50.0) for level in range(4)]
    assert later[0] == later[1] > later[2] > later[3]
    for margins in (
        [Attempt(level).cut_margin_mm(1.0, grid) for level, grid in enumerate(later[:2])],
        [Attempt(level).move_margin_mm(0.01) for level in range(4)],
    ):
        assert all(after > before > 0 for before, after in pairwise(margins))


def test_cells_grow_until_there_are_few_enough(cuts, monkeypatch):
    monkeypatch.setattr(cutting, "_MOST_CELLS", 4_000)
    other = sphere(12, (16, 0, 0), subdivisions=3)
    found = Cutter(BALL, beside(BALL, other, 0.5, 0.5), ClearanceOptions(), Attempt(), may_shrink=False).cut(BALL)
    assert len(cuts) > 1 and found.grid_mm == cuts[-1][1] > cuts[0][1] == 0.4
    assert found.good and volume(BALL) - found.candidate.measures["volume_mm3"] > math.pi * 4**2 * (36 - 4) / 3


def test_of_moving_and_cutting_what_takes_less_is_kept():
    """A tip 1 mm deep in a side of 40 mm of two triangles: moving draws a wide dent, cutting takes a small cap."""
    block, tip = box((0, 0, 0), (40, 40, 40)), sphere(3, (42.0, 20, 20), 3)
    cell = beside(block, tip, 1.0, 1.0)
    moved = separate(block, cell, ClearanceOptions(method="move", max_move_mm=4.0), Attempt(), may_shrink=False)
    both = separate(block, cell, ClearanceOptions(max_move_mm=4.0), Attempt(), may_shrink=False)
    lost = [1 - volume(outcome.mesh) / volume(block) for outcome in (moved, both)]
    assert lost[0] > 0.01 > lost[1]
    assert [action["step"] for action in both.actions] == ["cut"]


def test_a_squeezed_tissue_keeps_the_whole_gap_to_those_that_do_not_squeeze_it():
    plate = box((-10, -10, 0), (10, 10, 2.0))
    lower, upper = box((-20, -20, -9), (20, 20, 0.2)), box((-20, -20, 1.8), (20, 20, 11))
    near = (box((10.4, -20, -9), (30, 20, 11)), lower, upper)
    cell = Cell(SignedDistance(plate), [Bound("apart", SignedDistance(mesh), 1.0, 1.0) for mesh in near])
    found = Cutter(plate, cell, ClearanceOptions(), Attempt(), may_shrink=False).cut(plate)
    assert found.good and found.scale < 1 and found.tight == 2
    made = found.candidate.mesh
    gaps = [gap(Tree(made.vertices, made.faces), Tree(mesh.vertices, mesh.faces)) for mesh in near]
    assert not any(one.contact_kind for one in gaps)
    assert gaps[0].distance >= 0.99 > max(gaps[1].distance, gaps[2].distance) > 0
    (note,) = [action for action in found.actions if action["step"] == SQUEEZED]
    assert "to 2 of them" in note["message"]
