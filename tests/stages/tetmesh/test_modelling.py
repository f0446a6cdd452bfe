"""A model, cluster by cluster, with an engine that does as it is told."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from shapes import moved, sphere
from tetmesh_targets import mesh_by_delaunay

from vhp_cli import engines
from vhp_cli.errors import UsageError
from vhp_cli.processes import CallFailed
from vhp_cli.stages.tetmesh.modelling import in_threads, mesh_model
from vhp_cli.stages.tetmesh.options import TetmeshOptions
from vhp_cli.stages.tetmesh.tissues import Relations, Tissue

ASKED = TetmeshOptions(epsilon_mm=0.2, fit=False, attempts=1)
GAP = 0.5
# Less than an envelope of 0.2 mm gives, and more than one of two fifths of the gap does.
BALLS = Relations(distances_mm={("a", "b"): GAP})


def balls(gap=GAP):
    """Return two balls of 5 mm that stand apart."""
    first, second = sphere(5, subdivisions=2), sphere(5, subdivisions=2)
    reach = np.ptp(first.vertices[:, 0])
    return [
        Tissue("a", first, 500.0),
        Tissue("b", moved(second, (reach + gap, 0, 0)), 500.0),
    ]


def planted(monkeypatch, engine):
    """Call a function in place of fTetWild: it gets vertices, faces, options, and the number of the call."""
    calls = []

    def call_volume(name, mesh, **options):
        calls.append(options["envelope_mm"])
        return engine(mesh.vertices, mesh.faces, options, len(calls))

    monkeypatch.setattr(engines, "call_volume", call_volume)
    return calls


@pytest.mark.parametrize("crashes", [1, 2, 3])
def test_a_crash_is_no_attempt_and_not_repeated_as_it_was(monkeypatch, crashes):
    def engine(vertices, faces, options, number):
        if number <= crashes:
            raise CallFailed("crash", "SIGSEGV")
        return mesh_by_delaunay(vertices, faces, options)

    calls = planted(monkeypatch, engine)
    made = mesh_model(balls()[:1], Relations(), ASKED)
    assert len(calls) == len(set(calls)) == len(made.attempts) == min(crashes + 1, 3)
    assert [attempt["chosen"] for attempt in made.attempts] == [False] * min(crashes, 2) + [crashes < 3]
    if crashes == 3:
        assert made.mesh is None and made.failures == {("a",): "crash: SIGSEGV"}
        return
    assert made.measured.labels[0]["volume_mm3"] == pytest.approx(500, rel=0.1)
    assert made.clusters[0]["epsilon_mm"] == pytest.approx(0.2 * 0.9**crashes)
    assert "later attempt" in made.clusters[0]["epsilon_reason"]


def swollen(largest_envelope_mm, by_mm):
    """Return an engine that lets balls swell, if the envelope is larger than a limit."""

    def engine(vertices, faces, options, number):
        points, tetrahedra = mesh_by_delaunay(vertices, faces, options)
        alone = np.ptp(vertices[:, 0]) < 11
        if alone and options["envelope_mm"] > largest_envelope_mm:
            middle = vertices.mean(axis=0)
            points = middle + (points - middle) * (1 + by_mm / 5)
        return points, tetrahedra

    return engine


@pytest.mark.parametrize(("limit", "clusters", "calls"), [(10.0, 2, 2), (0.25, 2, 4), (0.0, 1, 5)])
def test_clusters_that_meet_are_made_again(monkeypatch, limit, clusters, calls):
    made_of = planted(monkeypatch, swollen(limit, 0.4))
    options = TetmeshOptions(epsilon_mm=0.38, fit=False, attempts=1)
    made = mesh_model(balls(), BALLS, options, threads=1)
    assert len(made_of) == calls and len(made.clusters) == clusters
    assert made.measured.nonconforming == {}
    assert [label["name"] for label in made.measured.labels] == ["a", "b"]
    assert len(made.notes) == {2: 0, 4: 1, 5: 2}[calls]
    for number in range(1, clusters + 1):
        own = [attempt for attempt in made.attempts if attempt["cluster"] == number]
        assert [attempt["chosen"] for attempt in own] == [False] * (len(own) - 1) + [True]
    assert sum(attempt["chosen"] for attempt in made.attempts) == clusters and len(made.attempts) == calls


def test_thin_walls_are_told(monkeypatch):
    planted(monkeypatch, lambda vertices, faces, options, _: mesh_by_delaunay(vertices, faces, options))
    asked = TetmeshOptions(epsilon_mm=6.0, fit=False, attempts=1)
    (note,) = mesh_model(balls()[:1], Relations(), asked).notes
    assert "walls of a" in note
    assert mesh_model(balls()[:1], Relations(), ASKED).notes == ()


def test_results_come_in_the_order_of_the_calls_and_the_largest_begin_first():
    begun = []
    assert in_threads([lambda n=n: begun.append(n) or n for n in range(4)], [1, 9, 5, 9], 1) == [0, 1, 2, 3]
    assert begun == [1, 3, 2, 0]
    barrier = threading.Barrier(3, timeout=20)
    counted = []
    assert len(in_threads([barrier.wait] * 3, [1, 1, 1], 3, lambda done, total: counted.append((done, total)))) == 3
    assert counted == [(1, 3), (2, 3), (3, 3)]


def test_a_box_of_air_makes_one_cluster(monkeypatch):
    planted(monkeypatch, lambda vertices, faces, options, _: mesh_by_delaunay(vertices, faces, options))
    made = mesh_model(balls(20.0), Relations(), TetmeshOptions(epsilon_mm=0.2, fit=False, attempts=1, air="2"))
    assert len(made.clusters) == 1 and made.measured.air is not None
    with pytest.raises(UsageError, match="does not hold the model"):
        mesh_model(balls(20.0), Relations(), TetmeshOptions(air="0,0,0,1,1,1"))
