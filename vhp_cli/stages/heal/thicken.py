"""Make an open sheet a solid: its two sides, and a rim between them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vhp_cli.inspection.places import point
from vhp_cli.kernels.repairing import mates
from vhp_cli.measures import Action
from vhp_cli.mesh import Mesh
from vhp_cli.stages.heal.candidate import face_areas
from vhp_cli.stages.heal.clean import compact
from vhp_cli.stages.heal.zones import normals_at


def thicken(mesh: Mesh, sheet: NDArray[np.bool_], thickness_mm: float) -> tuple[Mesh, list[Action]]:
    """Replace a sheet by a solid plate about it.

    Parameters
    ----------
    mesh
        Manifold and oriented coherently.
    sheet : (F,) bool
        The faces to thicken: whole components.
    thickness_mm
        Of the plate; each side lies half of it away.
    """
    faces, count = mesh.faces[sheet], len(mesh.vertices)
    offset = thickness_mm / 2 * normals_at(mesh.vertices, faces)
    glued, _ = mates(faces, count)
    face, k = np.nonzero(glued < 0)
    start, end = faces[face, k], faces[face, (k + 1) % 3]
    # The second side has the numbers of the first, and `count` more.
    rims = [np.stack([end, start, start + count], axis=1), np.stack([end, start + count, end + count], axis=1)]
    plate = np.concatenate([faces, faces[:, ::-1] + count, *rims])
    action: Action = {
        "step": "thicken",
        "message": f"sheet made a plate of {thickness_mm:.3g} mm thickness",
        "count": len(faces),
        "places": [{"xyz_mm": point(mesh.vertices[faces].mean(axis=(0, 1))), "face": None, "value": thickness_mm}],
        "area_mm2": float(face_areas(mesh)[sheet].sum()),
    }
    vertices = np.concatenate([mesh.vertices + offset, mesh.vertices - offset])
    return compact(Mesh(vertices, np.concatenate([mesh.faces[~sheet], plate]))), [action]
