"""What the surfaces alone say of the parts of each tissue."""

from __future__ import annotations

import numpy as np
from shapes import box, flipped, joined, moved, sphere

from vhp_cli.mesh import Mesh
from vhp_cli.stages.tetmesh.components import components_of, expected_parts, locate
from vhp_cli.stages.tetmesh.tissues import Tissue


def parts(*meshes, clean=None, order=None):
    tissues = [
        Tissue(str(number), mesh, 1.0, clean=clean is None or number in clean) for number, mesh in enumerate(meshes)
    ]
    return expected_parts(tissues, components_of(tissues), order or list(range(len(tissues))))


def test_nested_and_paired():
    pair = joined(moved(sphere(3), (-5, 0, 0)), moved(sphere(3), (5, 0, 0)))
    assert parts(sphere(12), pair) == [1, 2]


def test_a_hollow_tissue_parts_the_one_around_it():
    hollow = joined(sphere(8), flipped(sphere(5)))
    assert parts(hollow) == [1]
    # What is within the cavity belongs to the tissue around.
    assert parts(sphere(12), hollow) == [2, 1]
    # Unless something fills the cavity.
    assert parts(sphere(12), hollow, sphere(4)) == [2, 1, 1]


def test_a_part_within_a_part_of_the_same_tissue_is_the_same():
    assert parts(joined(sphere(8), sphere(5))) == [1]
    assert parts(flipped(sphere(8))) == [1]


def test_a_tissue_that_is_laid_over_is_gone():
    assert parts(sphere(5), sphere(8), order=[0, 1]) == [0, 1]


def test_nothing_is_told_near_what_is_not_clean():
    opened = Mesh(sphere(3).vertices, sphere(3).faces[1:])
    assert parts(sphere(12), opened, moved(sphere(3), (30, 0, 0)), clean=(0, 2)) == [None, None, 1]


def test_locating_points():
    tissues = [Tissue("a", joined(sphere(12), box((20, 20, 20), (30, 30, 30))), 1.0), Tissue("b", sphere(5), 1.0)]
    points = np.array([[0.0, 0, 0], [8, 0, 0], [25, 25, 25], [50, 0, 0]])
    found = locate(components_of(tissues), points)
    assert found.innermost.tolist() == [2, 0, 1, -1]
    assert found.tissues.tolist() == [[True, True, True, False], [True, False, False, False]]
    hollow = locate(components_of([Tissue("a", joined(sphere(12), flipped(sphere(5))), 1.0)]), points)
    assert hollow.innermost.tolist() == [1, 0, -1, -1]
    assert hollow.tissues.tolist() == [[False, True, False, False]]
