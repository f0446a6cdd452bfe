"""Mass: nested own volumes times densities."""

from __future__ import annotations

import pytest
import trimesh
from breathing_tissues import mass_of, phantom, phantom_fit, tissues_of
from shapes import box, sphere

from vhp_cli.errors import UsageError
from vhp_cli.stages.breathe.fitting.shells import volumes_at
from vhp_cli.stages.breathe.mass import densities, density_of
from vhp_cli.stages.breathe.nesting import parents

NESTED = {
    "skin": box((-100, -100, -100), (100, 100, 100)),
    "fat": box((-98, -98, -98), (98, 98, 98)),
    "average_body": box((-90, -90, -90), (90, 90, 90)),
    "lung_left": box((10, -40, -50), (70, 40, 60)),
    "lung_right": box((-70, -40, -50), (-10, 40, 60)),
    "bronchus_left": box((30, -5, 0), (40, 5, 20)),
    "heart": box((-8, -60, 0), (8, -45, 30)),
}
OUTER, FAT, BODY, LUNG, BRONCHUS, HEART = 200**3, 196**3, 180**3, 60 * 80 * 110, 10 * 10 * 20, 16 * 15 * 30


def test_the_tree_of_nested_boxes():
    assert parents(tissues_of(NESTED)) == {
        "skin": None,
        "fat": "skin",
        "average_body": "fat",
        "lung_left": "average_body",
        "lung_right": "average_body",
        "bronchus_left": "lung_left",
        "heart": "average_body",
    }


def test_own_volumes_of_nested_boxes_by_hand():
    tissues = tissues_of(NESTED)
    mass = mass_of(tissues)
    own = mass.own_mm3(mass.rest_mm3)
    expected = {
        "skin": OUTER - FAT,
        "fat": FAT - BODY,
        "average_body": BODY - 2 * LUNG - HEART,
        "lung_left": LUNG - BRONCHUS,
        "lung_right": LUNG,
        "bronchus_left": BRONCHUS,
        "heart": HEART,
    }
    assert own == pytest.approx(expected, rel=1e-12)
    known = densities(tissues)
    by_hand = sum(volume * known[name].kg_per_m3 * 1e-9 for name, volume in expected.items())
    assert mass.kg(mass.rest_mm3) == pytest.approx(by_hand, rel=1e-6)


def test_own_volumes_of_the_phantom_add_up_to_the_outermost():
    mass = mass_of(tissues_of(phantom()))
    outer = trimesh.Trimesh(phantom()["skin"].vertices, phantom()["skin"].faces, process=False).volume
    assert sum(mass.own_mm3(mass.rest_mm3).values()) == pytest.approx(outer, rel=1e-9)


@pytest.mark.parametrize(
    ("convention", "gain"),
    [
        # The lungs grow by 10 %, and take their share from the body around them.
        ("fixed-mass", -0.1 * 2 * LUNG * 1090),
        ("fixed-density", 0.1 * 2 * LUNG * (394 - 1090)),
        ("none", -0.1 * 2 * LUNG * 1090),
    ],
)
def test_conventions_of_the_lungs(convention, gain):
    mass = mass_of(tissues_of({name: mesh for name, mesh in NESTED.items() if "bronchus" not in name}), convention)
    grown = {name: volume * (1.1 if "lung" in name else 1.0) for name, volume in mass.rest_mm3.items()}
    assert mass.kg(grown) - mass.kg(mass.rest_mm3) == pytest.approx(gain * 1e-9, rel=1e-9)


def test_the_lungs_weigh_nothing_if_so_asked():
    tissues = tissues_of(NESTED)
    full, empty = mass_of(tissues), mass_of(tissues, "none")
    lungs = (2 * LUNG - BRONCHUS) * 394e-9
    assert full.kg(full.rest_mm3) - empty.kg(empty.rest_mm3) == pytest.approx(lungs, rel=1e-9)


def test_the_shells_hold_the_mass_at_every_step():
    tissues, mass, found = phantom_fit()
    rest = mass.kg(mass.rest_mm3)
    motions = {motion.name: motion for motion in found.sequence.motions}
    for t in range(1, 12):
        volumes = {}
        for tissue in tissues:
            motion = motions.get(tissue.name)
            vertices = tissue.mesh.vertices if motion is None else motion.apply(tissue.mesh.vertices, float(t))
            volumes[tissue.name] = abs(trimesh.Trimesh(vertices, tissue.mesh.faces, process=False).volume)
        assert mass.kg(volumes) == pytest.approx(rest, rel=1e-6)
    without_shells = {name: rest for name, rest in mass.rest_mm3.items() if name in ("skin", "fat", "average_body")}
    assert mass.kg(volumes | without_shells) < rest * (1 - 5e-3)


def test_volumes_of_scaled_tissues_follow_from_their_matrices():
    from breathing_tissues import moving

    from vhp_cli.stages.breathe.fitting.scene import Scene

    tissues, _, found = phantom_fit()
    scene = Scene(tissues, 1.0, 11)
    scene.motions = {motion.name: motion for motion in found.sequence.motions} | {"heart": moving("heart", (0, 0, -3))}
    rest = {tissue.name: tissue.volume_mm3 for tissue in tissues}
    volumes = volumes_at(scene, 11.0, set(), rest)
    for name in ("lung_left", "liver", "skin", "heart", "aorta"):
        tissue = scene.tissues[name]
        motion = scene.motions.get(name)
        vertices = tissue.mesh.vertices if motion is None else motion.apply(tissue.mesh.vertices, 11.0)
        by_mesh = abs(trimesh.Trimesh(vertices, tissue.mesh.faces, process=False).volume)
        assert volumes[name] == pytest.approx(by_mesh, rel=1e-9)


def test_every_tissue_of_the_phantom_has_a_known_density():
    found = densities(tissues_of(phantom()))
    assert all(density.certain and density.source for density in found.values())
    assert found["lung_left"].kg_per_m3 == 394
    assert found["aorta"].kg_per_m3 == 1050
    assert found["rib_left_01"].kg_per_m3 == 1908


def test_settings_come_before_the_table_and_the_unknown_is_said():
    tissues = tissues_of({"liver": sphere(), "tissue_17": sphere(centre=(50, 0, 0))})
    found = densities(tissues, {"liver": {"density": 1000}})
    assert found["liver"].kg_per_m3 == 1000 and found["liver"].source == "settings"
    assert not found["tissue_17"].certain
    with pytest.raises(UsageError, match="liver: density"):
        densities(tissues, {"liver": {"density": -1}})
    assert density_of("thing", "carried", "muscle").kg_per_m3 == 1090


@pytest.mark.parametrize(
    ("name", "part", "density"),
    [
        ("right_main_bronchus", "carried", 1102),
        ("trachea", "carried", 1080),
        ("cerebral_artery", "carried", 1050),
        ("cerebrospinal_fluid", "carried", 1007),
        ("left_adrenal_gland", "carried", 1028),
        ("adrenal_vein", "carried", 1050),
        ("thyroid_cartilage", "cartilage", 1100),
        ("left_fifth_costal_cartilage", "cartilage", 1100),
        ("recurrent_laryngeal_nerve", "carried", 1075),
        ("intervertebral_disk_of_fifth_thoracic_vertebra", "disc", 1100),
        ("diaphragm", "diaphragm", 1090),
    ],
)
def test_densities_are_those_of_the_tissue_and_not_of_its_neighbour(name, part, density):
    assert density_of(name, part).kg_per_m3 == density
