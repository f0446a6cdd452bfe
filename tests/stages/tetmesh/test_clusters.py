"""Tissues that are meshed together, and the proof that the others do not meet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from shapes import moved, sphere
from tetrahedron_grids import grid, labelled_grid

from vhp_cli.mesh import Mesh
from vhp_cli.stages.tetmesh.clusters import clusters_of, meeting, union
from vhp_cli.stages.tetmesh.tissues import Relations, Tissue
from vhp_cli.volume import VolumeMesh, volumes


def tissues(*meshes, volume=1.0):
    return [Tissue(str(number), mesh, volume) for number, mesh in enumerate(meshes)]


def row(count, step=100.0):
    """Return balls of 10 mm in a row."""
    return tissues(*(moved(sphere(10), (step * number, 0, 0)) for number in range(count)))


def groups(found, relations, **options):
    return [cluster.tissues for cluster in clusters_of(found, relations, [None] * len(found), **options)]


def test_what_stands_apart_is_a_cluster_of_its_own():
    assert groups(row(3), Relations()) == [(0,), (1,), (2,)]
    assert groups(row(1), Relations()) == [(0,)]


@pytest.mark.parametrize(
    "relations",
    [
        Relations({"2": frozenset({"0"})}),
        Relations(overlaps_mm3={("0", "2"): 3.0}),
        Relations(gaps_mm={("0", "2"): 3.0}),
        Relations(contacts=frozenset({("0", "2")})),
        Relations(distances_mm={("0", "2"): 1e-3}),
    ],
)
def test_what_belongs_together(relations):
    assert groups(row(3), relations) == [(0, 2), (1,)]


@given(st.lists(st.tuples(st.integers(0, 7), st.integers(0, 7)), max_size=12))
def test_clusters_are_the_connected_parts(links):
    pairs = frozenset((str(a), str(b)) for a, b in links if a != b)
    found = groups(row(8), Relations(contacts=pairs))
    # By repeated widening, one member at a time.
    expected = set()
    for start in range(8):
        reached = {start}
        while True:
            wider = reached | {b for a, b in links if a in reached} | {a for a, b in links if b in reached}
            if wider == reached:
                break
            reached = wider
        expected.add(tuple(sorted(reached)))
    assert found == sorted(expected)


def test_envelopes_follow_the_gaps_between_clusters():
    found, walls = row(3), [None] * 3
    wide = clusters_of(found, Relations(), walls)
    natural = wide[0].envelope.mm
    assert {cluster.envelope.mm for cluster in wide} == {natural}
    assert natural == pytest.approx(5e-3 * np.linalg.norm(np.ptp(sphere(10).vertices, axis=0)))
    near = Relations(distances_mm={("0", "1"): natural})
    first, second, third = clusters_of(found, near, walls)
    assert first.envelope.mm == second.envelope.mm == pytest.approx(0.8 * natural)
    assert third.envelope.mm == natural and "distance of 0 and 1" in first.envelope.reason
    # After they met, no envelope may be able to close the gap.
    first, second, third = clusters_of(found, near, walls, careful=[(0, 1)])
    assert first.envelope.mm + second.envelope.mm < natural and third.envelope.mm == natural
    assert groups(found, near, together=[(0, 1)]) == [(0, 1), (2,)]


def test_an_envelope_that_was_asked_for_is_never_exceeded():
    found, walls = row(2), [None, None]
    assert clusters_of(found, Relations(), walls, asked_mm=0.7)[0].envelope == (0.7, "as asked")
    near = clusters_of(found, Relations(distances_mm={("0", "1"): 0.5}), walls, asked_mm=0.7)
    assert len(near) == 2 and near[0].envelope.mm == pytest.approx(0.4)
    assert groups(found, Relations(distances_mm={("0", "1"): 0.4}), asked_mm=0.7) == [(0, 1)]


def test_a_surface_without_an_inside_belongs_to_all_that_it_may_hold():
    opened = sphere(10)
    found = tissues(moved(sphere(2), (9, 9, 9)), Mesh(opened.vertices, opened.faces[1:]), moved(sphere(2), (30, 0, 0)))
    found[1] = replace(found[1], volume_mm3=None)
    assert groups(found, Relations()) == [(0, 1), (2,)]


def cube(lower, edge):
    """Return a cube of tetrahedra, all of one tissue."""
    points, tetrahedra = grid(edge=edge)
    return VolumeMesh(points + lower, tetrahedra, np.ones(len(tetrahedra), np.int32), ("cube",))


@pytest.mark.parametrize(
    ("other", "meet"),
    [
        (cube((10.001, 0, 0), 10.0), False),
        (cube((10.0, 0.1, 0.2), 10.0), True),
        (cube((10.0, 10.0, 10.0), 10.0), True),
        (cube((4.0, 4.0, 4.0), 10.0), True),
        (cube((4.0, 4.0, 4.0), 2.0), True),
        (cube((-1.0, -1.0, -1.0), 12.0), True),
    ],
)
def test_meshes_that_meet(other, meet):
    mesh, far = cube((0, 0, 0), 10.0), cube((50, 50, 50), 10.0)
    assert meeting([mesh, far, other]) == ([(0, 2)] if meet else [])
    assert meeting([other, mesh]) == ([(0, 1)] if meet else [])


def test_a_mesh_in_a_cavity_of_another_does_not_meet_it():
    whole = cube((0, 0, 0), 9.0)
    middle = (np.abs(whole.points[whole.tetrahedra].mean(axis=1) - 4.5) < 1.5).all(axis=1)
    hollow = VolumeMesh(whole.points, whole.tetrahedra[~middle], whole.labels[~middle], whole.names)
    assert volumes(hollow.points, hollow.tetrahedra).sum() == pytest.approx(9**3 - 3**3)
    assert meeting([hollow, cube((4.0, 4.0, 4.0), 1.0)]) == []
    assert meeting([hollow, cube((1.0, 1.0, 1.0), 1.0)]) == [(0, 1)]


def test_the_union_keeps_labels_and_points():
    first, second = labelled_grid(), labelled_grid()
    second = replace(second, points=second.points + 100.0)
    count = len(first.names)
    names = tuple(f"{part}{name}" for name in first.names for part in "ab")
    labels = [[2 * number + part for number in range(count)] for part in (1, 2)]
    whole = union([first, second], labels, names)
    assert len(whole.points) == 2 * len(first.points)
    assert volumes(whole.points, whole.tetrahedra).tolist() == pytest.approx(
        [*volumes(first.points, first.tetrahedra), *volumes(second.points, second.tetrahedra)]
    )
    assert len(np.unique(whole.tetrahedra[: len(first.tetrahedra)])) <= len(first.points)
    for offset, label_of, part in ((0, labels[0], first), (len(first.labels), labels[1], second)):
        own = whole.labels[offset : offset + len(part.labels)]
        assert own.tolist() == [label_of[label - 1] if label else 0 for label in part.labels]
