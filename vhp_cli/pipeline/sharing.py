"""Share out a number of triangles over the tissues of a model, by where their loss costs the least error."""

from __future__ import annotations

import queue
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vhp_cli import formats
from vhp_cli.config import Settings
from vhp_cli.errors import UnreadableFileError
from vhp_cli.model import TissueFile
from vhp_cli.pipeline.check import Progress, available_cores
from vhp_cli.pipeline.measuring import parse_in_mm
from vhp_cli.pipeline.stage import Limits
from vhp_cli.processes import CallFailed, Child

_WORK = "vhp_cli.pipeline.sharing:errors_of"
_FEWEST = 4  # of a closed surface


def errors_of(path: Path, settings: Settings) -> tuple[int, NDArray[np.float64]]:
    """Return the number of triangles of a tissue, and its error curve (`vhp_cli.stages.decimate.error_curve`).

    None for a file that can't be read: the stage says why.
    """
    from vhp_cli.stages.decimate import error_curve

    try:
        mesh = parse_in_mm(path, formats.read_bytes(path), settings).mesh
    except UnreadableFileError:
        return 0, np.empty(0)
    return len(mesh.faces), error_curve(mesh)


def share_triangles(
    tissues: Sequence[TissueFile],
    total: int,
    settings: Settings,
    *,
    jobs: int | None = None,
    limits: Limits | None = None,
    progress: Progress | None = None,
) -> dict[str, int]:
    """Return how many triangles each tissue gets, by name.

    Each is decimated in a child process as far as it goes, which gives the error that every collapse costs. Those of
    least error in the whole model are done, until the number is reached. A tissue of which nothing is known keeps its
    triangles, beyond that number.

    Parameters
    ----------
    tissues
        The tissues.
    total
        Number of triangles for all of them.
    settings
        How files are read.
    jobs
        Workers; None: one per available core.
    limits
        Of each worker.
    progress
        Called with step, number done and number in all.
    """
    limits = limits or Limits()
    jobs = min(jobs or available_cores(), len(tissues))
    children: queue.SimpleQueue[Child] = queue.SimpleQueue()
    kept = [Child(memory_gb=limits.memory_gb, name="the worker") for _ in range(jobs)]
    for child in kept:
        children.put(child)

    def one(source: TissueFile) -> tuple[int, NDArray[np.float64]]:
        child = children.get()
        try:
            found: tuple[int, NDArray[np.float64]] = child.call(
                _WORK, source.path.absolute(), settings, timeout_s=limits.timeout_s
            )
            return found
        except CallFailed:
            return 0, np.empty(0)
        finally:
            children.put(child)

    curves: dict[str, tuple[int, NDArray[np.float64]]] = {}
    try:
        with ThreadPoolExecutor(max(jobs, 1)) as executor:
            for done, (source, curve) in enumerate(zip(tissues, executor.map(one, tissues), strict=True), start=1):
                curves[source.name] = curve
                if progress:
                    progress("sharing out", done, len(tissues))
    finally:
        for child in kept:
            child.close()
    return shares(curves, total)


def shares(curves: Mapping[str, tuple[int, NDArray[np.float64]]], total: int) -> dict[str, int]:
    """Return how many triangles each tissue gets of a total.

    Parameters
    ----------
    curves
        Number of triangles, and errors that never fall from one collapse to the next, by tissue.
    total
        Number of triangles for all tissues together.
    """
    names = [name for name, (n_triangles, _) in curves.items() if n_triangles]
    errors = [curves[name][1] for name in names]
    surplus = sum(curves[name][0] for name in names) - total
    wanted = min(max(-(-surplus // 2), 0), sum(map(len, errors)))
    tissue = np.repeat(np.arange(len(names)), [len(each) for each in errors])
    # Stable: of equal errors those of the first tissue go first, and always the first ones of each.
    order = np.argsort(np.concatenate([*errors, np.empty(0)]), kind="stable")[:wanted]
    collapses = np.bincount(tissue[order], minlength=len(names))
    return {name: max(curves[name][0] - 2 * int(count), _FEWEST) for name, count in zip(names, collapses, strict=True)}
