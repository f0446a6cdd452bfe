"""Healed surfaces beside the clean shapes that they were made from."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from shapes import box, sphere

from vhp_cli.inspection.deviation import deviation
from vhp_cli.mesh import Mesh
from vhp_cli.stages.heal import heal
from vhp_cli.stages.heal.candidate import diagonal, judge
from vhp_cli.stages.heal.options import HealOptions
from vhp_cli.stages.outcome import Outcome

SOURCE = Path(__file__).resolve().parents[3] / "benchmarks" / "damage.py"
TOPOLOGY = HealOptions(only_topology=True)


def _loaded() -> ModuleType:
    spec = importlib.util.spec_from_file_location("made_damage", SOURCE)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


damage = _loaded()
# Sound as they are, however poor their triangles.
SOUND = ("sphere, slivers", "tube, slivers")
# Two solids side to side: one without the wall between them, or two with a gap.
TOUCHING = ("two boxes, common side", "two boxes, one on the other")
# Each takes less than a second without remeshing.
QUICK = (
    "sphere, holes",
    "sphere, duplicate faces",
    "sphere, inner wall",
    "torus, T-junctions",
    "tube, flipped faces",
    "hollow sphere, cavity outward",
    "two boxes, joined at an edge",
    "pipe, open ends",
)


def made(name: str):
    if damage.needs_union(name):
        pytest.importorskip("manifold3d")
    return damage.case(name)


def result(given: Mesh, outcome: Outcome) -> Mesh:
    return given if outcome.mesh is None else outcome.mesh


def assert_as_good_as_the_truth(case, outcome: Outcome) -> None:
    assert outcome.status == ("unchanged" if outcome.mesh is None else "changed"), outcome.reason
    healed = judge(result(case.damaged, outcome))
    assert healed.sound, healed.flaws
    if outcome.mesh is not None:
        assert np.array_equal(outcome.mesh.vertices, outcome.mesh.vertices.astype(np.float32))
        assert outcome.actions and outcome.deviation is not None
    if case.clean is None:
        return
    limit = min(0.1, 1e-3 * diagonal(case.damaged))
    before = deviation(case.damaged, case.clean, lost_limit_mm=0.0)["max"]
    after = deviation(healed.mesh, case.clean, lost_limit_mm=0.0)["max"]
    if case.kind in ("missing", "extra") and case.name not in TOUCHING:
        assert after < before
    else:
        # What moved the surface can't be known; healing may add no more than it is allowed to.
        assert after <= before + limit
    truth = judge(case.clean).measures["volume_mm3"]
    assert healed.measures["volume_mm3"] == pytest.approx(truth, rel=0.01)


def test_there_is_a_truth_to_most_cases():
    assert len(damage.CASES) >= 40
    assert sum(damage.case(name).clean is None for name in damage.CASES if not damage.needs_union(name)) <= 2


@pytest.mark.parametrize("name", QUICK)
def test_repair_leads_back_to_the_clean_shape(name: str):
    case = made(name)
    assert_as_good_as_the_truth(case, heal(case.damaged, TOPOLOGY))


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in damage.CASES if name not in QUICK])
def test_every_repair_leads_back_to_the_clean_shape(pymeshlab: ModuleType, name: str):
    case = made(name)
    outcome = heal(case.damaged, TOPOLOGY)
    assert (outcome.status == "unchanged") == (name in SOUND)
    assert_as_good_as_the_truth(case, outcome)


@pytest.mark.slow
@pytest.mark.parametrize("name", damage.CASES)
def test_remeshing_stays_at_the_clean_shape(pymeshlab: ModuleType, name: str):
    case = made(name)
    outcome = heal(case.damaged, HealOptions())
    assert_as_good_as_the_truth(case, outcome)
    healed = judge(result(case.damaged, outcome))
    assert healed.min_quality >= 0.2
    assert healed.mean_quality >= 0.85
    assert healed.min_edge >= 0.01


@pytest.mark.parametrize("name", ["sphere, slivers", "torus, holes"])
def test_the_same_bytes_twice(name: str):
    case = made(name)
    first, second = (heal(case.damaged, HealOptions()) for _ in range(2))
    assert first.mesh is not None and second.mesh is not None
    assert first.mesh.vertices.tobytes() == second.mesh.vertices.tobytes()
    assert first.mesh.faces.tobytes() == second.mesh.faces.tobytes()
    assert (first.status, first.reason, first.actions, first.deviation) == (
        second.status,
        second.reason,
        second.actions,
        second.deviation,
    )


@pytest.mark.parametrize("options", [HealOptions(), TOPOLOGY], ids=["remeshed", "topology"])
@pytest.mark.parametrize("name", ["torus, holes", "plate, flipped and duplicate"])
def test_a_healed_mesh_is_left_alone(name: str, options: HealOptions):
    healed = heal(made(name).damaged, options).mesh
    assert healed is not None
    again = heal(healed, options)
    assert again.status == "unchanged" and again.mesh is None and again.actions == []


def test_a_poor_but_sound_mesh_is_handed_on_by_topology():
    case = made("sphere, slivers")
    outcome = heal(case.damaged, TOPOLOGY)
    assert outcome.status == "unchanged" and outcome.mesh is None and outcome.actions == []


def test_a_sheet_is_refused():
    flat = box()
    sheet = Mesh(flat.vertices, flat.faces[:2])
    outcome = heal(sheet, TOPOLOGY)
    assert outcome.mesh is None and outcome.status == "refused"
    assert outcome.reason


SHAPES = {
    "sphere": lambda: sphere(20, subdivisions=3),
    "torus": lambda: damage.torus(),
    "tube": lambda: damage.tube(damage.course(np.linspace(0, 0.2, 61)), 1.0, 10),
}
DAMAGES = {
    "holes": lambda mesh, random: damage.holes(mesh, random, 3, 1),
    "flipped": lambda mesh, random: damage.flipped(mesh, random, 0.1),
    "duplicates": lambda mesh, random: damage.duplicates(mesh, random, 0.05),
    "t_junctions": lambda mesh, random: damage.t_junctions(mesh, random, 0.03),
    "riddled": lambda mesh, random: damage.riddled(mesh, random, 0.03),
}
CROSSING = {
    "folds": lambda mesh, random: damage.folds(mesh, random, 3),
    "noise": lambda mesh, random: damage.noise(mesh, random, 0.1),
    "jittered": lambda mesh, random: damage.jittered(mesh, random, 1e-5),
}


def damaged_shapes(damages):
    return st.tuples(
        st.sampled_from(sorted(SHAPES)),
        st.lists(st.sampled_from(sorted(damages)), min_size=1, max_size=3, unique=True),
        st.integers(0, 2**32 - 1),
    )


def assert_sound_or_as_it_was(shape: str, names: list[str], seed: int, options: HealOptions) -> None:
    mesh, random = SHAPES[shape](), np.random.default_rng(seed)
    for name in names:
        mesh = {**DAMAGES, **CROSSING}[name](mesh, random)
    given = damage.as_written(mesh)
    outcome = heal(given, options)
    if outcome.status == "changed":
        assert outcome.mesh is not None
        healed = judge(outcome.mesh)
        assert healed.sound, healed.flaws
        falls_short = healed.min_quality < options.target_quality or healed.min_edge < options.min_edge_mm
        assert bool(outcome.reason) == (falls_short and not options.only_topology)
    elif outcome.status == "unchanged":
        assert outcome.mesh is None and judge(given).sound
    else:
        assert outcome.status == "refused" and outcome.mesh is None and outcome.reason


@settings(max_examples=12, deadline=None, derandomize=True)
@given(damaged_shapes(DAMAGES))
def test_random_damage_is_healed_or_refused(case):
    assert_sound_or_as_it_was(*case, TOPOLOGY)


@pytest.mark.slow
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(damaged_shapes({**DAMAGES, **CROSSING}), st.booleans())
def test_random_crossings_are_healed_or_refused(pymeshlab: ModuleType, case, only_topology):
    assert_sound_or_as_it_was(*case, HealOptions(only_topology=only_topology, engine_timeout_s=20))
