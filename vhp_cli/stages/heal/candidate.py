"""Judge a mesh as it would be read back from the file: the measures of the gate, and what is wrong."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vhp_cli.inspection.tissue import ShapeLimits, inspect_tissue
from vhp_cli.kernels.reading import weld
from vhp_cli.kernels.surface import quality, topology
from vhp_cli.measures import TissueMeasures
from vhp_cli.mesh import Mesh
from vhp_cli.rounding import rounded

# Shapes are judged by the gate itself; here only the measures count.
_NO_LIMITS = ShapeLimits(quality=0.0, edge_mm=0.0, fold_deg=0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A mesh in its written form, and what the gate measures on it.

    Parameters
    ----------
    mesh
        Rounded coordinates, equal ones welded, no collapsed face: what a reader of the STL gets.
    measures
        As `vhp check` reports them.
    flaws
        What keeps it from being a solid, such as ``"12 open edges"``; empty if nothing does.
    """

    mesh: Mesh
    measures: TissueMeasures
    flaws: tuple[str, ...]

    @property
    def sound(self) -> bool:
        """Closed, 2-manifold, outward, free of self-intersections and of faces without area."""
        return not self.flaws

    @property
    def min_quality(self) -> float:
        """Smallest q = 2 r_in / r_out of a face (thesis eq. 2.4)."""
        return self.measures["quality"]["min"] if self.measures["quality"] else 0.0

    @property
    def mean_quality(self) -> float:
        """Mean q of the faces."""
        return self.measures["quality"]["mean"] if self.measures["quality"] else 0.0

    @property
    def min_edge(self) -> float:
        """Shortest edge in mm."""
        return self.measures["edge_mm"]["min"] if self.measures["edge_mm"] else 0.0


def as_written(mesh: Mesh) -> Mesh:
    """Return what a reader gets of a mesh after it was written as STL: float32 coordinates, equal ones welded.

    Faces that collapse on the way are left out.
    """
    corners = rounded(mesh.vertices)[mesh.faces].reshape(-1, 3)
    vertices, index = weld(corners)
    faces = index.reshape(-1, 3)
    collapsed = (faces == faces[:, [1, 2, 0]]).any(axis=1)
    return Mesh(vertices, faces[~collapsed])


def judge(mesh: Mesh, *, may_be_open: bool = False) -> Candidate:
    """Measure a mesh in its written form; open edges are no flaw if it may be open."""
    written = as_written(mesh)
    measures, _, _ = inspect_tissue(written, _NO_LIMITS)
    return Candidate(written, measures, tuple(_flaws(measures, may_be_open)))


def _flaws(measures: TissueMeasures, may_be_open: bool) -> list[str]:
    topology, hits = measures["topology"], measures["self_intersections"]
    counted = [
        (0 if may_be_open else topology["boundary_edges"], "open edge", "open edges"),
        (topology["nonmanifold_edges"], "non-manifold edge", "non-manifold edges"),
        (topology["nonmanifold_vertices"], "non-manifold vertex", "non-manifold vertices"),
        (topology["inconsistent_edges"], "inconsistently oriented edge", "inconsistently oriented edges"),
        (topology["duplicate_faces"], "duplicate face", "duplicate faces"),
        (topology["degenerate_faces"], "face without area", "faces without area"),
        (topology["inward_components"], "part turned inside out", "parts turned inside out"),
        (hits["pairs"], "pair of intersecting faces", "pairs of intersecting faces"),
    ]
    flaws = [f"{count} {one if count == 1 else many}" for count, one, many in counted if count]
    is_open = may_be_open and topology["boundary_edges"] > 0
    if not flaws and not measures["outward"] and not is_open:
        flaws.append("no volume" if measures["triangles"] else "no faces")
    return flaws


def face_areas(mesh: Mesh) -> NDArray[np.float64]:
    """Return the area of each face in mm2 (F,)."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    areas: NDArray[np.float64] = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    return areas


def face_quality(mesh: Mesh) -> NDArray[np.float64]:
    """Return q = 2 r_in / r_out of each face (F,) (thesis eq. 2.4)."""
    found = topology(mesh.vertices, mesh.faces)
    q: NDArray[np.float64] = quality(mesh.vertices, mesh.faces, found.component, found.n_components).q
    return q


def diagonal(mesh: Mesh) -> float:
    """Return the diagonal of the box around a mesh in mm."""
    if not len(mesh.vertices):
        return 0.0
    return float(np.linalg.norm(mesh.vertices.max(axis=0) - mesh.vertices.min(axis=0)))
