"""Resolve self-intersections by exact union: keep what has material, drop the walls within."""

from __future__ import annotations

from functools import partial

from vhp_cli import engines
from vhp_cli.kernels.surface import quality, topology
from vhp_cli.measures import Action
from vhp_cli.mesh import Mesh
from vhp_cli.processes import CallFailed
from vhp_cli.stages.heal.candidate import as_written
from vhp_cli.stages.heal.clean import clean, remove_plugs
from vhp_cli.stages.heal.crossings import untangle
from vhp_cli.stages.heal.manifold import make_manifold
from vhp_cli.stages.heal.orientation import orient
from vhp_cli.stages.heal.quality import remove_flat
from vhp_cli.stages.heal.separation import separate

# Parts thinner than this, in mm, are left over from the cutting: the gap that separates them is as wide.
_THINNEST = 0.02


def unite(
    mesh: Mesh, *, either_sign: bool = False, timeout_s: float | None = None, memory_gb: float | None = None
) -> tuple[Mesh, list[Action]]:
    """Bound the regions that a surface encloses, in exact arithmetic.

    Parts that overlap become one. Where the two sides of a wall have passed through each other, the wall gets a hole
    there, so `untangle` should come first. What the rounding to float32 makes cross again is untangled.

    Parameters
    ----------
    mesh
        Closed and consistently oriented.
    either_sign
        Keep the regions of negative winding number too: pockets that are turned inside out stay, turned right side
        out, and touch the rest along a seam, where they are separated.
    timeout_s, memory_gb
        Limits of the engine.

    Raises
    ------
    CallFailed
        If the engine came to no result.
    """
    try:
        united = engines.call("union", mesh, timeout_s=timeout_s, memory_gb=memory_gb, either_sign=either_sign)
    except CallFailed as failed:
        if either_sign:
            raise
        # It can unite components only, but has a permissive licence and needs no system library.
        try:
            united = engines.call("component-union", mesh, timeout_s=timeout_s, memory_gb=memory_gb)
        except CallFailed:
            raise failed from None
    before, after = _volume(mesh), _volume(united)
    actions: list[Action] = [
        {
            "step": "union",
            "message": "parts that cross each other united"
            + (", pockets that were inside out included" if either_sign else ""),
            "count": 1,
            "places": [],
            "volume_mm3": after - before,
        }
    ]
    united = as_written(united)
    plugs = partial(remove_plugs, thickness=_THINNEST)
    for step in (clean, make_manifold, orient, plugs, separate, remove_flat, untangle, orient):
        united, done = step(united)
        actions += done
    return united, actions


def _volume(mesh: Mesh) -> float:
    found = topology(mesh.vertices, mesh.faces)
    return quality(mesh.vertices, mesh.faces, found.component, found.n_components).volume
