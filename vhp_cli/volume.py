"""The tetrahedral mesh value: what a FEM solver computes on, each tetrahedron carrying its tissue."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

BACKGROUND = 0  # the label of what is in no tissue: air

Points = NDArray[np.float64]
Tetrahedra = NDArray[np.int32]
Labels = NDArray[np.int32]


@dataclass(frozen=True, slots=True, eq=False)
class VolumeMesh:
    """An immutable tetrahedral mesh with one label per tetrahedron.

    Parameters
    ----------
    points : (N, 3) float64
        Coordinates in mm.
    tetrahedra : (M, 4) int32
        Point indices of each tetrahedron, positively oriented: the fourth point lies on the side of the
        first three from which they run counter-clockwise, ``(b - a) x (c - a) . (d - a) > 0``
        (the order of VTK, Gmsh, Abaqus and Nastran). The orientation is measured (`volumes`), not refused:
        an inverted tetrahedron is a finding of the report.
    labels : (M,) int32
        Tissue of each tetrahedron: label ``k >= 1`` is the tissue ``names[k - 1]``; 0 is air, what lies
        outside of every tissue, where it was kept.
    names : tuple of str
        Name of each tissue, unique. A name may have no tetrahedra.

    Raises
    ------
    ValueError
        If a shape is wrong, a tetrahedron refers to a point that does not exist, a label has no name, or
        two names are the same.
    """

    points: Points
    tetrahedra: Tetrahedra
    labels: Labels
    names: tuple[str, ...]

    def __post_init__(self) -> None:
        points = np.ascontiguousarray(self.points, dtype=np.float64)
        tetrahedra = np.ascontiguousarray(self.tetrahedra, dtype=np.int32)
        labels = np.ascontiguousarray(self.labels, dtype=np.int32)
        names = tuple(self.names)
        if points.ndim != 2 or points.shape[1] != 3:
            raise ValueError(f"points must have shape (N, 3), not {points.shape}")
        if tetrahedra.ndim != 2 or tetrahedra.shape[1] != 4:
            raise ValueError(f"tetrahedra must have shape (M, 4), not {tetrahedra.shape}")
        if labels.shape != (len(tetrahedra),):
            raise ValueError(f"labels must have shape ({len(tetrahedra)},), not {labels.shape}")
        if len(tetrahedra) and (tetrahedra.min() < 0 or tetrahedra.max() >= len(points)):
            raise ValueError(f"tetrahedra refer to points outside 0..{len(points) - 1}")
        if len(labels) and (labels.min() < BACKGROUND or labels.max() > len(names)):
            raise ValueError(f"labels must lie in 0..{len(names)}, the number of names")
        if len(set(names)) != len(names):
            raise ValueError("names must be unique")
        # Views, so that read-only here does not freeze the caller's arrays.
        points, tetrahedra, labels = points.view(), tetrahedra.view(), labels.view()
        for array in (points, tetrahedra, labels):
            array.flags.writeable = False
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "tetrahedra", tetrahedra)
        object.__setattr__(self, "labels", labels)
        object.__setattr__(self, "names", names)


def volumes(points: Points, tetrahedra: Tetrahedra) -> NDArray[np.float64]:
    """Signed volumes of tetrahedra, a sixth of ``(b - a) x (c - a) . (d - a)``.

    Parameters
    ----------
    points : (N, 3) float64
        Coordinates in mm.
    tetrahedra : (M, 4) int32
        Point indices.

    Returns
    -------
    (M,) float64
        mm3; positive where the tetrahedron is positively oriented.
    """
    a, b, c, d = (points[tetrahedra[:, corner]] for corner in range(4))
    return np.asarray(np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) / 6.0)
