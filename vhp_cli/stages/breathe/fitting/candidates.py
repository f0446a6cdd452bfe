"""Choose, for one tissue, the gentlest of several motions that leaves it and its neighbours enough room."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from vhp_cli.stages.breathe.fitting.scene import Scene
from vhp_cli.stages.breathe.sequence import Motion


def choose(
    scene: Scene, name: str, candidates: Iterable[Motion | None], obstacles: Sequence[str], times: Sequence[float]
) -> float:
    """Give a tissue the motion with the smallest displacement that keeps all gaps, or the least bad one.

    Parameters
    ----------
    scene
        Where everything is.
    name
        The tissue.
    candidates
        Motions to choose from; None: it stays.
    obstacles
        What must be cleared.
    times
        When.

    Returns
    -------
    float
        How much gap is missing in all, in mm; 0: all gaps are kept.
    """
    ordered = sorted(candidates, key=lambda motion: effort(scene, name, motion))
    best, least = None, np.inf
    for motion in ordered:
        missing = scene.badness(name, motion, obstacles, times, contacts=True)
        if missing < least:
            best, least = motion, missing
        if missing == 0.0:
            break
    scene.set(name, best)
    return least


def effort(scene: Scene, name: str, motion: Motion | None) -> float:
    """Return the root mean square displacement of a tissue's vertices at t = N, in mm."""
    if motion is None:
        return 0.0
    rest = scene.tissues[name].mesh.vertices
    moved = motion.apply(rest, float(scene.steps))
    return float(np.sqrt(((moved - rest) ** 2).sum(axis=1).mean()))
