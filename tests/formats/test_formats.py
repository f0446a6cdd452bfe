"""All formats: damaged and random files never raise anything unforeseen, and good ones agree with other readers."""

from __future__ import annotations

import hashlib
import os
import threading
import time
import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from shapes import box, sphere

from vhp_cli import formats
from vhp_cli.errors import UnreadableFileError
from vhp_cli.formats import READERS, SUFFIXES, WRITERS, parse_mesh, read_bytes, read_mesh, sha256, write_mesh
from vhp_cli.mesh import Mesh
from vhp_cli.rules import RULES

ASCII_STL = (
    "solid a\n"
    + "".join(
        "facet normal 0 0 0\nouter loop\n"
        + "".join("vertex {!r} {!r} {!r}\n".format(*corner) for corner in corners)
        + "endloop\nendfacet\n"
        for corners in box().vertices[box().faces].tolist()
    )
    + "endsolid a\n"
).encode()
ASCII_PLY = (
    "ply\nformat ascii 1.0\nelement vertex 8\nproperty float x\nproperty float y\nproperty float z\n"
    "element face 12\nproperty list uchar int vertex_indices\nend_header\n"
    + "".join("{!r} {!r} {!r}\n".format(*vertex) for vertex in box().vertices.tolist())
    + "".join("3 {} {} {}\n".format(*face) for face in box().faces.tolist())
).encode()


def samples(folder):
    mesh = sphere(subdivisions=0)
    for suffix in SUFFIXES:
        write_mesh(folder / f"a{suffix}", mesh)
    return [(suffix, (folder / f"a{suffix}").read_bytes()) for suffix in SUFFIXES] + [
        (".stl", ASCII_STL),
        (".ply", ASCII_PLY),
    ]


@pytest.fixture(scope="module")
def sample_files(tmp_path_factory):
    return samples(tmp_path_factory.mktemp("samples"))


def check_any(suffix, data):
    """A reading that is consistent in itself, or the one exception; and quickly."""
    begin = time.process_time()
    try:
        reading = parse_mesh(Path(f"x{suffix}"), data)
    except UnreadableFileError as error:
        assert error.message
        return None
    finally:
        assert time.process_time() - begin < 1
    mesh = reading.mesh
    assert np.isfinite(mesh.vertices).all()
    assert (np.abs(mesh.vertices) <= 1e30 * (1 + 1e-7)).all()
    assert len(np.unique(mesh.vertices, axis=0)) == len(mesh.vertices)
    assert_array_equal(np.unique(mesh.faces), np.arange(len(mesh.vertices)))
    assert {issue.rule for issue in reading.issues} <= {"F002", "F003", "F004", "F008", "F009", "F010", "F011"}
    assert all(issue.count > 0 and issue.detail and issue.rule in RULES for issue in reading.issues)
    assert all(issue.place is None or 0 <= issue.place <= reading.n_facets_stored for issue in reading.issues)
    assert reading.n_bytes == len(data)
    if reading.face_number is None:
        assert reading.n_facets_stored == len(mesh.faces)
    else:
        assert len(reading.face_number) == len(mesh.faces)
        assert (np.diff(reading.face_number) >= 0).all()
        assert reading.face_number.size == 0 or reading.face_number.max() < reading.n_facets_stored
    if len(mesh.faces) < reading.n_facets_stored:
        assert {"F003", "F004"} & {issue.rule for issue in reading.issues}  # facets lost are an error
    return reading


@given(which=st.integers(0, 4), edits=st.lists(st.tuples(st.floats(0, 1), st.integers(0, 7)), min_size=1, max_size=8))
@settings(max_examples=400, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_flipped_bits(sample_files, which, edits):
    suffix, data = sample_files[which]
    damaged = bytearray(data)
    for place, bit in edits:
        damaged[int(place * (len(data) - 1))] ^= 1 << bit
    check_any(suffix, bytes(damaged))


@given(which=st.integers(0, 4), begin=st.floats(0, 1), end=st.floats(0, 1), filling=st.binary(max_size=60))
@settings(max_examples=400, deadline=None)
def test_replaced_stretches(sample_files, which, begin, end, filling):
    """Truncation, insertion, deletion and overwriting."""
    suffix, data = sample_files[which]
    first, last = sorted((int(begin * len(data)), int(end * len(data))))
    check_any(suffix, data[:first] + filling + data[last:])


WORDS = [
    b"solid", b"facet normal", b"outer loop", b"vertex", b"endloop", b"endfacet", b"endsolid", b"v", b"f", b"o", b"\\",
    b"#", b"ply", b"format ascii 1.0", b"format binary_little_endian 1.0", b"element vertex 3", b"element face 2",
    b"property float x", b"property float y", b"property float z", b"property list uchar int vertex_indices",
    b"end_header", b"1", b"2", b"3", b"-1", b"1/2/3", b"nan", b"1e999", b"x", b"\0",
]  # fmt: skip


@given(
    suffix=st.sampled_from(SUFFIXES),
    words=st.lists(st.tuples(st.sampled_from(WORDS), st.sampled_from([b"\n", b" ", b"\r\n", b""])), max_size=60),
)
@settings(max_examples=500, deadline=None)
def test_words_at_random(suffix, words):
    check_any(suffix, b"".join(word + space for word, space in words))


@given(
    suffix=st.sampled_from(SUFFIXES), start=st.sampled_from([b"", b"solid ", b"ply\n", b"v 1 2 3\n"]), data=st.binary()
)
@settings(max_examples=300, deadline=None)
def test_bytes_at_random(suffix, start, data):
    check_any(suffix, start + data)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_long_random_files(suffix):
    for seed in range(5):
        check_any(suffix, np.random.default_rng(seed).bytes(200_000))
    check_any(suffix, b"\n" * 200_000)
    check_any(suffix, b"facet " * 50_000)
    check_any(suffix, b"f 1 2 3 \\\n" * 20_000)
    check_any(suffix, b"solid\n" + b"vertex 1 2 3 " * 20_000)


def test_registry(tmp_path):
    assert set(READERS) == set(WRITERS) == set(SUFFIXES) == {".stl", ".ply", ".obj"}
    for suffix in (".STL", ".Ply", ".oBJ"):
        path = tmp_path / f"a{suffix}"
        write_mesh(path, box())
        assert len(read_mesh(path).mesh.faces) == 12


def test_the_hash_is_of_the_bytes_on_the_disk(tmp_path):
    path = tmp_path / "a.stl"
    write_mesh(path, box())
    expected = hashlib.sha256(path.read_bytes()).hexdigest()
    assert read_mesh(path).sha256 == expected
    assert sha256(read_bytes(path)) == expected
    assert parse_mesh(path, read_bytes(path)).sha256 == ""


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_what_is_no_file_is_refused_at_once(tmp_path):
    (tmp_path / "folder.stl").mkdir()
    os.mkfifo(tmp_path / "pipe.stl")
    (tmp_path / "null.stl").symlink_to("/dev/null")
    refused = []

    def read(path):
        with pytest.raises(UnreadableFileError, match="not a regular file"):
            read_bytes(path)
        refused.append(path.name)

    for name in ("folder.stl", "pipe.stl", "null.stl"):
        thread = threading.Thread(target=read, args=(tmp_path / name,), daemon=True)
        thread.start()
        thread.join(10)
    assert refused == ["folder.stl", "pipe.stl", "null.stl"]


def test_a_file_larger_than_the_memory_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "a.stl"
    with path.open("wb") as file:
        file.truncate(2**20)
    assert len(read_bytes(path)) == 2**20
    monkeypatch.setattr(formats, "_physical_memory", lambda: 2.0**20 - 1)
    with pytest.raises(UnreadableFileError, match="larger than the memory"):
        read_bytes(path)


@pytest.mark.skipif(not Path("/proc/meminfo").exists(), reason="the reference is Linux'")
def test_the_memory_of_this_machine():
    total = int(Path("/proc/meminfo").read_text().split()[1]) * 1024
    assert formats._physical_memory() == pytest.approx(total, rel=0.01)


mesh_coordinate = st.floats(-1e6, 1e6, width=32).map(lambda x: 0.0 if 0 < abs(x) < 1e-30 else x)


@given(
    suffix=st.sampled_from(SUFFIXES),
    corners=st.lists(st.tuples(*[mesh_coordinate] * 9), min_size=1, max_size=20),
)
@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_round_trip_of_any_mesh(tmp_path, suffix, corners):
    soup = np.array(corners).reshape(-1, 3)
    path = tmp_path / f"a{suffix}"
    write_mesh(path, Mesh(soup, np.arange(len(soup)).reshape(-1, 3)))
    reading = read_mesh(path)
    assert_array_equal(reading.mesh.vertices[reading.mesh.faces].reshape(-1, 3), soup + 0.0)
    assert reading.issues == ()


# ---------------------------------------------------------------- files of other programs


def with_trimesh(path):
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            loaded = trimesh.load(path, process=False, force="mesh")
    except (ImportError, ValueError, TypeError, IndexError):
        return None
    return np.asarray(loaded.triangles) if len(loaded.faces) else None


def test_originals_agree_with_trimesh(shared_data):
    compared = 0
    for path in sorted((shared_data / "broken" / "originals").iterdir()):
        if path.suffix.lower() not in SUFFIXES:
            with pytest.raises(UnreadableFileError):
                read_mesh(path)
            continue
        reading = check_any(path.suffix, path.read_bytes())
        other = with_trimesh(path)
        if other is None:
            continue
        mine = reading.mesh.vertices[reading.mesh.faces]
        # Faces may come in another order, and polygons may be cut otherwise: compare the vertices used.
        assert len(mine) == len(other), path
        scale = np.abs(other).max()
        first = np.unique(np.round(mine.reshape(-1, 3) / scale, 6), axis=0)
        second = np.unique(np.round(other.reshape(-1, 3) / scale, 6) + 0.0, axis=0)
        assert_allclose(first, second, atol=2e-6, err_msg=str(path))
        compared += 1
    assert compared >= 20


def test_stl_agrees_with_trimesh(tmp_path):
    for path, data in ((tmp_path / "a.stl", None), (tmp_path / "b.stl", ASCII_STL)):
        if data is None:
            write_mesh(path, box())
        else:
            path.write_bytes(data)
        reading = read_mesh(path)
        assert_array_equal(reading.mesh.vertices[reading.mesh.faces], with_trimesh(path))
