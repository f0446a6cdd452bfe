"""STL, binary and ASCII (M. Burns, Automated Fabrication, 1993, section 6.5).

A binary file is an 80-byte header, the number of facets as uint32, and 50 bytes for each facet: normal and three
corners as float32, and two attribute bytes, all little-endian. Many binary files begin with the word "solid" that
marks an ASCII file, so the size decides first.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vhp_cli.errors import UnreadableFileError, VhpError
from vhp_cli.formats.normals import unit_normals
from vhp_cli.formats.reading import (
    BYTE_ORDER_MARK,
    FileIssue,
    Format,
    Reading,
    damage,
    empty_mesh,
    is_text,
    line_number,
    plural,
)
from vhp_cli.kernels.reading import RECORD_SIZE, parse_stl_text, weld, weld_facets, weld_stl_records
from vhp_cli.mesh import Mesh

RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])

_SAMPLE = 1024  # bytes that tell text from binary


def parse_stl(path: Path, data: bytes, *, weld_tolerance: float = 0.0) -> Reading:
    """Read an STL file of either kind from its bytes.

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
        If the bytes are not an STL file.
    """
    if not data:
        return Reading(empty_mesh(), "stl-ascii", (), 0, 0)
    if _is_ascii(data):
        return _parse_ascii(path, data, weld_tolerance)
    return _parse_binary(path, data, weld_tolerance)


def _is_ascii(data: bytes) -> bool:
    starts_solid = data.removeprefix(BYTE_ORDER_MARK)[:256].lstrip()[:5].lower() == b"solid"
    if len(data) < 84:
        return starts_solid
    # The first record of a binary file lies where a text goes on.
    sample = data[84 : 84 + _SAMPLE] if starts_solid else data[:_SAMPLE]
    if not is_text(sample):
        return starts_solid and not sample and not _has_binary_size(data)
    if starts_solid and not _has_binary_size(data):
        return True
    return b"facet" in data[: 4 * _SAMPLE].lower() or b"vertex" in data[: 4 * _SAMPLE].lower()


def _has_binary_size(data: bytes) -> bool:
    return len(data) >= 84 and len(data) == 84 + RECORD_SIZE * int.from_bytes(data[80:84], "little")


# ---------------------------------------------------------------- binary


def _parse_binary(path: Path, data: bytes, weld_tolerance: float) -> Reading:
    if len(data) < 84:
        raise UnreadableFileError(
            path,
            f"{len(data)} bytes are too few for an STL file, which has a header of 84",
            where=f"byte {len(data)}",
            hint="export the surface again",
        )
    announced = int.from_bytes(data[80:84], "little")
    held, rest = divmod(len(data) - 84, RECORD_SIZE)
    if announced != held:
        _refuse_other_content(path, data, held)
    n, issues = _facets_to_read(announced, held, rest)
    records = np.frombuffer(data, dtype=np.uint8)[84:]
    vertices, faces, unusable, _ = weld_stl_records(records, n)
    if len(unusable):
        first = int(unusable[0])
        issues.append(_not_finite(len(unusable), first, f"byte {84 + RECORD_SIZE * first}"))
    return _reading("stl-binary", vertices, faces, n, unusable, issues, data, 1, weld_tolerance)


def _facets_to_read(announced: int, held: int, rest: int) -> tuple[int, list[FileIssue]]:
    """Compare header and size: how many facets to read, and what is wrong."""
    counts = f"the header announces {plural(announced, 'facet')}, the file holds {held}"
    if announced == held:
        return held, [_trailing(rest, 84 + RECORD_SIZE * held)] if rest else []
    if announced > held and rest:
        end = 84 + RECORD_SIZE * held + rest
        return held, [
            FileIssue("F002", announced - held, f"{counts} and ends in the middle of one at byte {end}", held)
        ]
    if announced > held or rest == 0:
        return held, [FileIssue("F003", abs(announced - held), counts)]
    if announced == 0:
        return held, [FileIssue("F003", held, counts), _trailing(rest, 84 + RECORD_SIZE * held)]
    end = 84 + RECORD_SIZE * announced
    return announced, [_trailing(RECORD_SIZE * (held - announced) + rest, end)]


def _refuse_other_content(path: Path, data: bytes, held: int) -> None:
    """Raise if the contents can't be facets; called where header and size disagree."""
    for signature, what in (
        (b"\x1f\x8b", "gzip-compressed"),
        (b"PK\x03\x04", "a zip archive (or 3MF)"),
        (b"ply\n", "a PLY file"),
        (b"ply\r", "a PLY file"),
        (b"OFF", "an OFF file"),
        (b"<?xml", "an XML file"),
        (b"glTF", "a binary glTF file"),
    ):
        if data.startswith(signature):
            raise UnreadableFileError(
                path, f"the file is {what}, not STL", where="byte 0", hint="unpack, rename or convert it"
            )
    if held == 0:
        raise UnreadableFileError(
            path, "the file ends before its first facet", where=f"byte {len(data)}", hint="export the surface again"
        )
    if is_text(data[:_SAMPLE]):
        raise UnreadableFileError(
            path, "the file is text, but no STL", where="line 1", hint='an ASCII STL file begins with "solid"'
        )
    records = np.frombuffer(data, dtype=RECORD, count=min(held, 1000), offset=84)
    with np.errstate(invalid="ignore"):
        size = np.abs(records["corners"].reshape(-1, 9))
        plausible = ((size == 0) | ((size > 1e-30) & (size <= 1e30))).all(axis=1)
    if 2 * np.count_nonzero(plausible) < len(plausible):
        raise UnreadableFileError(
            path,
            "the contents are not the facets of an STL file",
            where="byte 84",
            hint="export the surface again, as binary STL",
        )


def _trailing(count: int, offset: int) -> FileIssue:
    return FileIssue("F010", count, f"{plural(count, 'byte')} after the last facet, from byte {offset}")


def _not_finite(count: int, first: int, where: str) -> FileIssue:
    return FileIssue(
        "F004",
        count,
        f"{plural(count, 'facet')} with a coordinate that is not finite or beyond 1e30 left out, first facet {first} "
        f"at {where}",
        first,
    )


# ---------------------------------------------------------------- ASCII


def _parse_ascii(path: Path, data: bytes, weld_tolerance: float) -> Reading:
    has_mark = data.startswith(BYTE_ORDER_MARK)
    skipped = len(BYTE_ORDER_MARK) if has_mark else 0
    text = parse_stl_text(memoryview(data)[skipped:])

    def line(offset: int) -> int:
        return line_number(data, offset + skipped)

    n_good, n_bad = len(text.corners), len(text.bad)
    n = n_good + n_bad
    if n == 0 and text.n_solids == 0 and text.open_at_end != "facet":
        raise UnreadableFileError(
            path, "the file is text, but no STL", where="line 1", hint='an ASCII STL file begins with "solid"'
        )
    if n_good == 0 and n_bad:
        raise UnreadableFileError(
            path,
            "no facet has three vertices that can be read",
            where=f"line {line(text.first_bad)}",
            hint="write numbers with a decimal point" if text.has_decimal_comma else "export the surface again",
        )
    issues = damage(data, text.trailing + skipped if text.trailing >= 0 else len(data))
    if text.open_at_end == "facet":
        issues.append(FileIssue("F002", 1, f"the file ends in facet {n}, begun at line {line(text.last_start)}", n))
    elif text.open_at_end == "solid":
        issues.append(FileIssue("F002", 1, f"endsolid is missing after {plural(n, 'facet')}"))
    if n_bad:
        first = int(text.bad[0])
        detail = (
            f"{plural(n_bad, 'facet')} of {n} without exactly three readable vertices left out, first facet {first} "
            f"at line {line(text.first_bad)}"
        )
        issues.append(FileIssue("F003", n_bad, detail, first))
    if text.n_loose:
        detail = f"{plural(text.n_loose, 'departure')} from the STL grammar, first at line {line(text.first_loose)}"
        issues.append(FileIssue("F009", text.n_loose, detail))
    if has_mark:
        issues.append(FileIssue("F009", 1, "the file begins with a byte order mark"))
    if text.n_solids > 1:
        issues.append(FileIssue("F008", text.n_solids, plural(text.n_solids, "solid")))
    if text.trailing >= 0:
        offset = text.trailing + skipped
        count = len(data) - offset
        issues.append(
            FileIssue("F010", count, f"{plural(count, 'byte')} after endsolid, from line {line(text.trailing)}")
        )

    vertices, faces, unusable = weld_facets(text.corners)
    numbers = np.delete(np.arange(n), text.bad)
    if len(unusable):
        first = int(numbers[unusable[0]])
        issues.append(_not_finite(len(unusable), first, f"line {line(text.first_wild)}"))
    left_out = np.union1d(text.bad, numbers[unusable])
    return _reading("stl-ascii", vertices, faces, n, left_out, issues, data, text.n_solids, weld_tolerance)


# ---------------------------------------------------------------- both


def _reading(
    kind: Format,
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    n: int,
    left_out: NDArray[np.int64],
    issues: list[FileIssue],
    data: bytes,
    solids: int,
    weld_tolerance: float,
) -> Reading:
    if weld_tolerance > 0 and len(vertices):
        vertices, index = weld(vertices, weld_tolerance)
        faces = index[faces.ravel()].reshape(-1, 3)
    return Reading(
        mesh=Mesh(vertices, faces),
        format=kind,
        issues=tuple(issues),
        n_bytes=len(data),
        n_facets_stored=n,
        solids=solids,
        face_number=np.delete(np.arange(n), left_out) if len(left_out) else None,
    )


def stl_bytes(mesh: Mesh, unit: str = "millimetres") -> bytes:
    """Return the mesh as a binary STL file: float32 coordinates, unit normals (0 for a face without area).

    Raises
    ------
    VhpError
        If a coordinate is not finite or leaves the range of float32.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        single = mesh.vertices.astype(np.float32)
    if not np.isfinite(single).all():
        vertex = int(np.flatnonzero(~np.isfinite(single).all(axis=1))[0])
        raise VhpError(f"vertex {vertex} can't be written as STL: {mesh.vertices[vertex].tolist()} is no float32")
    corners = single[mesh.faces]
    records = np.zeros(len(corners), dtype=RECORD)
    records["normal"], records["corners"] = unit_normals(corners.astype(np.float64)), corners
    return f"vhp binary STL, {unit}".encode("ascii").ljust(80) + len(corners).to_bytes(4, "little") + records.tobytes()
