"""The peers of `vhp check`: the same questions, asked of other libraries. One function per stack.

``python benchmarks/peers.py STACK MODEL`` checks the STL files of a directory in this process and prints
what it found as JSON, so that start-up and imports are part of what `check.py` measures.
``python benchmarks/peers.py vhp REPORT`` prints the same summary of a report of `vhp check`.

Every stack reads all files, tests closedness, manifoldness and orientation as far as the library can, finds
self-intersections, measures the triangles, and tests every pair of tissues whose boxes are within the gap
limit: contact, smallest gap, nesting. Where a library lets other threads run (it releases the interpreter
lock), the tissues are shared out over all cores, as vhp does.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class Limits:
    """What counts as badly shaped or too near, the same for all."""

    quality: float = 0.01
    edge_mm: float = 0.01
    gap_mm: float = 1.0


@dataclass(slots=True)
class Found:
    """What a stack found in a model; None: it has no such test, or none that is not slow.

    Parameters
    ----------
    tissues, triangles
        As read.
    not_closed, not_manifold, misoriented, self_intersecting
        Tissues with such a defect. Misoriented: faces that disagree, or a closed surface inside out.
    poor_triangles, short_edges
        Below the limits.
    contacts, narrow_gaps, nested
        Pairs of tissues that cross or touch, that are apart by less than the limit, and of which one lies
        within the other without contact.
    """

    tissues: int = 0
    triangles: int = 0
    not_closed: int = 0
    not_manifold: int | None = None
    misoriented: int | None = None
    self_intersecting: int = 0
    poor_triangles: int | None = None
    short_edges: int | None = None
    contacts: int = 0
    narrow_gaps: int = 0
    nested: int = 0


def by_meshlib(files: Sequence[Path], limits: Limits) -> Found:
    """MeshLib, its own threads on; each tissue is read and tested in a thread of its own as well."""
    import numpy as np
    from meshlib import mrmeshpy

    def inspect(file: Path) -> tuple[Any, dict[str, int]]:
        skipped, duplicated = mrmeshpy.int_output(), mrmeshpy.int_output()
        settings = mrmeshpy.MeshLoadSettings()
        settings.skippedFaceCount, settings.duplicatedVertexCount = skipped, duplicated
        mesh = mrmeshpy.loadMesh(file, settings)
        part = mrmeshpy.MeshPart(mesh)
        closed = mesh.topology.isClosed()
        mesh.area()
        return mesh, {
            "triangles": mesh.topology.numValidFaces(),
            "not_closed": not closed,
            "not_manifold": bool(mrmeshpy.hasMultipleEdges(mesh.topology) or skipped.value or duplicated.value),
            "misoriented": closed and mesh.volume() < 0,
            "self_intersecting": len(mrmeshpy.findSelfCollidingTriangles(part)) > 0,
            # MeshLib's aspect ratio R / 2r is the inverse of q = 2r / R.
            "poor_triangles": mrmeshpy.findDegenerateFaces(part, 1 / limits.quality).count(),
            "short_edges": mrmeshpy.findShortEdges(part, limits.edge_mm).count(),
        }

    meshes, found = _collect(_in_threads(inspect, files))
    boxes = [mesh.computeBoundingBox() for mesh in meshes]
    lower = np.array([(box.min.x, box.min.y, box.min.z) for box in boxes])
    upper = np.array([(box.max.x, box.max.y, box.max.z) for box in boxes])
    parts = [mrmeshpy.MeshPart(mesh) for mesh in meshes]
    limit = limits.gap_mm**2
    gaps = {
        (a, b): mrmeshpy.findDistance(parts[a], parts[b], upDistLimitSq=limit).distSq ** 0.5
        for a, b in near_pairs(lower, upper, limits.gap_mm)
    }
    _count_gaps(found, gaps, limits)
    for inner, outer in _nesting_candidates(lower, upper, gaps):
        found.nested += bool(mrmeshpy.isNonIntersectingInside(parts[inner], parts[outer]))
    return found


def by_trimesh(files: Sequence[Path], limits: Limits) -> Found:
    """trimesh reads and tests the topology, pymeshlab quality and self-intersections, python-fcl the pairs."""
    import fcl
    import numpy as np
    import pymeshlab
    import trimesh

    def inspect(file: Path) -> tuple[Any, dict[str, int]]:
        mesh = trimesh.load_mesh(file)
        closed, consistent = bool(mesh.is_watertight), bool(mesh.is_winding_consistent)
        _ = mesh.body_count, mesh.area
        measured = pymeshlab.MeshSet(verbose=False)
        measured.add_mesh(pymeshlab.Mesh(mesh.vertices, mesh.faces.astype(np.int32)))
        topology = measured.get_topological_measures()
        measured.compute_scalar_by_aspect_ratio_per_face(metric="inradius/circumradius")
        quality = measured.current_mesh().face_scalar_array()
        measured.compute_selection_by_self_intersections_per_face()
        return mesh, {
            "triangles": len(mesh.faces),
            "not_closed": not closed,
            "not_manifold": not topology["is_mesh_two_manifold"],
            "misoriented": not consistent or (closed and mesh.volume < 0),
            "self_intersecting": measured.current_mesh().selected_face_number() > 0,
            "poor_triangles": int((quality < limits.quality).sum()),
            "short_edges": int((mesh.edges_unique_length < limits.edge_mm).sum()),
        }

    # Two threads gain nothing here: most of the work is trimesh's, in Python.
    meshes, found = _collect(map(inspect, files))
    lower = np.array([mesh.bounds[0] for mesh in meshes])
    upper = np.array([mesh.bounds[1] for mesh in meshes])
    solids = [_fcl_object(fcl, np.asarray(mesh.vertices), np.asarray(mesh.faces)) for mesh in meshes]
    gaps = {
        (a, b): fcl.distance(solids[a], solids[b], fcl.DistanceRequest(), fcl.DistanceResult())
        for a, b in near_pairs(lower, upper, limits.gap_mm)
    }
    _count_gaps(found, gaps, limits)
    for inner, outer in _nesting_candidates(lower, upper, gaps):
        found.nested += bool(meshes[outer].contains(meshes[inner].vertices[:1])[0])
    return found


def by_igl(files: Sequence[Path], limits: Limits) -> Found:
    """libigl with its CGAL part for self-intersections, numpy for the edges, python-fcl for the pairs.

    libigl's own tests for manifold edges and vertices take many times the rest of the check together, so
    sorted edges do that here, and vertices where fans meet are not looked for.
    """
    import fcl
    import igl
    import igl.copyleft.cgal
    import numpy as np

    def inspect(file: Path) -> tuple[Any, dict[str, int]]:
        vertices, faces = _read_for_igl(file)
        edges = np.concatenate((faces[:, :2], faces[:, 1:], faces[:, ::-2]))
        key = (edges.min(axis=1) << 32) | edges.max(axis=1)
        order = np.argsort(key)
        starts = np.flatnonzero(np.r_[True, np.diff(key[order]) != 0])
        uses = np.diff(np.r_[starts, len(key)])
        signs = np.where(edges[order, 0] < edges[order, 1], 1, -1)
        balance = np.add.reduceat(signs, starts)
        lengths = igl.edge_lengths(vertices, edges[order[starts]])
        quality = 2 * igl.inradius(vertices, faces) / igl.circumradius(vertices, faces)[0]
        igl.facet_components(faces)
        igl.doublearea(vertices, faces)
        closed = bool((uses % 2 == 0).all())
        corners = vertices[faces] - vertices[0]
        volume = np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
        crossing = igl.copyleft.cgal.remesh_self_intersections(vertices, faces, detect_only=True)[2]
        return (vertices, faces), {
            "triangles": len(faces),
            "not_closed": not closed,
            "not_manifold": bool((uses > 2).any()),
            "misoriented": bool((balance[uses == 2] != 0).any() or (closed and volume < 0)),
            "self_intersecting": len(crossing) > 0,
            "poor_triangles": int((quality < limits.quality).sum()),
            "short_edges": int((lengths < limits.edge_mm).sum()),
        }

    # libigl and fcl hold the interpreter lock: threads gain nothing.
    meshes, found = _collect(map(inspect, files))
    lower = np.array([vertices.min(axis=0) for vertices, _ in meshes])
    upper = np.array([vertices.max(axis=0) for vertices, _ in meshes])
    solids = [_fcl_object(fcl, vertices, faces) for vertices, faces in meshes]
    gaps = {
        (a, b): fcl.distance(solids[a], solids[b], fcl.DistanceRequest(), fcl.DistanceResult())
        for a, b in near_pairs(lower, upper, limits.gap_mm)
    }
    _count_gaps(found, gaps, limits)
    inside: dict[int, list[int]] = {}
    for inner, outer in _nesting_candidates(lower, upper, gaps):
        inside.setdefault(outer, []).append(inner)
    for outer, inners in inside.items():
        # One call for all points: each call builds the tree of the outer mesh anew.
        points = np.array([meshes[inner][0][0] for inner in inners])
        found.nested += int((np.abs(igl.fast_winding_number(*meshes[outer], points)) > 0.5).sum())
    return found


def by_vhp(report: Path, limits: Limits) -> Found:
    """Return what a report of `vhp check` says, in the terms of this comparison."""
    content = json.loads(report.read_bytes())
    tissues, pairs, findings = content["tissues"], content["pairs"], content["findings"]
    contact = ("touching", "crossing", "identical")
    apart = [pair for pair in pairs if pair["relation"] not in contact and pair["min_gap_mm"] is not None]

    def count(rule: str) -> int:
        return sum(finding["count"] for finding in findings if finding["rule"] == rule)

    return Found(
        tissues=len(tissues),
        triangles=sum(tissue["triangles"] for tissue in tissues),
        not_closed=sum(not tissue["closed"] for tissue in tissues),
        not_manifold=sum(not tissue["manifold"] for tissue in tissues),
        misoriented=sum(not tissue["oriented"] or tissue["topology"]["inward_components"] > 0 for tissue in tissues),
        self_intersecting=sum(tissue["self_intersections"]["pairs"] > 0 for tissue in tissues),
        # Faces without area have a rule of their own.
        poor_triangles=count("Q001") + count("Q003"),
        short_edges=count("Q002"),
        contacts=sum(pair["relation"] in contact for pair in pairs),
        narrow_gaps=sum(pair["min_gap_mm"] < limits.gap_mm for pair in apart),
        nested=sum(pair["relation"] in ("a_inside_b", "b_inside_a") for pair in pairs),
    )


@dataclass(frozen=True, slots=True)
class Stack:
    """One peer: its function, the modules it needs, and the packages that have them."""

    function: Callable[[Sequence[Path], Limits], Found]
    modules: tuple[str, ...]
    packages: tuple[str, ...]


STACKS = {
    "meshlib": Stack(by_meshlib, ("meshlib",), ("meshlib",)),
    "trimesh+pymeshlab": Stack(by_trimesh, ("trimesh", "pymeshlab", "fcl"), ("trimesh", "pymeshlab", "python-fcl")),
    "igl+fcl": Stack(by_igl, ("igl", "fcl"), ("libigl", "python-fcl")),
}


def near_pairs(lower: Any, upper: Any, margin_mm: float) -> list[tuple[int, int]]:
    """Return the pairs (i < j) of boxes (N, 3) that are nowhere farther apart than a margin."""
    import numpy as np

    near = ((lower[:, None] - margin_mm <= upper[None]) & (upper[:, None] + margin_mm >= lower[None])).all(axis=2)
    return [(int(a), int(b)) for a, b in np.argwhere(np.triu(near, 1))]


def _nesting_candidates(lower: Any, upper: Any, gaps: dict[tuple[int, int], float]) -> list[tuple[int, int]]:
    """Return the pairs (inner, outer) of boxes in boxes whose surfaces do not meet."""
    import numpy as np

    within = ((lower[:, None] >= lower[None]) & (upper[:, None] <= upper[None])).all(axis=2)
    np.fill_diagonal(within, False)
    pairs = [(int(inner), int(outer)) for inner, outer in np.argwhere(within)]
    return [(a, b) for a, b in pairs if gaps.get((min(a, b), max(a, b)), 1.0) > 0]


def _count_gaps(found: Found, gaps: dict[tuple[int, int], float], limits: Limits) -> None:
    found.contacts = sum(gap <= 0 for gap in gaps.values())
    found.narrow_gaps = sum(0 < gap < limits.gap_mm for gap in gaps.values())


def _collect(inspected: Iterable[tuple[Any, dict[str, int]]]) -> tuple[list[Any], Found]:
    meshes, found = [], Found(not_manifold=0, misoriented=0, poor_triangles=0, short_edges=0)
    for mesh, counts in inspected:
        meshes.append(mesh)
        found.tissues += 1
        for name, number in counts.items():
            setattr(found, name, getattr(found, name) + int(number))
    return meshes, found


def _in_threads(function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    with ThreadPoolExecutor(cores) as executor:
        return list(executor.map(function, items))


def _fcl_object(fcl: Any, vertices: Any, faces: Any) -> Any:
    model = fcl.BVHModel()
    model.beginModel(len(vertices), len(faces))
    model.addSubModel(vertices, faces)
    model.endModel()
    return fcl.CollisionObject(model, fcl.Transform())


def _read_for_igl(file: Path) -> tuple[Any, Any]:
    """Read and weld with stl_reader, which is faster than libigl but ends the process on some files."""
    import igl
    import numpy as np

    with file.open("rb") as stream:
        head = stream.read(84)
    binary = len(head) == 84 and file.stat().st_size == 84 + 50 * int.from_bytes(head[80:], "little")
    try:
        import stl_reader
    except ImportError:
        stl_reader = None
    if stl_reader is not None and binary and not head.startswith(b"solid") and any(head[80:]):
        vertices, faces = stl_reader.read(str(file))
        return vertices.astype(np.float64), faces.astype(np.int64)
    vertices, faces = igl.read_triangle_mesh(str(file))
    welded, _, number, *_ = igl.remove_duplicate_vertices(vertices, faces, 0.0)
    return np.ascontiguousarray(welded), number[faces].astype(np.int64)


def main() -> int:
    """Run one stack on one model."""
    parser = argparse.ArgumentParser(description="Check a model with another library and print what it found.")
    parser.add_argument("stack", choices=[*STACKS, "vhp"])
    parser.add_argument("model", type=Path, help="directory of STL files; with vhp: a report of vhp check")
    parser.add_argument("--limits", type=float, nargs=3, metavar=("Q", "EDGE", "GAP"), help="quality, mm, mm")
    arguments = parser.parse_args()
    limits = Limits(*arguments.limits) if arguments.limits else Limits()
    if arguments.stack == "vhp":
        found = by_vhp(arguments.model, limits)
    else:
        # The largest first, so that no long task is left for the end.
        files = sorted(arguments.model.glob("*.stl"), key=lambda file: -file.stat().st_size)
        found = STACKS[arguments.stack].function(files, limits)
    json.dump(asdict(found), sys.stdout)
    return 0


if __name__ == "__main__":
    sys.exit(main())
