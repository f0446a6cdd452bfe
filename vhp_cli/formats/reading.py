"""What comes out of a mesh file: the mesh, and everything that was not in order."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from vhp_cli.kernels.reading import weld
from vhp_cli.mesh import Mesh

Format = Literal["stl-binary", "stl-ascii", "ply-binary", "ply-ascii", "obj"]

# Beyond this, products of four coordinates leave the range of a double; no solver means such a value.
LARGEST = 1e30
# Below this, they vanish in the same way: such values become 0, far below any spacing of a mesh in mm.
SMALLEST = 1e-60

BYTE_ORDER_MARK = b"\xef\xbb\xbf"


@dataclass(frozen=True, slots=True)
class FileIssue:
    """Something in a file that is not in order, though the mesh could be read.

    Parameters
    ----------
    rule
        Code of the rule that is broken.
    count
        How often.
    detail
        One clause that says what and where (byte, line or facet; facets are counted from 0).
    place
        Facet of the file concerned, None if it is no single one.
    """

    rule: str
    count: int
    detail: str
    place: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """A mesh as read from a file.

    Parameters
    ----------
    mesh
        Welded exactly: equal coordinates are one vertex, so that only true cracks count as open edges. Vertices that
        no face uses are dropped.
    format
        What the file is.
    issues
        What is not in order.
    n_bytes
        Size of the file.
    n_facets_stored
        Facets that the file holds, those left out of the mesh included; polygons count once.
    solids
        Solids of an STL text, objects of an OBJ file; 1 in the other formats.
    unreferenced
        Vertices of the file that no face uses.
    face_number : (F,) int64
        Facet of the file that each mesh face comes from; None if face i is facet i.
    sha256
        Hexadecimal hash of the bytes read; empty if the bytes were handed over without it.
    """

    mesh: Mesh
    format: Format
    issues: tuple[FileIssue, ...]
    n_bytes: int
    n_facets_stored: int
    solids: int = 1
    unreferenced: int = 0
    face_number: NDArray[np.int64] | None = None
    sha256: str = ""


def empty_mesh() -> Mesh:
    """Return a mesh without vertices and faces."""
    return Mesh(np.empty((0, 3)), np.empty((0, 3), dtype=np.int32))


def line_number(data: bytes, offset: int) -> int:
    """Return the line, counted from 1, of a byte of a text with any kind of line ends."""
    newline = b"\n" if b"\n" in data else b"\r"
    return data.count(newline, 0, offset) + 1


def is_text(sample: bytes) -> bool:
    """Return whether nearly all bytes are printable, so that a damaged text is still a text.

    Bytes from 128 up are left out of account: names in any encoding may hold them.
    """
    codes = np.frombuffer(sample, dtype=np.uint8) if sample else np.empty(0, dtype=np.uint8)
    plain = ((codes >= 32) & (codes < 127)) | ((codes >= 9) & (codes <= 13))
    control = (codes < 128) & ~plain
    return bool(plain.sum() > 0.7 * len(codes) and control.sum() <= 0.03 * len(codes))


def damage(data: bytes, end: int) -> list[FileIssue]:
    """Report NUL bytes among the first `end` of a text: a stretch that was never written may hide faces."""
    count = data.count(b"\0", 0, end)
    if not count:
        return []
    where = f"from byte {data.find(bytes(1))}"
    return [FileIssue("F002", count, f"{plural(count, 'NUL byte')} in the text, {where}: a part is lost")]


def plural(count: int, noun: str) -> str:
    """Return the count with its noun: ``1 facet``, ``2 facets``."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


@dataclass(frozen=True, slots=True, eq=False)
class IndexedFaces:
    """Vertices and triangles as an indexed format stores them, before anything is checked.

    Parameters
    ----------
    points : (V, 3) float64
        Any values.
    triangles : (T, 3) integer
        Any values; -1 stands for a vertex number that can't be represented.
    face_of : (T,) integer
        Face of the file that each triangle is part of.
    n_faces, n_polygons
        Faces of the file, and those with more than three corners.
    n_bad
        Faces already left out because they can't be read.
    bad_place
        Where the first of them is.
    """

    points: NDArray[np.float64]
    triangles: NDArray[np.integer[Any]]
    face_of: NDArray[np.integer[Any]]
    n_faces: int
    n_polygons: int
    n_bad: int = 0
    bad_place: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class CleanFaces:
    """The usable part of `IndexedFaces`, welded; fields as in `Reading`."""

    mesh: Mesh
    issues: tuple[FileIssue, ...]
    unreferenced: int
    face_number: NDArray[np.int64] | None


def clean_faces(stored: IndexedFaces, weld_tolerance: float) -> CleanFaces:
    """Leave out faces with vertices that do not exist or are not finite, drop unused vertices, and weld the rest."""
    points, triangles, face_of = stored.points, stored.triangles, stored.face_of
    n_points = len(points)
    issues: list[FileIssue] = []

    exists = ((triangles >= 0) & (triangles < n_points)).all(axis=1)
    lost = np.unique(face_of[~exists])
    if len(lost) or stored.n_bad:
        count = len(lost) + stored.n_bad
        clauses = []
        if stored.n_bad:
            clauses.append(
                f"{plural(stored.n_bad, 'face')} without three readable vertex numbers, first at {stored.bad_place}"
            )
        if len(lost):
            clauses.append(f"{plural(len(lost), 'face')} with a vertex outside the {n_points}, first face {lost[0]}")
        detail = " and ".join(clauses) + f"; {'it was' if count == 1 else 'they were'} left out"
        place = int(lost[0]) if len(lost) else None
        issues += [FileIssue("F003", count, detail, place), FileIssue("F009", count, detail, place)]
        keep = ~np.isin(face_of, lost)
        triangles, face_of = triangles[keep], face_of[keep]

    used = np.zeros(n_points, dtype=bool)
    used[triangles.ravel()] = True
    unreferenced = n_points - int(np.count_nonzero(used))

    with np.errstate(invalid="ignore"):
        finite: NDArray[np.bool_] = np.all(np.abs(points) <= LARGEST, axis=1)
    if not finite.all():
        wild = np.flatnonzero(~finite)
        lost = np.unique(face_of[~finite[triangles].all(axis=1)])
        issues.append(
            FileIssue(
                "F004",
                len(wild),
                f"{len(wild)} of {n_points} vertices not finite or beyond 1e30, first vertex "
                f"{wild[0]}; {plural(len(lost), 'face')} left out",
                int(lost[0]) if len(lost) else None,
            )
        )
        keep = ~np.isin(face_of, lost)
        triangles, face_of = triangles[keep], face_of[keep]
        used[:] = False
        used[triangles.ravel()] = True
    if stored.n_polygons:
        issues.append(
            FileIssue("F011", stored.n_polygons, f"{plural(stored.n_polygons, 'face')} with more than three corners")
        )

    kept = points[used]
    kept[np.abs(kept) < SMALLEST] = 0.0
    vertices, index = weld(kept, weld_tolerance)
    number = np.zeros(n_points, dtype=np.int32)
    number[used] = index
    is_identity = len(face_of) == stored.n_faces and not stored.n_polygons
    return CleanFaces(
        mesh=Mesh(vertices, number[triangles.ravel()].reshape(-1, 3)),
        issues=tuple(issues),
        unreferenced=unreferenced,
        face_number=None if is_identity else face_of.astype(np.int64),
    )
