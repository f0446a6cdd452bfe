"""The phantom's rib cage with joints: vertebrae pressed on ribs, cartilages stuck into ribs and sternum."""

from __future__ import annotations

from functools import cache

import numpy as np
from breathing_tissues import phantom, tissues_of

from vhp_cli.kernels.spatial import gap
from vhp_cli.mesh import Mesh
from vhp_cli.stages.breathe.tissue import Tissue

PRESSED_MM, STUCK_MM = 0.5, 2.0


@cache
def joined_cage() -> dict[str, Mesh]:
    kept = ("lung", "rib", "vertebra", "sternum", "costal")
    model = {name: mesh for name, mesh in phantom().items() if name.startswith(kept)}
    tissues = {tissue.name: tissue for tissue in tissues_of(model)}
    for number in range(1, 13):
        name = f"vertebra_t{number:02d}"
        ribs = [tissues[f"rib_{side}_{number:02d}"] for side in ("left", "right")]
        model[name] = drawn(tissues[name], ribs, PRESSED_MM)
    for side in ("left", "right"):
        for number in range(1, 8):
            name = f"costal_cartilage_{side}_{number:02d}"
            bodies = [tissues[f"rib_{side}_{number:02d}"], tissues["sternum"]]
            model[name] = drawn(tissues[name], bodies, STUCK_MM)
        # The lower ones hang on each other by their ribs' ends; what these move by is not what is tested here.
        for number in range(8, 11):
            del model[f"costal_cartilage_{side}_{number:02d}"]
    return model


def drawn(tissue: Tissue, bodies: list[Tissue], depth_mm: float) -> Mesh:
    """Draw what of a tissue is nearest to each of some bodies into it."""
    vertices = tissue.mesh.vertices.copy()
    for body in bodies:
        nearest = gap(tissue.tree, body.tree)
        assert nearest is not None
        way = nearest.points[1] - nearest.points[0]
        step = way * (1.0 + depth_mm / nearest.distance)
        distance = np.linalg.norm(tissue.mesh.vertices - nearest.points[0], axis=1)
        vertices += np.clip(1.5 - distance / 12.0, 0.0, 1.0)[:, None] * step
    return Mesh(vertices.astype(np.float32).astype(float), tissue.mesh.faces)
