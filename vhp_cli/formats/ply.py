"""PLY (G. Turk, "The PLY Polygon File Format", 1994): ASCII, and binary of both byte orders."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vhp_cli.errors import UnreadableFileError
from vhp_cli.formats.reading import (
    FileIssue,
    IndexedFaces,
    Reading,
    clean_faces,
    empty_mesh,
    line_number,
    plural,
)
from vhp_cli.kernels.reading import COUNT_KINDS, parse_numbers, walk_records
from vhp_cli.mesh import Mesh

_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float32": "f4", "float64": "f8",
}  # fmt: skip
_NATIVE = "<" if sys.byteorder == "little" else ">"
_ENCODINGS = {"ascii": "ascii", "binary_little_endian": "<", "binary_big_endian": ">"}
_CORNER_LISTS = ("vertex_indices", "vertex_index")
_LONGEST_LINE = 10_000  # of a header; longer: it is no header

Bytes = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class _Property:
    name: str
    type: str  # of the value, as numpy names it without byte order
    count_type: str = ""  # of the list length; empty: no list

    @property
    def size(self) -> int:
        return int(self.type[1])

    @property
    def layout(self) -> tuple[int, int]:
        return COUNT_KINDS[self.count_type] if self.count_type else 0, self.size


@dataclass(frozen=True, slots=True)
class _Element:
    name: str
    count: int
    properties: tuple[_Property, ...]

    def index(self, *names: str) -> int | None:
        return next((i for i, item in enumerate(self.properties) if item.name in names), None)


@dataclass(frozen=True, slots=True)
class _Header:
    encoding: str  # "ascii", or the byte order as numpy writes it
    elements: tuple[_Element, ...]
    end: int  # offset of the first byte behind it
    n_unknown: int  # lines that mean nothing

    def element(self, name: str) -> _Element | None:
        return next((item for item in self.elements if item.name == name), None)


def parse_ply(path: Path, data: bytes, *, weld_tolerance: float = 0.0) -> Reading:
    """Read a PLY file from its bytes, and weld it.

    Parameters
    ----------
    path
        For the messages.
    data
        The whole file.
    weld_tolerance
        As of `vhp_cli.kernels.reading.weld`, in mm.

    Raises
    ------
    UnreadableFileError
        If the header can't be understood, or no face can be read though the file announces some.
    """
    if not data:
        return Reading(empty_mesh(), "ply-ascii", (), 0, 0)
    header = _parse_header(path, data)
    _check_elements(path, header)
    is_ascii = header.encoding == "ascii"
    body = _Text(data, header) if is_ascii else _Body(data, header)

    points, triangles, face_of = np.empty((0, 3)), np.empty((0, 3), dtype=np.int64), np.empty(0, dtype=np.int64)
    n_faces = n_polygons = n_short = 0
    issues: list[FileIssue] = []
    for element in header.elements:
        if element.name == "vertex":
            points, complete = body.read_points(element)
        elif element.name == "face":
            starts, lengths, complete = body.read_corner_lists(element)
            n_faces, n_polygons = complete, int(np.count_nonzero(lengths > 3))
            n_short = int(np.count_nonzero(lengths < 3))
            triangles, face_of = body.fans(element, starts, lengths)
        else:
            complete = body.skip(element)
        if complete < element.count:
            what = f"the file {body.end_clause()} in {element.name} {complete} of {element.count}"
            place = complete if element.name == "face" else None
            issues.append(FileIssue("F002", element.count - complete, what, place))
            break
    else:
        if left := body.bytes_left():
            issues.append(FileIssue("F010", left, f"{plural(left, 'byte')} after the last element"))
    if header.n_unknown:
        issues.append(FileIssue("F009", header.n_unknown, f"{plural(header.n_unknown, 'header line')} without meaning"))

    stored = IndexedFaces(
        points, triangles, face_of, n_faces, n_polygons, n_bad=n_short, bad_place="a list of fewer than three"
    )
    clean = clean_faces(stored, weld_tolerance)
    return Reading(
        mesh=clean.mesh,
        format="ply-ascii" if is_ascii else "ply-binary",
        issues=(*issues, *clean.issues),
        n_bytes=len(data),
        n_facets_stored=n_faces,
        unreferenced=clean.unreferenced,
        face_number=clean.face_number,
    )


def face_property(path: Path, data: bytes, name: str) -> NDArray[np.float64] | None:
    """Read one number for each face of a PLY file.

    Parameters
    ----------
    path, data
        As of `parse_ply`, which has to accept the file.
    name
        Of the property.

    Returns
    -------
    (N,) float64
        One for each face of the file that is complete; None if the faces have no such property, or it is a list.
    """
    header = _parse_header(path, data)
    body = _Text(data, header) if header.encoding == "ascii" else _Body(data, header)
    for element in header.elements:
        if element.name != "face":
            body.skip(element)
            continue
        index = element.index(name)
        return None if index is None or element.properties[index].count_type else body.read_numbers(element, index)
    return None


# ---------------------------------------------------------------- header


def _header_lines(path: Path, data: bytes) -> Iterator[tuple[int, list[str], int]]:
    """Yield number, words, and the offset behind each line. The first line tells how lines end."""
    if not data.startswith((b"ply\n", b"ply\r")):
        raise UnreadableFileError(path, 'the file does not begin with "ply"', where="line 1", hint="export it again")
    line_end = b"\r\n" if data.startswith(b"ply\r\n") else data[3:4]
    number, begin = 0, 0
    while True:
        number += 1
        end = data.find(line_end, begin, begin + _LONGEST_LINE)
        if end < 0:
            # The last line of a header without data needs no line end.
            if data[begin:].strip() == b"end_header":
                yield number, ["end_header"], len(data)
            raise UnreadableFileError(
                path, "the PLY header does not end", where=f"line {number}", hint="export it again"
            )
        words = data[begin:end].decode("latin-1").split()
        begin = end + len(line_end)
        yield number, words, begin


def _parse_header(path: Path, data: bytes) -> _Header:
    encoding, n_unknown = "", 0
    elements: list[_Element] = []
    for number, words, end in _header_lines(path, data):
        where = f"line {number}"
        match words:
            case ["end_header"]:
                if not encoding:
                    raise UnreadableFileError(path, "the PLY header names no format", where=where)
                return _Header(encoding, tuple(elements), end, n_unknown)
            case ["format", name, *_] if name in _ENCODINGS:
                encoding = _ENCODINGS[name]
            case ["element", name, count] if count.isascii() and count.isdigit() and len(count) < 19:
                elements.append(_Element(name, int(count), ()))
            case ["property", "list", count_type, kind, name] if (
                elements and kind in _TYPES and _TYPES.get(count_type) in COUNT_KINDS and _TYPES[count_type] != "f8"
            ):
                item = _Property(name, _TYPES[kind], _TYPES[count_type])
                elements[-1] = replace(elements[-1], properties=(*elements[-1].properties, item))
            case ["property", kind, name] if elements and kind in _TYPES:
                item = _Property(name, _TYPES[kind])
                elements[-1] = replace(elements[-1], properties=(*elements[-1].properties, item))
            case ["format" | "element" | "property", *_]:
                raise UnreadableFileError(path, f"can't understand {' '.join(words)[:80]!r}", where=where)
            case [] | ["ply" | "comment" | "obj_info", *_]:
                pass
            case _:
                n_unknown += 1
    raise AssertionError("the header lines end by an exception")


def _check_elements(path: Path, header: _Header) -> None:
    names = [element.name for element in header.elements]
    for name in ("vertex", "face"):
        if names.count(name) > 1:
            raise UnreadableFileError(path, f"the PLY header has several {name} elements", where="header")
    vertex, face = header.element("vertex"), header.element("face")
    if face is None and "tristrips" in names:
        raise UnreadableFileError(
            path, "the surface is stored as triangle strips", where="header", hint="export it with triangles as faces"
        )
    if vertex is None or any(vertex.index(axis) is None for axis in "xyz"):
        raise UnreadableFileError(path, "the PLY header has no vertex element with x, y and z", where="header")
    if any(vertex.properties[vertex.index(axis) or 0].count_type for axis in "xyz"):
        raise UnreadableFileError(path, "x, y and z of the vertices are lists", where="header")
    if face is not None:
        index = face.index(*_CORNER_LISTS)
        if index is None or not face.properties[index].count_type:
            raise UnreadableFileError(path, "the face element has no list vertex_indices", where="header")


# ---------------------------------------------------------------- body


class _Body:
    """The elements behind the header of a binary file, read one after the other."""

    def __init__(self, data: bytes, header: _Header) -> None:
        self._values: Bytes = np.frombuffer(data, dtype=np.uint8)[header.end :]
        self._order = header.encoding
        self._start = header.end
        self._offset = 0

    def end_clause(self) -> str:
        return f"ends at byte {self._start + len(self._values)},"

    def bytes_left(self) -> int:
        return len(self._values) - self._offset

    def _stored(self, element: _Element) -> _Element:
        """Return the element as its bytes are."""
        return element

    def skip(self, element: _Element) -> int:
        """Pass over an element; return the number of complete records."""
        return self._walk(self._stored(element), 0)[2] if element.properties else element.count

    def read_corner_lists(self, element: _Element) -> tuple[NDArray[np.int64], NDArray[np.int64], int]:
        """Return start and length of the list in each record, and the number of complete records."""
        return self._walk(self._stored(element), element.index(*_CORNER_LISTS) or 0)

    def _walk(self, element: _Element, target: int) -> tuple[NDArray[np.int64], NDArray[np.int64], int]:
        rest = self._values[self._offset :]
        layout = [item.layout for item in element.properties]
        # Each record has at least a byte: a larger count than that would only cost memory.
        n = min(element.count, len(rest))
        starts, lengths, stop = walk_records(rest, n, layout, target, self._order == ">")
        starts += self._offset
        self._offset += stop
        return starts, lengths, len(starts)

    def read_points(self, element: _Element) -> tuple[NDArray[np.float64], int]:
        """Return the (V, 3) coordinates of the complete vertices, and their number."""
        element = self._stored(element)
        axes = [element.index(axis) or 0 for axis in "xyz"]
        if any(item.count_type for item in element.properties):
            begin, columns, complete = self._offset, [], 0
            for axis in axes:
                self._offset = begin
                starts, lengths, complete = self._walk(element, axis)
                columns.append(self._gather(starts, lengths, element.properties[axis]))
            with np.errstate(invalid="ignore"):
                return np.column_stack(columns).astype(np.float64), complete
        stride = sum(item.size for item in element.properties)
        complete = min(element.count, (len(self._values) - self._offset) // stride)
        points = np.empty((complete, 3))
        for k, axis in enumerate(axes):
            item = element.properties[axis]
            first = self._offset + sum(before.size for before in element.properties[:axis])
            if complete:
                # A signalling NaN warns when it is cast; it is reported with the others that are not finite.
                with np.errstate(invalid="ignore"):
                    points[:, k] = np.ndarray(complete, self._order + item.type, self._values, first, stride)
        self._offset += complete * stride
        return points, complete

    def read_numbers(self, element: _Element, index: int) -> NDArray[np.float64]:
        """Return the values of a property that is no list in the complete records."""
        element = self._stored(element)
        with np.errstate(invalid="ignore"):
            return self._gather(*self._walk(element, index)[:2], element.properties[index]).astype(np.float64)

    def fans(
        self, element: _Element, starts: NDArray[np.int64], lengths: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Cut each list of corners into triangles about its first corner: (T, 3) corners, (T,) number of the list."""
        element = self._stored(element)
        item = element.properties[element.index(*_CORNER_LISTS) or 0]
        steps = np.diff(starts)
        if len(starts) and (lengths == 3).all() and (steps == (steps[0] if len(steps) else 0)).all():
            strides = (int(steps[0]) if len(steps) else 0, item.size)
            shape = (len(starts), 3)
            corners = np.ndarray(shape, self._order + item.type, self._values, int(starts[0]), strides)
            return _as_indices(corners), np.arange(len(starts))
        corners = _as_indices(self._gather(starts, lengths, item))
        first = np.cumsum(lengths) - lengths
        n_triangles = np.maximum(lengths - 2, 0)
        list_of = np.repeat(np.arange(len(lengths)), n_triangles)
        position = np.arange(len(list_of)) - np.repeat(np.cumsum(n_triangles) - n_triangles, n_triangles)
        anchor = first[list_of]
        second = anchor + position + 1
        return np.column_stack((corners[anchor], corners[second], corners[second + 1])), list_of

    def _gather(self, starts: NDArray[np.int64], lengths: NDArray[np.int64], item: _Property) -> NDArray[Any]:
        """Return the values of all lists, one after the other."""
        first = np.cumsum(lengths) - lengths
        position = np.arange(int(lengths.sum())) - np.repeat(first, lengths)
        places = np.repeat(starts, lengths) + position * item.size
        values = self._values[places[:, None] + np.arange(item.size)]
        numbers: NDArray[Any] = values.view(self._order + item.type).ravel()
        return numbers


class _Text(_Body):
    """The same for an ASCII file, whose numbers have been read into doubles."""

    def __init__(self, data: bytes, header: _Header) -> None:
        text = memoryview(data)[header.end :]
        numbers, self._stop = parse_numbers(text, np.float64)
        self._data, self._text_start = data, header.end
        self._values = numbers.view(np.uint8)
        self._order = _NATIVE
        self._start = 0
        self._offset = 0
        self._text = text

    def _stored(self, element: _Element) -> _Element:
        items = (replace(item, type="f8", count_type=item.count_type and "f8") for item in element.properties)
        return replace(element, properties=tuple(items))

    def end_clause(self) -> str:
        if self._stop == len(self._text):
            return "ends"
        return f"has no number at line {line_number(self._data, self._text_start + self._stop)},"

    def bytes_left(self) -> int:
        left = (len(self._values) - self._offset) // 8
        rest = bytes(self._text[self._stop :]).strip()
        # Each number has a character and a space at least.
        return 2 * left + len(rest)

    def read_points(self, element: _Element) -> tuple[NDArray[np.float64], int]:
        """Return the coordinates; those declared as float are rounded once, from the text to float32."""
        singles = [element.properties[element.index(axis) or 0].type == "f4" for axis in "xyz"]
        begin = self._offset
        points, complete = super().read_points(element)
        if any(singles):
            end, doubles = self._offset, self._values
            self._values = parse_numbers(self._text, np.float32)[0].astype(np.float64).view(np.uint8)
            self._offset = begin
            rounded = super().read_points(element)[0]
            points[:, singles] = rounded[:, singles]
            self._offset, self._values = end, doubles
        return points, complete


def _as_indices(values: NDArray[Any]) -> NDArray[np.int64]:
    """Return vertex numbers; -1 where a value is none."""
    if values.dtype.kind != "f":
        return values.astype(np.int64)
    valid = (values >= 0) & (values < 2**31) & (values == np.floor(values))
    return np.where(valid, values, -1).astype(np.int64)


def ply_bytes(mesh: Mesh, unit: str = "millimetres") -> bytes:
    """Return the mesh as a binary little-endian PLY file, with float coordinates if these hold them exactly."""
    with np.errstate(over="ignore"):
        single = mesh.vertices.astype("<f4")
    exact = bool((single == mesh.vertices).all())
    header = (
        f"ply\nformat binary_little_endian 1.0\ncomment vhp, {unit}\n"
        f"element vertex {len(mesh.vertices)}\n"
        + "".join(f"property {'float' if exact else 'double'} {axis}\n" for axis in "xyz")
        + f"element face {len(mesh.faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.empty(len(mesh.faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, mesh.faces
    vertices = single if exact else mesh.vertices.astype("<f8")
    return header.encode("ascii") + vertices.tobytes() + faces.tobytes()
