"""The proof that what is in contact at rest gets no tighter."""

from __future__ import annotations

import manifold3d
import numpy as np
import pytest
from breathing_tissues import STEPS, moving, tissues_of
from hypothesis import given, settings
from hypothesis import strategies as st
from shapes import box, joined, moved, sphere

from vhp_cli.mesh import Mesh
from vhp_cli.stages.breathe.blend import Blend, Holder
from vhp_cli.stages.breathe.curves import Polynomial
from vhp_cli.stages.breathe.fitting.curves import at, even
from vhp_cli.stages.breathe.operations import LocalFrame, Move, Parameter, Rotate, Scale
from vhp_cli.stages.breathe.proof import Proof, prove
from vhp_cli.stages.breathe.rest import at_rest, most_in_common
from vhp_cli.stages.breathe.sequence import Motion


def proof_of(first: Mesh, second: Mesh, motions: dict[str, Motion], steps: int = STEPS) -> Proof:
    rest = at_rest(tissues_of({"rib": first, "vertebra": second}), 1.0)
    assert ("rib", "vertebra") in rest.contacts
    return prove(rest, motions, steps)


def there_and_back(size: float) -> Motion:
    """Move along x and back within one step, so that at its ends it is where it was: by 16 t^2 (1 - t)^2."""
    curve = Polynomial((0.0, 0.0, 16.0 * size, -32.0 * size, 16.0 * size))
    return Motion("rib", (Move(LocalFrame(), x=Parameter(curve)),), tissues=("rib",))


WALL = box((8, -20, -20), (30, 20, 20))


def test_what_withdraws_is_bounded() -> None:
    proof = proof_of(sphere(10.0), WALL, {"rib": moving("rib", (-0.5, 0.3, 0.0))})
    assert proof.bounded == (("rib", "vertebra"),) and not proof.excused and not proof.unproven


def test_what_turns_in_its_socket_is_bounded() -> None:
    turning = Motion("rib", (Rotate(at((0, 0, 0)), "x", even(5.0, STEPS)), *moving("rib", (-0.05, 0, 0)).operations))
    assert proof_of(sphere(10.0, subdivisions=4), WALL, {"rib": turning}).bounded == (("rib", "vertebra"),)


def test_what_goes_deeper_is_not() -> None:
    proof = proof_of(sphere(10.0), WALL, {"rib": moving("rib", (0.2, 0, 0))})
    assert not proof.bounded and not proof.excused
    assert [(item.a, item.b, item.start) for item in proof.unproven] == [("rib", "vertebra", 1.0)]


def test_what_goes_deeper_between_the_frames_alone_is_not() -> None:
    deeper = proof_of(sphere(10.0), WALL, {"rib": there_and_back(0.2)}, 1)
    assert not deeper.bounded and not deeper.excused
    assert [item.start for item in deeper.unproven] == [0.5]
    assert proof_of(sphere(10.0), WALL, {"rib": there_and_back(-0.2)}, 1).bounded == (("rib", "vertebra"),)


def test_both_may_move() -> None:
    apart = {"rib": moving("rib", (-1.0, 0, 0)), "vertebra": moving("vertebra", (-0.8, 0, 0))}
    assert proof_of(sphere(10.0), WALL, apart).bounded == (("rib", "vertebra"),)
    together = {"rib": moving("rib", (-0.8, 0, 0)), "vertebra": moving("vertebra", (-1.0, 0, 0))}
    assert proof_of(sphere(10.0), WALL, together).unproven


def test_two_of_one_motion_are_joined() -> None:
    both = {name: moving(name, (5.0, -3.0, 1.0)) for name in ("rib", "vertebra")}
    assert proof_of(sphere(10.0), WALL, both).joined == (("rib", "vertebra"),)


def test_nothing_is_said_of_open_growing_or_tangled_surfaces() -> None:
    still = moving("rib", (-0.5, 0, 0))
    whole = sphere(10.0)
    opened = Mesh(whole.vertices, whole.faces[:-1])
    growing = Motion("rib", (Scale(at((20, 0, 0)), x=even(0.9, STEPS, 1.0)),), tissues=("rib",))
    tangled = joined(whole, moved(whole, (-5.0, 0, 0)))
    for first, motion in ((opened, still), (whole, growing), (tangled, still)):
        assert proof_of(first, WALL, {"rib": motion}).excused == (("rib", "vertebra"),)


def bar() -> Mesh:
    """Return a strip from x = 0 to 40 of about 2 mm wide faces."""
    mesh = sphere(1.0, subdivisions=4)
    return Mesh(mesh.vertices * [20.0, 4.0, 3.0] + [20.0, 0.0, 0.0], mesh.faces)


def bent(radius: float, name: str = "rib") -> Motion:
    """Return the motion of the strip: one end goes up, the other stays."""
    up = moving("end", (0.0, 1.0, 6.0)).operations
    holders = (Holder("end", up, ((1.0, 0.0, 0.0, radius),)), Holder("wall", (), ((39.0, 0.0, 0.0, 6.0),)))
    return Motion(name, fields=(Blend("strip", holders),), tissues=(name,))


def test_a_strip_that_is_held_at_its_contact_is_joined() -> None:
    wall = box((37, -20, -20), (60, 20, 20))
    assert proof_of(bar(), wall, {"rib": bent(6.0)}).joined == (("rib", "vertebra"),)
    # The end that goes up takes what it touches along.
    block = box((-20, -20, -20), (3, 20, 20))
    motions = {"rib": bent(6.0), "vertebra": moving("vertebra", (0.0, 1.0, 6.0))}
    assert proof_of(bar(), block, motions).joined == (("rib", "vertebra"),)
    # If that goes a little further, the contact is not the same, and a body that bends has no bound.
    motions["vertebra"] = moving("vertebra", (0.0, 1.0, 6.001))
    assert proof_of(bar(), block, motions).excused == (("rib", "vertebra"),)


def test_a_strip_that_is_held_by_too_little_is_not_joined() -> None:
    block = box((-20, -20, -20), (8, 20, 20))
    motions = {"rib": bent(2.0), "vertebra": moving("vertebra", (0.0, 1.0, 6.0))}
    assert proof_of(bar(), block, motions).excused == (("rib", "vertebra"),)


def test_a_strip_that_bends_into_what_it_is_joined_to_is_not_joined() -> None:
    # The wall has a shelf above the strip, which the lifted end hits.
    shelf = joined(box((37, -20, -20), (60, 20, 20)), box((-5, -20, 5), (15, 20, 8)))
    assert proof_of(bar(), shelf, {"rib": bent(6.0)}).excused == (("rib", "vertebra"),)


def manifold(vertices: np.ndarray, faces: np.ndarray) -> manifold3d.Manifold:
    return manifold3d.Manifold(
        manifold3d.Mesh(np.asarray(vertices, dtype=np.float32), np.asarray(faces, dtype=np.uint32))
    )


@settings(max_examples=15, deadline=None)
@given(
    st.floats(-15, 15),
    st.sampled_from(["x", "y", "z"]),
    st.lists(st.floats(-1.0, 0.6), min_size=3, max_size=3),
    st.lists(st.floats(-4.0, 4.0), min_size=3, max_size=3),
)
def test_what_is_bounded_holds_on_a_dense_sample(angle: float, axis: str, way: list, origin: list) -> None:
    # manifold3d measures, which knows nothing of this package.
    solid = moved(box((-9, -3, -4), (9, 3, 4)), np.array([0.5, 0.25, 0.125]))
    operations = (Rotate(at(origin), axis, even(angle, STEPS)), *moving("rib", way).operations)
    motion = Motion("rib", operations, tissues=("rib",))
    proof = proof_of(solid, WALL, {"rib": motion})
    assert len(proof.bounded) + len(proof.excused) + len(proof.unproven) == 1
    other = manifold(WALL.vertices, WALL.faces)
    volumes = [
        (manifold(motion.apply(solid.vertices, t), solid.faces) ^ other).volume() for t in np.linspace(0, 11, 67)
    ]
    limit = most_in_common(volumes[0])
    if proof.bounded:
        assert max(volumes) <= limit + 1e-2
    if proof.unproven:
        assert max(volumes) > limit - 0.1
    if max(volumes) > limit + 1e-2:
        assert not proof.bounded


def test_volumes_are_those_of_the_motion() -> None:
    # A box in a wall by 2 mm, drawn out by 1 mm: half of the volume is left.
    solid = box((0, -3, -4), (10, 3, 4))
    rest = at_rest(tissues_of({"rib": solid, "vertebra": WALL}), 1.0)
    assert rest.contacts["rib", "vertebra"].overlap_mm3 == pytest.approx(2 * 6 * 8, rel=1e-6)
    assert most_in_common(96.0) == pytest.approx(96.96) and most_in_common(0.001) == pytest.approx(0.011)
