"""What all rungs of topological repair have in common."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from repair_shapes import flaws, volume, welded, without
from shapes import box, joined, sphere

from vhp_cli.formats import read_mesh
from vhp_cli.mesh import Mesh
from vhp_cli.stages.heal.clean import clean
from vhp_cli.stages.heal.holes import fill_holes
from vhp_cli.stages.heal.junctions import join_cracks
from vhp_cli.stages.heal.manifold import make_manifold
from vhp_cli.stages.heal.orientation import orient
from vhp_cli.stages.heal.separation import separate
from vhp_cli.stages.heal.walls import join_walls

RUNGS = [
    clean, join_cracks, make_manifold, orient, join_walls, lambda mesh: fill_holes(mesh)[:2],
    make_manifold, orient, separate,
]  # fmt: skip


def repaired(mesh: Mesh) -> Mesh:
    for rung in RUNGS:
        mesh, _ = rung(mesh)
    return mesh


@pytest.mark.parametrize("rung", RUNGS)
def test_nothing_comes_of_nothing(rung):
    empty = Mesh(np.empty((0, 3)), np.empty((0, 3), np.int32))
    same, actions = rung(empty)
    assert same is empty and actions == []


@pytest.mark.parametrize("rung", RUNGS)
def test_a_sound_mesh_is_handed_through(rung):
    mesh = joined(sphere(), box((20, 0, 0), (30, 10, 10)))
    same, actions = rung(mesh)
    assert same is mesh and actions == []


def test_many_defects_at_once():
    random = np.random.default_rng(11)
    mesh = sphere(subdivisions=3)
    faces = np.concatenate([np.delete(mesh.faces, random.choice(1280, 60), axis=0), mesh.faces[500:520]])
    turned = random.random(len(faces)) < 0.2
    faces = np.where(turned[:, None], faces[:, ::-1], faces)
    pair = welded(joined(Mesh(mesh.vertices, faces), box(np.array([0, 0, 10]), np.array([3, 3, 13])), sphere(0.01)))
    solid = repaired(without(pair, []))
    assert flaws(solid) == {}
    assert volume(solid) == pytest.approx(volume(mesh) + 27, rel=0.02)
    again = repaired(pair)
    assert (again.vertices == solid.vertices).all() and (again.faces == solid.faces).all()


@pytest.mark.parametrize(
    "name",
    [
        "vhf_organs/airway_trachea",  # walls with forks
        "vhf_organs/colon_vermiform_appendix",  # the wall of a blind end
        "vhf_organs/vessel_pulmonary_trunk",  # two sheets, three rims
        "vhf_organs/uterus_cornua",
        "vhf_organs/ureter_l_major_calyx_a",
        "abdomen_ct/voxel_vertebrae_l3",  # voxels that share single edges
        "bones/myosim_pisiform",  # non-manifold edges and holes
        "thorax_r3/left_clavicle",  # cracks of T-junctions
        "thorax_r3/third_thoracic_vertebra",
        "thorax_r3/thymus_left_lobe",  # double faces
    ],
)
def test_real_tissues_end_sound(shared_data: Path, name: str):
    mesh = read_mesh(shared_data / f"{name}.stl").mesh
    assert flaws(mesh)
    assert flaws(repaired(mesh)) == {}
