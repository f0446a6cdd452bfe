"""The peers of `vhp heal`: the same meshes, repaired by other libraries. One function per peer.

All run in a child process, by `timed`: libraries are loaded and engines started before the clock starts.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Arrays = tuple[Floats, Ints]


@dataclass(frozen=True, slots=True)
class Made:
    """What a repairer made of a mesh.

    Parameters
    ----------
    vertices, faces
        The output; that of a refusal is the input.
    status, reason
        As `vhp heal` tells; of all others ``"changed"`` and nothing.
    """

    vertices: Floats
    faces: Ints
    status: str = "changed"
    reason: str = ""


def by_vhp(vertices: Floats, faces: Ints) -> Made:
    """Everything: repair and remeshing, with the measures of the report."""
    return _healed(vertices, faces, only_topology=False)


def by_vhp_topology(vertices: Floats, faces: Ints) -> Made:
    """Repair only."""
    return _healed(vertices, faces, only_topology=True)


def _healed(vertices: Floats, faces: Ints, *, only_topology: bool) -> Made:
    from vhp_cli.mesh import Mesh
    from vhp_cli.stages.heal import heal
    from vhp_cli.stages.heal.options import HealOptions

    outcome = heal(Mesh(vertices, faces), HealOptions(only_topology=only_topology))
    if outcome.mesh is None:
        return Made(vertices, faces, outcome.status, outcome.reason)
    return Made(outcome.mesh.vertices, outcome.mesh.faces, outcome.status, outcome.reason)


def by_meshfix(vertices: Floats, faces: Ints) -> Made:
    """MeshFix as it is documented; it keeps the largest component only."""
    import pymeshfix

    engine = pymeshfix.MeshFix(np.array(vertices), np.array(faces))
    engine.repair()
    return Made(np.array(engine.points), np.array(engine.faces))


def by_meshfix_parts(vertices: Floats, faces: Ints) -> Made:
    """MeshFix on each component by itself, so that none is dropped; each keeps the sign of its volume."""
    from vhp_cli.engines.meshfix import repair

    return Made(*repair(vertices, faces, {}))


def by_meshlib(vertices: Floats, faces: Ints) -> Made:
    """MeshLib: holes filled, degenerate faces fixed, self-intersections cut out and filled."""
    from meshlib import mrmeshnumpy, mrmeshpy

    size = _diagonal(vertices)
    mesh = mrmeshnumpy.meshFromFacesVerts(np.array(faces), np.array(vertices))
    mrmeshpy.uniteCloseVertices(mesh, 1e-6)
    mrmeshpy.fixMultipleEdges(mesh)
    mrmeshpy.duplicateMultiHoleVertices(mesh)
    filling = mrmeshpy.FillHoleParams()
    filling.metric = mrmeshpy.getUniversalMetric(mesh)
    for edge in mesh.topology.findHoleRepresentiveEdges():
        mrmeshpy.fillHole(mesh, edge, filling)
    degenerate = mrmeshpy.FixMeshDegeneraciesParams()
    degenerate.tinyEdgeLength = 1e-5 * size
    degenerate.maxDeviation = 1e-4 * size
    degenerate.criticalTriAspectRatio = 1e3
    mrmeshpy.fixMeshDegeneracies(mesh, degenerate)
    crossing = mrmeshpy.SelfIntersections.Settings()
    crossing.method = mrmeshpy.SelfIntersections.Settings.Method.CutAndFill
    crossing.touchIsIntersection = True
    crossing.relaxIterations = 2
    crossing.maxExpand = 3
    mrmeshpy.SelfIntersections.fix(mesh, crossing)
    mesh.pack()
    return Made(mrmeshnumpy.getNumpyVerts(mesh), mrmeshnumpy.getNumpyFaces(mesh.topology))


def by_meshlab(vertices: Floats, faces: Ints) -> Made:
    """The repair filters of MeshLab: duplicates removed, non-manifold places split, oriented, holes closed."""
    import pymeshlab

    meshes = _mesh_set(vertices, faces)
    meshes.meshing_remove_duplicate_vertices()
    meshes.meshing_remove_duplicate_faces()
    meshes.meshing_remove_null_faces()
    meshes.meshing_remove_unreferenced_vertices()
    meshes.meshing_repair_non_manifold_edges(method="Split Vertices")
    meshes.meshing_repair_non_manifold_vertices(vertdispratio=0)
    # It refuses meshes that are no manifold after all.
    with contextlib.suppress(pymeshlab.PyMeshLabException):
        meshes.meshing_re_orient_faces_coherently()
    meshes.meshing_close_holes(maxholesize=1000, selfintersection=False)
    return _current(meshes)


def by_wrap(vertices: Floats, faces: Ints) -> Made:
    """Alpha wrapping with CGAL, by MeshLab: openings of 1/100 of the diagonal, offset 1/1500."""
    import pymeshlab

    meshes = _mesh_set(vertices, faces)
    meshes.generate_alpha_wrap(alpha=pymeshlab.PercentageValue(1), offset=pymeshlab.PercentageValue(100 / 1500))
    return _current(meshes)


def by_trimesh(vertices: Floats, faces: Ints) -> Made:
    """trimesh.repair: holes of three and four edges filled, normals made consistent and outward."""
    import trimesh

    mesh = trimesh.Trimesh(vertices, faces, process=True, validate=True)
    trimesh.repair.fill_holes(mesh)
    trimesh.repair.fix_normals(mesh, multibody=True)
    return Made(np.array(mesh.vertices), np.array(mesh.faces))


@dataclass(frozen=True, slots=True)
class Repairer:
    """One way to repair: its function, the modules it needs, the packages that have them, and the licence."""

    function: Callable[[Floats, Ints], Made]
    modules: tuple[str, ...]
    packages: tuple[str, ...]
    licence: str


REPAIRERS = {
    "vhp": Repairer(by_vhp, ("vhp_cli",), ("vhp-cli",), "MIT"),
    "vhp --only-topology": Repairer(by_vhp_topology, ("vhp_cli",), ("vhp-cli",), "MIT"),
    "MeshFix": Repairer(by_meshfix, ("pymeshfix",), ("pymeshfix",), "AGPL-3.0"),
    "MeshFix by parts": Repairer(by_meshfix_parts, ("pymeshfix",), ("pymeshfix",), "AGPL-3.0"),
    "MeshLib": Repairer(by_meshlib, ("meshlib",), ("meshlib",), "non-commercial"),
    "pymeshlab repair": Repairer(by_meshlab, ("pymeshlab",), ("pymeshlab",), "GPL-3.0"),
    "pymeshlab wrap": Repairer(by_wrap, ("pymeshlab",), ("pymeshlab",), "GPL-3.0"),
    "trimesh.repair": Repairer(by_trimesh, ("trimesh", "networkx"), ("trimesh", "networkx"), "MIT"),
}


def timed(name: str, vertices: Floats, faces: Ints) -> tuple[dict[str, Any], float, float]:
    """Run one repairer on a mesh; return what it made, wall and CPU seconds (its children's included)."""
    run = REPAIRERS[name].function
    started, used = time.perf_counter(), _cpu_seconds()
    made = run(vertices, faces)
    wall, cpu = time.perf_counter() - started, _cpu_seconds() - used
    return (
        {
            "vertices": np.ascontiguousarray(made.vertices, dtype=np.float64),
            "faces": np.ascontiguousarray(made.faces, dtype=np.int64),
            "status": made.status,
            "reason": made.reason,
        },
        wall,
        cpu,
    )


def warm_up(name: str) -> None:
    """Load what a repairer needs and let it repair a small mesh: two crossing boxes, one of them open."""
    for module in REPAIRERS[name].modules:
        importlib.import_module(module)
    corners = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], dtype=float)
    box = np.array([
        (0, 2, 3), (0, 3, 1), (4, 5, 7), (4, 7, 6), (0, 1, 5), (0, 5, 4),
        (2, 6, 7), (2, 7, 3), (0, 4, 6), (0, 6, 2), (1, 3, 7), (1, 7, 5),
    ], dtype=np.int32)  # fmt: skip
    vertices = np.concatenate((corners * 10, corners * 8 + (5.0, 1.0, 1.5)))
    REPAIRERS[name].function(vertices, np.concatenate((box, box[1:] + 8)))


def one_core(core: int) -> None:
    """Keep this process and those that it starts on one core, where the system can."""
    if hasattr(os, "sched_setaffinity"):
        cores = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {cores[core % len(cores)]})


def _cpu_seconds() -> float:
    """CPU seconds of this process, of its children that have ended and, on Linux, of those that run."""
    times = os.times()
    ended = times.children_user + times.children_system
    return time.process_time() + ended + _running(Path("/proc/self"))


def _running(process: Path) -> float:
    total = 0.0
    for children in process.glob("task/*/children"):
        # A process may end while it is looked at.
        with contextlib.suppress(OSError):
            for child in children.read_text().split():
                fields = Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split()
                total += sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK") + _running(Path(f"/proc/{child}"))
    return total


def _mesh_set(vertices: Floats, faces: Ints) -> Any:
    import pymeshlab

    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.add_mesh(pymeshlab.Mesh(vertices, faces))
    return meshes


def _current(meshes: Any) -> Made:
    mesh = meshes.current_mesh()
    return Made(mesh.vertex_matrix(), mesh.face_matrix())


def _diagonal(vertices: Floats) -> float:
    return float(np.linalg.norm(vertices.max(axis=0) - vertices.min(axis=0)))
