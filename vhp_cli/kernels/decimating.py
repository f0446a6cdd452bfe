"""Decimation by guarded collapses: fewer triangles, and a surface that is as valid as it was."""

from __future__ import annotations

import ctypes
import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vhp_cli import rounding
from vhp_cli.errors import KernelError
from vhp_cli.kernels._library import address, check_allocation, f64, function, i32, i64, pointer
from vhp_cli.kernels.remeshing import (
    _COUNTS,
    _LEAST_FOLD_DEG,
    Remesher,
    _checked_mesh,
    _components,
    _create,
    _extent,
    _free,
    _read,
    _Settings,
    _volumes,
)
from vhp_cli.kernels.spatial import Tree, _tree

Float = NDArray[np.float64]
Int = NDArray[np.int32]
Method = Literal["quadric", "midpoint", "removal"]
Ending = Literal["target", "edge length", "error", "refused", "work"]

# Mirrored from guarded_decimate.c, by number.
_PLACES: dict[Method, int] = {"quadric": 0, "midpoint": 1, "removal": 2}
_ENDINGS: tuple[Ending, ...] = get_args(Ending)
_GUARDS = ("topology", "quality", "normal", "envelope", "contact", "deviation")
_UNLIMITED = 1e200


class _Decimation(ctypes.Structure):
    """`Decimation` of guarded_decimate.c."""

    _fields_ = (
        ("target_faces", i64),
        ("edge_length", f64),
        ("max_error", f64),
        ("min_quality", f64),
        ("place", i32),
        ("with_contacts", i32),
    )


_decimate = function(
    "vhp_guarded_decimate", ctypes.c_int, [pointer, ctypes.POINTER(_Decimation), _tree] + [pointer] * 3
)
_vertex_components = function("vhp_guarded_vertex_components", None, [pointer, pointer])
_want_volumes = function("vhp_guarded_want_volumes", None, [pointer, pointer])


@dataclass(frozen=True, slots=True, eq=False)
class Decimated:
    """A decimated mesh, and how it came about.

    Parameters
    ----------
    vertices : (V, 3) float64
        With float32 values, in mm.
    faces : (F, 3) int32
    errors : (C,) float64
        Largest error of all collapses up to each: the root of the mean squared distance of the vertex from the
        planes of the original faces that it stands for, in mm; with the method ``"midpoint"``, the length of the edge.
    ending
        ``"target"``, ``"edge length"`` and ``"error"``: that limit was reached; ``"refused"``: the guards refuse
        whatever is left; ``"work"``: the bound on the time was reached.
    last_refused
        Collapses refused by each guard in the last round, in which none was done any more: ``"topology"``,
        ``"quality"``, ``"normal"``, ``"envelope"`` (no good place), ``"contact"``, ``"deviation"``.
    volumes : (V,) float64
        Of the component of each vertex before the decimation, in mm3; NaN where that is open.
    """

    vertices: Float
    faces: Int
    errors: Float
    ending: Ending
    last_refused: dict[str, int]
    volumes: Float


def decimate(
    vertices: ArrayLike,
    faces: ArrayLike,
    *,
    target_triangles: int = 0,
    edge_length: float = math.inf,
    max_error: float = math.inf,
    max_deviation: float = math.inf,
    method: Method = "quadric",
    min_quality: float = 0.0,
    check_contacts: bool = True,
    max_work: int = 10**15,
) -> Decimated:
    """Collapse edges, those of least error first, until a limit is reached.

    A surface without contacts stays without: if the result has one, as few do, all is done again with a test for
    contacts at every collapse. This adds none to those that there are.

    Vertices on edges that do not have exactly two faces in opposite directions stay, and so do these edges.

    Parameters
    ----------
    vertices : (V, 3) array_like
        Coordinates in mm, which must be float32 values.
    faces : (F, 3) array_like
        Vertex indices of each triangle.
    target_triangles
        End with so many, or one less.
    edge_length
        End when the mean edge is so long, in mm; looked at after every 2 % of the triangles.
    max_error
        End when the least error (see `Decimated.errors`) exceeds this.
    max_deviation
        Largest distance between the surface and the original one, either way, in mm: of the original vertices, and of
        vertices, edges and faces at a few points of each, so that it can be exceeded between these.
    method
        ``"quadric"``: the vertex goes to where the planes of the original faces want it, without a change of the
        volume (Garland & Heckbert 1997; Lindstrom & Turk 1998 for the volume); ``"midpoint"``: the shortest edge
        becomes its midpoint; ``"removal"``: a vertex goes, and the hole is filled by a fan from one of its
        neighbours, the one of least quadric error.
    min_quality
        q = 2 r_in / r_out below which no collapse may leave a triangle, unless there was a worse one before.
    check_contacts
        False: let the surface touch and cross itself; only for an estimate of the errors.
    max_work
        Bound on the time, by boxes and triangles looked at.

    Raises
    ------
    ValueError
        If a shape, an index, a coordinate or a setting is wrong.
    KernelError
        If memory runs out.
    """
    vertices, faces = _checked_mesh(vertices, faces)
    if method not in _PLACES:
        raise ValueError(f"no method {method!r}")
    for name, value in (("edge_length", edge_length), ("max_error", max_error), ("max_deviation", max_deviation)):
        if not value > 0:
            raise ValueError(f"{name} must be above 0, not {value}")
    if not 0 <= min_quality <= 1:
        raise ValueError(f"min_quality must be from 0 to 1, not {min_quality}")
    if not len(faces):
        nothing = dict.fromkeys(_GUARDS, 0)
        return Decimated(np.empty((0, 3)), np.empty((0, 3), np.int32), np.empty(0), "target", nothing, np.empty(0))
    wanted = _Decimation(
        max(target_triangles, 0), edge_length, min(max_error, 1e150), min_quality, _PLACES[method], False
    )
    made = _decimated(vertices, faces, wanted, max_deviation, max_work)
    if check_contacts and Tree(made.vertices, made.faces).self_hits(0).n_pairs:
        wanted.with_contacts = True
        made = _decimated(vertices, faces, wanted, max_deviation, max_work)
    return made


def _decimated(vertices: Float, faces: Int, wanted: _Decimation, max_deviation: float, max_work: int) -> Decimated:
    settings = _Settings(
        deviation=min(max_deviation, _UNLIMITED),
        fold_cosine=math.cos(math.radians(180 - _LEAST_FOLD_DEG)),
        unit=rounding.unit_mm(),
        max_faces=len(faces) + 2,
        max_work=max_work,
    )
    tree = Tree(vertices, faces) if math.isfinite(max_deviation) else None
    nothing = Tree(np.empty((0, 3)), np.empty((0, 3), np.int32))
    sizes, no_sizes, no_samples = np.ones(len(vertices)), np.empty((0, 3)), np.empty((0, 3))
    handle = _create(
        address(vertices),
        len(vertices),
        address(faces),
        len(faces),
        address(sizes),
        None,
        nothing._view,
        address(no_sizes),
        address(no_samples),
        0,
        settings,
    )
    if not handle:
        raise KernelError("out of memory in a compiled kernel")
    try:
        errors, done = np.empty(len(faces) // 2 + 1), np.zeros(1, np.int64)
        refused = np.zeros(_COUNTS, np.int64)
        ending = _decimate(
            handle, wanted, None if tree is None else tree._view, address(errors), address(done), address(refused)
        )
        check_allocation(ending)
        extent = np.zeros(2, np.int64)
        _extent(handle, address(extent), address(extent) + 8)
        made, made_sizes = np.empty((int(extent[0]), 3)), np.empty(int(extent[0]))
        made_faces = np.empty((int(extent[1]), 3), np.int32)
        check_allocation(_read(handle, address(made), address(made_sizes), address(made_faces)))
        component = np.empty(len(made), np.int32)
        _vertex_components(handle, address(component))
        volume, area, before = (np.empty(_components(handle)) for _ in range(3))
        _volumes(handle, address(volume), address(area), address(before))
    finally:
        _free(handle)
    return Decimated(
        made,
        made_faces,
        errors[: int(done[0])].copy(),
        _ENDINGS[ending],
        dict(zip(_GUARDS, refused[4:10].tolist(), strict=True)),
        before[component],
    )


def want_volumes(remesher: Remesher, volumes: ArrayLike) -> None:
    """Make a remesher restore other volumes than those that its mesh has, such as `Decimated.volumes`.

    Parameters
    ----------
    remesher
        Just made, from a mesh of which every vertex is in use.
    volumes : (V,) array_like
        Of the component of each vertex, in mm3; NaN: none is restored.
    """
    volumes = np.ascontiguousarray(volumes, dtype=np.float64)
    component = _components_of(remesher)
    if volumes.shape != component.shape:
        raise ValueError(f"volumes must have shape {component.shape}, not {volumes.shape}")
    wanted = np.full(_components(remesher._handle), np.nan)
    wanted[component] = volumes
    _want_volumes(remesher._handle, address(wanted))


def wanted_volumes(remesher: Remesher) -> Float:
    """Return the volume that a remesher restores, of the component of each vertex of its result, in mm3 (V,)."""
    found: Float = remesher.volumes()[1][_components_of(remesher)]
    return found


def _components_of(remesher: Remesher) -> Int:
    component = np.empty(remesher._extent()[0], np.int32)
    _vertex_components(remesher._handle, address(component))
    return component
