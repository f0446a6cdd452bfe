"""Surfaces as 3MF (3MF Consortium, core specification 1.3): a zip archive with one XML model of named objects."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Sequence
from typing import BinaryIO
from xml.sax.saxutils import quoteattr

from vhp_cli.formats.surfaces.named import NamedSurface
from vhp_cli.formats.volume.text import write_rows

_UNITS = {"um": "micron", "mm": "millimeter", "cm": "centimeter", "in": "inch", "m": "meter"}
_CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
_MODEL = "3D/3dmodel.model"
_HEAD = '<?xml version="1.0" encoding="UTF-8"?>\n'
_TYPES = (
    _HEAD + '<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">\n'
    '<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>\n'
    '<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/>\n</Types>\n'
)
_RELATIONS = (
    _HEAD + '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">\n'
    f'<Relationship Id="rel0" Target="/{_MODEL}" '
    'Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/>\n</Relationships>\n'
)
# The earliest moment that zip knows: the same model gives the same bytes.
_MOMENT = (1980, 1, 1, 0, 0, 0)


def write(file: BinaryIO, surfaces: Sequence[NamedSurface], unit: str) -> None:
    """Write an object for each tissue, with the shortest decimal numbers that give the coordinates back exactly."""
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in (
            ("[Content_Types].xml", _TYPES.encode()),
            ("_rels/.rels", _RELATIONS.encode()),
            (_MODEL, _model(surfaces, unit)),
        ):
            entry = zipfile.ZipInfo(name, _MOMENT)
            entry.compress_type = zipfile.ZIP_DEFLATED
            # The system is part of the archive, too: the same one everywhere.
            entry.create_system = 3
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, content)


def _model(surfaces: Sequence[NamedSurface], unit: str) -> bytes:
    text = io.BytesIO()
    text.write(f'{_HEAD}<model unit="{_UNITS[unit]}" xml:lang="en-US" xmlns="{_CORE}">\n'.encode())
    text.write(b'<metadata name="Application">vhp</metadata>\n<resources>\n')
    for number, surface in enumerate(surfaces, start=1):
        text.write(f'<object id="{number}" type="model" name={quoteattr(surface.name)}>\n<mesh>\n'.encode())
        text.write(b"<vertices>\n")
        write_rows(text, '<vertex x="%r" y="%r" z="%r"/>\n', surface.mesh.vertices)
        text.write(b"</vertices>\n<triangles>\n")
        write_rows(text, '<triangle v1="%d" v2="%d" v3="%d"/>\n', surface.mesh.faces)
        text.write(b"</triangles>\n</mesh>\n</object>\n")
    text.write(b"</resources>\n<build>\n")
    for number in range(1, len(surfaces) + 1):
        text.write(f'<item objectid="{number}"/>\n'.encode())
    text.write(b"</build>\n</model>\n")
    return text.getvalue()
