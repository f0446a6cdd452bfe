"""Shape of tetrahedra: radius ratio, dihedral angles, scaled Jacobian."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vhp_cli.volume import Points, Tetrahedra, volumes

Floats = NDArray[np.float64]

# The three corners opposite to each corner, counter-clockwise seen from outside of a positive tetrahedron.
FACES = np.array([(1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)])
EDGES = np.array([(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)])
# The edges that meet at each corner, by their rows in EDGES.
_EDGES_AT = np.array([(0, 1, 2), (0, 3, 4), (1, 3, 5), (2, 4, 5)])
# Tetrahedra measured at once, which bounds the memory.
_CHUNK = 100_000
_TINY = 1e-300


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
    parts = [
        _measured(points, tetrahedra[start : start + _CHUNK]) for start in range(0, max(len(tetrahedra), 1), _CHUNK)
    ]
    return TetrahedronQuality(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _measured(points: Points, tetrahedra: Tetrahedra) -> tuple[Floats, ...]:
    """Return the six columns of `TetrahedronQuality`."""
    corners = points[tetrahedra]
    volume = volumes(points, tetrahedra)
    edges = corners[:, EDGES[:, 1]] - corners[:, EDGES[:, 0]]
    lengths = np.sqrt(np.einsum("mei,mei->me", edges, edges))
    a, b, c = (corners[:, FACES[:, corner]] for corner in range(3))
    normals = np.cross(b - a, c - a)
    sizes = np.sqrt(np.einsum("mfi,mfi->mf", normals, normals))
    normals /= np.maximum(sizes, _TINY)[:, :, None]
    # The faces opposite to two corners meet at the edge between the two others.
    cosines = np.stack([-np.einsum("mi,mi->m", normals[:, i], normals[:, j]) for i, j in EDGES], axis=1)
    angles = np.degrees(np.arccos(np.clip(cosines, -1.0, 1.0)))
    r_in = 6 * np.abs(volume) / np.maximum(sizes.sum(axis=1), _TINY)
    # Products of opposite edges are the sides of a triangle, whose area gives the circumradius (Crelle).
    p, q, r = (lengths[:, i] * lengths[:, j] for i, j in ((0, 5), (1, 4), (2, 3)))
    heron = np.maximum((p + q + r) * (p + q - r) * (p - q + r) * (q + r - p), 0.0)
    # 3 r_in / r_out with r_out = sqrt(heron) / (24 V); no quotient of two vanishing numbers.
    radius_ratio = np.divide(
        72 * r_in * np.abs(volume), np.sqrt(heron), out=np.zeros_like(volume), where=(heron > 0) & (volume != 0)
    )
    at_corner = lengths[:, _EDGES_AT].prod(axis=2).max(axis=1)
    jacobian = np.divide(6 * np.sqrt(2.0) * volume, at_corner, out=np.zeros_like(volume), where=at_corner > 0)
    return volume, np.minimum(radius_ratio, 1.0), angles.min(axis=1), angles.max(axis=1), jacobian, lengths.mean(axis=1)
