"""Tissues for tests of the fit, the proof and the mass: boxes and spheres, and the phantom."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import fcl
import numpy as np

from vhp_cli.mesh import Mesh
from vhp_cli.phantom import generate
from vhp_cli.stages.breathe.fitting.curves import even_move
from vhp_cli.stages.breathe.fitting.fit import Fit, FitSettings, fit
from vhp_cli.stages.breathe.mass import MassModel, densities
from vhp_cli.stages.breathe.nesting import parents
from vhp_cli.stages.breathe.roles import assign
from vhp_cli.stages.breathe.sequence import Motion
from vhp_cli.stages.breathe.tissue import Tissue

STEPS = 11


def tissues_of(meshes: Mapping[str, Mesh]) -> list[Tissue]:
    """Return the tissues with the roles that their names suggest."""
    roles = assign(meshes)
    return [Tissue.from_mesh(name, mesh, roles[name]) for name, mesh in meshes.items()]


def mass_of(tissues: list[Tissue], convention="fixed-mass", density=None) -> MassModel:
    """Return the mass model, with one density for all tissues or those of the table."""
    known = {name: item.kg_per_m3 for name, item in densities(tissues).items()}
    return MassModel(
        parents(tissues),
        known if density is None else dict.fromkeys(known, density),
        frozenset(tissue.name for tissue in tissues if tissue.role.part == "lung"),
        {tissue.name: tissue.volume_mm3 for tissue in tissues if tissue.closed},
        convention,
    )


def moving(name: str, vector) -> Motion:
    """Return a motion that reaches a translation at full inhalation."""
    return Motion(name, (even_move(np.asarray(vector, float), STEPS),), tissues=(name,))


@cache
def phantom(triangles: int = 20_000) -> dict[str, Mesh]:
    return generate(triangles)


@cache
def phantom_fit() -> tuple[list[Tissue], MassModel, Fit]:
    """Return the phantom and the sequence fitted to it."""
    tissues = tissues_of(phantom())
    mass = mass_of(tissues)
    return tissues, mass, fit(tissues, mass.parents, mass, FitSettings())


def mirrored(meshes: Mapping[str, Mesh]) -> dict[str, Mesh]:
    """Return the mirror image in x = 0 of a model, its names kept."""
    return {name: Mesh(mesh.vertices * [-1.0, 1.0, 1.0], mesh.faces[:, ::-1]) for name, mesh in meshes.items()}


def fcl_distance(vertices, faces, other: Mesh) -> float:
    """Return the distance of a surface from another by fcl; negative on contact."""

    def body(v, f):
        model = fcl.BVHModel()
        model.beginModel(len(v), len(f))
        model.addSubModel(np.ascontiguousarray(v), np.ascontiguousarray(f, dtype=np.int64))
        model.endModel()
        return fcl.CollisionObject(model)

    first, second = body(vertices, faces), body(other.vertices, other.faces)
    if fcl.collide(first, second, fcl.CollisionRequest(), fcl.CollisionResult()):
        return -1.0
    result = fcl.DistanceResult()
    fcl.distance(first, second, fcl.DistanceRequest(), result)
    return float(result.min_distance)
