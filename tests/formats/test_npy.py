"""Arrays in NPY files: numbers of any type, and nothing else."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vhp_cli.errors import UnreadableFileError
from vhp_cli.formats.npy import parse_values

PATH = Path("a.npy")


def saved(values, **options):
    stream = io.BytesIO()
    np.save(stream, values, **options)
    return stream.getvalue()


@pytest.mark.parametrize("kind", ["<f4", ">f8", "<f2", "<i4", ">u2", "i1"])
def test_types(kind):
    values = np.array([3, 1, 4, 1, 5], dtype=kind)
    read = parse_values(PATH, saved(values))
    assert read.dtype == np.float64
    assert read.tolist() == [3, 1, 4, 1, 5]


def test_versions():
    values = np.arange(4.0)
    for version in ((1, 0), (2, 0), (3, 0)):
        stream = io.BytesIO()
        np.lib.format.write_array(stream, values, version=version)
        assert parse_values(PATH, stream.getvalue()).tolist() == [0, 1, 2, 3]


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "not a whole NPY file"),
        (b"\x93NUMPY\x01\x00", "not a whole NPY file"),
        (b"0.1\n0.2\n", "not a whole NPY file"),
        (saved(np.arange(9.0))[:-1], "not a whole NPY file"),
        (saved(np.ones((3, 1))), r"shape \(3, 1\), not of numbers with shape \(F,\)"),
        (saved(np.float64(3)), r"shape \(\)"),
        (saved(np.array([1j, 2])), "complex128"),
        (saved(np.array([True, False])), "bool"),
        (saved(np.array(["a", "b"])), "shape"),
        (saved(np.array([None, {}]), allow_pickle=True), "object"),
        (saved(np.zeros(2, dtype=[("x", "f4")])), "shape"),
    ],
)
def test_anything_else_is_refused(data, message):
    with pytest.raises(UnreadableFileError, match=message) as caught:
        parse_values(PATH, data)
    assert "numpy.save" in caught.value.hint


def test_a_header_that_announces_too_much_takes_no_memory():
    data = saved(np.arange(4.0)).replace(b"(4,), }     ", b"(10000000000000,), }")
    assert b"10000000000000" in data
    with pytest.raises(UnreadableFileError):
        parse_values(PATH, data)


@given(st.binary(max_size=200), st.integers(0, 150))
def test_damage_is_an_error_of_the_file(junk, at):
    data = bytearray(saved(np.arange(4.0)))
    data[at : at + len(junk)] = junk
    with contextlib.suppress(UnreadableFileError):
        parse_values(PATH, bytes(data))
