"""Inner loops of the file readers: welding of points, and parsing of text."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from vhp_cli.kernels._library import address, check_allocation, f64, function, i32, i64, pointer

Float = NDArray[np.float64]
Int = NDArray[np.int32]

RECORD_SIZE = 50  # bytes of a facet in a binary STL file

# How the length of a list is stored, the enum of text_ply.c.
COUNT_KINDS = {"u1": 1, "i1": 2, "u2": 3, "i2": 4, "u4": 5, "i4": 6, "f8": 7}

_weld = function("vhp_weld", i64, [pointer, i64, pointer, pointer])
_weld_facets = function("vhp_weld_facets", i64, [pointer, i64, pointer, pointer, pointer, pointer])
_weld_stl_records = function("vhp_weld_stl_records", i64, [pointer, i64, pointer, pointer, pointer, pointer])
_link_points = function("vhp_link_points", i32, [pointer, i32, pointer, f64, pointer])
_parse_numbers = function("vhp_parse_numbers", i64, [pointer, i64, pointer, i64, pointer])
_parse_floats = function("vhp_parse_floats", i64, [pointer, i64, pointer, i64, pointer])
_count_words = function("vhp_count_words", i64, [pointer, i64])
_parse_stl = function("vhp_parse_stl", None, [pointer, i64, pointer, pointer, pointer])
_count_obj = function("vhp_count_obj", None, [pointer, i64, pointer])
_parse_obj = function("vhp_parse_obj", None, [pointer, i64, pointer, pointer, pointer, pointer])
_walk_records = function("vhp_walk_records", i64, [pointer, i64, i64, pointer, i32, i32, i32, *[pointer] * 3])


def weld(points: NDArray[np.floating], tolerance: float = 0.0) -> tuple[Float, Int]:
    """Merge points into vertices.

    Parameters
    ----------
    points : (N, 3) float32 or float64
        Finite coordinates in mm.
    tolerance
        0: points are merged only where they are equal (-0.0 equals 0.0). Above: points that are joined by steps not
        longer than this many mm (single linkage) become one vertex, at the place of the first of them.

    Returns
    -------
    vertices : (V, 3) float64
        In order of first appearance.
    index : (N,) int32
        Vertex of each point.
    """
    points = np.ascontiguousarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points must have shape (N, 3), not {points.shape}")
    if len(points) >= 2**31:
        raise ValueError(f"can't weld more than {2**31 - 1} points")
    vertices = np.empty((len(points), 3))
    index = np.empty(len(points), dtype=np.int32)
    count = _weld(address(points), len(points), address(vertices), address(index))
    check_allocation(count)
    vertices = vertices[:count].copy()
    if tolerance > 0 and count:
        vertices, merged = _weld_near(vertices, tolerance)
        index = merged[index]
    return vertices, index


def _weld_near(vertices: Float, tolerance: float) -> tuple[Float, Int]:
    origin = vertices.min(axis=0)
    extent = float((vertices.max(axis=0) - origin).max())
    count = len(vertices)
    if not np.isfinite(extent) or extent / tolerance > 1e15:
        # Finer than the spacing of floating-point numbers: nothing but equal points is that near.
        return vertices, np.arange(count, dtype=np.int32)
    root = np.empty(count, dtype=np.int32)
    check_allocation(_link_points(address(vertices), count, address(origin), tolerance, address(root)))
    is_first = root == np.arange(count)
    number = np.cumsum(is_first, dtype=np.int32) - 1
    return vertices[is_first], number[root].astype(np.int32)


def weld_facets(corners: NDArray[np.float32]) -> tuple[Float, Int, NDArray[np.int64]]:
    """Weld the corners of facets exactly.

    Parameters
    ----------
    corners : (n, 3, 3) float32
        The three corners of each facet, in mm.

    Returns
    -------
    vertices : (V, 3) float64
        In order of first appearance.
    faces : (F, 3) int32
        Without the facets that have a coordinate that is not finite or beyond 1e30.
    unusable : (n - F,) int64
        Numbers of these facets.
    """
    corners = np.ascontiguousarray(corners, dtype=np.float32)
    n = len(corners)
    if corners.shape != (n, 3, 3):
        raise ValueError(f"corners must have shape (n, 3, 3), not {corners.shape}")
    vertices, faces, unusable, counts = _weld_buffers(n)
    n_vertices = _weld_facets(
        address(corners), n, address(vertices), address(faces), address(unusable), address(counts)
    )
    check_allocation(n_vertices)
    return vertices[:n_vertices].copy(), faces[: counts[0]].copy(), unusable[: counts[1]].copy()


def weld_stl_records(records: bytes | NDArray[np.uint8], n: int) -> tuple[Float, Int, NDArray[np.int64], int]:
    """Weld the facets of a binary STL file straight from their records of 50 bytes.

    Parameters
    ----------
    records
        At least 50 n bytes.
    n
        Number of facets.

    Returns
    -------
    vertices, faces, unusable
        As of `weld_facets`.
    n_attributes
        Facets whose attribute bytes are not 0 (colours, in the usual extensions).
    """
    data = np.frombuffer(records, dtype=np.uint8) if isinstance(records, bytes) else np.ascontiguousarray(records)
    if data.dtype != np.uint8 or data.ndim != 1 or len(data) < RECORD_SIZE * n or n < 0:
        raise ValueError(f"{n} STL records need {RECORD_SIZE * n} bytes")
    if sys.byteorder != "little":
        fields = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
        table = data[: RECORD_SIZE * n].view(fields)
        return *weld_facets(table["corners"].astype(np.float32)), int(np.count_nonzero(table["attribute"]))
    vertices, faces, unusable, counts = _weld_buffers(n)
    n_vertices = _weld_stl_records(
        address(data), n, address(vertices), address(faces), address(unusable), address(counts)
    )
    check_allocation(n_vertices)
    return vertices[:n_vertices].copy(), faces[: counts[0]].copy(), unusable[: counts[1]].copy(), int(counts[2])


def _weld_buffers(n: int) -> tuple[Float, Int, NDArray[np.int64], NDArray[np.int64]]:
    """Return room for n facets that have no vertex in common; untouched pages cost nothing."""
    if 3 * n >= 2**31:
        raise ValueError(f"can't read more than {2**31 // 3} facets")
    return np.empty((3 * n, 3)), np.empty((n, 3), np.int32), np.empty(n, np.int64), np.zeros(3, np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class StlText:
    """The facets of an ASCII STL text, and what is not as it should be. Offsets are in bytes, -1: nowhere.

    Parameters
    ----------
    corners : (n, 3, 3) float32
        The facets with three readable vertices; not all need be finite.
    bad : (k,) int64
        Numbers of the facets left out, counted from 0 over all facets of the text.
    n_solids
        "solid" keywords.
    first_bad
        Offset of the first facet left out.
    n_loose, first_loose
        Departures from the grammar, and the offset of the first.
    open_at_end
        Where the text ends: ``""`` after endsolid, ``"solid"`` in a solid, ``"facet"`` in a facet.
    last_start
        Offset of the last "facet" or "solid".
    trailing
        Offset of what follows the last endsolid.
    has_decimal_comma
        A number could not be read because of a comma.
    first_wild
        Offset of the first readable facet with a coordinate that is not finite or beyond 1e30.
    """

    corners: NDArray[np.float32]
    bad: NDArray[np.int64]
    n_solids: int
    first_bad: int
    n_loose: int
    first_loose: int
    open_at_end: Literal["", "solid", "facet"]
    last_start: int
    trailing: int
    has_decimal_comma: bool
    first_wild: int


@dataclass(frozen=True, slots=True, eq=False)
class ObjText:
    """Vertices and faces of an OBJ text. Offsets are in bytes, -1: nowhere.

    Parameters
    ----------
    points : (V, 3) float64
        NaN where a coordinate can't be read.
    triangles : (T, 3) int32
        Vertex numbers counted from 0; they may be too large.
    face_of : (T,) int32
        Number of the face that a triangle is part of.
    n_faces, n_polygons, n_objects
        Faces, those with more than three corners, "o" statements.
    n_bad, first_bad
        Faces without three readable corners, left out; the offset of the first.
    n_loose, first_loose
        Statements that OBJ does not know and vertices that can't be read; the offset of the first.
    """

    points: Float
    triangles: Int
    face_of: Int
    n_faces: int
    n_polygons: int
    n_objects: int
    n_bad: int
    first_bad: int
    n_loose: int
    first_loose: int


def _as_array(data: bytes | memoryview) -> NDArray[np.uint8]:
    return np.frombuffer(data, dtype=np.uint8) if len(data) else np.empty(0, dtype=np.uint8)


def parse_stl_text(data: bytes | memoryview) -> StlText:
    """Read the facets of an ASCII STL text, each coordinate rounded correctly to float32."""
    text = _as_array(data)
    facets = np.empty((len(text) // 38 + 1, 3, 3), dtype=np.float32)
    bad = np.empty(len(text) // 5 + 1, dtype=np.int64)
    account = np.empty(11, dtype=np.int64)
    _parse_stl(address(text), len(text), address(facets), address(bad), address(account))
    # The order of the enum in text_stl.c.
    n_solids, n_facets, n_bad, first_bad, n_loose, first_loose = account[:6].tolist()
    at_end, last_start, trailing, comma, first_wild = account[6:].tolist()
    ends: tuple[Literal["", "solid", "facet"], ...] = ("", "solid", "facet")
    return StlText(
        corners=facets[:n_facets],
        bad=bad[:n_bad].copy(),
        n_solids=n_solids,
        first_bad=first_bad,
        n_loose=n_loose,
        first_loose=first_loose,
        open_at_end=ends[at_end],
        last_start=last_start,
        trailing=trailing,
        has_decimal_comma=bool(comma),
        first_wild=first_wild,
    )


def parse_obj_text(data: bytes | memoryview) -> ObjText:
    """Read vertices and faces of an OBJ text; faces with more than three corners are cut into fans."""
    text = _as_array(data)
    sizes = np.empty(2, dtype=np.int64)
    _count_obj(address(text), len(text), address(sizes))
    points = np.empty((int(sizes[0]), 3))
    triangles = np.empty((int(sizes[1]), 3), dtype=np.int32)
    face_of = np.empty(int(sizes[1]), dtype=np.int32)
    account = np.empty(9, dtype=np.int64)
    _parse_obj(address(text), len(text), address(points), address(triangles), address(face_of), address(account))
    # The order of the enum in text_obj.c.
    _, n_triangles, n_faces, n_polygons, n_objects, n_bad, first_bad, n_loose, first_loose = account.tolist()
    return ObjText(
        points=points,
        triangles=triangles[:n_triangles],
        face_of=face_of[:n_triangles],
        n_faces=n_faces,
        n_polygons=n_polygons,
        n_objects=n_objects,
        n_bad=n_bad,
        first_bad=first_bad,
        n_loose=n_loose,
        first_loose=first_loose,
    )


def parse_numbers(data: bytes | memoryview, dtype: type[np.float64] | type[np.float32]) -> tuple[NDArray[Any], int]:
    """Read white-space separated numbers, each rounded correctly.

    Returns
    -------
    values : (n,) float64 or float32
        Up to the end of the text or the first word that is no number.
    stop
        Offset of that word; the length of the text if there is none.
    """
    text = _as_array(data)
    values = np.empty(_count_words(address(text), len(text)), dtype=dtype)
    stop = np.zeros(1, dtype=np.int64)
    parse = _parse_numbers if dtype is np.float64 else _parse_floats
    count = parse(address(text), len(text), address(values), len(values), address(stop))
    return values[:count], len(text) if count == len(values) else int(stop[0])


def walk_records(
    data: NDArray[np.uint8], n: int, properties: Sequence[tuple[int, int]], target: int, big_endian: bool
) -> tuple[NDArray[np.int64], NDArray[np.int64], int]:
    """Find a list in records of varying length.

    Parameters
    ----------
    data : (length,) uint8
        Begins with the first record.
    n
        Number of records wanted, not more than there are bytes.
    properties
        For each property the kind of its list length (see `COUNT_KINDS`; 0: no list), and the bytes of a value.
    target
        Index of the property whose lists are wanted.
    big_endian
        Byte order of the list lengths.

    Returns
    -------
    starts, lengths : (m,) int64
        Offset of the first value of that list, and number of values, for each complete record; m < n if the data ends
        early or a length is negative.
    stop
        Offset behind the last complete record.
    """
    data = np.ascontiguousarray(data, dtype=np.uint8)
    layout = np.array(properties, dtype=np.int32).reshape(-1, 2)
    starts, lengths = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int64)
    stop = np.zeros(1, dtype=np.int64)
    complete = _walk_records(
        address(data),
        len(data),
        n,
        address(layout),
        len(layout),
        target,
        big_endian,
        address(starts),
        address(lengths),
        address(stop),
    )
    return starts[:complete], lengths[:complete], int(stop[0])
