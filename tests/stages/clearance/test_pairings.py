"""What two tissues are to each other, and who gives way."""

from __future__ import annotations

import math

import pytest

from vhp_cli.config import PairPattern, Settings, load_settings
from vhp_cli.errors import UsageError
from vhp_cli.stages.clearance.options import ClearanceOptions
from vhp_cli.stages.clearance.relations import TOUCHING_MM, pairing
from vhp_cli.stages.clearance.stiffness import Stiffness, default_yielding, share_of, stiffness_of, thickness_of
from vhp_cli.tissues import type_names


def pair(relation="crossing", overlap=0.0, gap=0.0, inside=""):
    return {"a": "a", "b": "b", "relation": relation, "inside": inside, "min_gap_mm": gap, "overlap_mm3": overlap}


ORGAN = Stiffness(0.6)


def decided(record, *, volumes=(1000.0, 1000.0), stiffness=(ORGAN, ORGAN), settings=None, **options):
    tissues = {name: {"volume_mm3": volume, "closed": True} for name, volume in zip("ab", volumes, strict=True)}
    return pairing(
        record,
        tissues,
        dict(zip("ab", stiffness, strict=True)),
        settings or load_settings(),
        ClearanceOptions(**options),
    )


def declared(**patterns) -> Settings:
    from dataclasses import replace

    return replace(load_settings(), **patterns)


@pytest.mark.parametrize(
    ("record", "kind", "close"),
    [
        (pair(overlap=50), "apart", True),
        (pair("touching"), "apart", True),
        (pair("disjoint", gap=0.99), "apart", True),
        (pair("disjoint", gap=1.0), "apart", False),
        (pair("disjoint", gap=None), "apart", False),
        (pair("a_inside_b", gap=0.3, inside="a"), "nested", True),
        (pair("b_inside_a", gap=2.0, inside="b"), "nested", False),
        (pair(overlap=400), "conflict", True),
        (pair(overlap=1000), "conflict", True),  # neither is the inner one
        (pair("identical", overlap=1000), "identical", True),
    ],
)
def test_kinds_by_what_the_surfaces_are(record, kind, close):
    found = decided(record)
    assert (found.kind, found.close) == (kind, close)


def test_one_that_lies_in_the_other_for_the_most_part_was_meant_to():
    small, large = Stiffness(0.6, thickness_mm=15), Stiffness(0.6, thickness_mm=60)
    found = decided(pair(overlap=700), volumes=(1000, 50_000), stiffness=(small, large))
    assert (found.kind, found.inner, found.outer, found.share, found.close) == ("nested", "a", "b", 1.0, True)
    assert decided(pair(overlap=700), volumes=(50_000, 1000), stiffness=(large, small)).inner == "b"
    assert decided(pair(overlap=590), volumes=(1000, 50_000), stiffness=(small, large)).kind == "conflict"


@pytest.mark.parametrize("thickness", [(1.2, 8.0), (3.7, 3.8), (15.0, 16.0)])
def test_what_is_thin_or_has_no_room_in_the_other_is_not_brought_inside_but_keeps_the_common_volume(thickness):
    """An artery of 1 mm in a fold of the brain would vanish; a nerve labelled twice can't lie inside itself."""
    stiffness = tuple(Stiffness(0.6, thickness_mm=one) for one in thickness)
    found = decided(pair(overlap=700), volumes=(1000, 50_000), stiffness=stiffness)
    assert (found.kind, found.winner, found.share) == ("conflict", "a", 0.0)
    # What lies inside but for an end, or is rigid, or is declared, is nested all the same.
    thin = (Stiffness(0.6, thickness_mm=2), ORGAN)
    assert decided(pair(overlap=950), volumes=(1000, 50_000), stiffness=thin).inner == "a"
    bone = decided(pair(overlap=700), volumes=(1000, 50_000), stiffness=(Stiffness(0.0, thickness_mm=2), ORGAN))
    assert (bone.inner, bone.share_of("b")) == ("a", 1.0)
    assert decided(pair("a_inside_b", gap=0.2, inside="a"), stiffness=stiffness).inner == "a"
    nested = declared(nested=(PairPattern("a", "b"),))
    assert decided(pair(overlap=700), volumes=(1000, 50_000), stiffness=stiffness, settings=nested).inner == "a"


def test_a_rigid_inner_tissue_makes_the_outer_one_grow():
    bone, soft = Stiffness(0.0), Stiffness(0.7)
    record = pair("a_inside_b", gap=0.2, inside="a")
    assert decided(record, stiffness=(bone, soft)).share_of("b") == 1
    assert decided(record, stiffness=(soft, bone)).share_of("a") == 1
    assert decided(record, stiffness=(bone, bone)).share_of("a") == 1
    assert decided(record, stiffness=(Stiffness(0.0, fixed=True), bone)).share_of("b") == 1
    fixed = Stiffness(0.5, fixed=True)
    assert decided(record, stiffness=(fixed, fixed)).kind == "kept"


def test_a_conflict_goes_to_the_one_for_which_losing_is_worse():
    stiff, soft = Stiffness(0.1), Stiffness(0.7)
    found = decided(pair(overlap=400), stiffness=(soft, stiff))
    assert (found.winner, found.share) == ("b", 1.0) and "40%" in found.reason
    assert decided(pair(overlap=400), volumes=(1000, 900), stiffness=(soft, soft)).winner == "b"
    assert decided(pair(overlap=400), volumes=(900, 1000), stiffness=(soft, soft)).winner == "a"
    assert decided(pair(overlap=400), stiffness=(Stiffness(0.9, fixed=True), stiff)).winner == "a"
    bone = Stiffness(0.0)
    assert decided(pair(overlap=400), volumes=(50_000, 1000), stiffness=(bone, soft)).winner == "a"
    assert decided(pair(overlap=400), volumes=(1000, 900), stiffness=(bone, bone)).winner == "b"


def test_a_thin_wall_keeps_what_a_stiffer_organ_can_spare():
    """A diaphragm of 88 ml, 33 of them in a liver of 840: that loses 4 %, the wall would lose 37 %."""
    wall, organ = Stiffness(0.7, thickness_mm=6), Stiffness(0.6)
    found = decided(pair(overlap=33_000), volumes=(88_000, 840_000), stiffness=(wall, organ))
    assert (found.kind, found.winner, found.share) == ("conflict", "a", 0.0)


def test_declared_pairs():
    may_touch = declared(may_touch=(PairPattern("B", "a*"),))
    found = decided(pair("touching"), settings=may_touch)
    assert not found.close and found.may_touch
    found = decided(pair(overlap=5), settings=may_touch)
    assert found.close and found.gap_mm == TOUCHING_MM
    nested = declared(nested=(PairPattern("b", "a"),))
    found = decided(pair(overlap=5), settings=nested)
    assert (found.kind, found.inner, found.close) == ("nested", "b", True)


def test_shares_follow_from_yielding_and_thickness():
    assert share_of(Stiffness(0.0), Stiffness(0.7), thin_mm=4.5) == 0
    assert share_of(Stiffness(0.7), Stiffness(0.0), thin_mm=4.5) == 1
    assert share_of(Stiffness(0.6), Stiffness(0.6), thin_mm=4.5) == 0.5
    assert share_of(Stiffness(0.6, thickness_mm=10), Stiffness(0.6), thin_mm=4.5) == pytest.approx(1 / 3)
    # A thin one stays if the other one can give way, and gives way alone if that is rigid or thinner still.
    assert share_of(Stiffness(0.7, thickness_mm=3), Stiffness(0.6), thin_mm=4.5) == 0
    assert share_of(Stiffness(0.7, thickness_mm=3), Stiffness(0.0), thin_mm=4.5) == 1
    assert share_of(Stiffness(0.7, thickness_mm=3), Stiffness(0.7, thickness_mm=2), thin_mm=4.5) == 1
    # Rigid ones give way to each other only.
    assert share_of(Stiffness(0.0), Stiffness(0.0), thin_mm=4.5) == 0.5
    assert share_of(Stiffness(0.0, fixed=True), Stiffness(0.0), thin_mm=4.5) == 0
    assert share_of(Stiffness(0.0), Stiffness(0.9, fixed=True), thin_mm=4.5) == 1


def test_of_two_rigid_tissues_that_cross_the_larger_one_gives_way():
    bones = (Stiffness(0.0), Stiffness(0.0))
    for relation in ("crossing", "touching"):
        found = decided(pair(relation, overlap=5), stiffness=bones, volumes=(900.0, 1000.0))
        assert (found.kind, found.share, found.gap_mm, found.aim_mm, found.reason) == ("apart", 0.0, 1.0, 1.0, "")
        found = decided(pair(relation, overlap=5), stiffness=bones, volumes=(900.0, 1000.0), rigid_gap_mm=0.3)
        assert (found.kind, found.share, found.gap_mm, found.aim_mm) == ("apart", 0.0, 1.0, 0.3)
        assert "b gives way by no more than parts them" in found.reason
    found = decided(pair("disjoint", gap=0.1), stiffness=bones)
    assert (found.kind, found.close) == ("kept", True) and "neither cross nor touch" in found.reason
    one_fixed = (Stiffness(0.0), Stiffness(0.0, fixed=True))
    assert decided(pair(overlap=5), stiffness=one_fixed, volumes=(900.0, 1000.0)).share == 1.0
    # The gap that was asked for is the least, if it is smaller still.
    found = decided(pair(overlap=5), stiffness=bones, rigid_gap_mm=2.0)
    assert (found.aim_mm, found.reason) == (1.0, "")


def test_rigid_pairs_can_share_the_way_or_be_left_as_they_are():
    bones = (Stiffness(0.0), Stiffness(0.0))
    found = decided(pair(overlap=5), stiffness=bones, rigid_pairs="share")
    assert (found.kind, found.share, found.aim_mm) == ("apart", 0.5, 1.0)
    assert decided(pair(overlap=5), stiffness=bones, rigid_pairs="keep").kind == "kept"


def test_thickness_is_the_mean_chord():
    assert thickness_of(math.pi * 4 * 100, 2 * math.pi * 2 * 100) == pytest.approx(4)  # a long cylinder: its diameter
    assert thickness_of(-4 / 3 * math.pi * 27, 4 * math.pi * 9) == pytest.approx(4)  # a ball: 2/3 of its diameter
    assert thickness_of(1.0, 0.0) == 0


def test_every_tissue_type_has_a_default_and_settings_come_before_it():
    assert set(default_yielding()) == set(type_names())
    assert stiffness_of("bone", []).rigid
    assert not stiffness_of("muscle", []).rigid
    tables = [("first", {"yielding": 0.2}), ("second", {"fixed": True})]
    assert stiffness_of("bone", tables) == Stiffness(0.2, fixed=True)
    for table, message in [({"yield": 1}, "yielding"), ({"yielding": 2}, "at most 1"), ({"fixed": 1}, "true or false")]:
        with pytest.raises(UsageError, match=message):
            stiffness_of("bone", [("here", table)])
