"""The methods of the thesis as a stage: names, history, and when it stops."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from shapes import moved, sphere

from vhp_cli.formats import read_mesh
from vhp_cli.kernels import smoothing
from vhp_cli.kernels.smoothing import Smoothing, delaunay_flips, smooth_vertices
from vhp_cli.kernels.surface import topology
from vhp_cli.mesh import Mesh
from vhp_cli.stages.smooth.textbook import (
    Correction,
    Method,
    TextbookSettings,
    Update,
    smooth_textbook,
)


def rough_sphere(seed=0, scale=0.8, subdivisions=3):
    mesh = sphere(10, subdivisions=subdivisions)
    noise = np.random.default_rng(seed).normal(scale=scale, size=mesh.vertices.shape)
    return Mesh(mesh.vertices + noise, mesh.faces)


def q_of(mesh):
    """2 r_in / r_out = 8 (s - a) (s - b) (s - c) / (a b c), with half the perimeter s."""
    corners = mesh.vertices[mesh.faces]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    half = sides.sum(axis=1, keepdims=True) / 2
    return 8 * (half - sides).prod(axis=1) / sides.prod(axis=1)


def volume_of(mesh):
    corners = mesh.vertices[mesh.faces]
    return np.linalg.det(corners).sum() / 6


def test_names_are_those_of_the_kernel():
    assert tuple(Method) == smoothing.METHODS
    assert tuple(Update) == smoothing.UPDATES
    assert tuple(Correction) == smoothing.CORRECTIONS
    for method in Method:
        for update in Update:
            for correction in Correction:
                Smoothing(method=method, update=update, correction=correction)


@pytest.mark.parametrize("method", Method)
def test_stage_is_the_kernel_with_a_history(method):
    mesh = rough_sphere()
    chosen = Smoothing(method=method, step=0.5)
    found = smooth_textbook(mesh, TextbookSettings(chosen, iterations=4))
    assert_array_equal(
        found.mesh.vertices, smooth_vertices(mesh.vertices, mesh.faces, method=method, step=0.5, iterations=4)
    )
    assert_array_equal(found.mesh.faces, mesh.faces)
    assert found.chosen == 4
    assert [step.number for step in found.history] == [0, 1, 2, 3, 4]
    for step, state in ((found.history[0], mesh), (found.history[-1], found.mesh)):
        assert_allclose(step.min_q, q_of(state).min(), rtol=1e-9)
        assert_allclose(step.mean_q, q_of(state).mean(), rtol=1e-12)
        assert_allclose(step.volume_mm3, volume_of(state), rtol=1e-12)
        assert step.flips == 0


def test_shrinkage_and_what_is_done_against_it():
    """Plain smoothing shrinks; each correction loses less, and keeping the volume loses nothing."""
    mesh = rough_sphere(scale=0.3)
    lost = {}
    for correction in Correction:
        found = smooth_textbook(mesh, TextbookSettings(Smoothing(correction=correction), iterations=10))
        assert found.history[-1].mean_q > found.history[0].mean_q
        lost[correction] = abs(1 - found.history[-1].volume_mm3 / found.history[0].volume_mm3)
    assert lost["none"] > 0.1
    assert max(lost["hc"], lost["taubin"]) < 0.3 * lost["none"]
    assert lost["volume"] < 1e-11


@pytest.mark.parametrize("method", Method)
def test_flips_and_smoothing_alternate(method):
    mesh = rough_sphere(scale=0.6)
    chosen = Smoothing(method=method, tangential=True)
    found = smooth_textbook(mesh, TextbookSettings(chosen, flips=True, iterations=3))
    vertices, faces = mesh.vertices, mesh.faces
    for step in found.history[1:]:
        vertices = smooth_vertices(vertices, faces, method=method, tangential=True)
        faces, flips = delaunay_flips(vertices, faces)
        assert step.flips == flips
    assert_array_equal(found.mesh.vertices, vertices)
    assert_array_equal(found.mesh.faces, faces)
    assert found.history[1].flips > 0
    joined = topology(vertices, faces)
    assert joined.euler == 2
    assert len(joined.boundary_edges) == len(joined.nonmanifold_edges) == 0


def test_volume_is_kept_through_flips():
    mesh = rough_sphere(scale=0.6)
    chosen = Smoothing(correction="volume")
    found = smooth_textbook(mesh, TextbookSettings(chosen, flips=True, iterations=5))
    assert sum(step.flips for step in found.history) > 0
    assert_allclose([step.volume_mm3 for step in found.history], volume_of(mesh), rtol=1e-12)


def test_volume_of_an_open_surface_is_told_from_one_point():
    mesh = rough_sphere(3, 0.4)
    mesh = moved(Mesh(mesh.vertices, mesh.faces[:-40]), (30, 0, 0))
    found = smooth_textbook(mesh, TextbookSettings(Smoothing(correction="volume"), iterations=5))
    assert_allclose([step.volume_mm3 for step in found.history], found.history[0].volume_mm3, rtol=1e-11)
    assert abs(found.mesh.vertices - mesh.vertices).max() > 0.1


def test_constrained_edges_and_fixed_vertices_stay():
    mesh = rough_sphere(1)
    fixed = np.zeros(len(mesh.vertices), bool)
    fixed[mesh.faces[:40].ravel()] = True
    found = smooth_textbook(mesh, TextbookSettings(flips=True, iterations=3), fixed)
    assert_array_equal(found.mesh.vertices[fixed], mesh.vertices[fixed])
    assert (found.mesh.vertices[~fixed] != mesh.vertices[~fixed]).any(axis=1).all()
    assert {frozenset(face) for face in mesh.faces[:40].tolist()} <= {
        frozenset(face) for face in found.mesh.faces.tolist()
    }


def test_stops_at_the_goal():
    mesh = rough_sphere(2, 0.4)
    whole = smooth_textbook(mesh, TextbookSettings(iterations=20)).history
    goal = whole[3].min_q
    first = next(step.number for step in whole if step.min_q >= goal)
    found = smooth_textbook(mesh, TextbookSettings(iterations=20, until_q=goal))
    assert found.chosen == first == len(found.history) - 1
    assert 0 < first <= 3
    # Already there: nothing is done.
    done = smooth_textbook(mesh, TextbookSettings(until_q=0.0))
    assert done.mesh is mesh
    assert len(done.history) == 1


def test_stops_when_quality_no_longer_rises_and_takes_the_best():
    mesh = sphere(10, subdivisions=2)
    mesh = Mesh(mesh.vertices, mesh.faces[:-40])  # its boundary stays, so that the rest is drawn out of shape
    found = smooth_textbook(mesh, TextbookSettings(iterations=200, patience=4))
    means = [step.mean_q for step in found.history]
    best = int(np.argmax(means))
    assert found.chosen == best
    assert len(found.history) == best + 5 < 200
    assert_array_equal(
        found.mesh.vertices, smooth_vertices(mesh.vertices, mesh.faces, iterations=best) if best else mesh.vertices
    )
    assert_allclose(q_of(found.mesh).mean(), max(means), rtol=1e-12)
    # Without patience it goes on.
    assert len(smooth_textbook(mesh, TextbookSettings(iterations=len(means) + 10)).history) == len(means) + 11


def test_nothing_to_smooth():
    for mesh in (Mesh(np.empty((0, 3)), np.empty((0, 3), np.int32)), Mesh(np.eye(3), np.array([[0, 1, 2]]))):
        found = smooth_textbook(mesh, TextbookSettings(flips=True, iterations=2))
        assert_array_equal(found.mesh.vertices, mesh.vertices)
        assert_array_equal(found.mesh.faces, mesh.faces)
        assert len(found.history) == 3
        assert math.isnan(found.history[0].min_q) == (len(mesh.faces) == 0)


def test_wrong_settings():
    for wrong in ({"iterations": -1}, {"until_q": 1.5}, {"until_q": -0.1}, {"patience": 0}):
        with pytest.raises(ValueError):
            TextbookSettings(**wrong)
    with pytest.raises(ValueError):
        smooth_textbook(rough_sphere(), TextbookSettings(), np.zeros(3, bool))


def test_standard_smoothing_ruins_thin_tissue(shared_data):
    """What the thesis found on nerves: plain smoothing takes most of their volume, tangential smoothing hardly any."""
    paths = sorted((shared_data / "head_bp3d").glob("*nerve*.stl"))
    assert paths
    for path in paths:
        mesh = read_mesh(path).mesh

        def kept(settings, mesh=mesh):
            history = smooth_textbook(mesh, TextbookSettings(settings, iterations=10)).history
            return history[-1].volume_mm3 / history[0].volume_mm3

        assert kept(Smoothing()) < 0.9
        assert abs(1 - kept(Smoothing(tangential=True))) < 0.06
