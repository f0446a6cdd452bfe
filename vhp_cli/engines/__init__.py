"""Third-party engines: one table, and one way to call them.

Every engine runs in a child process, as it may hang, crash, print or leave files behind. The modules beside this
file are loaded there only; each function takes vertices, faces and options, and returns vertices and faces.
"""

from __future__ import annotations

import importlib.util
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import metadata
from types import MappingProxyType
from typing import Literal

import numpy as np

from vhp_cli.mesh import Mesh
from vhp_cli.processes import CallFailed, Child

Name = Literal["union", "component-union", "meshfix", "tetwild", "wrap"]


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


ENGINES: Mapping[Name, Engine] = MappingProxyType(
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
    try:
        vertices, faces = child.call(ENGINES[name].target, mesh.vertices, mesh.faces, options, timeout_s=timeout_s)
    except CallFailed as failed:
        detail = failed.detail.removeprefix("the engine").lstrip(": ")
        raise CallFailed(failed.reason, f"{name} ({ENGINES[name].distribution}): {detail}") from None
    if not len(faces):
        raise CallFailed("error", f"{name} ({ENGINES[name].distribution}): returned no faces")
    if not np.isfinite(vertices).all():
        raise CallFailed("error", f"{name} ({ENGINES[name].distribution}): returned coordinates that are not finite")
    return Mesh(vertices, faces)
