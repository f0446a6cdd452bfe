"""Interfaces moved onto the surfaces."""

from __future__ import annotations

import numpy as np
import pytest
from shapes import sphere

from vhp_cli.inspection.tetrahedra import tetrahedron_quality
from vhp_cli.kernels.spatial import Tree
from vhp_cli.stages.tetmesh.fitting import fit_to_surfaces, match_volumes
from vhp_cli.stages.tetmesh.relaxing import Floor
from vhp_cli.volume import VolumeMesh, volumes

R_OUT, R_IN = 10.0, 5.0


def onion(shrink=1.0):
    """Return a ball within a ball, in layers of prisms that are cut into three tetrahedra each."""
    base = sphere(1.0, subdivisions=2)
    count = len(base.vertices)
    radii = np.array([2.5, R_IN * shrink, 7.5, R_OUT * shrink])
    points = np.concatenate(([[0.0, 0, 0]], *(base.vertices * radius for radius in radii)))
    a, b, c = np.sort(base.faces, axis=1).T + 1
    tetrahedra, labels = [np.column_stack((np.zeros_like(a), a, b, c))], [2]
    for layer, label in ((0, 2), (1, 1), (2, 1)):
        (low_a, low_b, low_c), (a1, b1, c1) = ([x + step * count for x in (a, b, c)] for step in (layer, layer + 1))
        for corners in ((low_a, low_b, low_c, c1), (low_a, low_b, c1, b1), (low_a, a1, b1, c1)):
            tetrahedra.append(np.column_stack(corners))
            labels.append(label)
    found = np.concatenate(tetrahedra).astype(np.int32)
    inverted = volumes(points, found) < 0
    found[inverted] = found[inverted][:, [0, 2, 1, 3]]
    return VolumeMesh(points, found, np.repeat(labels, len(base.faces)), ("shell", "core"))


TREES = [Tree(mesh.vertices, mesh.faces) for mesh in (sphere(R_OUT, subdivisions=5), sphere(R_IN, subdivisions=5))]
BALL = 4 / 3 * np.pi


def volume_of(mesh, label):
    return volumes(mesh.points, mesh.tetrahedra)[mesh.labels == label].sum()


def test_volumes_come_out_right():
    flat = onion(shrink=0.98)
    before = [volume_of(flat, 2) / (BALL * R_IN**3) - 1, volume_of(flat, 1) / (BALL * (R_OUT**3 - R_IN**3)) - 1]
    assert max(before) < -0.06
    fitted = fit_to_surfaces(flat, TREES, 0.6)
    assert volume_of(fitted, 2) == pytest.approx(BALL * R_IN**3, rel=3e-3)
    assert volume_of(fitted, 1) == pytest.approx(BALL * (R_OUT**3 - R_IN**3), rel=3e-3)
    # More than vertices on the surface can do: their facets lie within it.
    on_the_surface = onion()
    assert abs(volume_of(on_the_surface, 2) / (BALL * R_IN**3) - 1) > 5e-3


def test_nothing_else_changes():
    flat = onion(shrink=0.98)
    fitted = fit_to_surfaces(flat, TREES, 0.6)
    assert (fitted.tetrahedra == flat.tetrahedra).all() and (fitted.labels == flat.labels).all()
    moved = np.linalg.norm(fitted.points - flat.points, axis=1)
    reach = np.linalg.norm(flat.points, axis=1)
    at_interface = np.isclose(reach, 0.98 * R_IN) | np.isclose(reach, 0.98 * R_OUT)
    assert (moved[~at_interface] == 0).all() and (moved[at_interface] > 0).all()


def test_the_limit_holds():
    flat = onion(shrink=0.985)
    moved = np.linalg.norm(fit_to_surfaces(flat, TREES, 0.1).points - flat.points, axis=1)
    assert 0.09 < moved.max() <= 0.1 + 1e-12
    assert (fit_to_surfaces(flat, TREES, 0.0).points == flat.points).all()


@pytest.mark.parametrize("threads", [1, 3])
def test_no_tetrahedron_falls_below_the_floor(threads):
    """A mesh so uneven that moving it all the way would turn tetrahedra over."""
    flat = onion(shrink=0.9)
    rng = np.random.default_rng(1)
    uneven = VolumeMesh(
        flat.points + rng.normal(scale=0.25, size=flat.points.shape), flat.tetrahedra, flat.labels, flat.names
    )
    before = tetrahedron_quality(uneven.points, uneven.tetrahedra)
    floor = Floor(15.0, 0.4)
    fitted = fit_to_surfaces(uneven, TREES, 2.0, floor=floor, threads=threads)
    after = tetrahedron_quality(fitted.points, fitted.tetrahedra)
    assert (fitted.points != uneven.points).any()
    assert (after.min_dihedral_deg >= np.minimum(before.min_dihedral_deg, 15) - 1e-9).all()
    assert (after.radius_ratio >= np.minimum(before.radius_ratio, 0.4) - 1e-9).all()
    assert ((after.volume > 0) | (before.volume <= 0)).all()
    free = fit_to_surfaces(uneven, TREES, 2.0, floor=Floor(0.0, 0.0))
    assert tetrahedron_quality(free.points, free.tetrahedra).min_dihedral_deg.min() < after.min_dihedral_deg.min()


def test_what_is_cut_off_may_suffer_but_not_turn_over():
    flat = onion(shrink=0.9)
    kept = flat.labels == 2
    fitted = fit_to_surfaces(flat, TREES, 1.0, kept=kept, floor=Floor(40.0, 0.8))
    assert volumes(fitted.points, fitted.tetrahedra).min() > 0


CORE, SHELL = BALL * R_IN**3, BALL * R_OUT**3
GOALS = {frozenset((2,)): CORE, frozenset((1, 2)): SHELL}


def test_volumes_are_matched():
    flat = onion(shrink=0.99)
    assert abs(volume_of(flat, 2) / CORE - 1) > 0.03
    matched = match_volumes(flat, GOALS, 0.5)
    assert volume_of(matched, 2) == pytest.approx(CORE, rel=2e-4)
    assert volume_of(matched, 1) == pytest.approx(SHELL - CORE, rel=2e-4)
    # Along the normals, and nothing but the two surfaces.
    moved = np.linalg.norm(matched.points - flat.points, axis=1)
    reach = np.linalg.norm(flat.points, axis=1)
    at_interface = np.isclose(reach, 0.99 * R_IN) | np.isclose(reach, 0.99 * R_OUT)
    assert (moved[~at_interface] == 0).all()
    assert moved.max() < 2.1 * moved[moved > 0].min()
    # What is right stays to the last bit, and a tissue without a goal, too.
    assert (match_volumes(matched, GOALS, 0.5).points == matched.points).all()
    assert volume_of(match_volumes(flat, {frozenset((2,)): CORE}, 0.5), 1) != volume_of(flat, 1)
    assert (match_volumes(flat, {}, 0.5).points == flat.points).all()


def test_those_that_can_move_make_up_for_those_that_can_not():
    """A core of which one point stays, as its tetrahedra are bad already."""
    flat = onion(shrink=0.99)
    points = flat.points.copy()
    on_core = np.flatnonzero(np.isclose(np.linalg.norm(points, axis=1), 0.99 * R_IN))
    stuck = on_core[0]
    points[stuck] *= 1.45
    mesh = VolumeMesh(points, flat.tetrahedra, flat.labels, flat.names)
    floor = Floor(30.0, 0.6)
    before = tetrahedron_quality(mesh.points, mesh.tetrahedra)
    matched = match_volumes(mesh, {frozenset((2,)): CORE}, 0.5, floor=floor)
    assert volume_of(matched, 2) == pytest.approx(CORE, rel=1e-3)
    after = tetrahedron_quality(matched.points, matched.tetrahedra)
    assert (after.min_dihedral_deg >= np.minimum(before.min_dihedral_deg, 30) - 1e-9).all()


def test_the_limit_of_matching_holds_and_common_walls_stay():
    flat = onion(shrink=0.95)
    moved = np.linalg.norm(match_volumes(flat, GOALS, 0.05).points - flat.points, axis=1)
    assert moved.max() <= 0.05 + 1e-12 and moved.max() > 0.049
    # Two tissues side by side, neither in the other: only the outer wall is free.
    beside = {frozenset((2,)): CORE, frozenset((1,)): SHELL - CORE}
    moved = np.linalg.norm(match_volumes(flat, beside, 0.2).points - flat.points, axis=1)
    inner = np.linalg.norm(flat.points, axis=1) < 0.99 * R_IN
    assert (moved[inner] == 0).all() and (moved[~inner] > 0).any()
