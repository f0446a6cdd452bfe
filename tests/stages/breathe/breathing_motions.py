"""Motions for tests: drawn by hypothesis, and a hand-made sequence with every form."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from vhp_cli.stages.breathe.blend import Blend, Holder
from vhp_cli.stages.breathe.curves import Interpolant, Polynomial, Power
from vhp_cli.stages.breathe.field import Field
from vhp_cli.stages.breathe.operations import LocalFrame, Move, Operation, Parameter, Rotate, Scale
from vhp_cli.stages.breathe.profile import Profile
from vhp_cli.stages.breathe.sequence import Motion, Sequence, Targets

small = st.floats(-1.0, 1.0)


def parameters(identity: float, size: float) -> st.SearchStrategy[Parameter]:
    """Parameters with the identity at t = 0 that change by about `size` up to t = 11."""
    polynomial = st.lists(small, min_size=1, max_size=6).map(
        lambda values: Polynomial((identity, *(size * v / 11.0**p for p, v in enumerate(values, start=1))))
    )
    interpolant = st.lists(small, min_size=11, max_size=11).map(
        lambda values: Interpolant((identity, *(identity + size * v for v in values)))
    )
    return (polynomial | interpolant).map(Parameter)


@st.composite
def frames(draw: st.DrawFn) -> LocalFrame:
    origin = draw(st.lists(st.floats(-300.0, 300.0), min_size=3, max_size=3))
    direction = np.array(draw(st.lists(small, min_size=3, max_size=3)))
    return LocalFrame.along(origin, direction if np.linalg.norm(direction) > 0.1 else [1.0, 0.0, 0.0])


@st.composite
def operations(draw: st.DrawFn) -> Operation:
    frame = draw(frames())
    kind = draw(st.sampled_from(["scale", "rotate", "move"]))
    if kind == "rotate":
        return Rotate(frame, draw(st.sampled_from(["x", "y", "z"])), draw(parameters(0.0, 20.0)))
    if kind == "scale":
        return Scale(frame, *(draw(parameters(1.0, 0.1)) for _ in range(3)))
    return Move(frame, *(draw(parameters(0.0, 15.0)) for _ in range(3)))


affine_motions = st.lists(operations(), min_size=1, max_size=4).map(lambda found: Motion("affine", tuple(found)))


def blend(turn: Rotate) -> Blend:
    """Return the field of a cartilage between a rib, the sternum, another cartilage and something that stays."""
    forward = Move(LocalFrame(), y=Parameter(Polynomial((0.0, -0.25))), z=Parameter(Polynomial((0.0, 0.125))))
    return Blend(
        "cartilage",
        (
            Holder("Rib 6 left", (turn,), ((60.0, -40.0, -230.0, 6.0), (64.0, -44.0, -232.0, 5.0))),
            Holder("sternum", (forward,), ((0.0, -80.0, -200.0, 1 / 3),)),
            Holder(
                "5 + 6", (Scale(LocalFrame((0.0, 0.0, -9.0)), z=smooth_scale()), forward), ((20.0, -70.0, -170.0, 4.0),)
            ),
            Holder("clavicle", (), ((30.0, -60.0, -100.0, 8.0),)),
        ),
    )


def smooth_scale() -> Parameter:
    return Parameter(Polynomial((1.0, 1e-3, -2e-4)))


def every_form() -> Sequence:
    """Return a sequence with every operation, curve and field, and names that have to be escaped."""
    tilted = LocalFrame.along((32.07, 104.5, -215.3), (-36.17, -1.9, -2.5))
    smooth = Parameter(Polynomial((0.0, 0.45, 1.234567890123456e-3, -1 / 3, 0.0, 1e-17)), (0.1, 1 / 3), 2e-3, ("E25",))
    field = Field("chest", Parameter(Polynomial((0.0, 10 / 11))), (-141.3, 173.4), (-330.6, -150.6), 64.0)
    profile = Profile(
        "descent",
        Parameter(Polynomial((0.0, 1 / 11))),
        (-500.0, -300.0, -200.0),
        ((0, 0, 0), (0, -3, -20.0), (0, 0, 0)),
    )
    return Sequence(
        name='a "quoted" \\ name\twith é, 骨 and 🫁',
        motions=(
            Motion(
                "Rib 6 left",
                (Rotate(tilted, "x", smooth),),
                tissues=("rib L6", "marrow"),
                role="rib",
                side="left",
                number=6,
            ),
            Motion(
                "Lungs",
                (
                    Scale(
                        LocalFrame((0.0, 122.8, -131.3)),
                        x=Parameter(Power(1.0 + 0.01 / 11)),
                        z=Parameter(Interpolant((1.0, 1.02, 1.1), "linear")),
                    ),
                    Move(LocalFrame(), y=Parameter(Interpolant((0.0, -1.0, -1.5, -3.0)))),
                ),
                role="lung",
                errata=("E10", "E11"),
                note="line one\nline two",
            ),
            Motion("Cartilage 6 left", fields=(blend(Rotate(tilted, "x", smooth)),), role="cartilage", side="left"),
            Motion("Skin", fields=(field,), role="skin"),
            Motion("Fat", fields=(field, profile), role="fat", name_has="subcutaneous"),
        ),
        steps=7,
        period_s=4.2,
        variable="sweep_1",
        targets=Targets(0.5, 31.25),
        description="for tests",
        source="nowhere",
        errata=("E01",),
    )
