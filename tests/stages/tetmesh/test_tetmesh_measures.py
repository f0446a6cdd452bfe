"""What is measured on a labelled mesh."""

from __future__ import annotations

import numpy as np
import pytest
from shapes import box, sphere
from tetrahedron_grids import grid

from vhp_cli.inspection.adjacency import adjacency
from vhp_cli.stages.tetmesh.measuring import Truth, measure_mesh, nonconformity, truths
from vhp_cli.stages.tetmesh.surfaces import tissue_surfaces
from vhp_cli.stages.tetmesh.tissues import Relations, Tissue
from vhp_cli.volume import VolumeMesh

POINTS, TETRAHEDRA = grid(4, 8.0)
CENTROIDS = POINTS[TETRAHEDRA].mean(axis=1)


def measured(mesh, known=None, enclosed=None):
    tissues = [Tissue(name, box(), 1.0, defects=("T001",) if name == "organ" else ()) for name in mesh.names]
    known = known or [Truth(1.0, False, 1.0, False, None)] * len(tissues)
    return measure_mesh(mesh, tissues, known, np.zeros(len(tissues)) if enclosed is None else enclosed, {1: 7})


def halves(names=("body", "organ")):
    return VolumeMesh(POINTS, TETRAHEDRA, np.where(CENTROIDS[:, 0] < 4, 1, 2), names)


def test_volumes_and_areas():
    known = [Truth(250.0, True, 512.0, True, 1), Truth(0.0, False, 200.0, True, 2)]
    found = measured(halves(), known, np.array([512.0, 256.0]))
    body, organ = found.labels
    assert body["volume_mm3"] == organ["volume_mm3"] == pytest.approx(256)
    assert body["volume_error"] == pytest.approx(256 / 250 - 1)
    # Where the volume of the label is not known, all that is within the surface is compared.
    assert organ["volume_error"] == pytest.approx(256 / 200 - 1)
    assert body["tets"] == organ["tets"] == len(TETRAHEDRA) / 2
    assert (body["relabelled_tets"], organ["relabelled_tets"]) == (7, 0)
    assert organ["defects"] == ["T001"] and organ["expected_parts"] == 2 and organ["parts"] == 1
    areas = {(face["a"], face["b"]): face["area_mm2"] for face in found.interfaces}
    outer = 64 + 4 * 32
    assert areas == {
        ("body", "organ"): pytest.approx(64), ("body", ""): pytest.approx(outer), ("organ", ""): pytest.approx(outer)
    }  # fmt: skip
    assert body["boundary"]["area_mm2"] == pytest.approx(64 + outer)
    assert not found.nonconforming and found.air is None


def test_a_lost_tissue_and_air():
    mesh = VolumeMesh(POINTS, TETRAHEDRA, np.where(CENTROIDS[:, 0] < 4, 0, 2), ("lost", "body"))
    found = measured(mesh)
    assert found.labels[0]["tets"] == 0 and found.labels[0]["quality"] is None and found.labels[0]["parts"] == 0
    assert found.air["tets"] == len(TETRAHEDRA) / 2
    assert {(face["a"], face["b"]) for face in found.interfaces} == {("air", ""), ("body", ""), ("body", "air")}


def test_quality_is_that_of_the_tissues_not_of_the_air():
    points = POINTS.copy()
    # A corner of the air is pushed in until its tetrahedra are nearly flat.
    corner = np.flatnonzero((points == 0).all(axis=1))[0]
    points[corner] = [1.9, 1.9, 1.9]
    air = VolumeMesh(points, TETRAHEDRA, np.where(CENTROIDS[:, 0] < 4, 0, 1), ("body",))
    found = measured(air)
    assert found.quality["radius_ratio_min"] > 0.5 > found.air["quality"]["radius_ratio_min"]
    assert found.quality["inverted"] == 0
    points[corner] = [2.1, 2.1, 2.1]
    turned = measured(VolumeMesh(points, TETRAHEDRA, np.ones(len(TETRAHEDRA)), ("body",)))
    assert turned.quality["inverted"] == 6 and turned.quality["scaled_jacobian_min"] < 0
    assert all(place["value"] < 0 for place in turned.places[1]["M004"][:6])
    assert np.abs(np.array(turned.places[1]["M004"][0]["xyz_mm"])).max() < 2.1


def test_non_manifold_boundaries_and_parts():
    cell = np.floor(CENTROIDS / 2).astype(int)
    edge = [(1, 1, 1), (2, 2, 1)]
    corner = [(0, 0, 0), (3, 3, 3)]
    organ = np.any([(cell == each).all(axis=1) for each in edge], axis=0)
    nerve = np.any([(cell == each).all(axis=1) for each in [(0, 0, 3), (1, 1, 2), *corner]], axis=0)
    mesh = VolumeMesh(POINTS, TETRAHEDRA, np.where(organ, 2, np.where(nerve, 3, 1)), ("body", "organ", "nerve"))
    known = [Truth(1.0, True, 1.0, True, number) for number in (1, 2, 1)]
    found = measured(mesh, known)
    _, on_edge, at_corner = found.labels
    assert on_edge["boundary"]["nonmanifold_edges"] == 1 and on_edge["parts"] == 2
    assert at_corner["boundary"]["nonmanifold_edges"] == 0 and at_corner["boundary"]["nonmanifold_vertices"] == 1
    assert found.places[2]["M009"] == [{"xyz_mm": [4.0, 4.0, 3.0], "face": None}]
    assert found.places[3]["M010"] == [{"xyz_mm": [2.0, 2.0, 6.0], "face": None}]
    assert "M011" not in found.places[2] and len(found.places[3]["M011"]) == 3


def broken(kind):
    if kind == "hanging point":
        # One half with twice as many cells.
        fine, fine_tetrahedra = grid(8, 8.0)
        kept = fine[fine_tetrahedra].mean(axis=1)[:, 0] < 4
        coarse = CENTROIDS[:, 0] > 4
        points = np.concatenate((fine, POINTS))
        tetrahedra = np.concatenate((fine_tetrahedra[kept], TETRAHEDRA[coarse] + len(fine)))
        joined, index = np.unique(points, axis=0, return_inverse=True)
        return joined, index.ravel()[tetrahedra].astype(np.int32)
    if kind == "overlap":
        return np.concatenate((POINTS, POINTS + 0.5)), np.concatenate((TETRAHEDRA, TETRAHEDRA[:1] + len(POINTS)))
    return POINTS, np.concatenate((TETRAHEDRA, TETRAHEDRA[40:41]))


@pytest.mark.parametrize("kind", ["hanging point", "overlap", "doubled"])
def test_meshes_that_do_not_conform(kind):
    points, tetrahedra = broken(kind)
    mesh = VolumeMesh(points, tetrahedra, np.ones(len(tetrahedra)), ("body",))
    assert nonconformity(mesh, adjacency(mesh.tetrahedra))


def tissue(name, volume):
    return Tissue(name, sphere(1), volume)


def test_what_the_surfaces_say():
    tissues = [tissue("body", 100.0), tissue("organ", 30.0), tissue("vessel", 2.0), tissue("bone", 10.0)]
    nested = {"organ": frozenset({"body"}), "vessel": frozenset({"body", "organ"}), "bone": frozenset({"body"})}
    sizes = [100.0, 30.0, 2.0, 10.0]
    found = truths(tissues, sizes, Relations(nested), [0, 1, 2, 3], [1, 1, None, 1])
    assert [truth.volume_mm3 for truth in found] == [60, 28, 2, 10]
    assert all(truth.exact for truth in found) and found[2].parts is None
    crossing = truths(tissues, sizes, Relations(nested, {("bone", "organ"): 3.0}), [0, 3, 1, 2], [1] * 4)
    assert [truth.volume_mm3 for truth in crossing] == [60, 28, 2, 7]
    assert [truth.exact for truth in crossing] == [False, False, True, False]
    tissues[2] = tissue("vessel", None)
    opened = truths(tissues, sizes, Relations(nested), [0, 1, 2, 3], [1] * 4)
    assert [truth.exact for truth in opened] == [True, False, False, True]
    assert [truth.enclosed_exact for truth in opened] == [True, True, False, True]


def test_surfaces_hold_what_lies_in_them():
    inner = np.where((np.abs(CENTROIDS - 4) < 2).all(axis=1), 2, 1)
    mesh = VolumeMesh(POINTS, TETRAHEDRA, inner, ("body", "organ"))
    filled = tissue_surfaces(mesh, {"organ": frozenset({"body"})})
    assert filled["body"].faces.shape == (6 * 16 * 2, 3)
    assert np.ptp(filled["organ"].vertices, axis=0).tolist() == [4, 4, 4]
    apart = tissue_surfaces(mesh, {})
    assert len(apart["body"].faces) == len(filled["body"].faces) + len(filled["organ"].faces)
