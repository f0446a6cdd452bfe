"""The fit: what each group of tissues does, and what the whole phantom does."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from breathing_tissues import STEPS, fcl_distance, mass_of, mirrored, moving, phantom, phantom_fit, tissues_of
from shapes import box, sphere

from vhp_cli.errors import UsageError
from vhp_cli.mesh import Mesh
from vhp_cli.stages.breathe.curves import Polynomial
from vhp_cli.stages.breathe.field import Field
from vhp_cli.stages.breathe.fitting.cage import make_struts
from vhp_cli.stages.breathe.fitting.candidates import choose, effort
from vhp_cli.stages.breathe.fitting.ends import RibEnds, rib_ends
from vhp_cli.stages.breathe.fitting.fit import FitSettings, fit
from vhp_cli.stages.breathe.fitting.lungs import fit_lungs
from vhp_cli.stages.breathe.fitting.ribs import lift_for, make_pairs
from vhp_cli.stages.breathe.fitting.scene import Scene
from vhp_cli.stages.breathe.fitting.soft import carried_candidates, descent
from vhp_cli.stages.breathe.operations import Parameter
from vhp_cli.stages.breathe.proof import prove
from vhp_cli.stages.breathe.rest import at_rest
from vhp_cli.stages.breathe.sequence import Targets


def motions():
    return {motion.name: motion for motion in phantom_fit()[2].sequence.motions}


# ---------------------------------------------------------------- lungs


@pytest.mark.parametrize("height", [150.0, 200.0, 232.65])
@pytest.mark.parametrize(("change", "travel"), [(0.32, 20.0), (0.592, 37.0), (0.16, 10.0)])
def test_boxes_gain_the_volume_and_travel_as_asked(height, change, travel):
    low, high = (20.0, -40.0, -height), (120.0, 60.0, 0.0)
    lungs = tissues_of({"lung_left": box(low, high), "lung_right": box((-120, -40, -height), (-20, 60, -10))})
    found = fit_lungs(lungs, Targets(change, travel), 0.0, 3.0)
    motion = found.motion("lung", ("lung_left",), STEPS)
    volume = 0.0
    for lung in lungs:
        moved = motion.apply(lung.mesh.vertices, 11.0)
        volume += float(np.prod(np.ptp(moved, axis=0)))
    assert volume - sum(lung.volume_mm3 for lung in lungs) == pytest.approx(change * 1e6, rel=1e-9)
    moved = motion.apply(lungs[0].mesh.vertices, 11.0)
    assert -height - moved[:, 2].min() == pytest.approx(travel, rel=1e-9)
    assert moved[:, 2].max() == pytest.approx(0.0, abs=1e-9)


def test_the_scales_of_the_thesis_follow_from_its_volumes():
    # E11: 200 mm high lungs of 2.22 l are scaled by 1.10 along and 1.0199 across.
    area = 2.22e6 / 200.0
    lungs = tissues_of({"lungs": box((0, 0, 0), (area / 100.0, 100.0, 200.0))})
    found = fit_lungs(lungs, Targets(0.32, 20.0), 0.0, None)
    assert found.along == pytest.approx(1.1)
    assert found.across == pytest.approx(1.0199, abs=5e-5)
    assert found.forward_mm == pytest.approx(3.0)


def test_open_lungs_are_refused():
    mesh = sphere(100.0)
    with pytest.raises(UsageError, match="lungs: the surface is open"):
        fit_lungs(tissues_of({"lungs": Mesh(mesh.vertices, mesh.faces[1:])}), Targets(), 0.0, None)


def test_a_model_without_lungs_is_refused():
    tissues = tissues_of({"liver": sphere(30.0)})
    with pytest.raises(UsageError, match="no lungs"):
        fit(tissues, {"liver": None}, None, FitSettings())


# ---------------------------------------------------------------- ribs


def test_heads_and_tips_of_the_phantoms_ribs():
    from vhp_cli.phantom.torso import rib_line

    tissues = {tissue.name: tissue for tissue in tissues_of(phantom())}
    spine = [tissue for tissue in tissues.values() if tissue.role.part == "vertebra"]
    for number in range(1, 13):
        ends = rib_ends(tissues[f"rib_left_{number:02d}"], spine)
        line = rib_line(number)
        assert np.linalg.norm(ends.head - line[0]) < 8.0
        assert np.linalg.norm(ends.tip - line[-1]) < 8.0
        # Without a spine, the end further back is the head; of the shorter ribs as well.
        assert np.allclose(rib_ends(tissues[f"rib_left_{number:02d}"], []).head, ends.head)


def pair_of(number=6):
    tissues, _, _ = phantom_fit()
    by_name = {tissue.name: tissue for tissue in tissues}
    spine = [tissue for tissue in tissues if tissue.role.part == "vertebra"]
    ribs = {(side, number): f"rib_{side}_{number:02d}" for side in ("left", "right")}
    ends = {name: rib_ends(by_name[name], spine) for name in ribs.values()}
    return make_pairs(ribs, ends, {})[0]


@pytest.mark.parametrize("side", ["left", "right"])
def test_positive_angles_lift_and_spread(side):
    pair = pair_of()
    tip = pair.ends[side].tip
    lifted = pair.motion(side, (3.0, 0.0), STEPS).apply(tip[None], 11.0)[0]
    assert lifted[2] - tip[2] > 5.0
    spread = pair.motion(side, (0.0, 3.0), STEPS).apply(tip[None], 11.0)[0]
    assert (spread[0] - tip[0]) * (1 if side == "left" else -1) > 5.0
    head = pair.ends[side].head
    assert np.allclose(pair.motion(side, (3.0, 2.0), STEPS).apply(head[None], 11.0)[0], head, atol=1e-9)


def test_the_lift_that_carries_tips_forward():
    pair = pair_of()
    lift = lift_for(pair, 3.5)
    for side in ("left", "right"):
        tip = pair.ends[side].tip
        moved = pair.motion(side, (lift, 0.0), STEPS).apply(tip[None], 11.0)[0]
        assert tip[1] - moved[1] == pytest.approx(3.5, rel=0.15)


def test_a_rib_without_its_twin_turns_about_its_neighbours_axis():
    ends = {
        "a": RibEnds(np.array([20.0, 0, 0]), np.zeros(3)),
        "b": RibEnds(np.array([-20.0, 2, 0]), np.zeros(3)),
        "c": RibEnds(np.array([21.0, 0, -20]), np.zeros(3)),
    }
    pairs = make_pairs({("left", 3): "a", ("right", 3): "b", ("left", 4): "c"}, ends, {})
    assert [pair.number for pair in pairs] == [3, 4]
    assert np.allclose(pairs[1].axis, pairs[0].axis)
    alone = make_pairs({("left", 4): "c"}, {"c": ends["c"]}, {})
    assert np.allclose(alone[0].axis, [-1, 0, 0])


def test_ribs_of_the_phantom_stay_rigid_and_move_alike_on_both_sides():
    found = motions()
    for name, mesh in phantom().items():
        if not name.startswith(("rib", "sternum", "clavicle", "vertebra")) or name not in found:
            continue
        edges = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
        before = np.linalg.norm(np.diff(mesh.vertices[edges], axis=1), axis=2)
        for t in (2.5, 11.0):
            after = np.linalg.norm(np.diff(found[name].apply(mesh.vertices, t)[edges], axis=1), axis=2)
            assert np.abs(after / before - 1).max() < 1e-6
        twin = name.replace("left", "right")
        if "left" in name:
            left = found[name].apply(mesh.vertices, 11.0)
            right = found[twin].apply(phantom()[twin].vertices, 11.0)
            assert np.allclose(left * [-1, 1, 1], right, atol=1e-6)
    angles = phantom_fit()[2].angles
    assert set(angles) == set(range(1, 13))
    assert all(0.0 <= lift <= 8.0 for lift, _ in angles.values())


# ---------------------------------------------------------------- cage


def test_cartilages_keep_to_rib_and_sternum():
    tissues, _, _ = phantom_fit()
    found = motions()
    scene = Scene(tissues, 1.0, STEPS)
    cartilages = {(t.role.side, t.role.number): t.name for t in tissues if t.role.part == "cartilage"}
    ribs = {(t.role.side, t.role.number): t.name for t in tissues if t.role.part == "rib"}
    struts = make_struts(scene, cartilages, ribs, ["sternum"])
    assert len(struts) == 20
    assert {strut.holder for strut in struts if strut.number <= 7} == {"sternum"}
    for strut in struts:
        assert strut.holder == "sternum" or strut.holder == f"costal_cartilage_{strut.side}_{strut.number - 1:02d}"
        for t in (1.0, 5.5, 11.0):
            for end, other in ((strut.tip, strut.rib), (strut.anchor, strut.holder)):
                own = found[strut.name].apply(end[None], t)
                assert np.allclose(own, found[other].apply(end[None], t), atol=1e-3)


def test_the_sternum_moves_forward_and_up_without_turning():
    found = motions()["sternum"]
    matrix = found.matrix(11.0)
    assert np.array_equal(matrix[:3, :3], np.eye(3))
    assert matrix[0, 3] == 0.0 and matrix[1, 3] < -1.0 and matrix[2, 3] > 1.0


# ---------------------------------------------------------------- soft tissues


def test_the_gentlest_motion_with_room_is_chosen():
    tissues = tissues_of({"wall": box((0, 0, 0), (10, 10, 10)), "organ": box((12, 0, 0), (20, 10, 10))})
    scene = Scene(tissues, 1.0, STEPS)
    scene.set("wall", moving("wall", (5, 0, 0)))
    candidates = [None, *(moving("organ", (mm, 0, 0)) for mm in (9.0, 5.0, 2.0, 4.0))]
    assert choose(scene, "organ", candidates, ["wall"], [11.0]) == 0.0
    # 15 + 1 <= 12 + mm
    assert effort(scene, "organ", scene.motions["organ"]) == pytest.approx(4.0)


def test_where_nothing_has_room_the_least_bad_is_chosen_and_what_is_missing_is_said():
    tissues = tissues_of({"wall": box((0, 0, 0), (10, 10, 10)), "organ": box((12, 0, 0), (20, 10, 10))})
    scene = Scene(tissues, 1.0, STEPS)
    scene.set("wall", moving("wall", (5, 0, 0)))
    missing = choose(scene, "organ", [None, moving("organ", (1, 0, 0)), moving("organ", (3.5, 0, 0))], ["wall"], [11.0])
    assert missing == pytest.approx(0.5)
    assert effort(scene, "organ", scene.motions["organ"]) == pytest.approx(3.5)


def test_the_descent_is_the_lungs_own_between_them_and_dies_out_below():
    _, _, found = phantom_fit()
    field = descent(found.lungs, -40.0, -300.0, STEPS)
    points = np.array([[0.0, 0.0, z] for z in (200.0, 80.0, -40.0, -100.0, -400.0, 400.0)])
    moved = field.displacement(points, 11.0)
    top, along = found.lungs.origin[2], found.lungs.along
    assert moved[:3, 2] == pytest.approx([(along - 1) * (z - top) for z in (200.0, 80.0, -40.0)], abs=1e-9)
    assert moved[:3, 1] == pytest.approx(-found.lungs.forward_mm, rel=0.05)
    assert moved[2, 2] < moved[3, 2] < 0.0
    assert np.array_equal(moved[4:], np.zeros((2, 3)))
    assert field.steepness() < 0.3


def test_what_the_descent_carries_keeps_its_order():
    tissues = tissues_of({"upper": box((0, 0, 20), (10, 10, 30)), "lower": box((0, 0, 8), (10, 10, 18))})
    _, _, found = phantom_fit()
    field = descent(found.lungs, -40.0, -300.0, STEPS)
    scene = Scene(tissues, 1.0, STEPS)
    for name in ("upper", "lower"):
        motion = next(m for m in carried_candidates(scene, name, field, []) if m is not None and m.fields == (field,))
        scene.set(name, motion)
    rest = at_rest(tissues, 1.0)
    proof = prove(rest, scene.motions, STEPS)
    assert not proof.unproven and proof.least_gap_mm > 0.0
    placed = [scene.motions[name].apply(scene.tissues[name].mesh.vertices, 11.0) for name in ("upper", "lower")]
    lower = Mesh(placed[1], scene.tissues["lower"].mesh.faces)
    # Between the lungs everything is drawn out, so that gaps grow.
    assert fcl_distance(placed[0], scene.tissues["upper"].mesh.faces, lower) > 2.0


def test_a_tissue_in_the_way_is_carried_by_the_field_or_a_neighbour():
    # A vessel right below the lungs can't stay.
    meshes = dict(phantom())
    kept = ("lung", "rib", "vertebra", "sternum", "costal")
    model = {name: mesh for name, mesh in meshes.items() if name.startswith(kept)}
    lung = model["lung_left"].vertices
    lowest = lung[lung[:, 2].argmin()]
    model["vessel"] = box(np.add(lowest, [-2, -2, -9]), np.add(lowest, [2, 2, -4]))
    tissues = tissues_of(model)
    found = fit(tissues, dict.fromkeys(model), None, FitSettings())
    assert not found.shortfalls
    assert "vessel" in {motion.name for motion in found.sequence.motions}


# ---------------------------------------------------------------- shells


def test_the_volume_of_a_bulge():
    # Design: a full sine window of width w and height h with amplitude a lifts 2/pi a w h.
    n = 160
    x, z = np.meshgrid(np.linspace(-150, 150, n), np.linspace(-100, 100, n))
    points = np.stack([x.ravel(), np.full(n * n, -200.0), z.ravel()], axis=1)
    field = Field("f", Parameter(Polynomial((0.0, 1.0))), (-150, 150), (-100, 100), 200.0, x_taper=0.01, y_taper=1.0)
    cell = 300 / (n - 1) * 200 / (n - 1)
    lifted = -field.displacement(points, 10.0)[:, 1].sum() * cell
    assert lifted == pytest.approx(2 / np.pi * 10.0 * 300 * 200, rel=0.02)


def test_the_shells_share_one_field_and_keep_their_gaps():
    found = motions()
    assert found["skin"].fields == found["fat"].fields == found["average_body"].fields
    skin, fat = (phantom()[name] for name in ("skin", "fat"))
    fat_now = Mesh(found["fat"].apply(fat.vertices, 11.0), fat.faces)
    assert 1.2 < fcl_distance(found["skin"].apply(skin.vertices, 11.0), skin.faces, fat_now) < 1.3


# ---------------------------------------------------------------- the whole


def test_rest_is_the_model_itself():
    for name, motion in motions().items():
        assert np.array_equal(motion.apply(phantom()[name].vertices, 0.0), phantom()[name].vertices)


def test_the_phantom_breathes_as_asked():
    tissues, mass, found = phantom_fit()
    assert not found.shortfalls
    lungs = [tissue for tissue in tissues if tissue.role.part == "lung"]
    placed = {lung.name: motions()[lung.name].apply(lung.mesh.vertices, 11.0) for lung in lungs}
    gained = sum(
        trimesh.Trimesh(placed[lung.name], lung.mesh.faces, process=False).volume - lung.volume_mm3 for lung in lungs
    )
    assert gained == pytest.approx(0.32e6, rel=1e-6)
    lowest = min(lung.mesh.vertices[:, 2].min() for lung in lungs)
    assert lowest - min(vertices[:, 2].min() for vertices in placed.values()) == pytest.approx(20.0, rel=1e-6)
    assert mass.kg(mass.rest_mm3) > 10.0


def test_a_mirrored_model_moves_as_the_mirror_image():
    swap = {"left": "right", "right": "left"}

    def other(name: str) -> str:
        return next((name.replace(a, b) for a, b in swap.items() if a in name), name)

    # Left and right are named anew, as a person seen in a mirror has them.
    model = {other(name): mesh for name, mesh in mirrored(phantom()).items()}
    tissues = tissues_of(model)
    mass = mass_of(tissues)
    found = {m.name: m for m in fit(tissues, mass.parents, mass, FitSettings()).sequence.motions}
    assert {other(name) for name in found} == set(motions())
    for name in ("rib_left_05", "lung_right", "liver", "costal_cartilage_right_07", "skin", "sternum"):
        mesh = phantom()[name]
        original = motions()[name].apply(mesh.vertices, 11.0)
        image = found[other(name)].apply(model[other(name)].vertices, 11.0)
        assert np.allclose(image * [-1, 1, 1], original, atol=0.05)


def test_the_same_model_gives_the_same_sequence():
    _, mass, found = phantom_fit()
    again = fit(tissues_of(phantom()), mass.parents, mass, FitSettings())
    assert again.sequence == found.sequence


def test_an_infeasible_model_names_the_pair():
    # A post below the lungs that may not move.
    model = {name: mesh for name, mesh in phantom().items() if name.startswith(("lung", "rib", "vertebra"))}
    lung = model["lung_left"]
    place = lung.vertices[lung.vertices[:, 2].argmin()]
    model["humerus"] = box(np.add(place, [-3, -3, -15]), np.add(place, [3, 3, -5]))
    found = fit(tissues_of(model), dict.fromkeys(model), None, FitSettings())
    pairs = {(item.tissue, item.other) for item in found.shortfalls}
    assert ("lung_left", "humerus") in pairs
    worst = next(item for item in found.shortfalls if item.other == "humerus")
    assert worst.crossing and np.linalg.norm(np.asarray(worst.xyz_mm) - place) < 25.0
