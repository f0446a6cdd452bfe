"""Cages whose bones and cartilages are joined: ribs glide in their joints, cartilages bend between theirs."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from breathing_tissues import STEPS, fcl_distance, moving, tissues_of
from hypothesis import given, settings
from hypothesis import strategies as st
from joined_cage import joined_cage
from scipy.optimize import nnls
from shapes import box, sphere

from vhp_cli.kernels.spatial import overlap_volume
from vhp_cli.mesh import Mesh
from vhp_cli.stages.breathe.fitting.cartilages import find_joined, place_joined
from vhp_cli.stages.breathe.fitting.curves import at, even
from vhp_cli.stages.breathe.fitting.fit import Fit, FitSettings, fit
from vhp_cli.stages.breathe.fitting.joints import MOST_MM, glide, is_unmeasured, joint_of, shortest
from vhp_cli.stages.breathe.fitting.scene import Scene
from vhp_cli.stages.breathe.operations import Rotate
from vhp_cli.stages.breathe.proof import prove
from vhp_cli.stages.breathe.rest import at_rest
from vhp_cli.stages.breathe.sequence import Motion
from vhp_cli.stages.breathe.tissue import Tissue


@given(st.lists(st.tuples(*[st.floats(-1, 1)] * 3, st.floats(-2, 1)), min_size=1, max_size=6))
@settings(max_examples=60)
def test_the_shortest_vector_within_limits(limits: list) -> None:
    slopes, needed = np.array(limits)[:, :3], np.array(limits)[:, 3]
    if (np.linalg.norm(slopes, axis=1) < 0.3).any():
        return
    # Non-negative least squares says whether there is a vector, and which is the shortest (Lawson and Hanson 23.4).
    system = np.vstack([slopes.T, needed[None]])
    target = np.array([0.0, 0.0, 0.0, 1.0])
    rest = system @ nnls(system, target)[0] - target
    if -rest[3] < 0.05:
        return
    wanted = rest[:3] / -rest[3]
    assert shortest(slopes, needed) == pytest.approx(wanted, abs=0.02 * (1.0 + np.linalg.norm(wanted)))


# ---------------------------------------------------------------- one joint


def hinge(depth: float) -> tuple[Scene, Motion]:
    """Return a rib whose corner is in a vertebra by a depth (apart, if negative), and that turns into it."""
    rib, bone = box((0, -3, 0), (80, 3, 6)), box((-20, -10, -20), (depth, 10, 20))
    tissues = tissues_of({"rib_left_06": rib, "vertebra_t06": bone})
    turning = Motion("rib_left_06", (Rotate(at((6.0, 0.0, 6.0)), "y", even(4.0, STEPS)),))
    return Scene(tissues, 1.0, STEPS), turning


@pytest.mark.parametrize("depth", [0.3, 1.0, -0.2, -0.9])
def test_a_rib_glides_out_of_what_it_would_turn_into(depth: float) -> None:
    scene, turning = hinge(depth)
    bone = scene.tissues["vertebra_t06"]
    joint = joint_of(scene, "rib_left_06", ["vertebra_t06"])
    assert joint == ["vertebra_t06"]
    way = glide(scene, "rib_left_06", joint, turning)
    assert way is not None and 0.05 < way[0] < MOST_MM and abs(way[1]) < 1e-6
    gliding = Motion("rib", (*turning.operations, *moving("rib", way).operations))
    for motion, tighter in ((turning, True), (gliding, False)):
        tree = scene.moved("rib_left_06", motion, 11.0)
        if depth > 0:
            grown = overlap_volume(tree, bone.tree) > scene.common("rib_left_06", "vertebra_t06")
        else:
            placed = motion.apply(scene.tissues["rib_left_06"].mesh.vertices, 11.0)
            grown = fcl_distance(placed, scene.tissues["rib_left_06"].mesh.faces, bone.mesh) < -depth
        assert grown == tighter


def test_what_would_glide_too_far_does_not() -> None:
    scene, _ = hinge(1.0)
    turning = Motion("rib_left_06", (Rotate(at((6.0, 0.0, 40.0)), "y", even(8.0, STEPS)),))
    assert glide(scene, "rib_left_06", ["vertebra_t06"], turning) is None


def test_a_rib_that_stays_does_not_glide() -> None:
    scene, _ = hinge(1.0)
    way = glide(scene, "rib_left_06", ["vertebra_t06"], Motion("rib_left_06"))
    assert way is not None and np.linalg.norm(way) < 0.05


def test_a_joint_of_open_surfaces_is_not_turned() -> None:
    rib, bone = box((0, -3, 0), (80, 3, 6)), box((-20, -10, -20), (1.0, 10, 20))
    opened = tissues_of({"rib_left_06": Mesh(rib.vertices, rib.faces[1:]), "vertebra_t06": bone})
    assert is_unmeasured(Scene(opened, 1.0, STEPS), "rib_left_06", ["vertebra_t06"])
    assert not is_unmeasured(hinge(1.0)[0], "rib_left_06", ["vertebra_t06"])


# ---------------------------------------------------------------- one cartilage


def strip(start: float, end: float, y: float = 0.0) -> Mesh:
    mesh = sphere(1.0, subdivisions=3)
    middle, half = 0.5 * (start + end), 0.5 * (end - start)
    return Mesh(mesh.vertices * [half, 5.0, 4.0] + [middle, y, 0.0], mesh.faces)


def test_cartilages_keep_what_they_have_in_common_with_all_that_they_are_joined_to() -> None:
    model = {
        "sternum": box((-15, -20, -30), (0, 20, 30)),
        "rib_left_05": box((100, -8, -6), (130, 2, 6)),
        "rib_left_06": box((100, 8, -6), (130, 21, 6)),
        "costal_cartilage_left_05": strip(-4.0, 104.0),
        "costal_cartilage_left_06": strip(30.0, 104.0, 9.3),
    }
    scene = Scene(tissues_of(model), 1.0, STEPS)
    cartilages = [name for name in model if name.startswith("costal")]
    joined = find_joined(scene, cartilages, ["rib_left_05", "rib_left_06"], ["sternum"], {})
    bodies = {name: [joint.body for joint in found.joints] for name, found in joined.items()}
    both = " + ".join(cartilages)
    assert bodies == {cartilages[0]: ["rib_left_05", "sternum", both], cartilages[1]: ["rib_left_06", both]}
    scene.set("sternum", moving("sternum", (0.0, -4.0, 3.0)))
    scene.set("rib_left_05", moving("rib_left_05", (1.0, -5.0, 6.0)))
    scene.set("rib_left_06", moving("rib_left_06", (1.0, -4.0, 4.0)))
    place_joined(scene, joined)
    assert len(scene.in_contact) == 4
    for first, second in (sorted(pair) for pair in scene.in_contact):
        for t in (2.0, 7.5, 11.0):
            now = overlap_volume(scene.tree(first, t), scene.tree(second, t))
            assert now == pytest.approx(scene.common(first, second), rel=1e-6, abs=1e-6)
    proof = prove(at_rest(tissues_of(model), 1.0), scene.motions, STEPS)
    assert len(proof.joined) == 4 and not proof.unproven and not proof.excused
    # In between it bends, and no face turns over.
    mesh = scene.tissues[cartilages[0]].mesh
    placed = scene.motions[cartilages[0]].apply(mesh.vertices, 11.0)
    normals = [np.cross(*np.diff(v[mesh.faces], axis=1).transpose(1, 0, 2)) for v in (mesh.vertices, placed)]
    assert ((normals[0] * normals[1]).sum(axis=1) > 0.0).all()


def test_cartilages_that_keep_their_gap_are_left_to_their_ends() -> None:
    model = {"sternum": box((-15, -20, -30), (-6, 20, 30)), "costal_cartilage_left_05": strip(-4.0, 64.0)}
    assert find_joined(Scene(tissues_of(model), 1.0, STEPS), ["costal_cartilage_left_05"], [], ["sternum"], {}) == {}


# ---------------------------------------------------------------- a whole cage


@cache
def fitted() -> tuple[list[Tissue], Fit]:
    tissues = tissues_of(joined_cage())
    return tissues, fit(tissues, dict.fromkeys(joined_cage()), None, FitSettings())


def test_a_joined_cage_follows_the_lungs() -> None:
    tissues, found = fitted()
    assert not found.shortfalls
    assert not any("follow the lungs" in note for note in found.notes)
    assert all(lift > 1.0 for number, (lift, _) in found.angles.items() if number <= 10)
    rest = at_rest(tissues, 1.0)
    parts = {tissue.name: tissue.role.part for tissue in tissues}
    kinds = {frozenset((parts[a], parts[b])) for a, b in rest.contacts}
    assert {frozenset(k) for k in (("rib", "vertebra"), ("rib", "cartilage"), ("sternum", "cartilage"))} <= kinds


def test_every_contact_of_a_joined_cage_is_proven() -> None:
    tissues, found = fitted()
    rest = at_rest(tissues, 1.0)
    proof = prove(rest, {motion.name: motion for motion in found.sequence.motions}, STEPS, jobs=2)
    assert not proof.unproven and not proof.excused
    # The lowest ribs have nothing to make room for, and stay.
    assert len(proof.joined) == 28 and len(proof.bounded) == 20
    still = [pair for pair in rest.contacts if pair[0].endswith(("_11", "_12"))]
    assert len(proof.joined) + len(proof.bounded) + len(still) == len(rest.contacts)


def test_ribs_of_a_joined_cage_stay_rigid() -> None:
    tissues, found = fitted()
    motions = {motion.name: motion for motion in found.sequence.motions}
    for tissue in tissues:
        if tissue.role.part in ("rib", "sternum") and tissue.name in motions:
            linear = motions[tissue.name].matrix(11.0)[:3, :3]
            assert np.abs(linear @ linear.T - np.eye(3)).max() < 1e-12
