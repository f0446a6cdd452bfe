"""Surfaces with fewer triangles for the mesher, which takes long to get rid of those it has no use for."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from vhp_cli.kernels.decimating import decimate
from vhp_cli.mesh import Mesh
from vhp_cli.stages.tetmesh.tissues import Tissue, without_flat_faces

# Of the envelope, what decimation may take; the mesher gets the rest.
SHARE = 0.25
# A surface is replaced only if so many of its triangles are left at most.
_WORTHWHILE = 0.7
_MIN_QUALITY = 0.1


def lightened(tissues: Sequence[Tissue], deviation_mm: float, *, threads: int = 1) -> list[Tissue]:
    """Return tissues with decimated surfaces, where these have many triangles to spare; for the mesher only.

    Parameters
    ----------
    tissues
        The tissues; rims of open surfaces stay.
    deviation_mm
        How far a surface may be off.
    threads
        How many to use; the result does not depend on it.
    """

    def lighter(tissue: Tissue) -> Tissue:
        mesh = without_flat_faces(tissue.mesh)
        if not len(mesh.faces) or deviation_mm <= 0:
            return tissue
        vertices = mesh.vertices.astype(np.float32).astype(np.float64)
        # Whether it touches itself does not matter to the mesher.
        made = decimate(
            vertices, mesh.faces, max_deviation=deviation_mm, min_quality=_MIN_QUALITY, check_contacts=False
        )
        if len(made.faces) > _WORTHWHILE * len(mesh.faces):
            return tissue
        return replace(tissue, mesh=Mesh(made.vertices, made.faces))

    with ThreadPoolExecutor(max(threads, 1)) as executor:
        return list(executor.map(lighter, tissues))
