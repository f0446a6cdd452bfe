"""The smoothing methods of the thesis as they are defined: nothing keeps triangles from inverting or tissues apart."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from vhp_cli.kernels.smoothing import Smoothing, smoothing_steps, volume_about
from vhp_cli.kernels.surface import quality
from vhp_cli.mesh import Mesh


class Method(StrEnum):
    """Where a vertex ``p_i`` is moved to, by the names of thesis 2.3.3.

    Attributes
    ----------
    STANDARD
        Standard Laplacian smoothing, eq. 2.12: the mean of the k neighbours, ``1/k sum p_j``.
    LUMPED
        Lumped Laplacian smoothing, eq. 2.13: ``1/3 p_i + 2/3 1/k sum p_j``.
    CVT
        Centroid Voronoi tessellation smoothing, eq. 2.14: ``sum t_j A_j / sum A_j`` over the centroids ``t_j`` and the
        areas ``A_j`` of the attached triangles.
    WCC
        Weighted centroid of circumcentres smoothing, eq. 2.15: ``sum c_j A_j / sum A_j`` over their circumcentres.
    CVT_EQUAL
        Eq. 2.14 with equal weights: at an inner vertex the same as eq. 2.13.
    WCC_EQUAL
        Eq. 2.15 with equal weights.
    """

    STANDARD = "standard"
    LUMPED = "lumped"
    CVT = "cvt"
    WCC = "wcc"
    CVT_EQUAL = "cvt-equal"
    WCC_EQUAL = "wcc-equal"


class Update(StrEnum):
    """When a vertex takes its new position (thesis 2.3.4).

    Attributes
    ----------
    SIMULTANEOUS
        After all new positions are known.
    SEQUENTIAL
        At once, so that the vertices after it already see it there.
    """

    SIMULTANEOUS = "simultaneous"
    SEQUENTIAL = "sequential"


class Correction(StrEnum):
    """What is done against shrinkage; the formulas and their sources stand at `kernels.smoothing.Smoothing`.

    Attributes
    ----------
    NONE
        Nothing.
    HC
        The vertices are pushed back towards their previous and original positions (thesis 2.3.5; Vollmer et al. 1999).
    TAUBIN
        Every pass is followed by one in the other direction (Taubin 1995).
    VOLUME
        Every component is offset to the volume that it had at first.
    """

    NONE = "none"
    HC = "hc"
    TAUBIN = "taubin"
    VOLUME = "volume"


@dataclass(frozen=True, slots=True)
class TextbookSettings:
    """How to smooth, and when to stop.

    Parameters
    ----------
    smoothing
        The method, its update, step factor and correction.
    flips
        Re-triangulate after each iteration by edge flips, until the surface is Delaunay (thesis 2.3.4).
    iterations
        How many at most.
    until_q
        Stop as soon as every triangle has at least this q. None: no such goal.
    patience
        Stop after so many iterations in a row in which the mean q did not exceed its highest value before (thesis
        2.3.4), and unless `until_q` was reached, take the mesh that had that. None: take the last mesh.

    Raises
    ------
    ValueError
        If a number is out of range.
    """

    smoothing: Smoothing = Smoothing()  # noqa: RUF009 - frozen
    flips: bool = False
    iterations: int = 10
    until_q: float | None = None
    patience: int | None = None

    def __post_init__(self) -> None:
        if self.iterations < 0:
            raise ValueError(f"iterations must not be negative, not {self.iterations}")
        if self.until_q is not None and not 0 <= self.until_q <= 1:
            raise ValueError(f"until_q must lie in [0, 1], not {self.until_q}")
        if self.patience is not None and self.patience < 1:
            raise ValueError(f"patience must be at least 1, not {self.patience}")


@dataclass(frozen=True, slots=True)
class Iteration:
    """The mesh after an iteration.

    Parameters
    ----------
    number
        0 for the mesh as given.
    min_q, mean_q
        Of q = 2 r_in / r_out (thesis eq. 2.4) over the faces; NaN if there is none.
    volume_mm3
        Enclosed volume; of an open surface, the volume between it and the mean of the vertices as given.
    flips
        Edges flipped in this iteration.
    held
        Components that skipped this iteration, because it would have lost the volume that is to be kept.
    """

    number: int
    min_q: float
    mean_q: float
    volume_mm3: float
    flips: int
    held: int


@dataclass(frozen=True, slots=True, eq=False)
class Smoothed:
    """A smoothed mesh.

    Parameters
    ----------
    mesh
        With the vertices, and but for flips the faces, of the mesh as given, in their order.
    history
        From the mesh as given to the last iteration that was carried out.
    chosen
        Number of the iteration after which `mesh` was taken.
    """

    mesh: Mesh
    history: tuple[Iteration, ...]
    chosen: int


def _measure(mesh: Mesh, anchor: NDArray[np.float64], number: int, flips: int = 0, held: int = 0) -> Iteration:
    if not len(mesh.faces):
        return Iteration(number, math.nan, math.nan, 0.0, flips, held)
    unlabelled = np.full(len(mesh.faces), -1, dtype=np.int32)
    q = quality(mesh.vertices, mesh.faces, unlabelled, 0).q
    volume = volume_about(mesh.vertices, mesh.faces, anchor)
    return Iteration(number, float(q.min()), float(q.mean()), volume, flips, held)


def smooth_textbook(mesh: Mesh, settings: TextbookSettings, fixed: NDArray[np.bool_] | None = None) -> Smoothed:
    """Smooth a mesh by a method of the thesis, unguarded.

    Parameters
    ----------
    mesh
        Any triangle mesh; its boundary stays.
    settings
        Method and end.
    fixed : (V,) bool
        Further vertices that stay, and with flips the edges between them. None: no vertex.

    Raises
    ------
    ValueError
        If `fixed` has a wrong shape or type.
    KernelError
        If memory runs out.
    """
    best = current = mesh
    anchor = mesh.vertices.mean(axis=0) if len(mesh.vertices) else np.zeros(3)
    history = [_measure(mesh, anchor, 0)]
    highest = latest = history[0]
    steps = smoothing_steps(mesh.vertices, mesh.faces, settings.smoothing, fixed=fixed, flips=settings.flips)

    def reached() -> bool:
        return settings.until_q is not None and latest.min_q >= settings.until_q

    while latest.number < settings.iterations and not reached():
        if settings.patience is not None and latest.number - highest.number >= settings.patience:
            break
        step = next(steps)
        current = Mesh(step.vertices, step.faces)
        latest = _measure(current, anchor, latest.number + 1, step.flips, step.held)
        history.append(latest)
        if latest.mean_q > highest.mean_q:
            best, highest = current, latest
    if settings.patience is not None and not reached():
        return Smoothed(best, tuple(history), highest.number)
    return Smoothed(current, tuple(history), latest.number)
