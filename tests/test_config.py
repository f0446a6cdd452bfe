from __future__ import annotations

from pathlib import Path

import pytest

from vhp_cli.config import load_settings, profiles
from vhp_cli.errors import UsageError
from vhp_cli.rules import RULES


def write(directory: Path, text: str) -> Path:
    path = directory / "vhp.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_strict_is_the_rule_table():
    settings = load_settings()
    assert settings.profile == "strict"
    assert {code: (s.level, s.limit) for code, s in settings.rules.items()} == {
        code: (rule.level, rule.limit) for code, rule in RULES.items()
    }


@pytest.mark.parametrize("profile", profiles())
def test_no_profile_lets_an_open_or_self_crossing_surface_pass(profile):
    settings = load_settings(profile=profile)
    for code in ("F001", "F002", "F003", "F004", "T001", "T002", "T003", "T004", "T005", "X001", "X002"):
        assert settings.rule(code).level == "error", code


def test_command_line_beats_file_beats_profile(tmp_path):
    config = write(
        tmp_path, 'profile = "hfss"\nunits = "cm"\n[rules]\nP005 = 0.5\nQ002 = { limit = 0.2 }\nT007 = "off"\n'
    )
    settings = load_settings(config=config, limits={"P005": 0.25})
    assert settings.profile == "hfss"
    assert settings.units == "cm"
    assert settings.rule("P005").limit == 0.25
    assert settings.rule("Q002").limit == 0.2
    assert settings.rule("T007").level is None
    assert load_settings(config=config, profile="print", units="mm").rule("P001").level == "warning"


def test_file_is_found_in_the_model_directory(tmp_path):
    (tmp_path / "pyproject.toml").write_text('[tool.vhp]\nprofile = "cst"\n')
    assert load_settings(model=[tmp_path]).profile == "cst"
    write(tmp_path, 'profile = "print"')
    assert load_settings(model=[tmp_path]).profile == "print"


def test_tissue_overrides_apply_to_matching_names_and_the_milder_one_to_pairs(tmp_path):
    text = (
        '[[tissue]]\nmatch = "*NERVE*"\ntype = "nerve"\nrules = { P005 = 0.5, Q001 = "warning" }\n'
        '[[tissue]]\nmatch = "skin"\nrules = { P005 = "off" }\n'
    )
    settings = load_settings(config=write(tmp_path, text))
    assert settings.rule("Q001", "optic_nerve").level == "warning"
    assert settings.rule("Q001", "liver").level == "error"
    assert settings.rule("P005", "optic_nerve", "liver").limit == 0.5
    assert settings.rule("P005", "kidney", "liver").limit == 1.0
    assert settings.rule("P005", "skin", "liver").level is None
    assert settings.tissue_type("my_nerve_bundle") == "nerve"


def test_select_and_ignore_take_prefixes():
    settings = load_settings(select=["T", "X001"], ignore=["T007"])
    on = {code for code, setting in settings.rules.items() if setting.level}
    files = {code for code, rule in RULES.items() if code.startswith("F") and rule.level == "error"}
    assert on == {code for code in RULES if code.startswith("T")} - {"T007"} | {"X001"} | files
    assert load_settings(select=["X"], ignore=["F"]).rule("F001").level is None


def test_a_selected_rule_is_on(tmp_path):
    config = write(tmp_path, "ignore = ['P']\n[rules]\nP001 = 'off'")
    assert load_settings(config=config, select=["P001"]).rule("P001").level == "error"
    assert load_settings(config=config).rule("P001").level is None


def test_nan_is_no_limit():
    for options in (
        {"limits": {"P005": float("nan")}},
        {"weld_tolerance_mm": float("nan")},
        {"gap_search_mm": float("nan")},
    ):
        with pytest.raises(UsageError, match="nan"):
            load_settings(**options)
    with pytest.raises(UsageError, match="finite"):
        load_settings(weld_tolerance_mm=float("inf"))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("profile = 3", "profile"),
        ('profile = "strct"', "strct"),
        ('unit = "mm"', "'units'"),
        ('units = "ft"', "ft"),
        ("[rules]\nX999 = 'off'", "X999"),
        ("[rules]\nT001 = 'fatal'", "fatal"),
        ("[rules]\nT001 = { limit = 3 }", "no limit"),
        ("[rules]\nQ001 = { limit = -1 }", "negative"),
        ("[rules]\nQ001 = { limit = nan }", "negative"),
        ("[rules]\nP005 = inf", "finite"),
        ("profile = ''", "no profile"),
        ("[rules]\nQ001 = { lmit = 1 }", "'limit'"),
        ("[[tissue]]\ntype = 'bone'", "match"),
        ("[[tissue]]\nmatch = '*'\ntype = 'bones'", "'bone'"),
        ("recursive = 'yes'", "true or false"),
        ("tissue = 3", "[[tissue]]"),
        ("[[nested]]\ninner = 'a'", "outer"),
        ("select = ['Z']", "'Z'"),
        ("this is not toml", "TOML"),
    ],
)
def test_mistakes_are_named_with_their_place(tmp_path, text, words):
    path = write(tmp_path, text)
    with pytest.raises(UsageError) as caught:
        load_settings(config=path)
    assert words in caught.value.message
    assert "vhp.toml" in caught.value.message or "select" in caught.value.message


def test_missing_file_is_named(tmp_path):
    with pytest.raises(UsageError, match=r"none\.toml"):
        load_settings(config=tmp_path / "none.toml")
