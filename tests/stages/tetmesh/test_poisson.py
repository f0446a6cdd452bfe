"""What the mesh is for: an independent FEM library solves Poisson's equation on it and meets the analytic solution."""

from __future__ import annotations

import numpy as np
import pytest
from shapes import sphere

from vhp_cli import engines
from vhp_cli.stages.tetmesh.keep_surface import keep_surface
from vhp_cli.stages.tetmesh.modelling import mesh_model
from vhp_cli.stages.tetmesh.options import TetmeshOptions
from vhp_cli.stages.tetmesh.tissues import Relations, Tissue
from vhp_cli.volume import VolumeMesh

INNER_RADIUS, OUTER_RADIUS = 6.0, 10.0  # mm
INNER_CONDUCTIVITY, OUTER_CONDUCTIVITY = 0.2, 1.0
NAMES = ("core", "shell")


def potential(radius):
    """Solution of -div(sigma grad u) = 1 with u = 0 on the outer sphere.

    The flux through a sphere is its volume, so u' = -r / (3 sigma).
    """
    outside = (OUTER_RADIUS**2 - radius**2) / (6 * OUTER_CONDUCTIVITY)
    at_core = (OUTER_RADIUS**2 - INNER_RADIUS**2) / (6 * OUTER_CONDUCTIVITY)
    inside = at_core + (INNER_RADIUS**2 - radius**2) / (6 * INNER_CONDUCTIVITY)
    return np.where(radius < INNER_RADIUS, inside, outside)


def integral_of_potential():
    radius = np.linspace(0, OUTER_RADIUS, 100_001)
    return float(np.trapezoid(4 * np.pi * radius**2 * potential(radius), radius))


def solved(mesh, conductivity_of):
    """Return what scikit-fem makes of it: potential at the points, its integral, and that of its error squared."""
    skfem = pytest.importorskip("skfem", reason="scikit-fem is not installed")
    helpers = pytest.importorskip("skfem.helpers")

    grid = skfem.MeshTet(np.ascontiguousarray(mesh.points.T), np.ascontiguousarray(mesh.tetrahedra.T, dtype=np.int64))
    basis = skfem.Basis(grid, skfem.ElementTetP1())
    constants = basis.with_element(skfem.ElementTetP0())
    conductivity = constants.interpolate(np.array([0.0, *conductivity_of])[mesh.labels])

    @skfem.BilinearForm
    def stiffness(u, v, w):
        return w.conductivity * helpers.dot(helpers.grad(u), helpers.grad(v))

    @skfem.LinearForm
    def source(v, w):
        return 1.0 * v

    @skfem.Functional
    def total(w):
        return w.u

    @skfem.Functional
    def squared_error(w):
        return (w.u - potential(np.linalg.norm(w.x, axis=0))) ** 2

    matrix = stiffness.assemble(basis, conductivity=conductivity)
    u = skfem.solve(*skfem.condense(matrix, source.assemble(basis), D=grid.boundary_nodes()))
    found = basis.interpolate(u)
    return u, float(total.assemble(basis, u=found)), float(squared_error.assemble(basis, u=found))


def check(mesh):
    u, integral, squared = solved(mesh, (INNER_CONDUCTIVITY, OUTER_CONDUCTIVITY))
    highest = float(potential(np.array(0.0)))
    assert u.max() == pytest.approx(highest, rel=0.01)
    assert integral == pytest.approx(integral_of_potential(), rel=0.01)
    volume = 4 / 3 * np.pi * OUTER_RADIUS**3
    assert np.sqrt(squared / volume) < 0.01 * highest
    # At the interface, where the slope jumps.
    radius = np.linalg.norm(mesh.points, axis=1)
    near = np.abs(radius - INNER_RADIUS) < 0.05
    assert near.sum() > 100
    assert np.abs(u[near] - potential(radius[near])).max() < 0.01 * highest


def spheres(subdivisions):
    return [sphere(INNER_RADIUS, subdivisions=subdivisions), sphere(OUTER_RADIUS, subdivisions=subdivisions)]


@pytest.fixture(scope="module")
def exact_mesh():
    if not engines.ENGINES["tetgen"].available:
        pytest.skip("tetgen is not installed")
    made = keep_surface(spheres(4), engine="tetgen", edge_length_mm=1.2, improve=False, timeout_s=60)
    # The region at the centre is the core.
    nearest = np.linalg.norm(made.points[made.tetrahedra].mean(axis=1), axis=1).argmin()
    labels = np.where(made.regions == made.regions[nearest], 1, 2)
    return VolumeMesh(made.points, made.tetrahedra, labels, NAMES)


def test_the_mesh_that_keeps_its_surfaces(exact_mesh):
    check(exact_mesh)


def test_labels_decide(exact_mesh):
    swapped = VolumeMesh(exact_mesh.points, exact_mesh.tetrahedra, 3 - exact_mesh.labels, NAMES)
    u, integral, _ = solved(swapped, (INNER_CONDUCTIVITY, OUTER_CONDUCTIVITY))
    assert abs(u.max() / float(potential(np.array(0.0))) - 1) > 0.1
    assert abs(integral / integral_of_potential() - 1) > 0.1


@pytest.mark.slow
def test_the_mesh_of_the_default_route():
    core, shell = spheres(4)
    tissues = [
        Tissue(name, surface, 4 / 3 * np.pi * radius**3)
        for name, surface, radius in zip(NAMES, (core, shell), (INNER_RADIUS, OUTER_RADIUS), strict=True)
    ]
    relations = Relations({"core": frozenset({"shell"})}, {}, {("core", "shell"): OUTER_RADIUS - INNER_RADIUS})
    made = mesh_model(tissues, relations, TetmeshOptions(edge_length="1.2", time_limit_s=100))
    assert made.mesh.names == NAMES
    check(made.mesh)
