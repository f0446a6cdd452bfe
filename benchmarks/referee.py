"""Judge what a repairer made of a mesh: by the gate of vhp and by other libraries. Runs in a child process."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vhp_cli.inspection.deviation import LostPart, deviation, lost_parts
from vhp_cli.measures import Deviation
from vhp_cli.mesh import Mesh
from vhp_cli.stages.heal.candidate import Candidate, as_written, diagonal, judge
from vhp_cli.stages.heal.cascade import lost_limit

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Arrays = tuple[Floats, Ints]

# Of the topology and the self-intersections: what a solid has none of.
FLAWS = (
    "boundary_edges",
    "nonmanifold_edges",
    "nonmanifold_vertices",
    "inconsistent_edges",
    "inward_components",
    "duplicate_faces",
    "degenerate_faces",
)


@dataclass(frozen=True, slots=True, eq=False)
class Input:
    """What all outputs for one mesh are compared with.

    Parameters
    ----------
    given
        The input and its measures.
    clean
        What it means, and the measures of that; None: nobody can tell.
    from_truth
        How far the two lie apart.
    """

    given: Candidate
    clean: Candidate | None
    from_truth: Deviation | None


@functools.lru_cache(maxsize=1)
def _input(*parts: tuple[bytes, str, tuple[int, ...]] | None) -> Input:
    arrays = [None if part is None else np.frombuffer(part[0], part[1]).reshape(part[2]) for part in parts]
    given = judge(Mesh(arrays[0], arrays[1]))
    if arrays[2] is None:
        return Input(given, None, None)
    clean = judge(Mesh(arrays[2], arrays[3]))
    return Input(given, clean, deviation(given.mesh, clean.mesh, lost_limit_mm=0.0))


def judged(before: Arrays, after: Arrays, clean: Arrays | None) -> dict[str, Any]:
    """Return what is right and wrong with an output, all of it in the form in which it would be written as STL.

    Parameters
    ----------
    before, after
        Vertices (V, 3) in mm and faces (F, 3).
    clean
        What the input means, if that is known.
    """
    finite = bool(np.isfinite(after[0]).all())
    made = judge(Mesh(*after)) if finite else None
    if made is None or not len(made.mesh.faces):
        flaw = "no faces" if finite else "coordinates that are not finite"
        return {"sound": False, "independent": False, "flaws": [flaw], "triangles": 0}
    # Inputs stay the same for all repairers: measured once.
    reference = _input(
        *((array.tobytes(), array.dtype.str, array.shape) for array in before),
        *((array.tobytes(), array.dtype.str, array.shape) for array in clean or ()),
        *(() if clean else (None, None)),
    )
    given = reference.given
    complaints = other_libraries(made.mesh)
    limit, lost = deviation_limit(given.mesh), lost_limit(given.mesh)
    apart = deviation(given.mesh, made.mesh, lost_limit_mm=lost)
    outside: list[LostPart] = []
    if apart["to_output"]["max"] > limit:
        outside = [part for part in lost_parts(given.mesh, made.mesh, limit_mm=limit) if part.share_outside > 0.5]
    return {
        "sound": made.sound,
        "independent": not complaints,
        "flaws": [*made.flaws, *complaints],
        "new_flaws": new_flaws(given, made),
        "triangles": len(made.mesh.faces),
        "min_quality": made.min_quality,
        "mean_quality": made.mean_quality,
        "min_edge_mm": made.min_edge,
        "limit_mm": limit,
        "lost_limit_mm": lost,
        "to_output_mm": apart["to_output"]["max"],
        "to_input_mm": apart["to_input"]["max"],
        "outside_mm": outside[0].distance_mm if outside else 0.0,
        "outside_at_mm": outside[0].xyz_mm if outside else None,
        "lost_area_mm2": apart["lost_area_mm2"],
        "volume_change": _volume(made) / _volume(given) - 1 if given.sound else None,
        "truth": beside_truth(made, reference.clean, reference.from_truth),
    }


def beside_truth(made: Candidate, clean: Candidate | None, input_apart: Deviation | None) -> dict[str, float] | None:
    """Return how far the input and the output lie from the truth, in mm, and by how much the volume is wrong."""
    if clean is None or input_apart is None:
        return None
    apart = deviation(made.mesh, clean.mesh, lost_limit_mm=0.0)
    return {
        "input_mm": input_apart["max"],
        "output_mm": apart["max"],
        "input_mean_mm": input_apart["mean"],
        "output_mean_mm": apart["mean"],
        "volume_error": _volume(made) / _volume(clean) - 1,
    }


def _volume(candidate: Candidate) -> float:
    return candidate.measures["volume_mm3"]


def deviation_limit(mesh: Mesh) -> float:
    """Return how far input and output may lie apart by default, in mm."""
    return min(0.1, 1e-3 * diagonal(mesh))


def new_flaws(given: Candidate, made: Candidate) -> list[str]:
    """Return the kinds of flaws that the output has and the input has not."""
    found = [flaw for flaw in FLAWS if made.measures["topology"][flaw] and not given.measures["topology"][flaw]]
    if made.measures["self_intersections"]["pairs"] and not given.measures["self_intersections"]["pairs"]:
        found.append("self_intersections")
    return found


def other_libraries(mesh: Mesh) -> list[str]:
    """Return what trimesh and libigl (or, without it, MeshLab) have against a mesh."""
    import trimesh

    surface = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    found = []
    if not surface.is_watertight:
        found.append("trimesh: not watertight")
    if not surface.is_winding_consistent:
        found.append("trimesh: winding not consistent")
    if not surface.volume > 0:
        found.append("trimesh: no positive volume")
    return found + _crossings(mesh)


def _crossings(mesh: Mesh) -> list[str]:
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces)
    try:
        from igl.copyleft import cgal
    except ImportError:
        import pymeshlab

        meshes = pymeshlab.MeshSet(verbose=False)
        meshes.add_mesh(pymeshlab.Mesh(vertices, faces))
        meshes.compute_selection_by_self_intersections_per_face()
        return ["MeshLab: self-intersections"] if meshes.current_mesh().selected_face_number() else []
    pairs = cgal.remesh_self_intersections(vertices, faces.astype(np.int64), detect_only=True, first_only=True)[2]
    return ["libigl: self-intersections"] if len(pairs) else []


def written(vertices: Floats, faces: Ints) -> Arrays:
    """Return a mesh as a reader gets it from an STL file."""
    mesh = as_written(Mesh(vertices, faces))
    return mesh.vertices, mesh.faces
