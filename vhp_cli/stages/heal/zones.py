"""Zones: the places where a surface crosses or touches itself, each with all that is caught in it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vhp_cli.kernels.spatial import Hits, Tree
from vhp_cli.mesh import Mesh
from vhp_cli.rounding import spacing

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Mask = NDArray[np.bool_]

_MOST_PAIRS = 200_000
# Rings of vertices by which a zone is widened: within them its repair may move vertices. Zones that then meet are one.
_MARGIN = 3
_MOST_RINGS = 100
# Where a vertex is asked for its winding number: this share of its mean edge in front of it, at least so many
# spacings of float32.
_AHEAD = 1e-3
_AHEAD_ULPS = 4


@dataclass(frozen=True, slots=True, eq=False)
class Zones:
    """The places where a surface meets itself.

    Parameters
    ----------
    count
        Number of zones.
    labels : (V,) int32
        Zone of each vertex, -1 for none; those of a zone reach some rings beyond what is wrong.
    core : (V,) bool
        True for vertices of faces that meet others, and for those on the wrong side of another part of the surface.
    """

    count: int
    labels: Ints
    core: Mask


def edges_of(faces: Ints) -> Ints:
    """Return the undirected edges of a mesh (E, 2), lower vertex first, in ascending order."""
    ends = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1).astype(np.int64)
    width = int(faces.max(initial=0)) + 1
    keys = np.unique(ends[:, 0] * width + ends[:, 1])
    return np.stack([keys // width, keys % width], axis=1).astype(np.int32)


def grown(mask: Mask, edges: Ints, rings: int = 1) -> Mask:
    """Return vertices and their neighbours up to so many rings."""
    found = mask.copy()
    for _ in range(rings):
        touched = edges[found[edges].any(axis=1)]
        found[touched] = True
    return found


def connected(n: int, links: NDArray[np.integer]) -> NDArray[np.int64]:
    """Return for each of n things the lowest one that links (L, 2) connect it to."""
    labels = np.arange(n)
    while True:
        ends = labels[links]
        low = ends.min(axis=1)
        fresh = labels.copy()
        np.minimum.at(fresh, ends[:, 0], low)
        np.minimum.at(fresh, ends[:, 1], low)
        while not np.array_equal(fresh, fresh[fresh]):
            fresh = fresh[fresh]
        if np.array_equal(fresh, labels):
            return labels
        labels = fresh


def normals_at(vertices: Floats, faces: Ints) -> Floats:
    """Return the unit normal of each vertex (V, 3), the mean of its faces' weighted by their angles there.

    Baerentzen & Aanaes 2005, Signed distance computation using the angle weighted pseudonormal. Zero for a vertex
    without one.
    """
    corners = vertices[faces]
    edges = np.roll(corners, -1, axis=1) - corners
    lengths = np.linalg.norm(edges, axis=2)
    normal = np.cross(edges[:, 0], edges[:, 1])
    size = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.divide(normal, size, out=np.zeros_like(normal), where=size > 0)
    total = np.zeros_like(vertices)
    for k in range(3):
        product = lengths[:, k] * lengths[:, k - 1]
        cosine = -np.einsum("ij,ij->i", edges[:, k], edges[:, k - 1])
        cosine = np.divide(cosine, product, out=np.ones_like(cosine), where=product > 0)
        angle = np.arccos(np.clip(cosine, -1, 1))[:, None]
        for d in range(3):
            total[:, d] += np.bincount(faces[:, k], (angle * normal)[:, d], minlength=len(vertices))
    size = np.linalg.norm(total, axis=1)
    total[size > 0] /= size[size > 0, None]
    return total


def mean_edge_lengths(vertices: Floats, edges: Ints) -> Floats:
    """Return the mean length of the edges at each vertex in mm (V,); 0 where there are none."""
    lengths = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    total, number = np.zeros(len(vertices)), np.zeros(len(vertices))
    for k in range(2):
        total += np.bincount(edges[:, k], lengths, minlength=len(vertices))
        number += np.bincount(edges[:, k], minlength=len(vertices))
    total[number > 0] /= number[number > 0]
    return total


def winding_ahead(
    trees: Iterable[Tree], vertices: Floats, normals: Floats, lengths: Floats, chosen: NDArray[np.intp]
) -> Ints:
    """Return the winding number just in front of vertices, rounded.

    0 is right; 1: within material of another part, which overlaps; -1: in a pocket that is turned inside out, as
    where the two sides of a wall have passed through each other.

    Parameters
    ----------
    trees
        The surface, all of it or its parts.
    vertices, normals, lengths
        Position, normal and mean edge length of all vertices.
    chosen
        The vertices asked for.
    """
    least = _AHEAD_ULPS * spacing(vertices)
    ahead = np.maximum(_AHEAD * lengths[chosen], least)[:, None]
    points = vertices[chosen] + ahead * normals[chosen]
    return np.rint(sum(tree.winding(points, accuracy=3.0) for tree in trees)).astype(np.int32)


def all_hits(tree: Tree) -> Hits:
    """Return the pairs of faces that meet."""
    return tree.self_hits(_MOST_PAIRS)


def find_zones(mesh: Mesh) -> Zones:
    """Find the zones of a closed, consistently oriented mesh.

    A zone starts from faces that meet others, grows over all vertices from which no way within the surface leads
    back to the right side but across such faces, and takes in the zones it runs into.
    """
    vertices, faces = mesh.vertices, mesh.faces
    tree = Tree(vertices, faces)
    pairs = all_hits(tree).pairs
    edges = edges_of(faces)
    hit = np.zeros(len(vertices), np.bool_)
    hit[faces[pairs]] = True
    core = hit | _wrong_side(tree, vertices, faces, edges, hit)
    near = grown(core, edges, _MARGIN)
    inside = edges[near[edges].all(axis=1)]
    links = np.concatenate([inside, faces[pairs][:, :, 0]]) if len(pairs) else inside
    label = connected(len(vertices), links)
    _, numbers = np.unique(label[near], return_inverse=True)
    labels = np.full(len(vertices), -1, np.int32)
    labels[near] = numbers
    return Zones(int(numbers.max(initial=-1)) + 1, labels, core)


def _wrong_side(tree: Tree, vertices: Floats, faces: Ints, edges: Ints, hit: Mask) -> Mask:
    normals, lengths = normals_at(vertices, faces), mean_edge_lengths(vertices, edges)
    wrong = np.zeros(len(vertices), np.bool_)
    known = hit.copy()
    fresh = np.flatnonzero(hit)
    for _ in range(_MOST_RINGS):
        if not len(fresh):
            break
        wrong[fresh] = winding_ahead((tree,), vertices, normals, lengths, fresh) != 0
        frontier = grown(wrong, edges) & ~known
        known |= frontier
        fresh = np.flatnonzero(frontier)
    return wrong


def zones_hit(labels: Ints, faces: Ints, pairs: Ints, count: int) -> Mask:
    """Tell for each zone whether any of its faces still meets another (count,)."""
    found = np.zeros(count + 1, np.bool_)
    found[labels[faces[pairs]]] = True  # those without a zone count in the last place
    return found[:count]
