"""Move every vertex of a surface inward, so that its faces get as deep as asked; the triangulation stays.

This fails where the body is too thin, or where inward ways meet: there the surface stays, with a gentle ramp around,
and what is too shallow is told, to be cut.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vhp_cli.kernels import surface
from vhp_cli.kernels.spatial import Tree
from vhp_cli.mesh import Mesh
from vhp_cli.rounding import rounded
from vhp_cli.stages.shells.layer import Layer
from vhp_cli.stages.shells.projections import projected
from vhp_cli.stages.shells.thickness import gentle

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]

# A vertex goes at most so many times its depth: sharp spikes would reach far into the body.
_LONGEST = 2.5
# Depths beyond so many thicknesses are not told apart.
_FAR = 2.0
# What is too shallow between vertices is asked of these on top, so many times over.
_CORRECTIONS, _MORE = 2, 1.1
# Faces turn by at most 60 degrees.
_LEAST_TURN_COSINE = 0.5
# Where a mitre is deeper than allowed, it ends at this part of it.
_CAP = 0.8
# What is not deeper by this part of the share counts as too shallow.
_LEAST_SHARE = 0.3
# Most contacts of a moved surface that are listed at once.
_LISTED = 200_000


class Displaced(NamedTuple):
    """A moved surface without self-intersections, and the faces (F,) of it that are too shallow."""

    mesh: Mesh
    shallow: Mask


def displaced(layer: Layer, *, share: float, loose: float) -> Displaced:
    """Move the vertices of the outer surface of a layer to its inner side.

    Parameters
    ----------
    layer
        The layer.
    share
        Share of its thickness by which vertices go deeper than asked.
    loose
        Share of its thickness by which they may end up deeper.
    """
    outer = layer.outer
    fans = _Fans(outer)
    asked = (1 + share) * layer.thickness
    joined = surface.topology(outer.vertices, outer.faces)
    samples = _Samples(outer, joined)
    ways = fans.mitred(asked)
    for _ in range(_CORRECTIONS):
        shallow = samples.shallow(layer, outer.vertices + ways, share)
        if not shallow.any():
            break
        asked = np.minimum(asked + _MORE * shallow, (1 + loose) * layer.thickness)
        ways = fans.mitred(asked)
    for _ in range(_CORRECTIONS):
        found, wanted = layer.distances(outer.vertices + ways, _FAR * layer.most)
        most = (1 + _CAP * loose) * wanted
        ways *= np.where(found > most, most / np.maximum(found, most), 1.0)[:, None]
    stays = samples.too_deep(layer, outer.vertices + ways, loose)
    normals = fans.normals
    whole = np.where(stays, 0.0, layer.thickness)
    while True:
        part = np.minimum(gentle(outer, whole) / layer.thickness, 1.0)
        vertices = np.where((part > 0)[:, None], rounded(outer.vertices + part[:, None] * ways), outer.vertices)
        bad = _turned(vertices, outer.faces, normals)
        if not bad.any():
            pairs = Tree(vertices, outer.faces).self_hits(_LISTED).pairs
            bad[pairs.ravel()] = True
        corners = np.unique(outer.faces[bad])
        corners = corners[whole[corners] > 0]
        if not len(corners):
            break
        whole[corners] = 0.0
    return Displaced(Mesh(vertices, outer.faces), samples.shallow_faces(layer, vertices, _LEAST_SHARE * share))


class _Fans:
    """The faces around each vertex."""

    def __init__(self, mesh: Mesh) -> None:
        corners = mesh.vertices[mesh.faces]
        crossed = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        lengths = np.linalg.norm(crossed, axis=1, keepdims=True)
        self.normals = crossed / np.where(lengths > 0, lengths, 1.0)
        flat = mesh.faces.ravel()
        order = np.argsort(flat, kind="stable")
        self._own = flat[order].astype(np.int64)
        self._inward = -self.normals[order // 3]
        weighted = self._inward * _angles(corners).ravel()[order, None]
        sums = np.stack([np.bincount(self._own, column, len(mesh.vertices)) for column in weighted.T], axis=1)
        sizes = np.linalg.norm(sums, axis=1, keepdims=True)
        self._mean = sums / np.where(sizes > 0, sizes, 1.0)

    def mitred(self, depths: Floats) -> Floats:
        """Return short ways (V, 3) that bring the planes of all faces around each vertex to its depth (V,) at least."""
        ways = projected(depths[:, None] * self._mean, self._own, self._inward, depths[self._own])
        lengths = np.linalg.norm(ways, axis=1)
        capped: Floats = ways * np.minimum(1.0, _LONGEST * depths / np.maximum(lengths, 1e-300))[:, None]
        return capped


class _Samples:
    """Vertices, middles of edges and centres of faces."""

    def __init__(self, mesh: Mesh, joined: surface.Topology) -> None:
        self._faces = mesh.faces.astype(np.int64)
        self._edges, self._edge_faces = joined.inner_edges.astype(np.int64), joined.inner_edge_faces
        self._count = len(mesh.vertices)

    def _points(self, vertices: Floats) -> Floats:
        return np.concatenate([vertices, vertices[self._edges].mean(axis=1), vertices[self._faces].mean(axis=1)])

    def _at_vertices(self, values: Floats) -> Floats:
        """Return the largest value of the samples around each vertex."""
        found = values[: self._count].copy()
        at_edges, at_faces = np.split(values[self._count :], [len(self._edges)])
        for corner in range(2):
            np.maximum.at(found, self._edges[:, corner], at_edges)
        for corner in range(3):
            np.maximum.at(found, self._faces[:, corner], at_faces)
        return found

    def shallow(self, layer: Layer, vertices: Floats, share: float) -> Floats:
        """Return by how much points around each vertex are shallower than asked, in mm."""
        found, wanted = layer.distances(self._points(vertices), _FAR * layer.most)
        # Farther up than that, it is no matter of going a bit deeper.
        need = (1 + share) * wanted - found
        return self._at_vertices(np.where(need < 0.5 * wanted, np.maximum(need, 0.0), 0.0))

    def too_deep(self, layer: Layer, vertices: Floats, loose: float) -> Mask:
        """Tell which vertices have points around them that are too deep, or outside of the body."""
        found, wanted = layer.depths(self._points(vertices), _FAR * layer.most)
        return self._at_vertices(((found < 0) | (found > (1 + loose) * wanted)).astype(np.float64)) > 0

    def shallow_faces(self, layer: Layer, vertices: Floats, share: float) -> Mask:
        """Tell which faces have points that are too shallow."""
        found, wanted = layer.depths(self._points(vertices), _FAR * layer.most)
        shallow = found < (1 + share) * wanted
        at_vertices, at_edges, at_faces = np.split(shallow, [self._count, self._count + len(self._edges)])
        bad = at_faces | at_vertices[self._faces].any(axis=1)
        bad[self._edge_faces[at_edges].ravel()] = True
        return bad


def _angles(corners: Floats) -> Floats:
    """Return the angle of each corner of triangles (F, 3)."""
    following, preceding = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    angles: Floats = np.arctan2(
        np.linalg.norm(np.cross(following, preceding), axis=2), (following * preceding).sum(axis=2)
    )
    return angles


def _turned(vertices: Floats, faces: NDArray[np.int32], normals: Floats) -> Mask:
    corners = vertices[faces]
    crossed = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    turned: Mask = (crossed * normals).sum(axis=1) < _LEAST_TURN_COSINE * np.linalg.norm(crossed, axis=1)
    return turned
