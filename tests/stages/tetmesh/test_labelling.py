"""Which tissue a tetrahedron belongs to."""

from __future__ import annotations

import numpy as np
import pytest
from shapes import box, flipped, joined, moved, sphere
from tetrahedron_grids import grid

from vhp_cli.kernels.spatial import Tree
from vhp_cli.mesh import Mesh
from vhp_cli.stages.tetmesh.labelling import (
    enclosed_volume,
    in_box,
    label_tetrahedra,
    precedence,
    smallest_containers,
    within,
    within_solid,
)
from vhp_cli.stages.tetmesh.tissues import Tissue, trees
from vhp_cli.volume import volumes


def tissue(name, mesh, volume=1.0, **more):
    return Tissue(name, mesh, volume, **more)


def cells(size=24.0, count=16):
    points, tetrahedra = grid(count, size)
    return points - size / 2, tetrahedra


def labels_of(*surfaces, order=None, **more):
    tissues = [tissue(str(number), surface, **more) for number, surface in enumerate(surfaces)]
    points, tetrahedra = cells()
    found = label_tetrahedra(points, tetrahedra, trees(tissues), order or range(len(tissues)))
    return points[tetrahedra].mean(axis=1), found, volumes(points, tetrahedra)


def test_the_last_one_wins():
    centroids, found, sizes = labels_of(sphere(11), sphere(6))
    distance = np.linalg.norm(centroids, axis=1)
    # The facets lie within the sphere.
    assert set(found.labels[distance < 5.7]) == {2}
    assert set(found.labels[(distance > 6) & (distance < 10.4)]) == {1}
    assert set(found.labels[distance > 11]) == {0}
    assert found.enclosed(sizes) == pytest.approx([sizes[found.labels > 0].sum(), sizes[found.labels == 2].sum()])
    _, other, _ = labels_of(sphere(11), sphere(6), order=[1, 0])
    assert set(other.labels) == {0, 1}


def test_what_lies_in_another_is_looked_for_only_there():
    points, tetrahedra = cells()
    surfaces = trees([tissue("a", sphere(9)), tissue("b", sphere(5))])
    plain = label_tetrahedra(points, tetrahedra, surfaces, [0, 1])
    quick = label_tetrahedra(points, tetrahedra, surfaces, [0, 1], parents=[None, 0])
    assert (quick.labels == plain.labels).all() and (quick.within[1] == plain.within[1]).all()
    other = label_tetrahedra(points, tetrahedra, surfaces, [0, 1], parents=[1, None])
    assert (other.labels == plain.labels).all()
    sizes = [3.0, 1.0, 2.0]
    tissues = [tissue(name, box()) for name in "abc"]
    inside = {"b": frozenset("ac"), "c": frozenset("a")}
    assert smallest_containers(tissues, sizes, inside) == [None, 2, 0]


def test_the_number_of_threads_and_chunks_does_not_matter(monkeypatch):
    points, tetrahedra = cells()
    surfaces = trees([tissue("a", sphere(9)), tissue("b", moved(sphere(5), (3, 0, 0)))])
    first = label_tetrahedra(points, tetrahedra, surfaces, [0, 1], threads=1).labels
    monkeypatch.setattr("vhp_cli.stages.tetmesh.labelling._CHUNK", 1000)
    assert (label_tetrahedra(points, tetrahedra, surfaces, [0, 1], threads=3).labels == first).all()


SOUND = sphere(9, subdivisions=3)


def defective(kind):
    rng = np.random.default_rng(0)
    faces = SOUND.faces.copy()
    if kind == "inside out":
        return flipped(SOUND), ("T005",)
    if kind == "a third of the faces turned":
        chosen = rng.random(len(faces)) < 0.33
        faces[chosen] = faces[chosen, ::-1]
        return Mesh(SOUND.vertices, faces), ("T004",)
    if kind == "small holes":
        return Mesh(SOUND.vertices, faces[rng.random(len(faces)) > 0.01]), ("T001",)
    if kind == "doubled faces":
        return Mesh(SOUND.vertices, np.concatenate((faces, faces[:300]))), ("T006",)
    return joined(SOUND, moved(sphere(4), (7, 0, 0))), ("X001",)


@pytest.mark.parametrize(
    ("kind", "wrong"),
    [
        ("inside out", 0.0),
        ("a third of the faces turned", 0.0),
        ("small holes", 0.01),
        ("doubled faces", 0.005),
        ("a part that crosses another", 0.0),
    ],
)
def test_defective_surfaces(kind, wrong):
    surface, defects = defective(kind)
    centroids, found, _ = labels_of(surface, defects=defects)
    _, sound, _ = labels_of(SOUND)
    expected = sound.labels == 1
    if "crosses" in kind:
        expected |= labels_of(moved(sphere(4), (7, 0, 0)))[1].labels == 1
    assert ((found.labels == 1) != expected).mean() <= wrong
    assert expected.any() and not expected.all() and len(centroids)


def test_regions_are_labelled_as_a_whole():
    points, tetrahedra = cells()
    centroids = points[tetrahedra].mean(axis=1)
    regions = (centroids[:, 0] > 0).astype(np.int32)
    surface = trees([tissue("half", box((0, -12, -12), (12, 12, 12)))])
    found = label_tetrahedra(points, tetrahedra, surface, [0], regions=regions)
    assert (found.labels == regions).all()
    assert found.enclosed(volumes(points, tetrahedra)) == pytest.approx([24**3 / 2])


def names(order, tissues):
    return [tissues[index].name for index in order]


def test_precedence():
    tissues = [tissue(name, box(), priority=high) for name, high in (("a", 0), ("b", 0), ("c", 1), ("d", 0))]
    sizes = [5.0, 9.0, 7.0, 5.0]
    # The large first, of equal ones by name; priority before size.
    assert names(precedence(tissues, sizes, {}), tissues) == ["b", "a", "d", "c"]
    # What lies in another comes after it, whatever sizes and priorities say.
    inside = {"b": frozenset("ac"), "c": frozenset("a")}
    assert names(precedence(tissues, sizes, inside), tissues) == ["a", "d", "c", "b"]
    # A circle can only be a mistake: nothing is lost.
    circle = {"a": frozenset("b"), "b": frozenset("a")}
    assert sorted(precedence(tissues, sizes, circle)) == [0, 1, 2, 3]


def test_volume_of_an_open_surface_is_estimated():
    opened = Mesh(SOUND.vertices, SOUND.faces[8:])
    estimate = enclosed_volume(tissue("x", opened, None), *trees([tissue("x", opened, None)]))
    assert estimate == pytest.approx(4 / 3 * np.pi * 9**3, rel=0.03)
    assert enclosed_volume(tissue("x", opened, -17.0), *trees([tissue("x", opened)])) == 17.0


def test_box():
    points, tetrahedra = cells(10.0, 5)
    inside = in_box(points, tetrahedra, (np.array([-1.0, -5, -5]), np.array([3.0, 5, 5])))
    assert volumes(points, tetrahedra)[inside].sum() == pytest.approx(400)


def test_cells_far_from_a_solid_are_asked_for_once(monkeypatch):
    """The same answers as one by one, with far fewer questions."""
    outer, inner = sphere(10.0, subdivisions=4), sphere(4.0, subdivisions=3)
    hollow = Tree(
        np.concatenate((outer.vertices, inner.vertices)),
        np.concatenate((outer.faces, inner.faces[:, ::-1] + len(outer.vertices))).astype(np.int32),
    )
    points = np.random.default_rng(0).uniform(-12, 12, (20_000, 3))
    asked = []
    real = Tree.winding
    monkeypatch.setattr(Tree, "winding", lambda tree, places: asked.append(len(places)) or real(tree, places))
    each = within(hollow, points)
    one_by_one, asked[:] = sum(asked), []
    assert (within_solid(hollow, points) == each).all()
    assert 0 < sum(asked) < 0.7 * one_by_one
    assert 0.2 < each.mean() < 0.4
    few = points[:10]
    assert (within_solid(hollow, few) == within(hollow, few)).all()
    nothing = Tree(np.empty((0, 3)), np.empty((0, 3), np.int32))
    assert not within_solid(nothing, few).any()
