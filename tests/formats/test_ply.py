"""PLY of all three encodings, with everything that its header allows."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_array_equal
from shapes import box, sphere

from vhp_cli.errors import UnreadableFileError
from vhp_cli.formats import parse_mesh, read_mesh, write_mesh
from vhp_cli.formats.ply import ply_bytes
from vhp_cli.mesh import Mesh

MESH = sphere(subdivisions=1)
N, V = len(MESH.faces), len(MESH.vertices)
ENCODINGS = ["ascii", "binary_little_endian", "binary_big_endian"]
NUMPY = {"float": "f4", "double": "f8", "uchar": "u1", "char": "i1", "short": "i2", "ushort": "u2", "int": "i4",
         "uint": "u4", "float32": "f4", "float64": "f8", "uint8": "u1", "int32": "i4", "uint32": "u4"}  # fmt: skip


def values(encoding, kind, *numbers):
    if encoding == "ascii":
        return " ".join(repr(number) for number in numbers).encode() + b" "
    order = "<" if encoding == "binary_little_endian" else ">"
    return np.array(numbers).astype(order + NUMPY[kind]).tobytes()


def lists(encoding, count_kind, kind, rows):
    end = b"\n" if encoding == "ascii" else b""
    return b"".join(
        values(encoding, count_kind, len(row)) + (values(encoding, kind, *row) if len(row) else b"") + end
        for row in rows
    )


def make(
    encoding,
    vertices=MESH.vertices,
    faces=MESH.faces,
    *,
    kind="float",
    count_kind="uchar",
    index_kind="int",
    list_name="vertex_indices",
    line_end="\n",
):
    header = [
        "ply", f"format {encoding} 1.0", "comment element face 5", f"element vertex {len(vertices)}",
        *(f"property {kind} {axis}" for axis in "xyz"), f"element face {len(faces)}",
        f"property list {count_kind} {index_kind} {list_name}", "end_header", "",
    ]  # fmt: skip
    end = line_end.encode() if encoding == "ascii" else b""
    rows = [values(encoding, kind, *vertex) + end for vertex in np.asarray(vertices).tolist()]
    rows = b"".join(rows) + lists(encoding, count_kind, index_kind, [list(map(int, face)) for face in faces])
    return line_end.join(header).encode() + rows


def parse(data, tmp_path, **options):
    return parse_mesh(tmp_path / "x.ply", data, **options)


def rules(reading):
    return sorted(issue.rule for issue in reading.issues)


def triangles(mesh):
    return mesh.vertices[mesh.faces]


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("kind", ["float", "double", "float32", "float64"])
@pytest.mark.parametrize("line_end", ["\n", "\r\n", "\r"])
def test_encodings(tmp_path, encoding, kind, line_end):
    reading = parse(make(encoding, kind=kind, line_end=line_end), tmp_path)
    assert_array_equal(reading.mesh.vertices, MESH.vertices)
    assert_array_equal(reading.mesh.faces, MESH.faces)
    assert reading.issues == ()
    assert reading.format == ("ply-ascii" if encoding == "ascii" else "ply-binary")
    assert (reading.n_facets_stored, reading.face_number, reading.unreferenced) == (N, None, 0)


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("count_kind", ["uchar", "char", "short", "ushort", "int", "uint", "uint8"])
@pytest.mark.parametrize("index_kind", ["uchar", "short", "ushort", "int", "uint", "int32", "float", "double"])
def test_list_types(tmp_path, encoding, count_kind, index_kind):
    data = make(encoding, count_kind=count_kind, index_kind=index_kind, list_name="vertex_index")
    reading = parse(data, tmp_path)
    assert_array_equal(reading.mesh.faces, MESH.faces)
    assert reading.issues == ()


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_other_properties_and_elements(tmp_path, encoding):
    header = f"""ply
format {encoding} 1.0
obj_info made for a test
element remark 2
property uchar n
property list ushort float extra
element vertex 4
property double nx
property float x
property uchar red
property double z
property float y
element edge 3
property int vertex1
property int vertex2
element face 3
property uchar quality
property list uchar float texcoord
property list ushort uint vertex_indices
property short label
element nothing 0
property float x
end_header
"""
    corners = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 2.0, 0.0), (0.0, 0.0, 3.0)]
    v = values
    body = v(encoding, "uchar", 1) + lists(encoding, "ushort", "float", [[1.5, 2.5]])
    body += v(encoding, "uchar", 1) + lists(encoding, "ushort", "float", [[]])
    for x, y, z in corners:
        body += v(encoding, "double", 9.0) + v(encoding, "float", x) + v(encoding, "uchar", 255)
        body += v(encoding, "double", z) + v(encoding, "float", y)
    body += v(encoding, "int", 0, 1, 1, 2, 2, 0)
    faces = [(0, 1, 2), (0, 3, 1), (1, 3, 2)]
    for i, face in enumerate(faces):
        body += v(encoding, "uchar", 5) + lists(encoding, "uchar", "float", [[0.5] * (6 - i)])
        body += lists(encoding, "ushort", "uint", [face]) + v(encoding, "short", -1)
    reading = parse(header.encode() + body, tmp_path)
    assert reading.issues == ()
    assert_array_equal(reading.mesh.vertices, corners)
    assert_array_equal(reading.mesh.faces, faces)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_vertices_with_lists(tmp_path, encoding):
    header = (
        f"ply\nformat {encoding} 1.0\nelement vertex 3\nproperty float x\nproperty list uchar int bones\n"
        "property float y\nproperty double z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
    )
    body = b""
    for i, (x, y, z) in enumerate([(1.0, 2.0, 3.0), (4.0, 5.0, 6.5), (7.0, 8.0, -9.0)]):
        body += values(encoding, "float", x) + lists(encoding, "uchar", "int", [[5] * i])
        body += values(encoding, "float", y) + values(encoding, "double", z)
    reading = parse(header.encode() + body + lists(encoding, "uchar", "int", [[0, 1, 2]]), tmp_path)
    assert reading.issues == ()
    assert_array_equal(reading.mesh.vertices, [(1, 2, 3), (4, 5, 6.5), (7, 8, -9)])


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_polygons(tmp_path, encoding):
    vertices = [(np.cos(a), np.sin(a), 0.0) for a in np.arange(6) * np.pi / 3]
    faces = [[0, 1, 2, 3, 4, 5], [0, 2, 1], [5, 4, 3, 2]]
    reading = parse(make(encoding, vertices, faces, kind="double"), tmp_path)
    assert rules(reading) == ["F011"]
    assert reading.issues[0].count == 2
    expected = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5], [0, 2, 1], [5, 4, 3], [5, 3, 2]]
    assert_array_equal(triangles(reading.mesh), np.array(vertices)[expected])
    assert reading.face_number.tolist() == [0, 0, 0, 0, 1, 2, 2]
    assert reading.n_facets_stored == 3


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("wrong", [[0, 1, V], [0, -1, 2], [1, 2], [], [2**31 - 1, 0, 1]])
def test_faces_that_cannot_be_right_are_an_error(tmp_path, encoding, wrong):
    faces = [*MESH.faces[:7], wrong, *MESH.faces[7:]]
    reading = parse(make(encoding, faces=faces), tmp_path)
    assert rules(reading) == ["F003", "F009"]
    assert reading.issues[0].count == 1
    assert_array_equal(triangles(reading.mesh), triangles(MESH))
    assert reading.face_number.tolist() == [*range(7), *range(8, N + 1)]


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("value", [np.nan, np.inf, -2e30])
def test_values_that_are_not_finite(tmp_path, encoding, value):
    vertices = MESH.vertices.copy()
    vertices[4, 2] = value
    reading = parse(make(encoding, vertices), tmp_path)
    assert rules(reading) == ["F004"]
    kept = np.flatnonzero(~(MESH.faces == 4).any(axis=1))
    assert_array_equal(triangles(reading.mesh), triangles(MESH)[kept])
    assert_array_equal(reading.face_number, kept)
    assert reading.issues[0].place == np.flatnonzero((MESH.faces == 4).any(axis=1))[0]


def test_unused_vertices(tmp_path):
    vertices = np.vstack([[[99, 99, 99]], MESH.vertices, [[np.nan, 0, 0], [7, 7, 7]]])
    reading = parse(make("ascii", vertices[:-2], MESH.faces + 1), tmp_path)
    assert (reading.unreferenced, reading.issues) == (1, ())
    assert_array_equal(reading.mesh.vertices, MESH.vertices)
    reading = parse(make("ascii", vertices, MESH.faces + 1), tmp_path)
    assert (reading.unreferenced, rules(reading)) == (3, ["F004"])
    assert_array_equal(reading.mesh.vertices, MESH.vertices)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_duplicated_vertices_are_welded(tmp_path, encoding):
    soup, faces = triangles(MESH).reshape(-1, 3), np.arange(3 * N).reshape(-1, 3)
    reading = parse(make(encoding, soup, faces), tmp_path)
    assert len(reading.mesh.vertices) == V
    assert_array_equal(triangles(reading.mesh), triangles(MESH))


def test_weld_tolerance(tmp_path):
    soup = triangles(box()).reshape(-1, 3) + np.random.default_rng(0).uniform(-1e-4, 1e-4, (36, 3))
    data = make("ascii", soup, np.arange(36).reshape(-1, 3), kind="double")
    assert len(parse(data, tmp_path).mesh.vertices) == 36
    assert len(parse(data, tmp_path, weld_tolerance=1e-3).mesh.vertices) == 8


def test_tiny_values_become_zero(tmp_path):
    vertices = MESH.vertices.copy()
    vertices[0, 0], vertices[1, 1], vertices[2, 2] = 1e-61, -1e-300, 1e-59
    reading = parse(make("ascii", vertices, kind="double"), tmp_path)
    assert (reading.mesh.vertices[0, 0], reading.mesh.vertices[1, 1]) == (0, 0)
    assert reading.mesh.vertices[2, 2] == 1e-59


def test_text_of_type_float_is_rounded_once(tmp_path):
    vertices = "0 0 0\n1.00000005960464477539062500000000000000001 0 0\n0 1 0.1\n"
    text = (
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty double z\n"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n" + vertices + "3 0 1 2\n"
    )
    reading = parse(text.encode(), tmp_path)
    assert reading.mesh.vertices[1, 0] == np.float64(np.nextafter(np.float32(1), np.float32(2)))
    assert reading.mesh.vertices[2, 2] == 0.1


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_every_cut(tmp_path, encoding):
    mesh = box()
    data = make(encoding, mesh.vertices, mesh.faces)
    body = data.index(b"end_header") + len("end_header\n")
    for length in range(len(data)):
        try:
            reading = parse(data[:length], tmp_path)
        except UnreadableFileError:
            assert length < body
            continue
        kept = len(reading.mesh.faces)
        last_character = encoding == "ascii" and length >= len(data.rstrip())
        if length:
            assert rules(reading) == ([] if last_character else ["F002"]), length
        if length and length < len(data) - 3:
            # The last number of a cut text may have lost digits; no face uses it then, for faces come last.
            assert_array_equal(triangles(reading.mesh)[:-1], triangles(mesh)[: max(kept - 1, 0)])


def test_trailing_bytes(tmp_path):
    for encoding in ENCODINGS:
        reading = parse(make(encoding) + b"7 8 9", tmp_path)
        assert rules(reading) == ["F010"]
        assert_array_equal(reading.mesh.faces, MESH.faces)
    assert rules(parse(make("ascii") + b"rubbish", tmp_path)) == ["F010"]


def test_words_where_numbers_should_be(tmp_path):
    data = make("ascii").replace(b"\n3 ", b"\nthree ", 1)
    reading = parse(data, tmp_path)
    assert rules(reading) == ["F002"]
    line = data[: data.index(b"three")].count(b"\n") + 1
    assert f"line {line}" in reading.issues[0].detail


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("element", [b"vertex", b"face"])
@pytest.mark.parametrize("count", [10**12, 2**32 - 1, 10**18 - 1])
def test_huge_counts(tmp_path, encoding, element, count):
    actual = b"%d" % (V if element == b"vertex" else N)
    data = make(encoding).replace(b"element %s %s\n" % (element, actual), b"element %s %d\n" % (element, count))
    reading = parse(data, tmp_path)
    assert "F002" in rules(reading)


def test_huge_lists(tmp_path):
    for encoding in ENCODINGS:
        data = make(encoding, faces=[], count_kind="uint").replace(b"element face 0", b"element face 1")
        reading = parse(data + values(encoding, "uint", 2**32 - 1), tmp_path)
        assert rules(reading) == ["F002"]


def test_points_only_and_nothing(tmp_path):
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    text = f"ply\nformat ascii 1.0\nelement vertex 1\n{axes}end_header\n1 2 3\n"
    reading = parse(text.encode(), tmp_path)
    assert (len(reading.mesh.faces), reading.unreferenced, reading.issues) == (0, 1, ())
    assert len(parse(b"", tmp_path).mesh.faces) == 0
    assert len(parse(make("ascii", faces=[]), tmp_path).mesh.faces) == 0


HEADER = make("ascii").decode()


@pytest.mark.parametrize(
    "text",
    [
        "solid x",
        "ply",
        "ply\n",
        "plyx\n",
        "ply\nend_header\n",
        HEADER.replace("format ascii 1.0\n", ""),
        HEADER.replace("ascii", "binary_middle_endian"),
        HEADER.replace("element vertex", "element vertex x"),
        HEADER.replace(f"element vertex {V}", "element vertex -1"),
        HEADER.replace(f"element vertex {V}", f"element vertex {'9' * 40}"),
        HEADER.replace(f"element vertex {V}", "element vertex ²"),
        HEADER.replace("property float x", "property quad x"),
        HEADER.replace("property float x", "property list uchar float x"),
        HEADER.replace("property float y\n", ""),
        HEADER.replace("list uchar", "list float"),
        HEADER.replace("list uchar int vertex_indices", "int vertex_indices"),
        HEADER.replace("vertex_indices", "corners"),
        HEADER.replace("element face", "element vertex"),
        HEADER.replace("element face", "element tristrips"),
        HEADER.replace("end_header", "end"),
        "ply\nproperty float x\nformat ascii 1.0\nend_header\n",
        "ply\n" + "x" * 20000,
    ],
)
def test_headers_that_make_no_sense(tmp_path, text):
    with pytest.raises(UnreadableFileError) as caught:
        parse(text.encode(), tmp_path)
    assert caught.value.where


def test_unknown_header_lines(tmp_path):
    reading = parse(make("ascii").replace(b"comment", b"remark"), tmp_path)
    assert rules(reading) == ["F009"]
    assert_array_equal(reading.mesh.faces, MESH.faces)


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_files_of_another_program(tmp_path, encoding):
    mesh = trimesh.Trimesh(MESH.vertices, MESH.faces, process=False)
    reading = parse(mesh.export(file_type="ply", encoding=encoding), tmp_path)
    assert_array_equal(triangles(reading.mesh), mesh.triangles)
    assert reading.issues == ()


@pytest.mark.parametrize("single", [True, False])
def test_round_trip(tmp_path, single):
    vertices = MESH.vertices if single else MESH.vertices / 3
    path = tmp_path / "a.ply"
    write_mesh(path, Mesh(vertices, MESH.faces))
    reading = read_mesh(path)
    assert_array_equal(reading.mesh.vertices, vertices)
    assert_array_equal(reading.mesh.faces, MESH.faces)
    assert (b"property float x" in path.read_bytes()) == single
    other = trimesh.load(io.BytesIO(ply_bytes(reading.mesh)), file_type="ply", process=False)
    assert_array_equal(other.vertices, vertices)
    assert_array_equal(other.faces, MESH.faces)


def test_a_signalling_nan_is_reported_like_any_other():
    header = b"ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
    header += b"property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4").view("<u4")
    corners[1, 1] = 0x7F800001
    faces = b"\x03" + np.arange(3, dtype="<i4").tobytes()
    reading = parse_mesh(Path("a.ply"), header + corners.tobytes() + faces)
    assert [issue.rule for issue in reading.issues] == ["F004"] and len(reading.mesh.faces) == 0
