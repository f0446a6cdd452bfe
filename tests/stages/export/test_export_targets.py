"""Names of objects, and the table of targets."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vhp_cli.config import load_settings, profiles
from vhp_cli.errors import UsageError
from vhp_cli.formats.surfaces import FORMS
from vhp_cli.stages.export.materials import user_materials
from vhp_cli.stages.export.options import KEYS
from vhp_cli.stages.export.scripts import SCRIPTS
from vhp_cli.stages.export.targets import TARGETS, chosen_forms, object_names

VALID = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,59}")
WINDOWS = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)", re.I)


def test_names_stay_where_they_can():
    assert object_names(["liver", "Rib_1", "T3", "muscle_42"]) == ["liver", "Rib_1", "T3", "muscle_42"]


def test_names_that_programs_do_not_take():
    names = ["3rd rib", "pulmonary vein (left)", "sub/liver", "肋骨", "", "_hidden", "größe", "a" * 80, "a" * 90]
    assert object_names(names) == [
        "T3rd_rib", "pulmonary_vein_left_", "sub_liver", "T_", "T__2", "T_hidden", "gr_e", "a" * 60, f"{'a' * 58}_2",
    ]  # fmt: skip


def test_case_tells_no_names_apart():
    assert object_names(["Liver", "liver", "LIVER_2"]) == ["Liver", "liver_3", "LIVER_2"]


def test_names_of_devices_and_of_our_own_files_are_taken():
    assert object_names(["nul", "COM1", "model", "manifest"]) == [
        "nul_tissue", "COM1_tissue", "model_tissue", "manifest_tissue"
    ]  # fmt: skip


@given(st.lists(st.text(max_size=90) | st.sampled_from(["nul", "a", "A", "a b", "a_b", "a.b", "T_", "9"]), max_size=30))
def test_any_names_become_valid_and_unique(names):
    found = object_names(names)
    assert len(found) == len(names)
    assert all(VALID.fullmatch(name) and not WINDOWS.fullmatch(name) for name in found)
    assert len({name.casefold() for name in found}) == len(found)
    assert object_names(names) == found
    # A name that is fine is kept by the first that has it.
    for name in {name for name in names if VALID.fullmatch(name) and not WINDOWS.fullmatch(name)}:
        if name.casefold() not in ("model", "manifest", "report"):
            assert name in found or any(other.casefold() == name.casefold() for other in found)


def test_targets_use_what_there_is():
    for name, target in TARGETS.items():
        assert set(target.forms) <= set(FORMS) and target.profile in profiles(), name
        assert target.description
    strict = load_settings(profile="strict").rules
    for name in ("matlab", "comsol", "generic"):
        assert load_settings(profile=name).rules == strict


def test_the_documentation_names_everything():
    text = (Path(__file__).resolve().parents[3] / "docs" / "export.md").read_text(encoding="utf-8")
    for name in (*TARGETS, *FORMS):
        assert f"`{name}`" in text, name
    for key in KEYS:
        assert f"`--{key} " in text and f"`{key}`" in text, key
    for file, _ in SCRIPTS.values():
        assert f"`{file}`" in text, file
    for form in FORMS.values():
        assert f"{form.suffix}`" in text
    [example] = re.findall(r"```toml\n(.*?)```", text, re.S)
    assert len(user_materials(tomllib.loads(example)["materials"], "docs")) == 4


def test_formats_replace_or_add():
    hfss = TARGETS["hfss"]
    assert chosen_forms(hfss, []) == ("stl",)
    assert chosen_forms(hfss, ["ply", "obj"]) == ("ply", "obj")
    assert chosen_forms(hfss, ["+ply", "+stl"]) == ("stl", "ply")
    assert chosen_forms(hfss, ["mat", "+obj"]) == ("mat", "obj")
    with pytest.raises(UsageError, match="no such format of surfaces: 'step'"):
        chosen_forms(hfss, ["+step"])
    with pytest.raises(UsageError, match="bdf and nas"):
        chosen_forms(TARGETS["comsol"], ["+bdf"])
