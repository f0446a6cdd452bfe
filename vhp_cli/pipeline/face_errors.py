"""The errors of a solution on each triangle of a tissue, from files beside the mesh or from the mesh file itself."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vhp_cli import formats
from vhp_cli.errors import UnreadableFileError, VhpError
from vhp_cli.formats.npy import parse_values
from vhp_cli.formats.ply import face_property
from vhp_cli.formats.reading import Reading, plural
from vhp_cli.model import Model, TissueFile


@dataclass(frozen=True, slots=True)
class FaceErrors:
    """Where the errors are.

    Parameters
    ----------
    path
        An NPY file, or a directory that has one for each tissue, by its name; absolute. None: in the mesh files.
    property_name
        Of the faces of PLY files.
    """

    path: Path | None
    property_name: str

    def file_of(self, tissue: TissueFile) -> Path | None:
        """Return the file with the errors of a tissue; None if they are in its mesh file."""
        if self.path is None or not self.path.is_dir():
            return self.path
        return self.path / f"{tissue.name}.npy"


def read_face_errors(where: FaceErrors, tissue: TissueFile, data: bytes, reading: Reading) -> NDArray[np.float64]:
    """Return the error of each face of a mesh.

    Parameters
    ----------
    where
        Where the errors are: one for each facet of the file, in its order, those that the reader leaves out included.
    tissue, data, reading
        The tissue, the bytes of its file, and what was read from them.

    Returns
    -------
    (F,) float64
        Finite, not negative.

    Raises
    ------
    VhpError
        If there are none, not as many as facets, or one is negative or not finite.
    """
    file = where.file_of(tissue)
    if file is not None:
        try:
            values = parse_values(file, formats.read_bytes(file))
        except UnreadableFileError as error:
            raise VhpError(f"no errors: {file}: {error.message}", hint=error.hint) from error
        source = str(file)
    elif reading.format in ("ply-binary", "ply-ascii"):
        found = face_property(tissue.path, data, where.property_name)
        if found is None:
            raise VhpError(f"no errors: the faces of {tissue.file} have no number {where.property_name!r}")
        values, source = found, f"property {where.property_name!r}"
    else:
        raise VhpError("no errors: only PLY files hold them", hint="give --errors")
    if len(values) != reading.n_facets_stored:
        expected = plural(reading.n_facets_stored, "facet")
        raise VhpError(f"{source}: {plural(len(values), 'error')} for {expected} in {tissue.file}")
    wrong = np.flatnonzero(~(np.isfinite(values) & (values >= 0)))
    if len(wrong):
        at = int(wrong[0])
        what = f"first facet {at}, {values[at]:g}"
        raise VhpError(f"{source}: {plural(len(wrong), 'error')} negative or not finite, {what}")
    return values if reading.face_number is None else values[reading.face_number]


def fingerprint(where: FaceErrors, model: Model) -> str:
    """Return a hash of the files with the errors of all tissues; one that can't be read counts as empty."""
    digest = hashlib.sha256()
    for tissue in model.tissues:
        file = where.file_of(tissue)
        if file is not None:
            try:
                found = formats.sha256(formats.read_bytes(file))
            except UnreadableFileError:
                found = ""
            digest.update(f"{tissue.file}\0{found}\n".encode())
    return digest.hexdigest()
