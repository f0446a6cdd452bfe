"""The textbook methods under guard: each iteration is taken only as far as the surface stays sound."""

from __future__ import annotations

from collections.abc import Iterator

from vhp_cli.kernels.smoothing import Smoothing, smoothing_steps
from vhp_cli.mesh import Mesh
from vhp_cli.stages.smooth.guard import Guard
from vhp_cli.stages.smooth.history import State, measured
from vhp_cli.stages.smooth.relaxing import remesher_of

# Parts of an iteration to try, until one keeps the volume.
_PARTS = (1.0, 0.5, 0.25, 0.1)
# Share of the volume's tolerance that is left alone.
_VOLUME_LEFT = 0.5


def stepped(guard: Guard, smoothing: Smoothing, tolerance: float, *, flips: bool) -> Iterator[State]:
    """Yield the given surface after each iteration of a method, as long as anything changes.

    Parameters
    ----------
    guard
        The surface and its limits.
    smoothing
        The method.
    tolerance
        Largest change of the volume, as a share of it; the volume is restored in each iteration.
    flips
        Whether each iteration ends with flips, where the worse of two triangles gets better.
    """
    mesh, iteration = guard.given, 0
    while True:
        iteration += 1
        found = _next_state(guard, mesh, smoothing, tolerance, iteration, flips=flips)
        if found is None:
            return
        mesh = found.mesh
        yield found


def _next_state(
    guard: Guard, mesh: Mesh, smoothing: Smoothing, tolerance: float, iteration: int, *, flips: bool
) -> State | None:
    """Return the mesh after an iteration or part of it; None if nothing keeps the volume, or nothing changes."""
    step = next(smoothing_steps(mesh.vertices, mesh.faces, smoothing, fixed=guard.fixed))
    for part in _PARTS:
        settled = guard.settle(mesh, mesh.vertices + part * (step.vertices - mesh.vertices))
        for flipping in (True, False) if flips else (False,):
            moved, flipped = settled.mesh, 0
            if flipping:
                remesher = remesher_of(moved, guard)
                flipped = remesher.flip()
                moved = Mesh(*remesher.result())
            if guard.volume_error(moved) > _VOLUME_LEFT * tolerance:
                moved = guard.restore_volume(moved, tolerance)
            if guard.volume_error(moved) > tolerance:
                continue
            if not settled.moved and not flipped:
                return None
            return measured(moved, smoothing.method, iteration, flips=flipped, moves=settled.moved, held=settled.held)
    return None
