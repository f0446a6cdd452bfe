from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from shapes import box, flipped, joined, moved, sphere

from vhp_cli import engines
from vhp_cli.engines import tetwild
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


FILLING = {
    "envelope_mm": 0.3,
    "edge_length_mm": 6.0,
    "stop_energy": 10.0,
    "iterations": 80,
    "coarsen": False,
    "threads": 1,
    "sizing": None,
}


def test_tetrahedra_of_nested_and_open_surfaces(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    given = joined(sphere(10), moved(sphere(4), (3, 0, 0)), Mesh(box().vertices + 30, box().faces[2:]))
    said = bytearray()
    points, tetrahedra = engines.call_volume(
        "tetwild-volume", given, timeout_s=TIMEOUT, on_output=said.extend, **FILLING
    )
    corners = points[tetrahedra]
    sizes = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6
    assert sizes.min() > 0
    # All of a box around the surfaces.
    assert sizes.sum() == pytest.approx(np.prod(np.ptp(points, axis=0)))
    assert (points.min(axis=0) < -10).all() and (points.max(axis=0) > 40).all()
    inner = np.linalg.norm(corners.mean(axis=1) - [3, 0, 0], axis=1) < 3.9
    assert sizes[inner].sum() == pytest.approx(4 / 3 * np.pi * 4**3, rel=0.2)
    # What it prints and leaves behind is kept from the user.
    assert b"max_energy" in said
    assert capfd.readouterr() == ("", "") and not any(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("vertices", "faces", "said"),
    [
        (np.zeros((3, 3)), np.empty((0, 3), np.int32), "no triangles"),
        (np.array([[0, 0, 0], [1, 0, 0], [0, np.nan, 1.0]]), np.array([[0, 1, 2]]), "not finite"),
        (np.array([[0, 0, 0], [1, 0, 0], [0, 1.0, 0]]), np.array([[0, 1, 2]]), "one plane"),
    ],
)
def test_what_would_crash_the_mesher_is_refused(vertices, faces, said):
    with pytest.raises(CallFailed, match=rf"^tetwild-volume \(pytetwild\): ValueError: .*{said}") as caught:
        engines.call_volume("tetwild-volume", Mesh(vertices, faces), timeout_s=TIMEOUT, **FILLING)
    assert caught.value.reason == "error"
    with pytest.raises(ValueError, match="does not exist"):
        tetwild.tetrahedralize(sphere().vertices, sphere().faces + 1, FILLING)


@pytest.mark.slow
def test_a_sizing_field_makes_edges_short_where_it_says_so():
    corners = np.array([[x, y, z] for x in (-15.0, 15) for y in (-15.0, 15) for z in (-15.0, 15)])
    cells = np.array([(0, 4, 6, 7), (0, 6, 2, 7), (0, 2, 3, 7), (0, 3, 1, 7), (0, 1, 5, 7), (0, 5, 4, 7)], np.int32)
    counts = []
    for sizing in (None, (corners, cells, np.full(8, 1.5))):
        options = {**FILLING, "sizing": sizing}
        counts.append(len(engines.call_volume("tetwild-volume", sphere(10), timeout_s=TIMEOUT, **options)[1]))
    assert counts[1] > 2 * counts[0]


def test_tetrahedra_that_are_none_are_not_believed(monkeypatch):
    known = dict(engines.ENGINES)
    monkeypatch.setattr(engines, "ENGINES", known)
    for target, said in (("no_tetrahedra", "no tetrahedra"), ("wild_points", "not finite"), ("lost_corners", "exist")):
        known["tetwild-volume"] = replace(known["tetwild-volume"], target=f"process_targets:{target}")
        with pytest.raises(CallFailed, match=said):
            engines.call_volume("tetwild-volume", sphere(), timeout_s=TIMEOUT)
