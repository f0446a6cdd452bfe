"""What tissues are made of: by the tables, by the user, and nothing made up."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

import vhp_cli
from vhp_cli.config import load_settings
from vhp_cli.errors import UsageError
from vhp_cli.stages.export.dielectric import dielectric, material_names
from vhp_cli.stages.export.materials import own_volumes, properties_of, user_materials

MHZ = 300e6
SETTINGS = load_settings()


def one(name, user=None, settings=SETTINGS, frequency=MHZ):
    rows = user_materials(user or {}, "materials")
    [found] = properties_of([name], settings, rows, frequency)
    return found


@pytest.mark.parametrize(
    ("name", "material", "density"),
    [
        ("liver", "Liver", 1079), ("Liver_segment_3", "Liver", 1079), ("left_renal_vein", "Blood", 1050),
        ("left_kidney", "Kidney", 1066), ("rib_left_05", "Bone (Cortical)", 1908),
        ("Rib5_marrow", "Bone Marrow (Not Infiltrated)", 980), ("costal_cartilage_left_03", "Cartilage", 1100),
        ("thyroid_cartilage", "Cartilage", 1100), ("thyroid", "Thyroid", None), ("pancreas", "Thyroid", 1087),
        ("spinal_cord", "Nerve", 1075), ("optic_nerve_left", "Nerve", 1075), ("skin", "Skin (Dry)", 1109),
        ("fat", "Fat (Not Infiltrated)", 911), ("average_body", "Muscle", 1090),
        ("lung_left", "Lung (Inflated)", 394), ("trachea", "Trachea", 1080), ("heart", "Heart", 1081),
        ("heart_wall_of_right_atrium", "Heart", 1081), ("heart_cavity_of_right_atrium", "Blood", 1050),
        ("left_lens", "Lens", None), ("gallbladder", "Gall Bladder", 1071), ("urinary_bladder", "Bladder", 1086),
        ("left_superior_temporal_gyrus", "Brain (Grey Matter)", 1046), ("white_matter", "Brain (White Matter)", 1046),
        ("cerebellum", "Cerebellum", None), ("CSF", "Cerebro Spinal Fluid", 1007), ("pulmonary_trunk", "Blood", 1050),
        ("erector_spinae_left", "Muscle", 1090), ("eye_lens_nucleus", "Lens Nucleus", None),
        ("oesophagus", "Stomach", 1040), ("lh_pial", "Brain (Grey Matter)", 1046), ("gm", "Brain (Grey Matter)", 1046),
        ("white_right", "Brain (White Matter)", 1046), ("wm", "Brain (White Matter)", 1046),
        ("pial_artery", "Blood", 1050), ("white_rami_of_nerve", "Nerve", 1075),
    ],
)  # fmt: skip
def test_materials_by_name(name, material, density):
    found = one(name)
    assert (found.material, found.density) == (material, density)
    values = dielectric(material, MHZ)
    assert (found.permittivity, found.conductivity) == (values.permittivity, values.conductivity)
    assert found.known and found.dielectric_source.startswith(f"Gabriel et al. 1996: {material}")
    assert bool(found.density_source) == (density is not None)


@pytest.mark.parametrize(
    "name",
    [
        "ureter_left", "common_bile_duct", "renal_pelvis", "maxillary_sinus", "mitral_valve", "heart_left_ventricle",
        "scalp", "inner_skull", "part_17", "left_hand", "superior_branch_of_left_superior_cerebellar",
    ],
)  # fmt: skip
def test_nothing_is_made_up(name):
    found = one(name)
    assert found.material == "" and not found.known
    assert found.permittivity is found.conductivity is found.density is None
    assert found.dielectric_source == found.density_source == ""


@pytest.mark.parametrize(("name", "density"), [("larynx", 1100), ("brain", 1046)])
def test_a_density_alone_is_no_material(name, density):
    found = one(name)
    assert found.material == "" and not found.known and found.permittivity is None
    assert found.density == density and found.density_source


def test_without_a_frequency_there_are_no_dielectric_properties():
    found = one("liver", frequency=None)
    assert found.material == "Liver" and found.density == 1079 and not found.known
    own = one("liver", {"liver": {"permittivity": 50, "conductivity": 0.5}}, frequency=None)
    assert own.known and own.dielectric_source == "settings"


def test_what_the_user_says_comes_first():
    user = {
        "liver*": {"density": 1050.0, "source": "CT of the subject"},
        "*_tumour": {"material": "tumour", "permittivity": 62, "conductivity": 0.9, "density": 1060, "source": "own"},
        "lung_*": {"material": "Lung (Deflated)"},
        "bone_plate": {"material": "none"},
    }
    liver = one("Liver_left", user)
    assert (liver.material, liver.density, liver.density_source) == ("Liver", 1050.0, "CT of the subject")
    tumour = one("liver_tumour", user)
    assert (tumour.material, tumour.permittivity, tumour.conductivity) == ("tumour", 62, 0.9)
    assert (tumour.density, tumour.dielectric_source, tumour.density_source) == (1060, "own", "own")
    lung = one("lung_left", user)
    assert lung.material == "Lung (Deflated)" and lung.permittivity == dielectric("Lung (Deflated)", MHZ).permittivity
    assert lung.density == 394  # that of the tables
    plate = one("bone_plate", user)
    assert plate.material == "" and not plate.known and plate.dielectric_source == "settings"


def test_later_rows_come_before_earlier_ones():
    user = {"*": {"density": 1000}, "liver": {"density": 1060}}
    assert (one("spleen", user).density, one("liver", user).density) == (1000, 1060)
    assert one("liver", dict(reversed(user.items()))).density == 1000


def test_types_and_densities_of_the_settings(tmp_path):
    (tmp_path / "vhp.toml").write_text(
        '[[tissue]]\nmatch = "part_*"\ntype = "muscle"\nbreathe = { density = 1041.5 }\n'
        '[[tissue]]\nmatch = "left_hand"\ntype = "bone"\n'
        '[materials."part_2"]\nmaterial = "Tongue"\n'
    )
    settings = load_settings(model=[tmp_path])
    part = one("part_1", settings=settings)
    assert (part.material, part.density, part.density_source) == ("Muscle", 1041.5, "settings")
    # A type that the user sets holds where a guessed one would not.
    assert one("left_hand", settings=settings).material == "Bone (Cortical)"
    assert one("part_2", settings.materials, settings).material == "Tongue"


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"a": 3}, "expected a table of material"),
        ({"a": {"colour": 1}}, "'colour' is not known"),
        ({"a": {"permitivity": 1}}, "did you mean 'permittivity'"),
        ({"a": {"permittivity": 40}}, "permittivity and conductivity belong together"),
        ({"a": {"permittivity": 0.5, "conductivity": 1}}, "at least 1, not 0.5"),
        ({"a": {"permittivity": 2, "conductivity": -1}}, "at least 0, not -1"),
        ({"a": {"density": float("nan")}}, "expected a finite number"),
        ({"a": {"density": True}}, "expected a finite number"),
        ({"a": {"material": "Livre"}}, "no material 'Livre' in the table; did you mean 'Liver'"),
        ({"a": {"material": "none", "permittivity": 1, "conductivity": 0}}, "no material, yet"),
        ({"a": {"material": 5}}, "expected a text"),
        ({"a": {"source": "two\nlines"}}, "expected a text"),
    ],
)
def test_what_is_not_understood_is_said(table, message):
    with pytest.raises(UsageError, match=message) as caught:
        user_materials(table, "vhp.toml: materials")
    assert "vhp.toml: materials.'a'" in caught.value.message


def test_the_tables_name_materials_that_there_are():
    table = tomllib.loads((Path(vhp_cli.__file__).parent / "data" / "tissue_materials.toml").read_text())
    named = {row["material"] for row in table["tissue"] if "material" in row} | set(table["type"].values())
    assert named <= set(material_names())
    assert all(row["phrases"] and set(row) <= {"material", "phrases", "except", "like"} for row in table["tissue"])


def test_own_volumes_add_up_to_the_outermost():
    nesting = {"skin": None, "fat": "skin", "liver": "fat", "vein": "liver", "arm": None}
    own = own_volumes({"skin": 100.0, "fat": 90.0, "liver": 20.0, "vein": 2.0, "arm": 7.0}, nesting)
    assert own == {"skin": 10.0, "fat": 70.0, "liver": 18.0, "vein": 2.0, "arm": 7.0}
    # An open tissue has no volume; what lies in it counts for nobody.
    assert own_volumes({"liver": 20.0, "vein": 2.0}, nesting) == {"liver": 18.0, "vein": 2.0}
