"""Exact tests of frames, and the proof between them."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from breathing_tissues import STEPS, fcl_distance, moving, phantom_fit, tissues_of
from hypothesis import given, settings
from hypothesis import strategies as st
from shapes import box, moved, sphere

from vhp_cli.mesh import Mesh
from vhp_cli.stages.breathe.curves import Polynomial
from vhp_cli.stages.breathe.fitting.curves import at, even
from vhp_cli.stages.breathe.frame_check import check_frame
from vhp_cli.stages.breathe.operations import Parameter, Rotate, Scale
from vhp_cli.stages.breathe.proof import prove
from vhp_cli.stages.breathe.rest import at_rest, is_worse, shared_loss
from vhp_cli.stages.breathe.sequence import Motion


def frame(rest, motions, x, gap=1.0):
    vertices = {name: motion.apply(rest.tissues[name].mesh.vertices, x) for name, motion in motions.items()}
    return check_frame(rest, vertices, x, gap)


def two(first: Mesh, second: Mesh, gap=1.0):
    return at_rest(tissues_of({"rib": first, "lung": second}), gap)


def there_and_back(name: str, vector) -> Motion:
    """Move to a place at t = N / 2 and back again, so that no whole step sees how far."""
    from vhp_cli.stages.breathe.operations import LocalFrame, Move

    def parameter(size: float) -> Parameter:
        # 4 s (1 - s) with s = t / N
        return Parameter(Polynomial((0.0, 4.0 * size / STEPS, -4.0 * size / STEPS**2)))

    x, y, z = (parameter(float(value)) for value in vector)
    return Motion(name, (Move(LocalFrame(), x, y, z),), tissues=(name,))


def test_a_staged_collision_is_found():
    rest = two(box((0, 0, 0), (10, 10, 10)), box((20, 0, 0), (30, 10, 10)))
    motions = {"rib": moving("rib", (15, 0.5, 0.25))}
    assert not frame(rest, motions, 5.0).contacts
    found = frame(rest, motions, 11.0)
    assert [(contact.a, contact.b) for contact in found.contacts] == [("rib", "lung")]
    assert found.contacts[0].overlap_mm3 == pytest.approx(5 * 9.5 * 9.75, rel=1e-6)
    assert found.contacts[0].crossing
    proof = prove(rest, motions, STEPS)
    assert {(item.a, item.b) for item in proof.unproven} == {("rib", "lung")}
    assert min(item.start for item in proof.unproven) < 10 / 15 * 11 < max(item.end for item in proof.unproven)


def test_a_tissue_wholly_inside_is_found_though_no_faces_meet():
    rest = two(sphere(3.0, (0, 0, 0)), box((20, -20, -20), (60, 20, 20)))
    found = frame(rest, {"rib": moving("rib", (40, 0, 0))}, 11.0)
    assert len(found.contacts) == 1 and found.contacts[0].faces == 0
    assert found.contacts[0].overlap_mm3 == pytest.approx(4 / 3 * np.pi * 27, rel=0.05)


def test_a_tissue_that_leaves_its_container_is_found():
    rest = two(sphere(3.0, (40, 0, 0)), box((20, -20, -20), (60, 20, 20)))
    assert rest.nested == {("rib", "lung")}
    assert not frame(rest, {"rib": moving("rib", (10, 0, 0))}, 11.0).contacts
    assert frame(rest, {"rib": moving("rib", (60, 0, 0))}, 11.0).contacts
    assert frame(rest, {"rib": moving("rib", (60, 0, 0))}, 4.0).contacts


def test_a_narrow_gap_is_found_and_one_that_was_narrow_at_rest_may_stay():
    rest = two(box((0, 0, 0), (10, 10, 10)), box((10.5, 0, 0), (30, 10, 10)))
    assert not frame(rest, {"lung": moving("lung", (0.4, 0, 0))}, 11.0).narrow
    found = frame(rest, {"lung": moving("lung", (-0.2, 0, 0))}, 11.0)
    assert [round(item.gap_mm, 6) for item in found.narrow] == [0.3]
    assert found.min_gap_mm == pytest.approx(0.3)
    assert found.min_gap_pair == ("rib", "lung")


def test_contact_at_rest_may_stay_and_must_not_grow():
    rest = two(box((0, 0, 0), (10, 10, 10)), box((9, 0.5, 0.5), (30, 9.5, 9.5)))
    assert rest.contacts["rib", "lung"].overlap_mm3 == pytest.approx(81, rel=1e-6)
    away = frame(rest, {"lung": moving("lung", (0.25, 0, 0))}, 11.0)
    assert not away.contacts and not away.narrow
    deeper = frame(rest, {"lung": moving("lung", (-0.25, 0, 0))}, 11.0)
    assert [contact.worse_than_rest for contact in deeper.contacts] == [True]
    assert prove(rest, {"lung": moving("lung", (0.25, 0, 0))}, STEPS).bounded == (("rib", "lung"),)
    assert is_worse(1.0, 1.02) and not is_worse(1.0, 1.009) and is_worse(1.0, float("nan"))


def test_a_collision_between_the_samples_is_not_proven_away():
    # At every whole step the two are 10 mm apart or more but in the middle, where one passes through the other.
    rest = two(box((0, 0, 0), (2, 2, 2)), box((30, 0.5, 0.5), (32, 1.5, 1.5)))
    motions = {"rib": there_and_back("rib", (60.0, 0.0, 0.0))}
    assert prove(rest, motions, STEPS).unproven
    # One that turns back before it gets there is proven, by a margin that no coarse bound could give.
    near = {"rib": there_and_back("rib", (27.95, 0.0, 0.0))}
    proof = prove(rest, near, STEPS)
    assert not proof.unproven and 0.0 < proof.least_gap_mm <= 0.05
    assert proof.intervals > STEPS


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.floats(-25, 25), min_size=3, max_size=3),
    st.floats(-60, 60),
    st.floats(0.7, 1.3),
    st.lists(st.floats(-20, 20), min_size=3, max_size=3),
)
def test_what_is_proven_holds_on_a_dense_sample(offset, angle, factor, way):
    # fcl decides, which knows nothing of bounds, trees or predicates of this package.
    still = sphere(6.0, subdivisions=1)
    turning = moved(box((-4, -2, -9), (4, 2, 9)), np.asarray(offset))
    rest = at_rest(tissues_of({"rib": turning, "lung": still}), 1.0)
    if rest.contacts or rest.nested:
        return
    operations = (
        Scale(at(offset), z=even(factor, STEPS, 1.0)),
        Rotate(at(np.add(offset, [3.0, 0.0, 0.0])), "y", even(angle, STEPS)),
        *moving("rib", way).operations,
    )
    motion = Motion("rib", operations, tissues=("rib",))
    proof = prove(rest, {"rib": motion}, STEPS, depth=8)
    distances = [fcl_distance(motion.apply(turning.vertices, t), turning.faces, still) for t in np.linspace(0, 11, 89)]
    if not proof.unproven:
        assert min(distances) > 0.0
        if proof.least_gap_mm is not None:
            assert min(distances) >= proof.least_gap_mm - 1e-6
    if min(distances) <= 0.0:
        assert proof.unproven


def test_the_phantom_is_proven_and_fcl_agrees_on_close_pairs():
    tissues, _, found = phantom_fit()
    rest = at_rest(tissues, 1.0)
    motions = {motion.name: motion for motion in found.sequence.motions}
    proof = prove(rest, motions, STEPS, jobs=2)
    assert not proof.unproven and not proof.excused
    assert proof.least_gap_mm > 0.1
    moving_names = {tissue.name for tissue in tissues} & set(motions)
    still = len(tissues) - len(moving_names)
    assert proof.pairs == len(tissues) * (len(tissues) - 1) // 2 - still * (still - 1) // 2
    for a, b in (("lung_left", "rib_left_06"), ("diaphragm", "lung_right"), ("liver", "diaphragm"), ("skin", "fat")):
        for t in (3.5, 7.25, 11.0):
            first, second = (rest.tissues[name].mesh for name in (a, b))
            placed = [
                motions[name].apply(mesh.vertices, t) if name in motions else mesh.vertices
                for name, mesh in ((a, first), (b, second))
            ]
            assert fcl_distance(placed[0], first.faces, Mesh(placed[1], second.faces)) > 0.99


def test_threads_change_nothing():
    tissues, _, found = phantom_fit()
    rest = at_rest(tissues, 1.0)
    motions = {motion.name: motion for motion in found.sequence.motions}
    assert prove(rest, motions, STEPS, jobs=1) == prove(rest, motions, STEPS, jobs=3)
    with ThreadPoolExecutor(3) as executor:
        vertices = {name: motion.apply(rest.tissues[name].mesh.vertices, 11.0) for name, motion in motions.items()}
        assert check_frame(rest, vertices, 11.0, 1.0, executor) == check_frame(rest, vertices, 11.0, 1.0)


def test_shells_of_one_field_may_lose_its_slope_of_their_gap_and_no_more():
    tissues, _, found = phantom_fit()
    motions = {motion.name: motion for motion in found.sequence.motions}
    loss = shared_loss(motions["skin"], motions["fat"], 11.0)
    assert 0.0 < loss < 0.25
    assert shared_loss(motions["skin"], motions["fat"], 0.0) == 0.0
    assert shared_loss(motions["skin"], motions["lung_left"], 11.0) == 0.0
    assert shared_loss(motions["skin"], None, 11.0) == 0.0
    shells = [tissue for tissue in tissues if tissue.name in ("skin", "fat")]
    rest = at_rest(shells, 2.0)
    vertices = {shell.name: motions[shell.name].apply(shell.mesh.vertices, 11.0) for shell in shells}
    assert [item.a for item in check_frame(rest, vertices, 11.0, 2.0).narrow] == ["skin"]
    both = {shell.name: motions[shell.name] for shell in shells}
    assert not check_frame(rest, vertices, 11.0, 2.0, motions=both).narrow
    pushed = vertices | {"fat": vertices["fat"] + [0.0, -0.5, 0.0]}
    assert check_frame(rest, pushed, 11.0, 2.0, motions=both).narrow
