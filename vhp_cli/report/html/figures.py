"""Pictures of the page: each tissue with the places of its findings, the worst place close by, the whole model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from vhp_cli.measures import Finding, Place
from vhp_cli.report.html.markup import data_uri, words
from vhp_cli.report.html.scene import place_tissue
from vhp_cli.report.html.shown import Shown, edge_length_near, normal_near
from vhp_cli.report.pictures.portraits import Colour, Portrait, model_picture, portrait
from vhp_cli.report.pictures.views import BACK, FRONT, LEFT, Frame, best_oblique, frame_all, view_from
from vhp_cli.report.text import headline, number
from vhp_cli.report.text import place as place_words
from vhp_cli.report.verdict import rule_name

_WIDTH, _HEIGHT = 240, 180
_MODEL_WIDTH, _MODEL_HEIGHT = 300, 420
_MOST_MARKS = 40
_CLOSE = 12.0  # mean edges across a close-up

# A finding, its number on the page, and one of its places.
Mark = tuple[int, Finding, Place]


def marks_of(name: str, findings: Sequence[tuple[int, Finding]]) -> list[Mark]:
    """Return the places of findings that lie in a tissue, of each finding in order, known ones left out."""
    return [
        (index, finding, place)
        for index, finding in findings
        if not finding.get("known")
        for place in finding["places"]
        if place_tissue(place, finding) == name
    ]


def tissue_figure(surface: Shown, colour: Colour, marks: Sequence[Mark]) -> str:
    """Return the picture of a tissue with a ring around each of the first places.

    Parameters
    ----------
    surface
        With at least one face.
    colour
        Of the tissue.
    marks
        What to mark.
    """
    faces = _marked_faces(surface, marks)
    normal = normal_near(surface, int(faces[0])) if len(faces) else None
    view = best_oblique(normal)
    drawn = portrait(surface.mesh, frame_all(view, surface.mesh.vertices, _WIDTH, _HEIGHT), colour, faces)
    return _svg(drawn, marks[:_MOST_MARKS], f"from the {view.name}", 6.0)


def close_up(surface: Shown, colour: Colour, mark: Mark) -> str:
    """Return a picture of the surroundings of one place, with the edges of the triangles; empty if it has no face."""
    faces = _marked_faces(surface, [mark])
    if not len(faces):
        return ""
    mesh = surface.mesh
    face = int(faces[0])
    edge = edge_length_near(surface, face)
    normal = normal_near(surface, face)
    view = best_oblique(None) if normal is None else view_from("its outside", normal)
    frame = Frame(view, np.asarray(mark[2]["xyz_mm"], dtype=float), _WIDTH / (_CLOSE * edge), _WIDTH, _HEIGHT)
    drawn = portrait(mesh, frame, colour, faces, edges=True)
    return _svg(drawn, [mark], f"{number(_CLOSE * edge)} mm across, from {view.name}", 0.12 * _HEIGHT)


def model_figures(surfaces: Sequence[Shown], colours: Sequence[Colour]) -> str:
    """Return pictures of all given tissues from three sides."""
    meshes = [surface.mesh for surface in surfaces]
    made = []
    for view in (FRONT, LEFT, BACK):
        drawn = model_picture(meshes, colours, view, _MODEL_WIDTH, _MODEL_HEIGHT)
        made.append(
            f'<figure class="model">{_svg(drawn, [], view.name, 0)}<figcaption>{view.name}</figcaption></figure>'
        )
    return "".join(made)


def _svg(drawn: Portrait, marks: Sequence[Mark], label: str, radius: float) -> str:
    width, height = drawn.frame.width, drawn.frame.height
    parts = [
        f'<svg class="picture" viewBox="0 0 {width} {height}" role="img" aria-label="{words(label)}">'
        f'<image href="{data_uri(drawn.png)}" width="{width}" height="{height}"/>'
    ]
    taken: list[tuple[float, float]] = []
    for index, finding, place in marks:
        column, row, _ = drawn.frame.project(np.asarray(place["xyz_mm"], dtype=float)[None])[0]
        # Of rings that would lie on each other, the first stands for all.
        if any(abs(column - x) + abs(row - y) < 0.5 * radius for x, y in taken):
            continue
        taken.append((column, row))
        hidden = " hidden" if drawn.is_hidden(place["xyz_mm"]) else ""
        parts.append(
            f'<circle class="ring {finding["level"]}{hidden}" cx="{column:.1f}" cy="{row:.1f}" r="{radius:g}" '
            f'data-finding="{index}"><title>{words(rule_name(finding["rule"]))}: {words(headline(finding))} '
            f"{words(place_words(place))}</title></circle>"
        )
    return "".join([*parts, "</svg>"])


def _marked_faces(surface: Shown, marks: Sequence[Mark]) -> NDArray[np.int64]:
    faces = (surface.face(place["face"]) for _, _, place in marks)
    return np.array(list(dict.fromkeys(face for face in faces if face is not None)), dtype=np.int64)
