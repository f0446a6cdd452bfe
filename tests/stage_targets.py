"""Stages that are told apart by what goes wrong in them; child processes import this module.

All but the first do their work on boxes only, so that a test sees what becomes of the other tissues.
"""

from __future__ import annotations

import os
import time

import numpy as np

from vhp_cli.kernels import surface
from vhp_cli.measures import Deviation
from vhp_cli.mesh import Mesh
from vhp_cli.stages.heal.options import HealOptions
from vhp_cli.stages.outcome import Outcome

NONE: Deviation = {
    "max": 0.0,
    "mean": 0.0,
    "to_output": {"max": 0.0, "mean": 0.0, "xyz_mm": None},
    "to_input": {"max": 0.0, "mean": 0.0, "xyz_mm": None},
    "lost_area_mm2": 0.0,
    "lost_outside_mm2": 0.0,
    "lost_limit_mm": 0.1,
    "lost_places": [],
}


def turn_over(mesh: Mesh, options: object) -> Outcome:
    """Turn surfaces of negative volume outward: the least that a stage can do."""
    corners = mesh.vertices[mesh.faces]
    volume = np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    if volume >= 0:
        return Outcome(None, "unchanged")
    action = {"step": "orient", "message": "turned a part outward", "count": 1, "places": []}
    return Outcome(Mesh(mesh.vertices, mesh.faces[:, ::-1]), "changed", "", [action], NONE)  # type: ignore[list-item]


def slow(mesh: Mesh, options: object) -> Outcome:
    time.sleep(0.05)
    return turn_over(mesh, options)


def is_box(mesh: Mesh) -> bool:
    return len(mesh.faces) == 12


def hang(mesh: Mesh, options: object) -> Outcome:
    while is_box(mesh):
        time.sleep(0.1)
    return turn_over(mesh, options)


def crash(mesh: Mesh, options: object) -> Outcome:
    if is_box(mesh):
        os.abort()
    return turn_over(mesh, options)


def eat(mesh: Mesh, options: object) -> Outcome:
    if is_box(mesh):
        hoard = [np.ones(1 << 24) for _ in range(1000)]
        assert len(hoard) == 1000
    return turn_over(mesh, options)


def fail(mesh: Mesh, options: object) -> Outcome:
    if is_box(mesh):
        raise ZeroDivisionError("nothing is left")
    return turn_over(mesh, options)


def tear(mesh: Mesh, options: object) -> Outcome:
    """Lose a face."""
    return (
        Outcome(Mesh(mesh.vertices, mesh.faces[1:]), "changed", "", [], NONE)
        if is_box(mesh)
        else turn_over(mesh, options)
    )


def squash(mesh: Mesh, options: object) -> Outcome:
    """Cut a face in two, one of them a needle: sound, but badly shaped."""
    if not is_box(mesh):
        return turn_over(mesh, options)
    topology = surface.topology(mesh.vertices, mesh.faces)
    assert topology.n_components == 1
    a, b, _ = mesh.faces[0]
    other = next(i for i, face in enumerate(mesh.faces) if i and a in face and b in face)
    middle = mesh.vertices[a] * 0.9999 + mesh.vertices[b] * 0.0001
    new = len(mesh.vertices)
    faces = [face for i, face in enumerate(mesh.faces.tolist()) if i not in (0, other)]
    for i in (0, other):
        face = mesh.faces[i].tolist()
        faces += [[new if v == a else v for v in face], [new if v == b else v for v in face]]
    return Outcome(Mesh(np.vstack([mesh.vertices, middle]), np.array(faces)), "changed", "", [], NONE)


def refuse(mesh: Mesh, options: object) -> Outcome:
    return Outcome(None, "refused", "a sheet is no solid") if is_box(mesh) else turn_over(mesh, options)


def no_surface(mesh: Mesh, options: object) -> Outcome:
    return Outcome(None, "changed") if is_box(mesh) else turn_over(mesh, options)


def move(mesh: Mesh, options: object) -> Outcome:
    """Push boxes 3 mm along x."""
    return (
        Outcome(Mesh(mesh.vertices + np.array([3.0, 0.0, 0.0]), mesh.faces), "changed", "", [], NONE)
        if is_box(mesh)
        else turn_over(mesh, options)
    )


def move_within(mesh: Mesh, options: HealOptions) -> Outcome:
    """Push boxes along x as far as the options allow."""
    if not is_box(mesh):
        return turn_over(mesh, options)
    assert options.max_deviation_mm
    by = np.array([options.max_deviation_mm, 0.0, 0.0])
    return Outcome(Mesh(mesh.vertices + by, mesh.faces), "changed", "", [], NONE)


def report_options(mesh: Mesh, options: object) -> Outcome:
    """Say what the options were."""
    return Outcome(None, "refused", repr(options))


def move_out(mesh: Mesh, options: object) -> Outcome:
    """Push boxes 9 mm along x, however gently it is asked for."""
    return (
        Outcome(Mesh(mesh.vertices + np.array([9.0, 0.0, 0.0]), mesh.faces), "changed", "", [], NONE)
        if is_box(mesh)
        else Outcome(None, "unchanged")
    )
