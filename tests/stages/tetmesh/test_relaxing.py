"""Bad tetrahedra made better by moving their corners."""

from __future__ import annotations

import numpy as np
from tetrahedron_grids import grid

from vhp_cli.inspection.adjacency import adjacency, interfaces
from vhp_cli.inspection.tetrahedra import tetrahedron_quality
from vhp_cli.stages.tetmesh.relaxing import Floor, relax
from vhp_cli.volume import VolumeMesh, volumes

TARGET = Floor(14.0, 0.4)


def uneven(scale, label=lambda centroids: np.ones(len(centroids)), names=("body", "organ"), seed=0):
    """Return a grid of which all points but those of the hull have been moved at random."""
    points, tetrahedra = grid(6, 6.0)
    labels = label(points[tetrahedra].mean(axis=1)).astype(np.int32)
    inner = np.setdiff1d(np.arange(len(points)), adjacency(tetrahedra).hull)
    moved = points.copy()
    moved[inner] += np.random.default_rng(seed).uniform(-scale, scale, (len(inner), 3))
    return VolumeMesh(moved, tetrahedra, labels, names), points


def short_of(mesh, target=TARGET):
    quality = tetrahedron_quality(mesh.points, mesh.tetrahedra)
    return (quality.min_dihedral_deg < target.min_dihedral_deg) | (quality.radius_ratio < target.radius_ratio), quality


def everything(mesh):
    return np.ones(len(mesh.tetrahedra), np.bool_)


def test_nearly_all_reach_the_target():
    mesh, _ = uneven(0.3)
    before, was = short_of(mesh)
    relaxed = relax(mesh, everything(mesh), TARGET, 0.1)
    after, quality = short_of(relaxed)
    assert before.sum() > 100 and after.sum() < 0.05 * before.sum()
    assert quality.min_dihedral_deg.min() > was.min_dihedral_deg.min()
    assert quality.radius_ratio.min() > was.radius_ratio.min()
    assert volumes(relaxed.points, relaxed.tetrahedra).min() > 0
    hull = np.unique(adjacency(mesh.tetrahedra).hull)
    assert (relaxed.points[hull] == mesh.points[hull]).all()


def test_the_worst_never_gets_worse():
    """Also where it goes as far as to inverted tetrahedra, which stay so."""
    for seed in range(3):
        mesh, _ = uneven(0.75, seed=seed)
        _, was = short_of(mesh)
        assert was.volume.min() < 0
        _, quality = short_of(relax(mesh, everything(mesh), TARGET, 0.1))
        assert (quality.volume <= 0).sum() <= (was.volume <= 0).sum()
        sound = was.volume > 0
        assert quality.min_dihedral_deg[sound].min() >= was.min_dihedral_deg[sound].min()
        assert quality.radius_ratio[sound].min() >= was.radius_ratio[sound].min()


def test_what_meets_the_target_stays():
    mesh, _ = uneven(0.05)
    assert not short_of(mesh)[0].any()
    assert (relax(mesh, everything(mesh), TARGET, 0.1).points == mesh.points).all()
    # What will be cut off need not meet it.
    mesh, _ = uneven(0.3)
    assert (relax(mesh, ~everything(mesh), TARGET, 0.1).points == mesh.points).mean() > 0.9


def test_interfaces_keep_their_plane():
    """The points on the plane between two labels are moved within it, so that the volumes stay."""
    mesh, even = uneven(0.3, lambda centroids: np.where(centroids[:, 0] < 3, 1, 2))
    points = mesh.points.copy()
    on_plane = even[:, 0] == 3
    points[on_plane, 0] = 3
    mesh = VolumeMesh(points, mesh.tetrahedra, mesh.labels, mesh.names)
    relaxed = relax(mesh, everything(mesh), TARGET, 0.0)
    assert (relaxed.points[on_plane] != points[on_plane]).any()
    assert np.abs(relaxed.points[on_plane, 0] - 3).max() < 1e-12
    assert short_of(relaxed)[0].sum() < 0.1 * short_of(mesh)[0].sum()


def test_points_at_edges_are_on_a_leash():
    inner = lambda centroids: np.where((np.abs(centroids - 3) < 1).all(axis=1), 2, 1)  # noqa: E731
    mesh, even = uneven(0.3, inner)
    points = mesh.points.copy()
    surface = (np.abs(even - 3) < 1.1).all(axis=1) & (np.abs(np.abs(even - 3).max(axis=1) - 1) < 0.1)
    points[surface] = even[surface]
    mesh = VolumeMesh(points, mesh.tetrahedra, mesh.labels, mesh.names)
    edges = np.isclose(np.abs(even - 3), 1).sum(axis=1) >= 2
    edges &= (np.abs(even - 3) < 1.1).all(axis=1)
    assert edges.sum() == 20
    for leash in (0.0, 0.05):
        moved = np.linalg.norm(relax(mesh, everything(mesh), Floor(35.0, 0.7), leash).points - mesh.points, axis=1)[
            edges
        ]
        assert moved.max() <= leash + 1e-12 and (moved > 0).any() == (leash > 0)
    between = interfaces(adjacency(mesh.tetrahedra), mesh.labels)
    assert len(between.boundary(2)) == 6 * 4 * 2
