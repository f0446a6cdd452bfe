from __future__ import annotations

import numpy as np
import pytest
from shapes import box, flipped, joined, moved, sphere

from vhp_cli import engines
from vhp_cli.kernels import surface
from vhp_cli.kernels.spatial import Tree
from vhp_cli.mesh import Mesh
from vhp_cli.processes import CallFailed

TIMEOUT = 60.0


def require(name):
    engine = engines.ENGINES[name]
    if not engine.available:
        pytest.skip(f"{engine.distribution} is not installed")


@pytest.fixture(autouse=True, scope="module")
def _ended():
    yield
    child, _ = getattr(engines._local, "child", (None, None))
    if child is not None:
        child.close()


def volume(mesh):
    topology = surface.topology(mesh.vertices, mesh.faces)
    assert not len(topology.boundary_edges)
    assert not len(topology.inconsistent_edges)
    return surface.quality(mesh.vertices, mesh.faces, topology.component, topology.n_components).volume


def is_sound(mesh):
    topology = surface.topology(mesh.vertices, mesh.faces)
    return (
        not len(topology.boundary_edges)
        and not len(topology.nonmanifold_edges)
        and not len(topology.nonmanifold_vertices)
        and not len(topology.inconsistent_edges)
        and Tree(mesh.vertices, mesh.faces).self_hits().n_pairs == 0
    )


def test_table_is_complete():
    for engine in engines.ENGINES.values():
        assert engine.licence
        assert engine.purpose
        assert engine.available == bool(engine.version)


@pytest.mark.parametrize("name", ["union", "component-union"])
def test_union_of_two_boxes(pymeshlab, name):
    require(name)
    overlapping = joined(box(), moved(box(), (5.5, 4.5, 3.5)))
    united = engines.call(name, overlapping, timeout_s=TIMEOUT)
    assert is_sound(united)
    assert volume(united) == pytest.approx(2000 - 4.5 * 5.5 * 6.5)
    # Corners that are kept are not moved at all.
    kept = {tuple(vertex) for vertex in united.vertices} & {tuple(vertex) for vertex in overlapping.vertices}
    assert len(kept) == 14


@pytest.mark.parametrize("name", ["union", "component-union"])
def test_union_keeps_cavities(pymeshlab, name):
    require(name)
    hollow = joined(sphere(10), flipped(sphere(5)))
    assert volume(engines.call(name, hollow, timeout_s=TIMEOUT)) == pytest.approx(volume(hollow))


def test_union_of_either_sign_keeps_an_inverted_pocket(pymeshlab):
    # A cavity that sticks out of its wall: outside of the box its winding number is -1.
    pocket = joined(box(), flipped(moved(box((0, 0, 0), (4, 4, 4)), (8, 3, 3))))
    assert volume(engines.call("union", pocket, timeout_s=TIMEOUT)) == pytest.approx(1000 - 2 * 16)
    either = engines.call("union", pocket, timeout_s=TIMEOUT, either_sign=True)
    assert volume(either) == pytest.approx(1000 - 2 * 16 + 2 * 16)


def test_union_refuses_an_open_surface(pymeshlab):
    opened = Mesh(box().vertices, box().faces[1:])
    with pytest.raises(CallFailed, match=r"^union \(pymeshlab\): ") as caught:
        engines.call("union", opened, timeout_s=TIMEOUT)
    assert caught.value.reason == "error"


def test_union_of_nothing_is_a_failure(pymeshlab):
    with pytest.raises(CallFailed, match="returned no faces"):
        engines.call("union", flipped(box()), timeout_s=TIMEOUT)


def test_wrap_closes_a_hole(pymeshlab):
    opened = Mesh(sphere().vertices, sphere().faces[3:])
    wrapped = engines.call("wrap", opened, timeout_s=TIMEOUT, alpha_mm=4.0, offset_mm=0.1)
    assert is_sound(wrapped)
    assert volume(wrapped) == pytest.approx(volume(sphere()), rel=0.05)
    assert np.linalg.norm(wrapped.vertices, axis=1).max() <= 10.11


def test_wrap_sizes_are_in_millimetres(pymeshlab):
    coarse = engines.call("wrap", sphere(), timeout_s=TIMEOUT, alpha_mm=8.0, offset_mm=1.0)
    fine = engines.call("wrap", sphere(), timeout_s=TIMEOUT, alpha_mm=2.0, offset_mm=0.05)
    assert len(coarse.faces) < len(fine.faces)
    assert np.linalg.norm(coarse.vertices, axis=1).max() == pytest.approx(11, abs=0.05)


def test_envelope_of_two_spheres():
    overlapping = joined(sphere(10), moved(sphere(10), (12, 0, 0)))
    rebuilt = engines.call("tetwild", overlapping, timeout_s=TIMEOUT, envelope_mm=0.05, edge_length_mm=5.0)
    # The lens that two caps of height h = 10 - 6 enclose counts once.
    lens = 2 * np.pi * 4**2 * (3 * 10 - 4) / 3
    assert volume(rebuilt) == pytest.approx(2 * volume(sphere(10)) - lens, rel=0.02)
    assert len(surface.topology(rebuilt.vertices, rebuilt.faces).boundary_edges) == 0


def test_meshfix_keeps_every_component_and_its_orientation():
    require("meshfix")
    hollow = joined(sphere(10), flipped(sphere(5)), moved(sphere(3), (30, 0, 0)))
    fixed = engines.call("meshfix", Mesh(hollow.vertices, hollow.faces[2:]), timeout_s=TIMEOUT)
    assert is_sound(fixed)
    assert surface.topology(fixed.vertices, fixed.faces).n_components == 3
    assert volume(fixed) == pytest.approx(volume(hollow), rel=0.01)


def test_timeout_names_the_engine(pymeshlab):
    with pytest.raises(CallFailed) as caught:
        engines.call("wrap", sphere(subdivisions=4), timeout_s=1.5, alpha_mm=0.02, offset_mm=0.001)
    assert caught.value.reason == "timeout"
    assert str(caught.value) == "wrap (pymeshlab): took more than 1.5 s"


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("union", {}),
        ("union", {"either_sign": True}),
        ("component-union", {}),
        ("wrap", {"alpha_mm": 4.0, "offset_mm": 0.2}),
        ("tetwild", {"envelope_mm": 0.1, "edge_length_mm": 6.0}),
        ("meshfix", {}),
    ],
)
def test_same_input_gives_the_same_bytes(pymeshlab, name, options):
    require(name)
    overlapping = joined(sphere(10), moved(sphere(10), (11, 1, 2)))
    if not engines.ENGINES[name].deterministic:
        pytest.skip("not deterministic")

    def result():
        found = engines.call(name, overlapping, timeout_s=TIMEOUT, **options)
        return found.vertices.tobytes(), found.faces.tobytes()

    first = result()
    assert result() == first
    engines._local.child[0].close()
    assert result() == first
