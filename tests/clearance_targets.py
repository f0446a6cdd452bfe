"""What stands in for the stage of ``vhp separate`` in tests; run in child processes."""

from __future__ import annotations

from dataclasses import replace

from vhp_cli.pipeline.clearance import separate_tissue


def only_coarse(mesh, task):
    """Keep half of the gap at first, and fail when it is to be done more finely."""
    if task.level:
        raise RuntimeError("no finer")
    near = tuple((replace(neighbour, gap_mm=0.5 * neighbour.gap_mm), path) for neighbour, path in task.neighbours)
    return separate_tissue(mesh, replace(task, neighbours=near))


def stubborn_spleen(mesh, task):
    """Refuse the tissue that is the larger one."""
    from vhp_cli.stages.outcome import Outcome

    if abs(mesh.vertices).max() < 13:
        return Outcome(None, "refused", "it is stubborn")
    return separate_tissue(mesh, task)


def failing_spleen(mesh, task):
    """Fail on the tissue that is the larger one."""
    if abs(mesh.vertices).max() < 13:
        raise RuntimeError("it broke")
    return separate_tissue(mesh, task)
