"""One number for each face of a PLY file, in the order of the file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vhp_cli.formats.ply import face_property, parse_ply

PATH = Path("a.ply")
POINTS = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0)]
FACES = [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)]
ERRORS = [0.5, 2.0, 0.25, 1e-3]


def ply(encoding, properties, faces, before=(), after=()):
    """A file whose faces have these properties: (type, name, values), the corners among them as a list."""
    names = {"ascii": "ascii", "<": "binary_little_endian", ">": "binary_big_endian"}
    header = [f"ply\nformat {names[encoding]} 1.0"]
    rows = []

    def put(kind, values):
        if encoding == "ascii":
            rows.append(" ".join(repr(value) for value in values).encode() + b" ")
        else:
            rows.append(np.array(values, dtype=encoding + kind).tobytes())

    def extra(elements):
        for name, count in elements:
            header.append(f"element {name} {count}\nproperty list uchar int items\nproperty double weight")
            for _ in range(count):
                put("u1", [2])
                put("i4", [7, 8])
                put("f8", [0.5])

    header.append(f"element vertex {len(POINTS)}\nproperty float x\nproperty float y\nproperty float z")
    extra_header = len(header)
    for point in POINTS:
        put("f4", [float(value) for value in point])
    extra(before)
    header.append(f"element face {len(faces)}")
    for kind, name, _ in properties:
        words = {"f4": "float", "f8": "double", "i4": "int", "u1": "uchar"}
        header.append("property list uchar int vertex_indices" if kind == "list" else f"property {words[kind]} {name}")
    for number, face in enumerate(faces):
        for kind, _, values in properties:
            if kind == "list":
                put("u1", [len(face)])
                put("i4", list(face))
            else:
                put(kind, [values[number]])
    extra(after)
    assert extra_header
    return "\n".join([*header, "end_header\n"]).encode() + b"".join(rows)


CORNERS = ("list", "vertex_indices", None)


@pytest.mark.parametrize("encoding", ["ascii", "<", ">"])
@pytest.mark.parametrize("kind", ["f4", "f8"])
def test_wherever_it_stands(encoding, kind):
    error = (kind, "error", ERRORS)
    label = ("i4", "label", [7, 8, 9, 10])
    expected = np.array(ERRORS, dtype="f8" if encoding == "ascii" else kind).tolist()
    for properties in ([CORNERS, error], [error, CORNERS], [label, error, CORNERS], [CORNERS, label, error]):
        for around in ({}, {"before": [("edge", 3)]}, {"after": [("edge", 2)]}):
            data = ply(encoding, properties, FACES, **around)
            assert parse_ply(PATH, data).n_facets_stored == 4
            assert face_property(PATH, data, "error").tolist() == expected


@pytest.mark.parametrize("encoding", ["ascii", "<", ">"])
def test_polygons_have_one_each(encoding):
    faces = [(0, 1, 4, 2), (0, 1, 3), (0, 1, 4), (0, 2, 4, 3, 1)]
    data = ply(encoding, [CORNERS, ("f4", "error", ERRORS), ("u1", "flag", [1, 0, 1, 0])], faces)
    assert np.allclose(face_property(PATH, data, "error"), ERRORS)
    reading = parse_ply(PATH, data)
    assert len(reading.mesh.faces) == 7 and reading.n_facets_stored == 4
    assert reading.face_number.tolist() == [0, 0, 1, 2, 3, 3, 3]


@pytest.mark.parametrize("encoding", ["ascii", "<"])
def test_whole_numbers_and_other_names(encoding):
    data = ply(encoding, [CORNERS, ("i4", "level", [3, 0, 2, 1])], FACES)
    assert face_property(PATH, data, "level").tolist() == [3, 0, 2, 1]
    assert face_property(PATH, data, "error") is None
    assert face_property(PATH, data, "vertex_indices") is None


def test_without_faces():
    header = (
        b"ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    )
    assert face_property(PATH, header, "error") is None
