"""The route that keeps every triangle: TetGen, Gmsh and MMG, where they are installed."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from shapes import box, flipped, moved, sphere
from tetrahedron_grids import grid

from vhp_cli import engines
from vhp_cli.errors import UsageError
from vhp_cli.inspection.tetrahedra import tetrahedron_quality
from vhp_cli.mesh import Mesh
from vhp_cli.processes import CallFailed
from vhp_cli.stages.tetmesh import keep_surface as module
from vhp_cli.stages.tetmesh.keep_surface import (
    improved,
    installed_engine,
    keep_surface,
    missing_triangles,
    regions_between,
    relaxed,
    united,
)
from vhp_cli.volume import volumes

TIMEOUT = 60.0


def need(*names):
    for name in names:
        engine = engines.ENGINES[name]
        if not engine.available:
            pytest.skip(f"{engine.distribution} is not installed")
        if name == "gmsh":
            # It is installed, but may lack libraries of the system.
            done = subprocess.run([sys.executable, "-c", "import gmsh"], capture_output=True, text=True, check=False)
            if done.returncode:
                pytest.skip(f"gmsh can't be imported: {done.stderr.strip().splitlines()[-1]}")


def enclosed(mesh):
    a, b, c = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def faces_as_coordinates(points, tetrahedra):
    """Return every face of every tetrahedron as the bytes of its sorted corners: no code of the package."""
    found = set()
    for corners in np.asarray(points)[np.asarray(tetrahedra)]:
        for left_out in range(4):
            found.add(tuple(sorted(corners[k].tobytes() for k in range(4) if k != left_out)))
    return found


NESTED = [
    sphere(20),
    sphere(14, (1, 0, 0)),
    flipped(sphere(3, (6, 0, 0), 1)),
    sphere(4, (-6, 0, 0), 1),
    sphere(3, (40, 0, 0), 1),
]


@pytest.mark.parametrize("engine", ["tetgen", "gmsh"])
@pytest.mark.parametrize("improve", [False, True])
def test_nested_surfaces_are_kept(engine, improve):
    need(engine, *(["mmg"] if improve else []))
    made = keep_surface(NESTED, engine=engine, improve=improve, timeout_s=TIMEOUT)
    there = faces_as_coordinates(made.points, made.tetrahedra)
    for surface in NESTED:
        for face in surface.faces:
            assert tuple(sorted(surface.vertices[vertex].tobytes() for vertex in face)) in there
    sizes = volumes(made.points, made.tetrahedra)
    assert sizes.min() > 0
    volume_of = [abs(enclosed(surface)) for surface in NESTED]
    outer, inner, hole, organ, apart = volume_of
    expected = sorted([outer - inner, inner - hole - organ, hole, organ, apart])
    assert sorted(np.bincount(made.regions, sizes)) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("engine", ["tetgen", "gmsh"])
def test_a_shorter_edge_length_gives_more_tetrahedra(engine):
    need(engine)
    surfaces = [sphere(20, subdivisions=1)]
    coarse, fine = (
        keep_surface(surfaces, engine=engine, edge_length_mm=length, improve=False, timeout_s=TIMEOUT)
        for length in (20.0, 3.0)
    )
    assert len(fine.tetrahedra) > 4 * len(coarse.tetrahedra)
    assert not len(missing_triangles(united(surfaces), fine.points, fine.tetrahedra))


def test_tissues_that_share_triangles_are_joined():
    need("tetgen")
    neighbours = [box(), moved(box(), (10, 0, 0))]
    assert len(united(neighbours).faces) == 22
    made = keep_surface(neighbours, engine="tetgen", improve=False, timeout_s=TIMEOUT)
    sizes = volumes(made.points, made.tetrahedra)
    assert np.bincount(made.regions, sizes).tolist() == pytest.approx([1000.0, 1000.0])


def test_gmsh_names_surfaces_that_touch():
    need("gmsh")
    with pytest.raises(CallFailed, match="surfaces touch each other"):
        keep_surface([box(), moved(box(), (10, 0, 0))], engine="gmsh", timeout_s=TIMEOUT)


@pytest.mark.parametrize("engine", ["tetgen", "gmsh"])
def test_what_crosses_is_refused(engine):
    need(engine)
    with pytest.raises(CallFailed, match=f"^{engine} "):
        keep_surface([box(), moved(box(), (5, 4, 3))], engine=engine, timeout_s=TIMEOUT)


@pytest.mark.parametrize("engine", ["tetgen", "gmsh"])
def test_an_open_surface_is_refused(engine):
    need(engine)
    opened = Mesh(box().vertices, box().faces[1:])
    with pytest.raises(CallFailed, match=f"^{engine} "):
        keep_surface([opened], engine=engine, improve=False, timeout_s=TIMEOUT)


@pytest.mark.parametrize("engine", ["tetgen", "gmsh"])
def test_the_same_surfaces_give_the_same_bytes(engine):
    need(engine)
    surfaces = [sphere(20, subdivisions=1), sphere(3, (5, 0, 0), 0)]
    first, second = (keep_surface(surfaces, engine=engine, timeout_s=TIMEOUT) for _ in range(2))
    assert first.points.tobytes() == second.points.tobytes()
    assert first.tetrahedra.tobytes() == second.tetrahedra.tobytes()


def least_angle(mesh):
    return tetrahedron_quality(mesh.points, mesh.tetrahedra).min_dihedral_deg.min()


def test_shapes_are_bettered_between_the_triangles():
    need("tetgen")
    plain = keep_surface(NESTED, engine="tetgen", improve=False, timeout_s=TIMEOUT)
    triangles = united(NESTED)
    better = relaxed(plain, triangles)
    assert least_angle(better) > least_angle(plain) + 3
    assert not len(missing_triangles(triangles, better.points, better.tetrahedra))
    assert (better.regions == regions_between(triangles, better.points, better.tetrahedra)).all()
    sizes = [np.bincount(mesh.regions, volumes(mesh.points, mesh.tetrahedra)) for mesh in (plain, better)]
    assert sizes[1] == pytest.approx(sizes[0], rel=1e-9)


def test_mmg_makes_better_shapes_or_leaves_them():
    need("tetgen", "mmg")
    plain = keep_surface(NESTED, engine="tetgen", improve=False, timeout_s=TIMEOUT)
    better = keep_surface(NESTED, engine="tetgen", improve=True, timeout_s=TIMEOUT)
    assert plain.notes == ()
    assert least_angle(better) > least_angle(plain) + 5
    assert "improved by mmg: " in better.notes[0]
    by_mmg = improved(plain, united(NESTED), timeout_s=TIMEOUT)
    assert least_angle(by_mmg) > least_angle(plain) + 5
    assert by_mmg.notes[0].startswith("improved by mmg: smallest dihedral angle from")


# With an engine in the place of the real ones


@pytest.fixture
def answers(monkeypatch):
    """Let engines return what the test says."""
    found = {}

    def answer(name, mesh, **_options):
        return found[name](mesh) if callable(found[name]) else found[name]

    monkeypatch.setattr(engines, "call_volume", answer)
    monkeypatch.setattr(engines.Engine, "available", property(lambda engine: engine.module in found or "mmg" in found))
    return found


def cube():
    points, tetrahedra = grid(1)
    return points, tetrahedra, Mesh(points, boundary(tetrahedra))


def boundary(tetrahedra):
    sides = np.concatenate([tetrahedra[:, list(side)] for side in ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))])
    _, first, count = np.unique(np.sort(sides, axis=1), axis=0, return_index=True, return_counts=True)
    return sides[first[count == 1]]


def test_a_lost_triangle_is_never_accepted(answers):
    points, tetrahedra, surface = cube()
    answers["tetgen"] = points, tetrahedra
    assert len(keep_surface([surface], engine="tetgen").tetrahedra) == 6
    answers["tetgen"] = points, tetrahedra[1:]
    with pytest.raises(CallFailed, match=r"tetgen \(tetgen\): 2 of 12 triangles are not in its mesh, the first at \("):
        keep_surface([surface], engine="tetgen")
    nudged = points.copy()
    nudged[0, 0] = np.nextafter(10.0, 11.0) - 10.0
    answers["tetgen"] = nudged, tetrahedra
    with pytest.raises(CallFailed, match="of 12 triangles are not in its mesh"):
        keep_surface([surface], engine="tetgen")


def test_a_mesh_turned_as_a_whole_is_turned_back_and_a_single_tetrahedron_is_not(answers):
    points, tetrahedra, surface = cube()
    answers["tetgen"] = points, tetrahedra[:, [1, 0, 2, 3]]
    made = keep_surface([surface], engine="tetgen")
    assert (volumes(made.points, made.tetrahedra) > 0).all()
    one = tetrahedra.copy()
    one[2] = one[2][[1, 0, 2, 3]]
    answers["tetgen"] = points, one
    made = keep_surface([surface], engine="tetgen")
    assert (volumes(made.points, made.tetrahedra) > 0).tolist() == [True, True, False, True, True, True]


def test_mmg_that_fails_or_loses_or_worsens_is_not_believed(answers):
    points, tetrahedra, surface = cube()
    answers["tetgen"] = points, tetrahedra

    def fail(_mesh):
        raise CallFailed("crash", "mmg (mmgpy): crashed with SIGSEGV")

    middle = np.append(points, [[5.0, 5.0, 0.1]], axis=0)
    walls = boundary(tetrahedra)
    fan = np.column_stack((walls[:, [0, 2, 1]], np.full(12, 8)))
    flat = fan[volumes(middle, fan) > 0]
    assert len(flat) == 12
    for answer, why in (
        (fail, "crashed with SIGSEGV"),
        ((points, tetrahedra[1:]), "it lost triangles"),
        ((points, tetrahedra), "the smallest dihedral angle would go from 45.00 to 45.00"),
        ((middle, flat), "the smallest dihedral angle would go from 45.00 to "),
    ):
        answers["mmg"] = answer
        made = keep_surface([surface], engine="tetgen")
        assert np.array_equal(made.tetrahedra, tetrahedra)
        assert len(made.notes) == 1 and made.notes[0].startswith("not improved by mmg: ") and why in made.notes[0]


def test_regions_are_what_triangles_part(monkeypatch):
    points, tetrahedra = grid(4)
    centres = points[tetrahedra].mean(axis=1)
    inside = (np.abs(centres - 5.0) < 2.5).all(axis=1)
    walls = Mesh(points, boundary(tetrahedra[inside]))
    regions = regions_between(walls, points, tetrahedra)
    assert set(regions[inside]) | set(regions[~inside]) == {0, 1}
    assert len(set(regions[inside])) == len(set(regions[~inside])) == 1
    # A hole in the wall joins them.
    opened = Mesh(walls.vertices, walls.faces[1:])
    assert regions_between(opened, points, tetrahedra).max() == 0


def test_points_at_one_place_count_as_one():
    points, tetrahedra, surface = cube()
    doubled = np.concatenate((points, points))
    apart = tetrahedra + np.array([0, 8, 0, 8, 0, 8])[:, None]
    assert not len(missing_triangles(united([surface]), doubled, apart))


def test_the_installed_engine_is_chosen(monkeypatch):
    present = {"gmsh"}
    monkeypatch.setattr(engines.Engine, "available", property(lambda engine: engine.module in present))
    assert installed_engine() == "gmsh"
    with pytest.raises(UsageError, match=r"needs tetgen \(AGPL-3.0-or-later\), which is not installed") as caught:
        installed_engine("tetgen")
    assert "vhp-cli[tetgen]" in caught.value.hint
    present.clear()
    with pytest.raises(UsageError, match=r"tetgen \(AGPL-3.0-or-later\) or gmsh \(GPL-2.0-or-later\)"):
        installed_engine()


def test_too_many_vertices_are_refused_not_confused(monkeypatch):
    monkeypatch.setattr(module, "_BITS", 3)
    with pytest.raises(CallFailed, match="8 vertices are too many"):
        united([box()])
