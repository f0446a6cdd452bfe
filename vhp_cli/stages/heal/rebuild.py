"""Rebuild a surface as a whole, where no local repair helps."""

from __future__ import annotations

import numpy as np

from vhp_cli import engines
from vhp_cli.measures import Action
from vhp_cli.mesh import Mesh
from vhp_cli.stages.heal.candidate import as_written, diagonal
from vhp_cli.stages.heal.clean import clean
from vhp_cli.stages.heal.crossings import untangle
from vhp_cli.stages.heal.manifold import make_manifold
from vhp_cli.stages.heal.orientation import orient
from vhp_cli.stages.heal.quality import remove_flat
from vhp_cli.stages.heal.separation import separate
from vhp_cli.stages.heal.zones import normals_at

# Of the diagonal of the box.
_ENVELOPE = 5e-4
_EDGE_LENGTH = 0.03
_ALPHA = 1e-2
_OFFSET = 6e-4


def refill(mesh: Mesh, *, timeout_s: float | None = None, memory_gb: float | None = None) -> tuple[Mesh, list[Action]]:
    """Rebuild each component by cutting out and refilling what crosses (MeshFix); needs the optional pymeshfix.

    Raises
    ------
    CallFailed
        If the engine came to no result, or is not installed.
    """
    rebuilt = engines.call("meshfix", mesh, timeout_s=timeout_s, memory_gb=memory_gb)
    return _finished(rebuilt, "components refilled where they crossed (MeshFix)")


def envelope(
    mesh: Mesh, *, timeout_s: float | None = None, memory_gb: float | None = None
) -> tuple[Mesh, list[Action]]:
    """Rebuild the surface as boundary of tetrahedra within 0.05 % of the diagonal (fTetWild).

    Not deterministic: two runs differ within the envelope.

    Raises
    ------
    CallFailed
        If the engine came to no result.
    """
    size = diagonal(mesh)
    rebuilt = engines.call(
        "tetwild",
        mesh,
        timeout_s=timeout_s,
        memory_gb=memory_gb,
        envelope_mm=_ENVELOPE * size,
        edge_length_mm=_EDGE_LENGTH * size,
    )
    return _finished(rebuilt, f"surface rebuilt within {_ENVELOPE * size:.3g} mm (fTetWild)")


def wrap(mesh: Mesh, *, timeout_s: float | None = None, memory_gb: float | None = None) -> tuple[Mesh, list[Action]]:
    """Wrap the surface from outside (CGAL alpha wrapping); openings wider than 1 % of the diagonal let it in.

    The wrap lies a small offset outside of the surface, by which it is moved back inward.

    Raises
    ------
    CallFailed
        If the engine came to no result.
    """
    size = diagonal(mesh)
    alpha, offset = _ALPHA * size, _OFFSET * size
    rebuilt = engines.call("wrap", mesh, timeout_s=timeout_s, memory_gb=memory_gb, alpha_mm=alpha, offset_mm=offset)
    vertices = rebuilt.vertices - offset * normals_at(rebuilt.vertices, rebuilt.faces)
    rebuilt = Mesh(np.where(np.isfinite(vertices), vertices, rebuilt.vertices), rebuilt.faces)
    return _finished(rebuilt, f"surface wrapped, openings above {alpha:.3g} mm kept (CGAL alpha wrap)")


def _finished(mesh: Mesh, message: str) -> tuple[Mesh, list[Action]]:
    actions: list[Action] = [{"step": "rebuild", "message": message, "count": 1, "places": []}]
    mesh = as_written(mesh)
    for step in (clean, make_manifold, orient, separate, remove_flat, untangle, orient):
        mesh, done = step(mesh)
        actions += done
    return mesh, actions
