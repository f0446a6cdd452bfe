"""Names to roles."""

from __future__ import annotations

import pytest

from vhp_cli.errors import UsageError
from vhp_cli.phantom import generate
from vhp_cli.stages.breathe.roles import assign, guess_role, parts


@pytest.mark.parametrize(
    ("name", "role"),
    [
        # as in the thesis
        ("VHP Ribs left2", "left rib 2"),
        ("ribs right7", "right rib 7"),
        ("VHPC Cartilage1 Left", "left cartilage 1"),
        ("VHPC Cartilage6 Right", "right cartilage 6"),
        ("VHPC Sternum", "sternum"),
        ("pectoralis major left", "left pectoral"),
        ("pectoralis minor right", "right pectoral"),
        ("abdominals left bottom", "left abdominal"),
        ("erector spinae left", "left erector"),
        ("VHP Lungs", "lung"),
        ("VHP Heart muscle", "heart"),
        ("VHP Liver", "liver"),
        ("VHP Stomach", "stomach"),
        ("VHP Average body", "body"),
        ("VHP Fat", "fat"),
        ("VHP Skin", "skin"),
        ("VHP Humerus left", "left bone"),
        ("VHP Median Nerve left", "left carried"),
        # as in BodyParts3D
        ("Left_sixth_rib", "left rib 6"),
        ("right_twelfth_rib", "right rib 12"),
        ("left_fifth_costal_cartilage", "left cartilage 5"),
        ("body_of_sternum", "sternum"),
        ("manubrium", "sternum"),
        ("eighth_thoracic_vertebra", "vertebra 8"),
        ("intervertebral_disk_of_third_thoracic_vertebra", "disc"),
        ("upper_lobe_of_left_lung", "left lung"),
        ("left_clavicle", "left bone"),
        ("bronchial_tree_right_apical_a", "right carried"),
        ("right_coronary_artery", "right carried"),
        # as in the Human Reference Atlas
        ("hepatic_flexure_of_colon", "carried"),
        ("colon_hepatic_flexure", "carried"),
        ("uterus_abdominal_ostium_of_uterine_tube", "carried"),
        ("larynx_arytenoid_cartilage_l", "carried"),
        ("knee cartilage 2", "carried"),
        ("kidney_l_outer_cortex", "left kidney"),
        # traps
        ("vertebra_l3", "vertebra 3"),
        ("rib_L3", "left rib 3"),
        ("lung_left", "left lung"),
        ("abdominal_aorta", "carried"),
        ("intercostal_nerve_left_03", "left carried"),
        ("diaphragm", "diaphragm"),
        ("pulmonary_vein_branch_left_01", "left carried"),
    ],
)
def test_names_of_three_schemes_give_their_roles(name, role):
    assert str(guess_role(name)) == role


def test_every_tissue_of_the_phantom_has_the_role_that_it_was_made_for():
    roles = assign(generate(20_000))
    by_part: dict[str, list] = {}
    for role in roles.values():
        by_part.setdefault(role.part, []).append(role)
    pairs = {(side, number) for side in ("left", "right") for number in range(1, 13)}
    assert {(role.side, role.number) for role in by_part["rib"]} == pairs
    assert len(by_part["rib"]) == 24 and len(by_part["cartilage"]) == 20 and len(by_part["vertebra"]) == 15
    assert {role.side for role in by_part["lung"]} == {"left", "right"}
    for part in ("skin", "fat", "body", "heart", "liver", "stomach", "spleen", "diaphragm", "sternum"):
        assert len(by_part[part]) == 1
    carried = sorted(name for name, role in roles.items() if role.part == "carried")
    assert carried == [
        "aorta", "internal_thoracic_artery_left", "internal_thoracic_artery_right", "oesophagus", "phrenic_nerve_left",
        "phrenic_nerve_right", "trachea", "vagus_nerve_left", "vagus_nerve_right", "vena_cava",
    ]  # fmt: skip


def test_settings_come_before_names():
    said = {"tissue_17": {"role": "lung", "side": "left"}, "rib_left_03": {"number": 4}, "heart": {"role": "carried"}}
    roles = assign([*said, "liver"], said)
    assert str(roles["tissue_17"]) == "left lung"
    assert str(roles["rib_left_03"]) == "left rib 4"
    assert str(roles["heart"]) == "carried"
    assert str(roles["liver"]) == "liver"


@pytest.mark.parametrize("said", [{"role": "lungs"}, {"side": "up"}, {"number": 2.5}, {"number": True}])
def test_settings_that_are_not_understood_are_refused(said):
    with pytest.raises(UsageError, match="rib_left_03"):
        assign(["rib_left_03"], {"rib_left_03": said})


def test_a_bone_by_type_stays():
    assert guess_role("object_5", "bone").part == "bone"
    assert guess_role("object_5").part == "carried"
    assert {"bone", "carried", "lung"} <= set(parts())
