"""Bad tetrahedra made better by moving their corners and by swaps."""

from __future__ import annotations

import numpy as np
import pytest
from tetrahedron_grids import grid

from vhp_cli.inspection.adjacency import adjacency, interfaces
from vhp_cli.inspection.tetrahedra import tetrahedron_quality
from vhp_cli.stages.tetmesh.relaxing import Floor, Parted, regions_of, relax
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


def relaxed_mesh(mesh, target=TARGET, leash=0.1, *, kept=True, regions=None, **options):
    """Return a mesh relaxed; ``kept`` is the same for all tetrahedra."""
    parted = Parted(
        mesh, np.full(len(mesh.tetrahedra), kept), mesh.labels if regions is None else regions.astype(np.int32)
    )
    return relax(parted, target, leash, **options).mesh


def share_of(quality, target=TARGET):
    share = np.minimum(quality.min_dihedral_deg / target.min_dihedral_deg, quality.radius_ratio / target.radius_ratio)
    return np.where(quality.volume > 0, share, -1.0)


def test_all_reach_the_target():
    mesh, _ = uneven(0.3)
    before, was = short_of(mesh)
    relaxed = relaxed_mesh(mesh)
    after, quality = short_of(relaxed)
    assert before.sum() > 100 and not after.any()
    assert quality.min_dihedral_deg.min() > was.min_dihedral_deg.min()
    assert quality.radius_ratio.min() > was.radius_ratio.min()
    hull = np.unique(adjacency(mesh.tetrahedra).hull)
    assert (relaxed.points[hull] == mesh.points[hull]).all()


def test_the_same_space_is_filled_without_gaps_or_overlaps():
    mesh, _ = uneven(0.35, lambda centroids: np.where(centroids[:, 0] < 3, 1, 2))
    relaxed = relaxed_mesh(mesh, leash=0.0)
    assert len(relaxed.tetrahedra) != len(mesh.tetrahedra)
    joined = adjacency(relaxed.tetrahedra)
    assert joined.overfull == 0 and not len(joined.folded)
    # All have a positive volume, and together they have that of the cube: nothing overlaps.
    sizes = volumes(relaxed.points, relaxed.tetrahedra)
    assert sizes.min() > 0
    assert sizes.sum() == pytest.approx(216)
    assert {tuple(sorted(face)) for face in joined.hull} == {tuple(sorted(f)) for f in adjacency(mesh.tetrahedra).hull}


@pytest.mark.parametrize("seed", range(3))
def test_the_worst_never_gets_worse(seed):
    """Also where it goes as far as to inverted tetrahedra, which stay so or get better."""
    mesh, _ = uneven(0.75, seed=seed)
    _, was = short_of(mesh)
    assert was.volume.min() < 0
    _, quality = short_of(relaxed_mesh(mesh))
    assert (quality.volume <= 0).sum() < (was.volume <= 0).sum()
    mesh, _ = uneven(0.45, seed=seed)
    _, was = short_of(mesh)
    _, quality = short_of(relaxed_mesh(mesh))
    assert share_of(quality).min() >= share_of(was).min()
    assert np.sort(share_of(quality))[20] > np.sort(share_of(was))[20]


def test_what_meets_the_target_stays():
    mesh, _ = uneven(0.05)
    assert not short_of(mesh)[0].any()
    relaxed = relaxed_mesh(mesh)
    assert (relaxed.points == mesh.points).all() and (relaxed.tetrahedra == mesh.tetrahedra).all()
    # What will be cut off need not meet it.
    mesh, _ = uneven(0.3)
    assert (relaxed_mesh(mesh, kept=False).points == mesh.points).mean() > 0.9


def test_interfaces_keep_their_plane():
    """The points on the plane between two labels are moved within it, so that the volumes stay."""
    mesh, even = uneven(0.3, lambda centroids: np.where(centroids[:, 0] < 3, 1, 2))
    points = mesh.points.copy()
    on_plane = even[:, 0] == 3
    points[on_plane, 0] = 3
    mesh = VolumeMesh(points, mesh.tetrahedra, mesh.labels, mesh.names)
    relaxed = relaxed_mesh(mesh, leash=1e-9)
    assert (relaxed.points[on_plane] != points[on_plane]).any()
    assert np.abs(relaxed.points[on_plane, 0] - 3).max() < 1e-8
    assert not short_of(relaxed)[0].any()
    sizes = volumes(relaxed.points, relaxed.tetrahedra)
    assert [sizes[relaxed.labels == label].sum() for label in (1, 2)] == pytest.approx([108, 108])
    # With inner tetrahedra alone, none of these points moves, and the triangles between them stay.
    inner = relaxed_mesh(mesh, inner_only=True)
    assert (inner.points[on_plane] == points[on_plane]).all() and (inner.points != mesh.points).any()
    kept = [interfaces(adjacency(each.tetrahedra), each.labels).boundary(1) for each in (mesh, inner)]
    assert len({frozenset(map(int, face)) for face in kept[0]} ^ {frozenset(map(int, face)) for face in kept[1]}) == 0


def test_regions_are_not_mixed():
    """Tetrahedra of one label that a surface parts are swapped on their own side of it only."""
    mesh, _ = uneven(0.35)
    within = [np.flatnonzero(mesh.points[mesh.tetrahedra].mean(axis=1)[:, 2] < 3).astype(np.int32)]
    regions = regions_of(mesh.labels, within)
    assert sorted(np.unique(regions)) == [0, 1] and (regions[within[0]] == regions[within[0][0]]).all()
    parted = Parted(mesh, np.ones(len(regions), np.bool_), regions)
    made = relax(parted, TARGET, 0.1)
    assert set(np.unique(made.regions)) == {0, 1} and (made.mesh.labels == 1).all()
    wall = [interfaces(adjacency(each.tetrahedra), labels).boundary(1) for each, labels in (
        (mesh, regions), (made.mesh, made.regions))]  # fmt: skip
    assert {frozenset(map(int, face)) for face in wall[0]} == {frozenset(map(int, face)) for face in wall[1]}


def test_many_surfaces_part_regions():
    rng = np.random.default_rng(0)
    within = [np.flatnonzero(rng.integers(0, 2, 50)).astype(np.int32) for _ in range(100)]
    assert len(np.unique(regions_of(np.zeros(50, np.int32), within))) == 50
    within = [np.arange(10, dtype=np.int32), np.arange(5, 15, dtype=np.int32)]
    assert len(np.unique(regions_of(np.zeros(20, np.int32), within))) == 4


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
        relaxed = relaxed_mesh(mesh, Floor(35.0, 0.7), leash)
        moved = np.linalg.norm(relaxed.points - mesh.points, axis=1)[edges]
        assert moved.max() <= leash + 1e-12 and (moved > 0).any() == (leash > 0)
    between = interfaces(adjacency(mesh.tetrahedra), mesh.labels)
    assert len(between.boundary(2)) == 6 * 4 * 2
