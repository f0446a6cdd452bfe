from __future__ import annotations

import numpy as np
import pytest
from shapes import box, flipped, joined, moved, sphere

from vhp_cli import engines
from vhp_cli.kernels import surface
from vhp_cli.kernels.measuring import closest
from vhp_cli.kernels.spatial import Tree
from vhp_cli.mesh import Mesh
from vhp_cli.processes import CallFailed
from vhp_cli.stages.heal.candidate import judge
from vhp_cli.stages.heal.rebuild import envelope, refill, wrap
from vhp_cli.stages.heal.union import unite

LIMITS = {"timeout_s": 60.0, "memory_gb": 4.0}


@pytest.fixture(autouse=True, scope="module")
def _ended():
    yield
    child, _ = getattr(engines._local, "child", (None, None))
    if child is not None:
        child.close()


def volume(mesh):
    topology = surface.topology(mesh.vertices, mesh.faces)
    return surface.quality(mesh.vertices, mesh.faces, topology.component, topology.n_components).volume


def farthest(points, mesh):
    return closest(Tree(mesh.vertices, mesh.faces), points).distances.max()


def crossed_wall():
    """Return a hollow ball, 0.2 mm thick, the inner side of which comes out through the outer one by 1.5 mm."""
    inner = sphere(19.8, subdivisions=4).vertices
    lift = 1.7 * np.exp(-((np.linalg.norm(inner - [0, 0, 19.8], axis=1) / 4) ** 2))
    inner = (inner * (1 + lift / 19.8)[:, None]).astype(np.float32).astype(float)
    return joined(sphere(20, subdivisions=4), flipped(Mesh(inner, sphere(1, subdivisions=4).faces)))


def test_overlapping_boxes_become_one(pymeshlab):
    mesh = joined(box(), moved(box(), (5, 5, 5)))
    united, actions = unite(mesh, **LIMITS)
    assert judge(united).sound
    assert surface.topology(united.vertices, united.faces).n_components == 1
    assert volume(united) == pytest.approx(1875)
    assert actions[0]["step"] == "union"
    assert actions[0]["volume_mm3"] == pytest.approx(-125)


def test_union_of_a_crossed_wall_loses_the_pocket_unless_told_to_keep_it(pymeshlab):
    mesh = crossed_wall()
    plain, _ = unite(mesh, **LIMITS)
    assert judge(plain).sound
    assert farthest(mesh.vertices, plain) > 1
    kept, _ = unite(mesh, either_sign=True, **LIMITS)
    assert judge(kept).sound
    assert farthest(mesh.vertices, kept) < 0.05
    assert volume(kept) > volume(plain) + 10


def test_union_of_an_open_surface_fails(pymeshlab):
    with pytest.raises(CallFailed, match="union"):
        unite(Mesh(box().vertices, box().faces[1:]), **LIMITS)


def test_wrap_lies_on_the_surface(pymeshlab):
    mesh = joined(sphere(10, subdivisions=3), moved(sphere(10, subdivisions=3), (12, 0, 0)))
    wrapped, actions = wrap(mesh, **LIMITS)
    assert judge(wrapped).sound
    assert farthest(wrapped.vertices, mesh) < 0.1
    assert actions[0]["step"] == "rebuild"


@pytest.mark.slow
def test_envelope_is_sound_and_near():
    mesh = joined(sphere(10), moved(sphere(10), (12, 0, 0)))
    rebuilt, _ = envelope(mesh, **LIMITS)
    assert judge(rebuilt).sound
    assert farthest(rebuilt.vertices, mesh) < 0.05


def test_refill_needs_the_optional_engine():
    mesh = joined(sphere(10), flipped(sphere(5)))
    if engines.ENGINES["meshfix"].available:
        refilled, _ = refill(mesh, **LIMITS)
        assert judge(refilled).sound
        assert volume(refilled) == pytest.approx(volume(mesh))
    else:
        with pytest.raises(CallFailed, match="pymeshfix"):
            refill(mesh, **LIMITS)
