"""OBJ files as programs write them."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_array_equal
from shapes import sphere

from vhp_cli.errors import UnreadableFileError
from vhp_cli.formats import parse_mesh, read_mesh, write_mesh
from vhp_cli.formats.obj import obj_bytes
from vhp_cli.mesh import Mesh

MESH = sphere(subdivisions=1)
N = len(MESH.faces)
SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
FLAT = [[[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]]]


def parse(data, tmp_path, **options):
    return parse_mesh(tmp_path / "x.obj", data.encode() if isinstance(data, str) else data, **options)


def rules(reading):
    return sorted(issue.rule for issue in reading.issues)


def triangles(mesh):
    return mesh.vertices[mesh.faces]


@pytest.mark.parametrize(
    "text",
    [
        pytest.param(SQUARE + "f 1 2 3\nf 1 3 4\n", id="plain"),
        pytest.param(SQUARE + "f 1 2 3\nf 1 3 4", id="no final newline"),
        pytest.param((SQUARE + "f 1 2 3\nf 1 3 4\n").replace("\n", "\r\n"), id="CRLF"),
        pytest.param((SQUARE + "f 1 2 3\nf 1 3 4\n").replace("\n", "\r"), id="CR"),
        pytest.param(SQUARE + "f 1/1 2/2 3/3\nf 1//7 3//8 4//9\n", id="texture or normal"),
        pytest.param(SQUARE + "f 1/1/1 2/2/2 3/3/3\nf 1/ 3/ 4//\n", id="texture and normal"),
        pytest.param(SQUARE + "f -4 -3 -2\nf -4 -2 -1\n", id="negative"),
        pytest.param("v 0 0 0\nv 1 0 0\nv 1 1 0\nf -3 -2 -1\nv 0 1 0\nf -4 -2 -1\n", id="negative in between"),
        pytest.param("f 1 2 3\nf 1 3 4\n" + SQUARE, id="faces first"),
        pytest.param(SQUARE.replace("\n", " 1.0\n") + "f 1 2 3\nf 1 3 4\n", id="weights"),
        pytest.param(SQUARE.replace("\n", " 0.1 0.2 0.3\n") + "f 1 2 3\nf 1 3 4\n", id="colours"),
        pytest.param("# made by X\n" + SQUARE + "f 1 2 3 # one\n#f 1 2 4\nf 1 3 4\n", id="remarks"),
        pytest.param(SQUARE + "f 1 2 \\\n3\nf \\\r\n 1 \\\n\\\n3 4\n", id="continued lines"),
        pytest.param("mtllib a.mtl\n" + SQUARE + "vn 0 0 1\nvt 0 0\ng skin\nusemtl b\ns off\nf 1 2 3\nf 1 3 4\nl 1 2\n",
                     id="other statements"),
        pytest.param("o liver\n" + SQUARE + "g a\nf 1 2 3\ng b\nf 1 3 4\n", id="groups"),
        pytest.param("\n\t \n" + SQUARE.replace(" ", "\t  ") + "\n\nf\t1 2 3  \n  f 1 3 4", id="white space"),
        pytest.param(SQUARE.replace("0", "-0.0").replace("1", "+1.E0") + "f +1 2 3\nf 1 3 4", id="numbers"),
    ],
)  # fmt: skip
def test_notations(tmp_path, text):
    reading = parse(text, tmp_path)
    assert_array_equal(triangles(reading.mesh), FLAT)
    assert len(reading.mesh.vertices) == 4
    assert (reading.issues, reading.format, reading.n_facets_stored) == ((), "obj", 2)
    assert (reading.face_number, reading.unreferenced, reading.solids) == (None, 0, 1)


def test_polygons(tmp_path):
    reading = parse(SQUARE + "f 1 2 3\nf 1 2 3 4\n", tmp_path)
    assert rules(reading) == ["F011"]
    assert_array_equal(triangles(reading.mesh), [FLAT[0], *FLAT])
    assert reading.face_number.tolist() == [0, 1, 1]


def test_several_objects(tmp_path):
    reading = parse("o a\n" + SQUARE + "f 1 2 3\no b\nf 1 3 4\n", tmp_path)
    assert rules(reading) == ["F008"]
    assert reading.solids == 2
    assert_array_equal(triangles(reading.mesh), FLAT)


@pytest.mark.parametrize(
    "wrong",
    [
        "f 1 2 5",
        "f 1 2 0",
        "f 1 2 -5",
        "f 1 2",
        "f",
        "f 1 2 x",
        "f 1 2 3 99",
        "f 1 2 99999999999999999999",
        "f 1 2 3.5",
    ],
)
def test_faces_that_cannot_be_right_are_an_error(tmp_path, wrong):
    reading = parse(f"{SQUARE}f 1 2 3\n{wrong}\nf 1 3 4\n", tmp_path)
    assert set(rules(reading)) - {"F011"} == {"F003", "F009"}
    assert_array_equal(triangles(reading.mesh), FLAT)
    assert reading.face_number.tolist() == [0, 2]
    assert reading.n_facets_stored == 3


@pytest.mark.parametrize("word", ["nan", "inf", "1e31", "x", "1,5"])
def test_vertices_that_cannot_be_used(tmp_path, word):
    reading = parse(SQUARE.replace("v 0 1 0", f"v 0 {word} 0") + "f 1 2 3\nf 1 3 4\n", tmp_path)
    assert set(rules(reading)) - {"F009"} == {"F004"}
    assert ("F009" in rules(reading)) == (word in ("x", "1,5"))
    assert_array_equal(triangles(reading.mesh), FLAT[:1])
    assert reading.face_number.tolist() == [0]


def test_a_vertex_with_two_coordinates(tmp_path):
    reading = parse(SQUARE.replace("v 0 1 0", "v 0 1") + "f 1 2 3\nf 1 3 4\n", tmp_path)
    assert rules(reading) == ["F004", "F009"]


def test_unknown_statements(tmp_path):
    reading = parse(SQUARE + "f 1 2 3\nq 1 2 3\nf 1 3 4\nface 1 2 3\n", tmp_path)
    assert rules(reading) == ["F009"]
    assert reading.issues[0].count == 2
    assert "line 6" in reading.issues[0].detail


def test_stretches_never_written_are_an_error(tmp_path):
    reading = parse(SQUARE + "f 1 2 3\n" + "\0" * 24 + "\nf 1 3 4\n", tmp_path)
    assert rules(reading) == ["F002", "F009"]


def test_unused_and_repeated_vertices(tmp_path):
    reading = parse("v 9 9 9\n" + SQUARE + SQUARE + "f 2 3 4\nf 6 8 9\n", tmp_path)
    assert reading.unreferenced == 3
    assert len(reading.mesh.vertices) == 4
    assert_array_equal(triangles(reading.mesh), FLAT)


def test_byte_order_mark(tmp_path):
    reading = parse(b"\xef\xbb\xbf" + (SQUARE + "f 1 2 3\nf 1 3 4\n").encode(), tmp_path)
    assert rules(reading) == ["F009"]
    assert_array_equal(triangles(reading.mesh), FLAT)


@pytest.mark.parametrize("text", ["", "# nothing\n", SQUARE, "o a\ng b\n"])
def test_no_face(tmp_path, text):
    reading = parse(text, tmp_path)
    assert (len(reading.mesh.faces), reading.issues) == (0, ())


@pytest.mark.parametrize(
    "data", [b"solid x\nendsolid", b"\x00\x01\x02" * 100, "<html>", SQUARE + "f 1 2\n", SQUARE + "f a b c\nf d e f\n"]
)
def test_other_contents(tmp_path, data):
    with pytest.raises(UnreadableFileError) as caught:
        parse(data, tmp_path)
    assert caught.value.where
    assert caught.value.hint


def test_files_of_another_program(tmp_path):
    mesh = trimesh.Trimesh(MESH.vertices, MESH.faces, process=False)
    reading = parse(mesh.export(file_type="obj", digits=12), tmp_path)
    assert np.allclose(triangles(reading.mesh), mesh.triangles, rtol=0, atol=1e-11)
    assert reading.issues == ()


def test_round_trip(tmp_path):
    path = tmp_path / "a.obj"
    mesh = Mesh(MESH.vertices / 3, MESH.faces)
    write_mesh(path, mesh)
    reading = read_mesh(path)
    assert_array_equal(reading.mesh.vertices, mesh.vertices)
    assert_array_equal(reading.mesh.faces, mesh.faces)
    assert reading.issues == ()
    assert obj_bytes(reading.mesh) == path.read_bytes()
