"""Shape of tetrahedra: radius ratio, dihedral angles, scaled Jacobian."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vhp_cli.kernels.tetrahedra import shape
from vhp_cli.volume import Points, Tetrahedra

Floats = NDArray[np.float64]

# The three corners opposite to each corner, counter-clockwise seen from outside of a positive tetrahedron.
FACES = np.array([(1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)])


@dataclass(frozen=True, slots=True, eq=False)
class TetrahedronQuality:
    """Measures of each tetrahedron.

    Parameters
    ----------
    volume : (M,) float64
        Signed, in mm3.
    radius_ratio : (M,) float64
        3 r_in / r_out: 1 for the regular tetrahedron, 0 for a flat one (Liu & Joe 1994, Relationship between
        tetrahedron shape measures).
    min_dihedral_deg, max_dihedral_deg : (M,) float64
        Smallest and largest angle between two faces; 70.53 for the regular tetrahedron.
    scaled_jacobian : (M,) float64
        sqrt(2) times the Jacobian over the product of the three edges that meet at a corner, the smallest of the
        four corners: 1 for the regular tetrahedron, negative for an inverted one (Knupp et al. 2006, The Verdict
        library reference manual).
    mean_edge_mm : (M,) float64
        Mean length of the six edges.
    """

    volume: Floats
    radius_ratio: Floats
    min_dihedral_deg: Floats
    max_dihedral_deg: Floats
    scaled_jacobian: Floats
    mean_edge_mm: Floats


def tetrahedron_quality(points: Points, tetrahedra: Tetrahedra) -> TetrahedronQuality:
    """Measure the shape of each tetrahedron.

    Parameters
    ----------
    points : (N, 3) float64
        Coordinates in mm.
    tetrahedra : (M, 4) int32
        Point indices.
    """
    return TetrahedronQuality(*shape(points, tetrahedra))
