"""Wavefront OBJ: the statements "v" and "f"; everything else is left aside."""

from __future__ import annotations

from pathlib import Path

from vhp_cli.errors import UnreadableFileError
from vhp_cli.formats.reading import (
    BYTE_ORDER_MARK,
    FileIssue,
    IndexedFaces,
    Reading,
    clean_faces,
    damage,
    line_number,
    plural,
)
from vhp_cli.kernels.reading import parse_obj_text
from vhp_cli.mesh import Mesh


def parse_obj(path: Path, data: bytes, *, weld_tolerance: float = 0.0) -> Reading:
    """Read an OBJ file from its bytes: all its objects and groups as one mesh, welded.

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
        If the bytes hold neither vertices nor faces, but something else.
    """
    skipped = len(BYTE_ORDER_MARK) if data.startswith(BYTE_ORDER_MARK) else 0
    text = parse_obj_text(memoryview(data)[skipped:])

    def line(offset: int) -> str:
        return f"line {line_number(data, offset + skipped)}"

    if text.n_loose and not text.n_faces and not len(text.points):
        raise UnreadableFileError(
            path,
            "the file holds no OBJ statement",
            where=line(text.first_loose),
            hint='an OBJ file has lines "v x y z" and "f i j k"',
        )
    stored = IndexedFaces(
        points=text.points,
        triangles=text.triangles,
        face_of=text.face_of,
        n_faces=text.n_faces,
        n_polygons=text.n_polygons,
        n_bad=text.n_bad,
        bad_place=line(text.first_bad) if text.n_bad else "",
    )
    if text.n_faces and not len(text.triangles):
        raise UnreadableFileError(
            path, "no face can be read", where=stored.bad_place, hint='faces are lines "f i j k" of vertex numbers'
        )
    clean = clean_faces(stored, weld_tolerance)
    issues = [*damage(data, len(data)), *clean.issues]
    if text.n_loose:
        detail = f"{plural(text.n_loose, 'statement')} that OBJ does not know, first at {line(text.first_loose)}"
        issues.append(FileIssue("F009", text.n_loose, detail))
    if skipped:
        issues.append(FileIssue("F009", 1, "the file begins with a byte order mark"))
    if text.n_objects > 1:
        issues.append(FileIssue("F008", text.n_objects, plural(text.n_objects, "object")))
    return Reading(
        mesh=clean.mesh,
        format="obj",
        issues=tuple(issues),
        n_bytes=len(data),
        n_facets_stored=text.n_faces,
        solids=max(text.n_objects, 1),
        unreferenced=clean.unreferenced,
        face_number=clean.face_number,
    )


def obj_bytes(mesh: Mesh, unit: str = "millimetres") -> bytes:
    """Return the mesh as an OBJ file, with the shortest decimal numbers that give the coordinates back exactly."""
    lines = [f"# vhp, {unit}"]
    lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (mesh.faces.astype("i8") + 1).tolist()]
    return ("\n".join(lines) + "\n").encode("ascii")
