"""The errors of faces: in the order of the file, one for each facet, and everything that can be wrong with them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from shapes import sphere

from vhp_cli import formats
from vhp_cli.errors import VhpError
from vhp_cli.formats import write_mesh
from vhp_cli.model import Model, TissueFile
from vhp_cli.pipeline.face_errors import FaceErrors, fingerprint, read_face_errors


def stl(corners):
    """A binary STL file of these facets (n, 3, 3), whatever their values."""
    records = np.zeros(len(corners), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    records["corners"] = corners
    return bytes(80) + len(corners).to_bytes(4, "little") + records.tobytes()


@pytest.fixture
def corners():
    mesh = sphere(subdivisions=1)
    return np.array(mesh.vertices[mesh.faces])


def read(path, where):
    data = path.read_bytes()
    tissue = TissueFile(path.stem, path, path.name)
    reading = formats.parse_mesh(path, data)
    return read_face_errors(where, tissue, data, reading), reading


def test_facets_that_are_left_out_keep_their_place(tmp_path, corners):
    """Collapsed and repeated facets are in the mesh, those that are not finite are not; each keeps its error."""
    corners[3, 0, 0] = np.nan
    corners[10, 1] = corners[10, 0]
    corners[20] = corners[19]
    corners[41, 2, 1] = np.inf
    path = tmp_path / "a.stl"
    path.write_bytes(stl(corners))
    np.save(tmp_path / "a.npy", np.arange(80.0))
    for where in (FaceErrors(tmp_path / "a.npy", "error"), FaceErrors(tmp_path, "error")):
        errors, reading = read(path, where)
        assert errors.tolist() == [number for number in range(80) if number not in (3, 41)]
        for face, number in enumerate(errors.astype(int)):
            assert (reading.mesh.vertices[reading.mesh.faces[face]] == corners[number].astype(np.float32)).all()


def test_without_anything_left_out(tmp_path, corners):
    path = tmp_path / "a.stl"
    path.write_bytes(stl(corners))
    values = np.random.default_rng(0).random(80)
    np.save(tmp_path / "a.npy", values)
    assert read(path, FaceErrors(tmp_path, "error"))[0].tolist() == values.tolist()


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (np.ones(79), "79 errors for 80 facets in a.stl"),
        (np.ones(81), "81 errors for 80 facets"),
        (np.ones(1), "1 error for 80 facets"),
        (np.ones(0), "0 errors for 80 facets"),
        (np.ones((80, 1)), r"shape \(80, 1\)"),
        (np.where(np.arange(80) % 40 == 9, np.nan, 1), "2 errors negative or not finite, first facet 9, nan"),
        (np.where(np.arange(80) == 5, np.inf, 1), "1 error negative or not finite, first facet 5, inf"),
        (np.where(np.arange(80) == 5, -0.5, 1), "first facet 5, -0.5"),
    ],
)
def test_wrong_arrays_are_named(tmp_path, corners, values, message):
    path = tmp_path / "a.stl"
    path.write_bytes(stl(corners))
    np.save(tmp_path / "a.npy", values)
    with pytest.raises(VhpError, match=message) as caught:
        read(path, FaceErrors(tmp_path, "error"))
    assert "a.npy" in caught.value.message


def test_a_missing_array_is_named(tmp_path, corners):
    path = tmp_path / "a.stl"
    path.write_bytes(stl(corners))
    with pytest.raises(VhpError, match=r"no errors: .*a\.npy: can't read the file: No such file"):
        read(path, FaceErrors(tmp_path, "error"))
    with pytest.raises(VhpError, match="only PLY files hold them"):
        read(path, FaceErrors(None, "error"))


def test_property_of_a_ply_file(tmp_path):
    points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1)]
    faces = ["4 0 1 2 3 0.5", "3 0 1 9 0.7", "3 0 1 4 0.25"]
    text = "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float z\n"
    text += "element face 3\nproperty list uchar int vertex_indices\nproperty float residual\nend_header\n"
    text += "\n".join([*(f"{x} {y} {z}" for x, y, z in points), *faces]) + "\n"
    path = tmp_path / "a.ply"
    path.write_text(text)
    errors, reading = read(path, FaceErrors(None, "residual"))
    assert len(reading.mesh.faces) == 3
    assert errors.tolist() == [0.5, 0.5, 0.25]
    with pytest.raises(VhpError, match=r"the faces of a\.ply have no number 'error'"):
        read(path, FaceErrors(None, "error"))
    path.write_text(text.replace("0.25", "nan"))
    with pytest.raises(VhpError, match="property 'residual': 1 error negative or not finite, first facet 2, nan"):
        read(path, FaceErrors(None, "residual"))


def test_the_fingerprint_follows_what_the_files_hold(tmp_path):
    tissues = []
    for name in ("a", "b"):
        write_mesh(tmp_path / f"{name}.stl", sphere(subdivisions=0))
        np.save(tmp_path / f"{name}.npy", np.ones(20))
        tissues.append(TissueFile(name, tmp_path / f"{name}.stl", f"{name}.stl"))
    model, where = Model(tuple(tissues)), FaceErrors(tmp_path, "error")
    first = fingerprint(where, model)
    np.save(tmp_path / "other.npy", np.ones(3))
    assert fingerprint(where, model) == first
    np.save(tmp_path / "b.npy", np.arange(20.0))
    second = fingerprint(where, model)
    (tmp_path / "a.npy").unlink()
    assert len({first, second, fingerprint(where, model)}) == 3
    assert isinstance(where.file_of(tissues[0]), Path)
