"""What the mesher is told of how tissues lie to each other."""

from __future__ import annotations

from vhp_cli.pipeline.tetmesh_input import relations_of


def pair(a, b, relation, gap=None, *, inside="", overlap=0.0, undecided=False):
    return {
        "a": a, "b": b, "relation": relation, "inside": inside, "min_gap_mm": gap, "overlap_mm3": overlap,
        "undecided": undecided,
    }  # fmt: skip


def test_relations_of_a_report():
    pairs = [
        pair("core", "shell", "a_inside_b", 0.5, inside="a"),
        pair("deep", "shell", "a_inside_b", None, inside="a"),
        pair("fat", "skin", "touching", 0.0, inside="a"),
        pair("left", "right", "touching", 0.0),
        pair("bone", "disc", "crossing", 0.0, overlap=3.0),
        pair("bone", "copy", "identical", 0.0, overlap=7.0),
        pair("bone", "rib", "disjoint", 0.3),
        pair("open", "rib", "disjoint", 0.4, undecided=True),
    ]
    failed = [
        {"rule": "F012", "tissues": ["rib", "broken"]},
        {"rule": "F012", "tissues": ["rib"]},
        {"rule": "P005", "tissues": ["bone", "rib"]},
    ]
    found = relations_of({"pairs": pairs, "findings": failed})
    assert found.containers == {"core": {"shell"}, "deep": {"shell"}, "fat": {"skin"}}
    assert found.overlaps_mm3 == {("bone", "disc"): 3.0, ("bone", "copy"): 7.0}
    assert found.gaps_mm == {("core", "shell"): 0.5} and found.smallest_gap_mm == 0.5
    assert found.distances_mm == {("bone", "rib"): 0.3, ("open", "rib"): 0.4} and found.smallest_distance_mm == 0.3
    assert found.contacts == {("fat", "skin"), ("left", "right"), ("open", "rib"), ("rib", "broken")}
    some = found.among({"core", "shell", "bone", "disc", "left"})
    assert some.containers == {"core": {"shell"}} and some.overlaps_mm3 == {("bone", "disc"): 3.0}
    assert some.gaps_mm == found.gaps_mm and not some.distances_mm and not some.contacts
    assert found.among(()).smallest_gap_mm is None and found.among(()).smallest_distance_mm is None
