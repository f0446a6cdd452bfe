"""Findings on tetrahedral meshes: each rule at its limit and beyond."""

from __future__ import annotations

import copy

import pytest

from vhp_cli.config import RuleChange, Settings, TissueOverride, load_settings
from vhp_cli.gate_tetmesh import tetmesh_findings

SHAPE = {
    "min_dihedral_deg": 10.0,
    "min_dihedral_p01_deg": 20.0,
    "max_dihedral_deg": 150.0,
    "radius_ratio_min": 0.1,
    "radius_ratio_p01": 0.35,
    "radius_ratio_p05": 0.4,
    "radius_ratio_p50": 0.7,
    "scaled_jacobian_min": 0.01,
    "inverted": 0,
    "mean_edge_mm": 2.0,
}
LABEL = {
    "name": "liver",
    "label": 1,
    "tets": 100,
    "volume_mm3": 99.0,
    "surface_volume_mm3": 100.0,
    "surface_volume_exact": True,
    "enclosed_mm3": 99.0,
    "surface_enclosed_mm3": 100.0,
    "volume_error": -0.01,
    "parts": 1,
    "expected_parts": 1,
    "boundary": {"triangles": 50, "area_mm2": 60.0, "nonmanifold_edges": 0, "nonmanifold_vertices": 0},
    "quality": SHAPE,
    "relabelled_tets": 0,
    "defects": [],
}
MESH = {"labels": [LABEL], "overlaps": [], "relaxed": [], "nonconforming": {}}
PLACE = {"xyz_mm": [1.0, 2.0, 3.0], "face": None}


def findings(changes=None, quality=None, boundary=None, settings=None, **whole):
    mesh = copy.deepcopy(MESH) | whole
    mesh["labels"][0] |= changes or {}
    if quality:
        mesh["labels"][0]["quality"] |= quality
    if boundary:
        mesh["labels"][0]["boundary"] |= boundary
    places = {"liver": {f"M{number:03}": [PLACE] for number in range(15)}}
    return tetmesh_findings(mesh, places, settings or load_settings())


def test_at_the_limits_nothing_is_wrong():
    assert findings() == []


@pytest.mark.parametrize(
    ("code", "level", "given"),
    [
        ("M001", "error", {"changes": {"tets": 0, "quality": None, "boundary": None}}),
        ("M002", "error", {"changes": {"volume_error": -0.0501}}),
        ("M002", "error", {"changes": {"volume_error": 0.2}}),
        ("M003", "warning", {"changes": {"volume_error": 0.0101}}),
        ("M004", "error", {"quality": {"inverted": 3}}),
        ("M005", "warning", {"quality": {"min_dihedral_deg": 9.99}}),
        ("M006", "warning", {"quality": {"radius_ratio_p01": 0.349}}),
        ("M007", "error", {"quality": {"scaled_jacobian_min": 0.0099}}),
        ("M008", "error", {"nonconforming": {"parts within others": 2}}),
        ("M009", "warning", {"boundary": {"nonmanifold_edges": 4}}),
        ("M010", "note", {"boundary": {"nonmanifold_vertices": 4}}),
        ("M011", "warning", {"changes": {"parts": 2}}),
        ("M011", "warning", {"changes": {"parts": 1, "expected_parts": 3}}),
        ("M012", "warning", {"changes": {"defects": ["T001"]}}),
        ("M013", "warning", {"overlaps": [{"a": "liver", "b": "lung", "overlap_mm3": 2.0, "winner": "lung"}]}),
        ("M014", "warning", {"relaxed": ["edges of 5 mm, not 4"]}),
    ],
)
def test_beyond_them_one_rule_is_broken(code, level, given):
    (found,) = findings(**given)
    assert (found["rule"], found["level"]) == (code, level)
    assert found["tissues"] == {"M008": [], "M013": ["liver", "lung"], "M014": []}.get(code, ["liver"])
    assert bool(found["places"]) == (code in ("M004", "M005", "M006", "M007", "M009", "M010", "M011"))
    assert found["count"] >= 1 and found["message"] and found["hint"]


def test_what_is_not_known_is_not_judged():
    assert findings({"volume_error": None, "expected_parts": None, "parts": 5}) == []


def test_limits_and_levels_are_those_of_the_settings():
    settings: Settings = load_settings(limits={"M005": 20}, ignore=["M006"])
    found = findings(quality={"radius_ratio_p01": 0.1}, settings=settings)
    assert [finding["rule"] for finding in found] == ["M005"]
    mild = TissueOverride("liv*", None, {"M002": RuleChange(limit=0.3)})
    from dataclasses import replace

    changed = replace(load_settings(), tissues=(mild,))
    assert [one["rule"] for one in findings({"volume_error": 0.2}, settings=changed)] == ["M003"]
