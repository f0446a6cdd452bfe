"""What is asked of the mesher, and what is asked next: after a mesh that is not good enough, and after a failure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from vhp_cli.measures import TetmeshAttempt
from vhp_cli.processes import CallFailed
from vhp_cli.stages.tetmesh.measuring import Measured
from vhp_cli.stages.tetmesh.options import TetmeshOptions
from vhp_cli.stages.tetmesh.tissues import Tissue
from vhp_cli.volume import BACKGROUND, VolumeMesh

# What is asked of the engine when it ran out of time or memory.
_DRAFT_ENERGY = 30.0
_DRAFT_ITERATIONS = 10
_DRAFT_EDGE = 1.5
# And when its mesh was not good enough; below 7 it may not end.
_FINE_ENERGY = 8.0
_FINE_EPSILON = 0.5
_FINE_ITERATIONS = 2
# How long it may take to better a mesh, in times that the mesh took.
_PATIENCE = 2.0
_LEAST_PATIENCE_S = 30.0
# Crashes depend on the engine's random numbers and on single coordinates: another envelope, then other edges, too.
_CRASHES = 3
_OTHER = 0.9
# Of the number of tetrahedra allowed, how many are aimed at.
_AIM = 0.9
# So much may volumes be off, of so many labels at least.
_VOLUME_ERROR = 0.01
_LABELS_RIGHT = 0.95


@dataclass(frozen=True, slots=True)
class Request:
    """What is asked of the engine: the options that change from one attempt to the next."""

    edge_length_mm: float
    epsilon_mm: float
    stop_energy: float
    iterations: int
    coarsen: bool


@dataclass(frozen=True, slots=True, eq=False)
class Made:
    """One attempt that came to a mesh."""

    mesh: VolumeMesh
    measured: Measured
    request: Request
    notes: tuple[str, ...]

    @property
    def tets(self) -> int:
        """Number of tetrahedra, air left out."""
        return int((self.mesh.labels != BACKGROUND).sum())

    def exceeds(self, options: TetmeshOptions) -> bool:
        """Tell if there are more tetrahedra than allowed."""
        return options.max_tets is not None and self.tets > options.max_tets

    @property
    def has_volumes(self) -> bool:
        """Whether the volumes of nearly all labels are right, as far as they are known."""
        errors = [abs(label["volume_error"]) for label in self.measured.labels if label["volume_error"] is not None]
        return sum(error <= _VOLUME_ERROR for error in errors) >= _LABELS_RIGHT * len(errors)

    def targets_met(self, options: TetmeshOptions) -> int:
        """Return how many of the two targets of quality are met."""
        quality = self.measured.quality
        if quality is None:
            return 0
        angle, ratio = quality["min_dihedral_deg"], quality["radius_ratio_p01"]
        return (angle >= options.min_dihedral_deg) + (ratio >= options.radius_ratio)

    def rank(self, options: TetmeshOptions) -> tuple[float, ...]:
        """Return what tells the better of two: tissues, limits and volumes kept, targets met, then the worst angle."""
        tissues = sum(label["tets"] > 0 for label in self.measured.labels)
        excess = -float(self.tets) if self.exceeds(options) else 0.0
        angle = self.measured.quality["min_dihedral_deg"] if self.measured.quality else 0.0
        return (tissues, excess, self.has_volumes, self.targets_met(options), angle)


def record_of(tissues: Sequence[Tissue], request: Request) -> TetmeshAttempt:
    """Return what the report says of an attempt before it was made."""
    return {
        "cluster": 1,
        "tissue": tissues[0].name if len(tissues) == 1 else "",
        "edge_length_mm": request.edge_length_mm,
        "epsilon_mm": request.epsilon_mm,
        "stop_energy": request.stop_energy,
        "iterations": request.iterations,
        "coarsen": request.coarsen,
        "tets": None,
        "min_dihedral_deg": None,
        "radius_ratio_p01": None,
        "failure": "",
        "chosen": False,
    }


def limit_s(options: TetmeshOptions, seconds: Mapping[str, float], has_mesh: bool) -> float:
    """Return how long the next attempt may take: where there is a mesh, a better one may cost so much and no more."""
    if not has_mesh:
        return options.time_limit_s
    return min(options.time_limit_s, _PATIENCE * seconds["mesh"] + _LEAST_PATIENCE_S)


def after_mesh(made: Made, options: TetmeshOptions) -> Request | None:
    """Return what to try after a mesh; None if it is as wanted, or nothing else is to be tried."""
    request = made.request
    if options.max_tets is not None and made.exceeds(options):
        longer = request.edge_length_mm * (made.tets / (_AIM * options.max_tets)) ** (1 / 3)
        return replace(request, edge_length_mm=longer, coarsen=True)
    if request.stop_energy >= _DRAFT_ENERGY:
        return None
    # Tissues that are lost, or too thin to keep their volume, need surfaces that are followed more closely.
    closer = options.epsilon_mm is None and not made.has_volumes
    if made.targets_met(options) == 2 and not closer:
        return None
    epsilon = _FINE_EPSILON * request.epsilon_mm if closer else request.epsilon_mm
    if made.targets_met(options) == 2:
        return replace(request, epsilon_mm=epsilon)
    return replace(
        request,
        epsilon_mm=epsilon,
        stop_energy=min(request.stop_energy, _FINE_ENERGY),
        iterations=_FINE_ITERATIONS * request.iterations,
    )


def after_failure(request: Request, failed: CallFailed, crashes: int) -> Request | None:
    """Return what to try after a failure; None if it would come again.

    Parameters
    ----------
    request
        What failed.
    failed
        How it failed.
    crashes
        How often the engine has crashed by now.
    """
    if failed.reason == "error" or crashes >= _CRASHES:
        return None
    if failed.reason == "crash":
        # A thinner envelope is within what was asked for; the same request may well crash again.
        length = request.edge_length_mm if crashes < 2 else _OTHER * request.edge_length_mm
        return replace(request, epsilon_mm=_OTHER * request.epsilon_mm, edge_length_mm=length)
    return replace(
        request,
        edge_length_mm=_DRAFT_EDGE * request.edge_length_mm,
        stop_energy=max(request.stop_energy, _DRAFT_ENERGY),
        iterations=min(request.iterations, _DRAFT_ITERATIONS),
    )
