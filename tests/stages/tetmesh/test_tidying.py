"""Crumbs and non-manifold edges of labels."""

from __future__ import annotations

import numpy as np
import pytest
from shapes import box, flipped, joined, sphere
from tetrahedron_grids import grid

from vhp_cli.inspection.adjacency import adjacency, connected_parts, interfaces
from vhp_cli.kernels import surface
from vhp_cli.stages.tetmesh.components import components_of
from vhp_cli.stages.tetmesh.tidying import tidy
from vhp_cli.stages.tetmesh.tissues import Tissue
from vhp_cli.volume import VolumeMesh

POINTS, TETRAHEDRA = grid(8, 8.0)
CENTROIDS = POINTS[TETRAHEDRA].mean(axis=1)


def cells(*corners):
    """Tell which tetrahedra lie in any of some cells of the grid."""
    cell = np.floor(CENTROIDS).astype(int)
    return np.any([(cell == corner).all(axis=1) for corner in corners], axis=0)


def labelled(labels, names=("body", "organ")):
    return VolumeMesh(POINTS, TETRAHEDRA, np.asarray(labels, np.int32), names)


def components(*meshes):
    return components_of([Tissue(str(number), mesh, 1.0) for number, mesh in enumerate(meshes)])


WHOLE = components(box((0, 0, 0), (8, 8, 8)), box((3, 3, 3), (5, 5, 5)))


def organ():
    return np.where(((CENTROIDS > 3) & (CENTROIDS < 5)).all(axis=1), 2, 1)


def test_a_crumb_goes_to_the_neighbour_with_the_largest_common_area():
    labels = organ()
    labels[cells((0, 0, 0))] = 2
    labels[cells((7, 7, 7))] = 0
    done = tidy(labelled(labels), WHOLE, 20)
    assert (done.mesh.labels == organ()).all()
    assert done.crumbs == 12 and done.fans == 0
    assert (tidy(labelled(labels), WHOLE, 6).mesh.labels == labels).all()


def test_crumbs_within_crumbs():
    labels = organ()
    labels[cells((0, 0, 0), (1, 0, 0), (0, 1, 0))] = 2
    labels[np.flatnonzero(cells((0, 0, 0)))[:2]] = 0
    assert (tidy(labelled(labels), WHOLE, 40).mesh.labels == organ()).all()


def test_the_only_region_of_a_tissue_stays():
    labels = np.where(cells((0, 0, 0)), 2, 1)
    assert (tidy(labelled(labels), WHOLE, 1000).mesh.labels == labels).all()


def test_small_parts_that_the_input_has_stay():
    labels = np.where(cells((1, 1, 1), (6, 6, 6), (6, 6, 7)), 2, 1)
    body, small, large = box((0, 0, 0), (8, 8, 8)), box((1, 1, 1), (2, 2, 2)), box((6, 6, 6), (7, 7, 8))
    assert (tidy(labelled(labels), components(body, joined(small, large)), 20).mesh.labels == labels).all()
    # Without the smaller box there is no reason for what lies there.
    done = tidy(labelled(labels), components(body, large), 20)
    assert (done.mesh.labels[cells((1, 1, 1))] == 1).all() and (done.mesh.labels[cells((6, 6, 6))] == 2).all()


def test_a_cavity_of_air_stays():
    labels = np.where(cells((4, 4, 4)), 0, 1)
    hollow = components(joined(box((0, 0, 0), (8, 8, 8)), flipped(box((4, 4, 4), (5, 5, 5)))))
    assert (tidy(labelled(labels), hollow, 20).mesh.labels == labels).all()
    filled = tidy(labelled(labels), hollow[:1], 20).mesh.labels
    assert (filled == 1).all()


def faults(mesh, label):
    boundary = interfaces(adjacency(mesh.tetrahedra), mesh.labels).boundary(label)
    return surface.topology(mesh.points, boundary).nonmanifold_edges


def test_blocks_that_touch_along_an_edge_are_parted_or_joined():
    """Two cubes of an organ with a common edge of two cells, and a fan of one cell's tetrahedra at it."""
    large = ((CENTROIDS > 1) & (CENTROIDS < 4)).all(axis=1)
    labels = np.where(large, 2, 1)
    # Along the edge x = y = 4, one cell diagonally beside the block; with more behind it, so that it is no crumb.
    labels[cells((4, 4, 2), (5, 4, 2), (5, 5, 2), (4, 5, 2), (5, 4, 3), (5, 5, 3))] = 2
    mesh = labelled(labels)
    assert len(faults(mesh, 2))
    done = tidy(mesh, WHOLE, 20)
    assert done.fans > 0
    assert not len(faults(done.mesh, 2)) and not len(faults(done.mesh, 1))
    changed = done.mesh.labels != labels
    # Only around that edge.
    assert changed.sum() < 40
    assert (np.abs(CENTROIDS[changed, :2] - 4) < 1).all()


def test_everything_stays_where_nothing_is_wrong():
    done = tidy(labelled(organ()), WHOLE, 20)
    assert (done.mesh.labels == organ()).all() and done.crumbs == done.fans == 0
    assert not len(faults(done.mesh, 2))


@pytest.mark.parametrize("seed", range(3))
def test_no_tissue_is_ever_lost_and_crumbs_are_gone(seed):
    """Labels at random are mostly crumbs."""
    rng = np.random.default_rng(seed)
    labels = organ()
    noise = rng.random(len(labels)) < 0.15
    labels[noise] = rng.integers(0, 4, noise.sum())
    mesh = VolumeMesh(POINTS, TETRAHEDRA, labels.astype(np.int32), ("body", "organ", "nerve"))
    done = tidy(mesh, [*WHOLE, *components(sphere(1, (50, 0, 0)))], 20).mesh
    assert set(done.labels) >= {1, 2, 3}
    found = adjacency(done.tetrahedra)
    same = done.labels[found.pairs[:, 0]] == done.labels[found.pairs[:, 1]]
    region = connected_parts(len(labels), found.pairs[same])
    sizes = np.bincount(region)
    # Only the nerve, which the input has nowhere here, may be small.
    assert (sizes < 20).sum() <= 1
    assert (tidy(mesh, [*WHOLE, *components(sphere(1, (50, 0, 0)))], 20).mesh.labels == done.labels).all()
