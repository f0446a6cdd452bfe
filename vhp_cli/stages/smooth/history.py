"""What a smoothed surface is like after each iteration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vhp_cli.kernels import surface
from vhp_cli.measures import SmoothingStep
from vhp_cli.mesh import Mesh


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """A mesh on the way, and its entry in the history.

    Parameters
    ----------
    mesh
        The surface.
    entry
        What it is like.
    min_edge_mm
        Its shortest edge.
    excess
        How much the surface turns too sharply: the squares of the angles beyond the limit, times the lengths of the
        edges.
    """

    mesh: Mesh
    entry: SmoothingStep
    min_edge_mm: float
    excess: float = 0.0

    @property
    def min_quality(self) -> float:
        """Smallest q of a triangle."""
        return self.entry["min_q"]

    @property
    def mean_quality(self) -> float:
        """Mean q of the triangles."""
        return self.entry["mean_q"]


def measured(
    mesh: Mesh,
    step: str,
    iteration: int,
    *,
    flips: int = 0,
    moves: int = 0,
    held: int = 0,
    sharp_deg: float | None = None,
) -> State:
    """Measure a mesh.

    Parameters
    ----------
    mesh
        At least one face.
    step, iteration, flips, moves, held
        As of `SmoothingStep`.
    sharp_deg
        Angle beyond which the surface turns too sharply at an edge; None: nowhere.
    """
    joined = surface.topology(mesh.vertices, mesh.faces)
    found = surface.quality(mesh.vertices, mesh.faces, joined.component, joined.n_components)
    turns = 180.0 - surface.dihedral_angles(mesh.vertices, mesh.faces, joined.inner_edges, joined.inner_edge_faces)
    excess = 0.0
    if sharp_deg is not None:
        ends = mesh.vertices[joined.inner_edges]
        lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        excess = float(np.maximum(np.nan_to_num(turns) - sharp_deg, 0.0) ** 2 @ lengths)
    known = turns[np.isfinite(turns)]
    entry: SmoothingStep = {
        "iteration": iteration,
        "step": step,
        "min_q": float(found.q.min()),
        "mean_q": float(found.q.mean()),
        "volume_mm3": found.volume,
        "max_turn_deg": float(known.max()) if len(known) else None,
        "flips": flips,
        "moves": moves,
        "held": held,
    }
    return State(mesh, entry, joined.edge_length_min, excess)
