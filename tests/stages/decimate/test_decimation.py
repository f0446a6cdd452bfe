"""Decimation of one tissue: target, shape and limits."""

from __future__ import annotations

import numpy as np
import pytest
from shapes import box, joined, moved, sphere

from vhp_cli.errors import UsageError
from vhp_cli.formats import read_mesh
from vhp_cli.inspection.deviation import deviation
from vhp_cli.mesh import Mesh
from vhp_cli.stages.decimate import decimate, error_curve
from vhp_cli.stages.decimate.decimation import default_limit
from vhp_cli.stages.decimate.options import DecimateOptions
from vhp_cli.stages.heal.candidate import judge

METHODS = ("quadric", "midpoint", "removal")


def bumpy(subdivisions=4) -> Mesh:
    ball = sphere(10, subdivisions=subdivisions)
    x, y, z = ball.vertices.T
    vertices = ball.vertices * (1 + 0.05 * np.sin(x) * np.cos(y + 0.5 * z))[:, None]
    return Mesh(vertices.astype(np.float32).astype(float), ball.faces)


def nerve(radius=0.5, bend=30.0, sides=10, rings=300) -> Mesh:
    """A closed tube of 1 mm width and 300 mm length that bends to and fro."""
    x = np.repeat(np.linspace(0, 300, rings), sides)
    angle = np.tile(np.arange(sides) * 2 * np.pi / sides, rings)
    rise = bend * np.sin(x / 40)
    vertices = np.column_stack([x, radius * np.cos(angle), rise + radius * np.sin(angle)])
    vertices = np.vstack([vertices, [0, 0, 0], [300, 0, bend * np.sin(300 / 40)]])
    faces = []
    for ring in range(rings - 1):
        for k in range(sides):
            p, q = ring * sides + k, ring * sides + (k + 1) % sides
            faces += [(p, q, p + sides), (q, q + sides, p + sides)]
    last, start, end = (rings - 1) * sides, rings * sides, rings * sides + 1
    for k in range(sides):
        faces += [(start, (k + 1) % sides, k), (end, last + k, last + (k + 1) % sides)]
    return Mesh(vertices.astype(np.float32).astype(float), np.array(faces))


@pytest.mark.parametrize("method", METHODS)
def test_ratio(method):
    mesh = bumpy()
    made = decimate(mesh, DecimateOptions(ratio=0.34, method=method))
    after = judge(made.mesh)
    assert made.status == "changed"
    assert made.reason == ""
    assert after.sound
    assert 0.3 * len(mesh.faces) < len(made.mesh.faces) <= round(0.34 * len(mesh.faces))
    assert after.min_quality >= 0.3
    assert after.measures["volume_mm3"] == pytest.approx(judge(mesh).measures["volume_mm3"], rel=1e-3)
    assert made.deviation["max"] <= default_limit(judge(mesh))


def test_triangles():
    mesh = bumpy()
    made = decimate(mesh, DecimateOptions(triangles=1000))
    assert 950 <= len(made.mesh.faces) <= 1000
    assert "5120 -> " in made.actions[0]["message"]
    assert made.actions[0]["count"] == len(mesh.faces) - len(made.mesh.faces)


def test_edge_length():
    mesh = bumpy()
    made = decimate(mesh, DecimateOptions(edge_length_mm=1.0))
    edges = judge(made.mesh).measures["edge_mm"]
    assert made.reason == ""
    assert edges["mean"] == pytest.approx(1.0, rel=0.05)


@pytest.mark.parametrize("limit", [0.5, 0.1, 0.05])
def test_limit_alone(limit):
    mesh = bumpy(3)
    made = decimate(mesh, DecimateOptions(max_deviation_mm=limit))
    assert made.status == "changed"
    assert made.reason == ""
    assert judge(made.mesh).sound
    assert deviation(mesh, made.mesh, lost_limit_mm=1)["max"] <= limit
    # A surface that bends by 1/r over edges of length h lies h^2 / 8 r from them: the limit is made use of.
    assert made.deviation["max"] > 0.3 * limit


def test_limit_comes_before_the_target():
    mesh = bumpy()
    made = decimate(mesh, DecimateOptions(ratio=0.05, max_deviation_mm=0.02))
    assert made.deviation["max"] <= 0.02
    assert len(made.mesh.faces) > 256
    assert made.reason.startswith("256 triangles were asked for")
    assert "farther than allowed" in made.reason
    assert f"{len(made.mesh.faces)} triangles are left" in made.reason


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("bend", [0.0, 30.0])
def test_nerve(method, bend):
    mesh = nerve(bend=bend)
    made = decimate(mesh, DecimateOptions(ratio=0.34, method=method))
    after = judge(made.mesh)
    assert made.status == "changed"
    assert after.sound
    # Half of its radius is the default limit for a tube.
    assert made.deviation["max"] <= 0.25
    assert after.measures["volume_mm3"] == pytest.approx(
        judge(mesh).measures["volume_mm3"], rel=1e-3 if method == "quadric" else 0.02
    )
    if method == "quadric":
        assert made.reason == ""


def test_nothing_to_do():
    assert decimate(sphere(), DecimateOptions(ratio=1.0)).status == "unchanged"
    assert decimate(box(), DecimateOptions(triangles=12)).status == "unchanged"


def test_what_can_not_go():
    corners = np.array([[0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 0, 9.0]])
    tetrahedron = Mesh(corners, np.array([(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]))
    assert decimate(tetrahedron, DecimateOptions(triangles=4)).status == "unchanged"
    two = joined(tetrahedron, moved(tetrahedron, (20, 0, 0)))
    made = decimate(two, DecimateOptions(triangles=4))
    assert made.status == "refused"
    assert "manifold" in made.reason


def test_open_surface_keeps_its_rim():
    ball = bumpy()
    cap = Mesh(ball.vertices, ball.faces[ball.vertices[ball.faces].mean(axis=1)[:, 2] > 0])
    before = judge(cap, may_be_open=True)
    made = decimate(cap, DecimateOptions(ratio=0.34))
    after = judge(made.mesh, may_be_open=True)
    assert made.status == "changed"
    assert after.sound
    assert after.measures["topology"]["boundary_edges"] == before.measures["topology"]["boundary_edges"]
    assert len(made.mesh.faces) <= round(0.34 * judge(cap, may_be_open=True).measures["triangles"])


def test_same_input_same_result():
    runs = [decimate(bumpy(3), DecimateOptions(ratio=0.3)) for _ in range(2)]
    assert runs[0].mesh.vertices.tobytes() == runs[1].mesh.vertices.tobytes()
    assert runs[0].mesh.faces.tobytes() == runs[1].mesh.faces.tobytes()


def test_gentler_attempts_move_less():
    options = DecimateOptions(ratio=0.1)
    far = [decimate(bumpy(3), options.gentler(level, 20.0)).deviation["max"] for level in range(3)]
    limit = default_limit(judge(bumpy(3)))
    assert all(each <= limit / 4**level for level, each in enumerate(far))


def test_error_curve():
    errors = error_curve(bumpy(3))
    assert (np.diff(errors) >= 0).all()
    # Down to a tetrahedron.
    assert len(errors) == (len(bumpy(3).faces) - 4) // 2
    assert not len(error_curve(Mesh(np.empty((0, 3)), np.empty((0, 3), int))))


def test_thin_tissue_has_a_small_limit():
    tube, ball = judge(nerve()), judge(sphere(10, subdivisions=4))
    assert default_limit(tube) == pytest.approx(0.25, rel=0.15)
    assert default_limit(ball) == pytest.approx(5e-3 * np.sqrt(3) * 20, rel=0.3)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"ratio": 0}, "ratio"),
        ({"ratio": 1.5}, "ratio"),
        ({"ratio": float("nan")}, "ratio"),
        ({"ratio": True}, "number"),
        ({"triangles": 3}, "at least 4"),
        ({"triangles": 10.5}, "whole"),
        ({"edge-length": -1}, "edge-length"),
        ({"max-deviation": 0}, "max-deviation"),
        ({"target-q": 0.95}, "target-q"),
        ({"method": "quadrics"}, "did you mean 'quadric'"),
        ({"method": 1}, "expected one of"),
        ({"ratios": 1}, "did you mean 'ratio'"),
        ({"ratio": 0.5, "triangles": 100}, "exclude each other"),
    ],
)
def test_wrong_options_are_named(values, message):
    with pytest.raises(UsageError, match=message):
        DecimateOptions().changed(values, "decimate")


def test_target_takes_the_place_of_another():
    options = DecimateOptions(ratio=0.5).changed({"triangles": 100}, "[[tissue]]")
    assert options.targets == ["triangles"]
    assert options.ratio is None


@pytest.mark.slow
def test_real_tissues(shared_data):
    for path in sorted(shared_data.glob("*/*.stl"))[::23]:
        mesh = read_mesh(path).mesh
        before = judge(mesh)
        if not before.sound or len(mesh.faces) > 30_000:
            continue
        made = decimate(mesh, DecimateOptions(ratio=0.34))
        if made.mesh is not None:
            assert judge(made.mesh).sound, path
            assert made.deviation["max"] <= default_limit(before), path
