"""Third-party engines: one table, and one way to call them.

Every engine runs in a child process, as it may hang, crash, print or leave files behind. The modules beside this
file are loaded there only; each function takes vertices, faces and options, and returns vertices and faces, or points
and tetrahedra.
"""

from __future__ import annotations

import importlib.util
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import metadata
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from vhp_cli.mesh import Mesh
from vhp_cli.processes import CallFailed, Child

Name = Literal["union", "component-union", "difference", "merge", "meshfix", "tetwild", "wrap"]
VolumeName = Literal["tetwild-volume", "tetgen", "gmsh", "mmg"]


@dataclass(frozen=True, slots=True)
class Engine:
    """A third-party engine.

    Parameters
    ----------
    target
        The function that calls it, as for `Child.call`.
    purpose
        What it does to a surface, in one clause.
    distribution, module
        Name of the library for pip and for import.
    licence
        SPDX identifier.
    deterministic
        Whether the same input gives the same bytes (by measurement).
    optional
        Whether the library is no dependency of the package, but used where it is installed.
    """

    target: str
    purpose: str
    distribution: str
    module: str
    licence: str
    deterministic: bool = True
    optional: bool = False

    @property
    def version(self) -> str:
        """Version of the library; empty if it isn't installed."""
        try:
            return metadata.version(self.distribution)
        except metadata.PackageNotFoundError:
            return ""

    @property
    def available(self) -> bool:
        """Whether the library is installed (not: whether it can be loaded)."""
        return importlib.util.find_spec(self.module) is not None


ENGINES: Mapping[Name | VolumeName, Engine] = MappingProxyType(
    {
        "union": Engine(
            "vhp_cli.engines.meshlab:union",
            "bounds the regions of positive winding number, in exact arithmetic (CGAL, libigl)",
            "pymeshlab",
            "pymeshlab",
            "GPL-3.0-only",
        ),
        "component-union": Engine(
            "vhp_cli.engines.manifold:component_union",
            "unites closed components that cross each other",
            "manifold3d",
            "manifold3d",
            "Apache-2.0",
        ),
        "difference": Engine(
            "vhp_cli.engines.manifold:difference",
            "takes a solid out of another one",
            "manifold3d",
            "manifold3d",
            "Apache-2.0",
        ),
        "merge": Engine(
            "vhp_cli.engines.manifold:merge",
            "unites two solids",
            "manifold3d",
            "manifold3d",
            "Apache-2.0",
        ),
        "meshfix": Engine(
            "vhp_cli.engines.meshfix:repair",
            "removes and refills what crosses, component by component",
            "pymeshfix",
            "pymeshfix",
            "AGPL-3.0-only",
            optional=True,
        ),
        "tetwild": Engine(
            "vhp_cli.engines.tetwild:envelope",
            "rebuilds the surface within an envelope, as boundary of a tetrahedral mesh (fTetWild)",
            "pytetwild",
            "pytetwild",
            "MPL-2.0",
            deterministic=False,  # it seeds its random numbers anew each time
        ),
        "tetwild-volume": Engine(
            "vhp_cli.engines.tetwild:tetrahedralize",
            "fills a box with tetrahedra along any triangles, within an envelope (fTetWild)",
            "pytetwild",
            "pytetwild",
            "MPL-2.0",
            deterministic=False,
        ),
        "tetgen": Engine(
            "vhp_cli.engines.tetgen:tetrahedralize",
            "fills what closed surfaces enclose with tetrahedra, and keeps every triangle (TetGen)",
            "tetgen",
            "tetgen",
            "AGPL-3.0-or-later",  # of TetGen; its Python wrapper is under the MIT licence
            optional=True,
        ),
        "gmsh": Engine(
            "vhp_cli.engines.gmsh:tetrahedralize",
            "fills what closed surfaces enclose with tetrahedra, and keeps every triangle (Gmsh, Netgen)",
            "gmsh",
            "gmsh",
            "GPL-2.0-or-later",
            optional=True,
        ),
        "mmg": Engine(
            "vhp_cli.engines.mmg:improve",
            "betters the shape of tetrahedra between triangles that stay (MMG)",
            "mmgpy",
            "mmgpy",
            "LGPL-3.0-or-later",  # of MMG; its Python wrapper is under the MIT licence
            optional=True,
        ),
        "wrap": Engine(
            "vhp_cli.engines.meshlab:alpha_wrap",
            "wraps the surface from outside (CGAL alpha wrapping)",
            "pymeshlab",
            "pymeshlab",
            "GPL-3.0-only",
        ),
    }
)

_local = threading.local()


def call(
    name: Name,
    mesh: Mesh,
    *,
    timeout_s: float | None = None,
    memory_gb: float | None = None,
    **options: float | bool,
) -> Mesh:
    """Return what an engine makes of a mesh.

    Each thread keeps one child process for its calls, which ends with the thread.

    Parameters
    ----------
    name
        Key of `ENGINES`.
    mesh
        The surface, in mm.
    timeout_s, memory_gb
        Limits of the call; see `Child`.
    options
        Of the engine: see its function.

    Raises
    ------
    CallFailed
        If there is no surface: a limit was broken, the engine failed or crashed, it isn't installed, or what
        it returned is empty or not finite.
    """
    child, limit = getattr(_local, "child", (None, None))
    if child is None or limit != memory_gb:
        if child is not None:
            child.close()
        child = Child(memory_gb=memory_gb, name="the engine")
        _local.child = child, memory_gb
    vertices, faces = _called(child, name, mesh, options, timeout_s)
    if not len(faces):
        raise CallFailed("error", f"{name} ({ENGINES[name].distribution}): returned no faces")
    if not np.isfinite(vertices).all():
        raise CallFailed("error", f"{name} ({ENGINES[name].distribution}): returned coordinates that are not finite")
    return Mesh(vertices, faces)


def call_volume(
    name: VolumeName,
    mesh: Mesh,
    *,
    timeout_s: float | None = None,
    memory_gb: float | None = None,
    on_output: Callable[[bytes], None] | None = None,
    **options: Any,
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return the tetrahedra that an engine makes of a surface: points (N, 3) in mm, and their indices (M, 4).

    The child process ends with the call, as tetrahedra take much memory.

    Parameters
    ----------
    name, mesh, timeout_s, memory_gb, options
        As of `call`.
    on_output
        Called with what the engine prints, from another thread.

    Raises
    ------
    CallFailed
        If there are no tetrahedra: a limit was broken, the engine failed or crashed, it isn't installed, or what it
        returned is empty, not finite, or refers to points that do not exist.
    """
    label = f"{name} ({ENGINES[name].distribution})"
    with Child(memory_gb=memory_gb, name="the engine", on_output=on_output) as child:
        points, tetrahedra = _called(child, name, mesh, options, timeout_s)
    if not len(tetrahedra):
        raise CallFailed("error", f"{label}: returned no tetrahedra")
    if not np.isfinite(points).all():
        raise CallFailed("error", f"{label}: returned coordinates that are not finite")
    if tetrahedra.min() < 0 or tetrahedra.max() >= len(points):
        raise CallFailed("error", f"{label}: returned tetrahedra with corners that do not exist")
    return points, tetrahedra


def _called(
    child: Child, name: Name | VolumeName, mesh: Mesh, options: Mapping[str, Any], timeout_s: float | None
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return the two arrays that an engine gives back; a failure names the engine."""
    try:
        points, cells = child.call(ENGINES[name].target, mesh.vertices, mesh.faces, options, timeout_s=timeout_s)
    except CallFailed as failed:
        detail = failed.detail.removeprefix("the engine").lstrip(": ")
        raise CallFailed(failed.reason, f"{name} ({ENGINES[name].distribution}): {detail}") from None
    return points, cells
