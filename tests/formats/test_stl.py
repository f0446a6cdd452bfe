"""STL as it should be, and in every way in which it is found broken."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from shapes import box, joined, moved, sphere

from vhp_cli.errors import UnreadableFileError, VhpError
from vhp_cli.formats import parse_mesh, read_mesh, write_mesh
from vhp_cli.formats.stl import stl_bytes
from vhp_cli.mesh import Mesh

MESH = sphere(subdivisions=1)
N = len(MESH.faces)
GOOD = stl_bytes(MESH)


def ascii_facet(corners, normal="0 0 0"):
    lines = [f"    vertex {' '.join(repr(float(x)) for x in corner)}" for corner in corners]
    return "\n".join([f"  facet normal {normal}", "   outer loop", *lines, "   endloop", "  endfacet", ""])


def ascii_stl(mesh=MESH, name="liver"):
    facets = "".join(ascii_facet(corners) for corners in mesh.vertices[mesh.faces])
    return f"solid {name}\n{facets}endsolid {name}\n"


def parse(data, tmp_path, **options):
    return parse_mesh(tmp_path / "x.stl", data.encode() if isinstance(data, str) else data, **options)


def rules(reading):
    return sorted(issue.rule for issue in reading.issues)


def issue(reading, rule):
    return next(item for item in reading.issues if item.rule == rule)


def triangles(mesh):
    return mesh.vertices[mesh.faces]


def same_surface(reading, mesh=MESH):
    assert_array_equal(triangles(reading.mesh), triangles(mesh))
    assert len(reading.mesh.vertices) == len(mesh.vertices)
    return True


# ---------------------------------------------------------------- binary


def test_binary(tmp_path):
    reading = parse(GOOD, tmp_path)
    assert same_surface(reading)
    assert (reading.format, reading.issues, reading.n_facets_stored) == ("stl-binary", (), N)
    assert (reading.n_bytes, reading.face_number, reading.unreferenced, reading.solids) == (len(GOOD), None, 0, 1)


def with_count(count, data=GOOD):
    return data[:80] + struct.pack("<I", count) + data[84:]


@pytest.mark.parametrize("header", [b"solid made by X", b"SOLID", b" solid facet normal vertex", b"\xef\xbb\xbfsolid"])
def test_binary_that_begins_like_a_text(tmp_path, header):
    reading = parse(header.ljust(80) + GOOD[80:], tmp_path)
    assert same_surface(reading)
    assert (reading.format, reading.issues) == ("stl-binary", ())
    damaged = parse((header.ljust(80) + GOOD[80:])[:-20], tmp_path)
    assert (damaged.format, rules(damaged)) == ("stl-binary", ["F002"])


@pytest.mark.parametrize("count", [0, 1, N - 1, N + 1, 2 * N, 0xFFFFFFFF])
def test_wrong_count(tmp_path, count):
    """The size tells how many facets there are."""
    reading = parse(with_count(count), tmp_path)
    assert same_surface(reading)
    assert rules(reading) == ["F003"]
    assert issue(reading, "F003").count == abs(count - N)


@pytest.mark.parametrize("cut", [1, 2, 49, 51, 50 * N - 51])
def test_truncated_in_a_record(tmp_path, cut):
    reading = parse(GOOD[:-cut], tmp_path)
    kept = (50 * N - cut) // 50
    assert rules(reading) == ["F002"]
    assert_array_equal(triangles(reading.mesh), triangles(MESH)[:kept])
    assert issue(reading, "F002").count == N - kept
    assert issue(reading, "F002").place == kept
    assert f"byte {len(GOOD) - cut}" in issue(reading, "F002").detail


def test_truncated_between_records(tmp_path):
    reading = parse(GOOD[:-100], tmp_path)
    assert rules(reading) == ["F003"]
    assert len(reading.mesh.faces) == N - 2


def test_huge_count_in_a_small_file(tmp_path):
    reading = parse(with_count(0xFFFFFFFF)[:-7], tmp_path)
    assert rules(reading) == ["F002"]
    assert len(reading.mesh.faces) == N - 1


@pytest.mark.parametrize("extra", [1, 2, 49, 51, 1000])
def test_trailing_bytes(tmp_path, extra):
    reading = parse(GOOD + b"\0" * extra, tmp_path)
    if extra % 50:
        assert same_surface(reading)
        assert rules(reading) == ["F010"]
        assert issue(reading, "F010").count == extra
        assert f"byte {len(GOOD)}" in issue(reading, "F010").detail
    else:  # whole records more than announced
        assert rules(reading) == ["F003"]


def test_attributes_are_no_defect(tmp_path):
    data = bytearray(GOOD)
    data[84 + 48 :: 50] = b"\x7f" * N
    assert parse(bytes(data), tmp_path).issues == ()


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 2e30, -3e38])
def test_values_that_are_not_finite(tmp_path, value):
    data = bytearray(GOOD)
    for facet, coordinate in ((3, 0), (7, 8)):
        struct.pack_into("<f", data, 84 + 50 * facet + 12 + 4 * coordinate, value)
    reading = parse(bytes(data), tmp_path)
    assert rules(reading) == ["F004"]
    assert (issue(reading, "F004").count, issue(reading, "F004").place) == (2, 3)
    assert f"byte {84 + 150}" in issue(reading, "F004").detail
    kept = [i for i in range(N) if i not in (3, 7)]
    assert_array_equal(triangles(reading.mesh), triangles(MESH)[kept])
    assert reading.face_number.tolist() == kept
    assert np.isfinite(reading.mesh.vertices).all()


def test_normals_are_left_aside(tmp_path):
    data = bytearray(GOOD)
    struct.pack_into("<3f", data, 84, np.nan, np.inf, 1e38)
    assert parse(bytes(data), tmp_path).issues == ()


def test_negative_zero_makes_no_crack(tmp_path):
    mesh = box((-1, -1, 0), (0, 0, 1))
    data = bytearray(stl_bytes(mesh))
    random = np.random.default_rng(0)
    for facet in range(12):
        for k in range(9):
            place = 84 + 50 * facet + 12 + 4 * k
            if struct.unpack_from("<f", data, place)[0] == 0 and random.random() < 0.5:
                struct.pack_into("<f", data, place, -0.0)
    reading = parse(bytes(data), tmp_path)
    assert len(reading.mesh.vertices) == 8
    assert not np.signbit(reading.mesh.vertices[reading.mesh.vertices == 0]).any()


def test_no_facet(tmp_path):
    for data in (b"", GOOD[:80] + bytes(4), b"solid".ljust(80) + bytes(4), "solid x\nendsolid x\n", "solid\nendsolid"):
        reading = parse(data, tmp_path)
        assert (len(reading.mesh.faces), reading.n_facets_stored, rules(reading)) == (0, 0, [])


@pytest.mark.parametrize(
    "data",
    [
        b"\0",
        b"x" * 83,
        b"\x1f\x8b\x08" + GOOD,
        b"PK\x03\x04" + GOOD,
        b"ply\nformat ascii 1.0\n" + b" " * 100,
        b"<!DOCTYPE html><html>" + b"<p>not found</p>" * 50,
        b"# a remark\n" * 60,
        np.random.default_rng(0).bytes(5000),
        b"solid " + np.random.default_rng(1).bytes(5000),
        GOOD[:84],
        GOOD[:133],
    ],
)
def test_other_contents(tmp_path, data):
    with pytest.raises(UnreadableFileError) as caught:
        parse(data, tmp_path)
    assert caught.value.where
    assert caught.value.hint


# ---------------------------------------------------------------- ASCII


def test_ascii(tmp_path):
    reading = parse(ascii_stl(), tmp_path)
    assert same_surface(reading)
    assert (reading.format, reading.issues, reading.n_facets_stored) == ("stl-ascii", (), N)
    assert (reading.solids, reading.face_number) == (1, None)


TEXT = ascii_stl()


@pytest.mark.parametrize(
    "text",
    [
        pytest.param(TEXT.replace("\n", "\r\n"), id="CRLF"),
        pytest.param(TEXT.replace("\n", "\r"), id="CR"),
        pytest.param(TEXT.upper(), id="upper case"),
        pytest.param(TEXT.replace(" ", "\t"), id="tabs"),
        pytest.param(TEXT.replace("    ", ""), id="no indentation"),
        pytest.param(TEXT.replace("facet normal 0 0 0", "facet normal nan -nan(ind) 1e400"), id="wild normals"),
        pytest.param(TEXT.replace("\n", " ").replace("solid liver", "solid liver\n"), id="two lines"),
        pytest.param(TEXT.replace("\n", " "), id="one line"),
        pytest.param("\n\n  " + TEXT + "\n\n\n", id="blank lines"),
        pytest.param(TEXT.replace(" liver", ""), id="no name"),
        pytest.param(TEXT.replace("liver", "a facet of solid vertex endsolid"), id="keywords in the name"),
        pytest.param(TEXT.rstrip(), id="no final newline"),
        pytest.param(TEXT.replace("\n", "\n\f\v"), id="other white space"),
    ],
)
def test_ascii_that_is_legal(tmp_path, text):
    reading = parse(text, tmp_path)
    assert reading.issues == ()
    assert same_surface(reading)


def test_numbers_in_every_notation(tmp_path):
    vertices = "vertex +1e1 .5 -2.E-1\nvertex 1E+01 0 0\nvertex 00.1 1d0 3\n"
    reading = parse(f"solid\nfacet normal 0 0 0 outer loop {vertices} endloop endfacet endsolid", tmp_path)
    expected = np.array([[10, 0.5, -0.2], [10, 0, 0], [0.1, 1, 3]], dtype=np.float32)
    assert_array_equal(triangles(reading.mesh)[0], expected.astype(float))


def test_coordinates_are_rounded_to_float32(tmp_path):
    reading = parse(ascii_stl().replace("vertex ", "vertex 0.1000000001 0.1 ", 1), tmp_path)
    assert reading.mesh.vertices[0, 0] == reading.mesh.vertices[0, 1] == np.float64(np.float32(0.1))


def test_names_that_are_not_utf8(tmp_path):
    data = ascii_stl().encode().replace(b"liver", b"Sch\xe4del \xff\xfe")
    assert same_surface(parse(data, tmp_path))


def test_byte_order_mark(tmp_path):
    reading = parse(b"\xef\xbb\xbf" + ascii_stl().encode(), tmp_path)
    assert same_surface(reading)
    assert rules(reading) == ["F009"]


def test_several_solids(tmp_path):
    other = sphere(centre=(50, 0, 0), subdivisions=1)
    reading = parse(ascii_stl() + ascii_stl(other, "spleen"), tmp_path)
    assert rules(reading) == ["F008"]
    assert (reading.solids, issue(reading, "F008").count) == (2, 2)
    assert_array_equal(triangles(reading.mesh), triangles(joined(MESH, other)))


@pytest.mark.parametrize("word", ["nan", "NaN", "-nan", "inf", "-Infinity", "1.#QNAN", "1e31", "1e999"])
def test_ascii_values_that_are_not_finite(tmp_path, word):
    lines = ascii_stl().splitlines()
    lines[10] = f"    vertex 1 {word} 2"  # facet 1 begins at line 9
    reading = parse("\n".join(lines) + "\n", tmp_path)
    assert rules(reading) == ["F004"]
    assert issue(reading, "F004").place == 1
    assert "line 9" in issue(reading, "F004").detail
    assert reading.face_number.tolist() == [0, *range(2, N)]


@pytest.mark.parametrize("ending", ["", "endsolid liver"])
def test_endsolid(tmp_path, ending):
    text = ascii_stl().replace("endsolid liver\n", ending)
    reading = parse(text, tmp_path)
    assert same_surface(reading)
    assert rules(reading) == ([] if ending else ["F002"])


@pytest.mark.parametrize("fraction", [0.2, 0.5, 0.9, 0.99])
def test_ascii_cut_in_the_middle(tmp_path, fraction):
    text = ascii_stl()
    reading = parse(text[: int(fraction * len(text))], tmp_path)
    assert "F002" in rules(reading)
    kept = len(reading.mesh.faces)
    assert abs(kept - fraction * N) < 2
    # A cut number is a number too: facets that are whole may be used, the last one never.
    assert_array_equal(triangles(reading.mesh), triangles(MESH)[:kept])


def test_every_cut_of_a_text(tmp_path):
    text = ascii_stl(box())
    whole = triangles(box())
    for length in range(len(text) - len("\n")):
        try:
            reading = parse(text[:length], tmp_path)
        except UnreadableFileError:
            assert length < 5
            continue
        kept = len(reading.mesh.faces)
        assert_array_equal(triangles(reading.mesh), whole[:kept])
        if length and length < text.index("endsolid") + 8:
            assert "F002" in rules(reading), length


def edited(old, new, count=1):
    text = ascii_stl()
    assert old in text
    return text.replace(old, new, count)


@pytest.mark.parametrize(
    "text",
    [
        pytest.param(edited("solid liver\n", ""), id="no solid"),
        pytest.param(edited("outer loop", "outer"), id="outer"),
        pytest.param(edited("   outer loop\n", ""), id="no loop"),
        pytest.param(edited("   endloop\n", ""), id="no endloop"),
        pytest.param(edited("  endfacet\n", ""), id="no endfacet"),
        pytest.param(edited("facet normal 0 0 0", "facet"), id="no normal"),
        pytest.param(edited("facet normal 0 0 0", "facet normal 0 0"), id="half a normal"),
        pytest.param(edited("  facet", "  color 1 0 0\n  facet"), id="colour"),
        pytest.param(edited("  facet", "; remark about a vertex\n  facet"), id="remark"),
        pytest.param(edited("  facet", "solid inner\n  facet"), id="solid in a solid"),
        pytest.param(edited("solid liver", "# remark\nsolid liver"), id="remark ahead"),
        pytest.param(edited("endsolid liver", "endsolid liver\nendsolid"), id="endsolid twice"),
        pytest.param(edited("   endloop", " 5\n   endloop"), id="a number too many"),
    ],
)
def test_loose_syntax(tmp_path, text):
    reading = parse(text, tmp_path)
    assert same_surface(reading)
    assert "F009" in rules(reading)
    assert set(rules(reading)) <= {"F009", "F008", "F002"}
    assert "line " in issue(reading, "F009").detail


@pytest.mark.parametrize(
    "text",
    [
        pytest.param(edited("   endloop", "    vertex 1 2 3\n   endloop"), id="four vertices"),
        pytest.param(edited("    vertex ", "    vertx "), id="two vertices"),
        pytest.param(edited("    vertex ", "    vertex x"), id="no number"),
        pytest.param(edited("   outer loop", "   outer loop\n    vertex 1 2\n"), id="two coordinates"),
    ],
)
def test_facets_that_cannot_be_read_are_an_error(tmp_path, text):
    reading = parse(text, tmp_path)
    assert rules(reading) == ["F003", "F009"]  # F003: a warning alone might let the model pass
    assert issue(reading, "F003").place == 0
    assert "line 2" in issue(reading, "F003").detail
    assert reading.face_number.tolist() == list(range(1, N))
    assert_array_equal(triangles(reading.mesh), triangles(MESH)[1:])


def test_decimal_commas_are_named(tmp_path):
    with pytest.raises(UnreadableFileError) as caught:
        parse("\n".join(line.replace(".", ",") for line in ascii_stl().splitlines()), tmp_path)
    assert "decimal point" in caught.value.hint
    assert caught.value.where == "line 2"


@pytest.mark.parametrize("tail", ["trailing words", "\0\0\0\0", "<eof>\n"])
def test_ascii_trailing_bytes(tmp_path, tail):
    reading = parse(ascii_stl() + tail, tmp_path)
    assert same_surface(reading)
    assert rules(reading) == ["F010"]
    assert issue(reading, "F010").count == len(tail)


def test_text_whose_size_happens_to_fit(tmp_path):
    """A text can have the size of a binary file if its name holds the right four bytes."""
    text = ascii_stl().encode()
    length = len(text) + 78
    count, rest = divmod(length - 84, 50)
    text += b" " * (50 - rest)
    count += 1
    name = (b"solid ".ljust(80, b"x") + struct.pack("<I", count)).ljust(6 + 78, b"x")
    data = name + text[len("solid ") :]
    assert len(data) == 84 + 50 * count
    reading = parse(data, tmp_path)
    assert reading.format == "stl-ascii"
    assert same_surface(reading)


def test_stretches_never_written_are_an_error(tmp_path):
    text = ascii_stl()
    begin, end = (len(text[: text.index("  facet", 300 * k)]) for k in (9, 15))
    reading = parse(text[:begin] + "\0" * (end - begin) + text[end:], tmp_path)
    assert rules(reading) == ["F002", "F009"]
    assert issue(reading, "F002").count == end - begin
    assert f"byte {begin}" in issue(reading, "F002").detail


def test_weld_tolerance(tmp_path):
    mesh = joined(box(), moved(box(), (10.001, 0, 0)))
    for data in (stl_bytes(mesh), ascii_stl(mesh)):
        assert len(parse(data, tmp_path).mesh.vertices) == 16
        assert len(parse(data, tmp_path, weld_tolerance=0.01).mesh.vertices) == 12


# ---------------------------------------------------------------- writing


def test_round_trip(tmp_path):
    path = tmp_path / "a.STL"
    write_mesh(path, MESH)
    reading = read_mesh(path)
    assert same_surface(reading)
    assert len(reading.sha256) == 64
    again = tmp_path / "b.stl"
    write_mesh(again, reading.mesh)
    assert again.read_bytes() == path.read_bytes()
    assert path.read_bytes()[:80] == b"vhp binary STL, millimetres".ljust(80)


def test_normals_are_unit_vectors(tmp_path):
    corners = np.array([[0, 0, 0], [1e-30, 0, 0], [0, 1e-30, 0], [1e25, 0, 0], [0, 0, 1e25]])
    mesh = Mesh(corners, np.array([[0, 1, 2], [0, 3, 4], [0, 0, 1]]))
    record = np.frombuffer(stl_bytes(mesh)[84:], dtype=np.uint8).reshape(-1, 50)[:, :12].copy().view("<f4")
    assert_array_equal(record, [[0, 0, 1], [0, -1, 0], [0, 0, 0]])


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e31])
@pytest.mark.parametrize("suffix", [".stl", ".ply", ".obj"])
def test_values_that_cannot_be_written(tmp_path, suffix, value):
    vertices = MESH.vertices.copy()
    vertices[5, 1] = value
    with pytest.raises(VhpError, match="vertex 5"):
        write_mesh(tmp_path / f"a{suffix}", Mesh(vertices, MESH.faces))
    assert list(tmp_path.iterdir()) == []


def test_stl_bytes_refuse_what_float32_cannot_hold():
    with pytest.raises(VhpError, match="float32"):
        stl_bytes(Mesh(np.array([[0, 0, 0], [1, 0, 0], [0, 1e39, 0]]), np.array([[0, 1, 2]])))
