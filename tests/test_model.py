from __future__ import annotations

from pathlib import Path

import pytest

from vhp_cli.errors import UsageError
from vhp_cli.model import find_model
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
