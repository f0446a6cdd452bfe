from __future__ import annotations

import os
from pathlib import Path

import pytest

from vhp_cli.errors import UsageError
from vhp_cli.model import find_model, object_name
from vhp_cli.tissues import guess_type


def touch(directory: Path, *names: str) -> None:
    for name in names:
        path = directory / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"")


def names(*args, **kwargs):
    return [tissue.name for tissue in find_model(*args, **kwargs).tissues]


def test_natural_order_and_only_mesh_files(tmp_path):
    touch(tmp_path, "rib_10.stl", "rib_2.STL", "rib_1.ply", "notes.txt", ".hidden.stl", "._rib_2.stl", "deep/liver.obj")
    assert names([tmp_path]) == ["rib_1", "rib_2", "rib_10"]
    assert names([tmp_path], recursive=True) == ["liver", "rib_1", "rib_2", "rib_10"]


def test_a_list_of_files_and_directories(tmp_path):
    touch(tmp_path, "a/heart.stl", "b/liver.stl", "skin.stl")
    assert sorted(names([tmp_path / "skin.stl", tmp_path / "a", tmp_path / "b"])) == ["heart", "liver", "skin"]
    assert len(names([tmp_path / "skin.stl", tmp_path / "skin.stl"])) == 1


def test_clashing_names_stay_apart_and_are_reported(tmp_path):
    touch(tmp_path, "left/kidney.stl", "right/kidney.stl", "Heart wall.stl", "heart_wall.ply", "liver.stl")
    tissues = find_model([tmp_path], recursive=True).tissues
    assert len({tissue.name for tissue in tissues}) == 5
    clashing = {tissue.file for tissue in tissues if tissue.clashes}
    assert clashing == {"left/kidney.stl", "right/kidney.stl", "Heart wall.stl", "heart_wall.ply"}


def test_meshes_that_are_left_out_are_named(tmp_path):
    touch(tmp_path, "skin.stl", "brain.off", "eye.stl.gz", "notes.txt", "head/skull.stl", "head/scan.vtk")
    assert find_model([tmp_path]).unread == ("brain.off", "eye.stl.gz", "head/skull.stl")
    assert find_model([tmp_path], recursive=True).unread == ("brain.off", "eye.stl.gz", "head/scan.vtk")
    assert find_model([tmp_path / "skin.stl"]).unread == ()


def test_link_cycles_end(tmp_path):
    touch(tmp_path, "a.stl")
    (tmp_path / "again").symlink_to(tmp_path, target_is_directory=True)
    assert names([tmp_path], recursive=True) == ["a"]


def files(*args, **kwargs):
    return [tissue.file for tissue in find_model(*args, **kwargs).tissues]


def test_linked_directories_are_searched_once(tmp_path):
    touch(tmp_path, "model/a.stl", "model/z/b.stl", "elsewhere/c.stl", "elsewhere/deep/d.stl")
    model, elsewhere = tmp_path / "model", tmp_path / "elsewhere"
    for link, target in (("far", elsewhere), ("again", elsewhere), ("first", model / "z")):
        (model / link).symlink_to(target, target_is_directory=True)
    (elsewhere / "deep" / "back").symlink_to(elsewhere, target_is_directory=True)
    assert files([model], recursive=True) == ["a.stl", "again/c.stl", "again/deep/d.stl", "z/b.stl"]
    found = find_model([model])
    assert [tissue.file for tissue in found.tissues] == ["a.stl"]
    assert found.unread == ("again/c.stl", "again/deep/d.stl", "z/b.stl")


@pytest.mark.parametrize("recursive", [False, True])
def test_a_directory_that_cannot_be_read_is_named(tmp_path, monkeypatch, recursive):
    touch(tmp_path, "a.stl", "locked/b.stl")
    scandir = os.scandir

    def refusing(path):
        if Path(path).name == "locked":
            raise PermissionError(13, "Permission denied", path)
        return scandir(path)

    monkeypatch.setattr(os, "scandir", refusing)
    with pytest.raises(UsageError, match="locked: can't read the directory: Permission denied"):
        find_model([tmp_path], recursive=recursive)


@pytest.mark.parametrize(
    "name",
    ["a.msh", "a.MESH", "a.inp", "a.bdf", "a.zip", "a.stl.zip", "a.stl.bz2", "a.ply.xz", "a.obj.bz2", "a.obj.gz"],
)
def test_other_formats_and_packed_files_are_left_out_by_name(tmp_path, name):
    touch(tmp_path, "skin.stl", name)
    assert find_model([tmp_path]).unread == (name,)


def test_directories_of_one_name_stay_apart(tmp_path, monkeypatch):
    touch(tmp_path, "x/model/a.stl", "x/model/b.stl", "y/model/a.stl", "y/model/c.stl")
    monkeypatch.chdir(tmp_path)
    tissues = find_model([Path("x/model"), Path("y/model")]).tissues
    assert [tissue.file for tissue in tissues] == [
        "x/model/a.stl", "x/model/b.stl", "y/model/a.stl", "y/model/c.stl",
    ]  # fmt: skip
    assert [tissue.name for tissue in tissues] == ["x/model/a.stl", "b", "y/model/a.stl", "c"]
    assert [tissue.clashes for tissue in tissues] == [("y/model/a.stl",), (), ("x/model/a.stl",), ()]


def test_a_directorys_name_that_equals_the_path_of_another_file(tmp_path, monkeypatch):
    touch(tmp_path, "x/model/a.stl", "model/a.stl")
    monkeypatch.chdir(tmp_path)
    tissues = find_model([Path("x/model"), Path("model/a.stl")]).tissues
    assert [tissue.file for tissue in tissues] == ["model/a.stl", "x/model/a.stl"]
    assert all(tissue.clashes for tissue in tissues)


def test_names_are_unique_even_where_a_stem_looks_like_a_file(tmp_path):
    touch(tmp_path, "kidney.stl", "kidney.ply", "kidney.stl.obj")
    assert sorted(names([tmp_path])) == ["kidney.ply", "kidney.stl", "kidney.stl.obj"]


def test_the_same_file_in_other_spellings_counts_once(tmp_path, monkeypatch):
    touch(tmp_path, "model/a.stl", "model/b.stl")
    monkeypatch.chdir(tmp_path)
    link = Path("link")
    link.symlink_to("model", target_is_directory=True)
    Path("other.stl").symlink_to("model/a.stl")
    model = Path("model")
    assert files([model, tmp_path / "model", link]) == ["a.stl", "b.stl"]
    assert files([model / "a.stl", tmp_path / "model" / "a.stl", link / "a.stl", Path("other.stl")]) == ["model/a.stl"]
    assert files([model / "a.stl", link]) == ["link/b.stl", "model/a.stl"]
    assert files([model, model / ".." / "model" / "b.stl"]) == ["model/a.stl", "model/b.stl"]


def test_a_link_beside_its_target_is_a_tissue(tmp_path):
    touch(tmp_path, "liver.stl")
    (tmp_path / "alias.stl").symlink_to(tmp_path / "liver.stl")
    assert names([tmp_path]) == ["alias", "liver"]


def test_the_current_directory_among_others(tmp_path, monkeypatch):
    touch(tmp_path, "here/a.stl", "here/sub/b.stl", "c.stl")
    monkeypatch.chdir(tmp_path / "here")
    assert files([Path()]) == ["a.stl"]
    assert files([Path(), Path("..")]) == ["../c.stl", "a.stl"]
    found = find_model([Path(), Path("sub")])
    assert [tissue.file for tissue in found.tissues] == ["a.stl", "sub/b.stl"]
    assert found.unread == ()


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        ("肝", "心", False),
        ("печень", "ПЕЧЕНЬ", True),
        ("Heart wall", "heart__wall", True),
        ("caf\u00e9", "cafe\u0301", True),
        ("caf\u00e9", "cafe", False),
        ("\u0915\u093f", "\u0915\u093e", False),  # one Devanagari letter with two vowel signs
        ("rib 1", "rib 2", False),
    ],
)
def test_names_that_solvers_take_for_one(tmp_path, one, other, same):
    assert (object_name(one) == object_name(other)) == same
    touch(tmp_path, f"{one}.stl", f"{other}.ply")
    assert [bool(tissue.clashes) for tissue in find_model([tmp_path]).tissues] == [same, same]


def test_nothing_found_is_a_usage_error(tmp_path):
    with pytest.raises(UsageError, match="no mesh file"):
        find_model([tmp_path])
    with pytest.raises(UsageError, match="no such"):
        find_model([tmp_path / "missing"])


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("VHP Hands1 1Phalange left", "bone"),
        ("VHPC Cartilage6 Right", "cartilage"),
        ("VHP Median Nerve left", "nerve"),
        ("costal_cartilage_left_03", "cartilage"),
        ("left_sixth_rib", "bone"),
        ("ribs left7", "bone"),
        ("left_optic_nerve_2", "nerve"),
        ("leftOpticNerve", "nerve"),
        ("vessel_left_renal_vein", "vessel"),
        ("phrenic_nerve_left", "nerve"),
        ("Pectoralis major left", "muscle"),
        ("average_body", "shell"),
        ("skin", "shell"),
        ("lung_left", "airway"),
        ("gallbladder", "organ"),
        ("left_cingulate_gyrus", "brain"),
        ("intervertebral_disk_of_first_thoracic_vertebra", "cartilage"),
        ("thing_42", "tissue"),
    ],
)
def test_types_from_names(name, kind):
    assert guess_type(name) == kind
