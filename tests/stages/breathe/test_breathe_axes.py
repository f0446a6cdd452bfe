"""How a model lies."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from breathing_tissues import mirrored, phantom, tissues_of

from vhp_cli.errors import UsageError
from vhp_cli.mesh import Mesh
from vhp_cli.stages.breathe.axes import recognise

KEPT = ("lung", "rib", "vertebra", "liver", "sternum")


def part_of_phantom():
    return {name: mesh for name, mesh in phantom().items() if name.startswith(KEPT)}


def test_the_phantom_lies_in_lps():
    axes = recognise(tissues_of(part_of_phantom()))
    assert axes.name == "LPS"
    assert np.array_equal(axes.to_lps, np.eye(3))
    assert "assumed" not in axes.said_by


def test_every_turned_model_is_recognised_and_every_mirror_image_refused():
    model = part_of_phantom()
    turned = 0
    for order in itertools.permutations(range(3)):
        for signs in itertools.product([1.0, -1.0], repeat=3):
            matrix = np.zeros((3, 3))
            matrix[range(3), order] = signs
            proper = np.linalg.det(matrix) > 0
            meshes = {
                name: Mesh(mesh.vertices @ matrix.T, mesh.faces if proper else mesh.faces[:, ::-1])
                for name, mesh in model.items()
            }
            if proper:
                # What was turned by the matrix is turned back by its inverse.
                assert np.array_equal(recognise(tissues_of(meshes)).to_lps, matrix.T)
                turned += 1
            else:
                with pytest.raises(UsageError, match="mirror image"):
                    recognise(tissues_of(meshes))
    assert turned == 24


def test_swapped_names_are_a_mirror_image():
    with pytest.raises(UsageError, match="mirror image"):
        recognise(tissues_of(mirrored(part_of_phantom())))


def test_what_nothing_tells_is_assumed():
    lungs = {"lungs": next(mesh for name, mesh in phantom().items() if name == "lung_left")}
    axes = recognise(tissues_of(lungs))
    assert axes.name == "LPS"
    assert axes.said_by == ("assumed", "assumed", "assumed")


@pytest.mark.parametrize("scale", [0.001, 0.1, 10.0])
def test_lungs_of_the_wrong_size_are_refused(scale):
    meshes = {name: Mesh(mesh.vertices * scale, mesh.faces) for name, mesh in part_of_phantom().items()}
    with pytest.raises(UsageError, match=r"lungs are .* mm high") as refused:
        recognise(tissues_of(meshes))
    assert "--units" in refused.value.hint
