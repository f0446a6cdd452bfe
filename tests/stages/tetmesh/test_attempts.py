"""What is asked of the mesher after a mesh or a failure."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from tetrahedron_grids import labelled_grid

from vhp_cli.processes import CallFailed
from vhp_cli.stages.tetmesh.attempts import Made, Request, after_failure, after_mesh, limit_s
from vhp_cli.stages.tetmesh.options import TetmeshOptions
from vhp_cli.volume import VolumeMesh

ASKED = Request(5.0, 0.2, 10.0, 80, False)


@dataclass
class Said:
    labels: list
    quality: dict | None


def made(angle=12.0, ratio=0.4, errors=(0.0, 0.0), request=ASKED):
    labels = [{"tets": 0 if error == -1 else 9, "volume_error": error} for error in errors]
    return Made(labelled_grid(), Said(labels, {"min_dihedral_deg": angle, "radius_ratio_p01": ratio}), request, ())


@pytest.mark.parametrize(
    ("mesh", "options", "changes"),
    [
        (made(), {}, None),
        (made(angle=9.0), {}, {"stop_energy": 8.0, "iterations": 160}),
        (made(ratio=0.3), {}, {"stop_energy": 8.0, "iterations": 160}),
        (made(errors=(0.0, 0.03)), {}, {"epsilon_mm": 0.1}),
        (made(errors=(0.0, -1)), {}, {"epsilon_mm": 0.1}),
        (made(errors=(0.0, -1), angle=9.0), {}, {"epsilon_mm": 0.1, "stop_energy": 8.0, "iterations": 160}),
        (made(errors=(None, -1, *[0.0] * 20)), {}, None),
        # An envelope that was asked for stays.
        (made(errors=(0.0, -1)), {"epsilon_mm": 0.2}, None),
        (made(errors=(0.0, -1), request=replace(ASKED, stop_energy=30.0)), {}, None),
        (made(errors=(0.0, -1)), {"max_tets": 81}, {"coarsen": True, "edge_length_mm": 5 * (162 / 72.9) ** (1 / 3)}),
    ],
)
def test_after_a_mesh(mesh, options, changes):
    found = after_mesh(mesh, TetmeshOptions(**options))
    assert (found is None) == (changes is None)
    if changes:
        assert found == replace(ASKED, **{key: pytest.approx(value) for key, value in changes.items()})


def test_the_better_mesh():
    options = TetmeshOptions(max_tets=100)
    small = VolumeMesh(np.zeros((4, 3)), np.array([[0, 1, 2, 3]]), np.array([1]), ("a",))
    worst_first = [
        made(errors=(0.0, -1), angle=40.0),
        made(angle=40.0),
        replace(made(errors=(0.0, 0.03), angle=40.0), mesh=small),
        replace(made(angle=8.0), mesh=small),
        replace(made(angle=11.0), mesh=small),
        replace(made(angle=12.0), mesh=small),
    ]
    ranks = [mesh.rank(options) for mesh in worst_first]
    assert ranks == sorted(ranks) and len(set(ranks)) == len(ranks)


def test_after_a_failure():
    assert after_failure(ASKED, CallFailed("error", ""), 0) is None
    draft = after_failure(ASKED, CallFailed("timeout", ""), 0)
    assert draft == Request(7.5, 0.2, 30.0, 10, False) == after_failure(ASKED, CallFailed("memory", ""), 0)


def test_after_a_crash_something_else_is_asked_within_the_same_envelope():
    crash = CallFailed("crash", "")
    second = after_failure(ASKED, crash, 1)
    assert second == replace(ASKED, epsilon_mm=pytest.approx(0.18))
    third = after_failure(second, crash, 2)
    assert third == replace(ASKED, epsilon_mm=pytest.approx(0.162), edge_length_mm=pytest.approx(4.5))
    assert after_failure(third, crash, 3) is None


def test_a_better_mesh_may_take_twice_as_long():
    options = TetmeshOptions(time_limit_s=500.0)
    assert limit_s(options, {}, False) == 500
    assert limit_s(options, {"mesh": 100.0}, True) == 230
    assert limit_s(options, {"mesh": 400.0}, True) == 500
