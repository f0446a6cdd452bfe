"""What `tetmesh` may be told: values, defaults and checks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal, get_args

import numpy as np

from vhp_cli.errors import UsageError
from vhp_cli.stages.options import Flag, Keys, Name, Number, StageOptions
from vhp_cli.stages.tetmesh.keep_surface import ExactEngine
from vhp_cli.stages.tetmesh.tissues import Box

# Of the diagonal of the model.
DEFAULT_EDGE_LENGTH = "5%"
# The first one that is installed.
ANY_ENGINE: Literal["any"] = "any"


@dataclass(frozen=True, slots=True)
class Length:
    """A length in mm as a number, or a part of the model's diagonal as a text such as ``"5%"``."""

    def typed(self, value: object, where: str) -> object:
        """Return the value as a text."""
        if isinstance(value, bool) or not isinstance(value, int | float | str):
            raise UsageError(f'{where}: expected a length in mm or a text such as "5%", not {value!r}')
        return str(value)

    def check(self, value: object, key: str) -> None:
        """Refuse what is no positive length."""
        absolute_length(str(value), 1.0, key)


@dataclass(frozen=True, slots=True)
class Air:
    """A margin in mm, or the corners of a box: ``"20"``, ``"-50,-50,0,50,50,80"``."""

    def typed(self, value: object, where: str) -> object:
        """Return the value as a text."""
        if isinstance(value, bool) or not isinstance(value, int | float | str):
            raise UsageError(f"{where}: expected a margin in mm or six coordinates, not {value!r}")
        return str(value)

    def check(self, value: object, key: str) -> None:
        """Refuse what is neither."""
        _numbers_of_air(str(value), key)


@dataclass(frozen=True, slots=True)
class TetmeshOptions(StageOptions):
    """How a model is meshed; lengths in mm.

    Parameters
    ----------
    edge_length
        Wanted edge length, in mm or as a part of the model's diagonal.
    epsilon_mm
        How far faces may lie from the surfaces; None: chosen from the model.
    stop_energy
        AMIPS energy at which the engine is content; lower is better and slower.
    iterations
        Most passes of the engine over the mesh at first. What it has not bettered by then takes it long, and is mostly
        a few tetrahedra that `vhp_cli.stages.tetmesh.relaxing` betters.
    coarsen
        Let the engine take out what it can at the same quality.
    fit
        Whether interfaces are moved onto the surfaces after meshing.
    max_tets
        Most tetrahedra, air left out.
    attempts
        How often the engine is called at most until limits and targets hold.
    time_limit_s, memory_gb
        Of one call of the engine.
    min_dihedral_deg, radius_ratio
        Targets: the smallest dihedral angle, and the radius ratio that 99 % of the tetrahedra reach.
    smallest_region
        Connected regions of a label with fewer tetrahedra go to a neighbour, unless the input has them.
    air
        Air to keep around the model: a margin, or the corners of a box; None: none.
    keep_surface
        Engine that keeps every triangle of the surfaces, or `ANY_ENGINE`; None: none, they may move by `epsilon_mm`.
    priority
        Of a tissue: of two that overlap, and do not lie in each other, the higher one gets the common volume.
    """

    edge_length: str = DEFAULT_EDGE_LENGTH
    epsilon_mm: float | None = None
    stop_energy: float = 10.0
    iterations: int = 20
    coarsen: bool = False
    fit: bool = True
    max_tets: int | None = None
    attempts: int = 2
    time_limit_s: float = 3600.0
    memory_gb: float = 8.0
    min_dihedral_deg: float = 10.0
    radius_ratio: float = 0.35
    smallest_region: int = 20
    air: str | None = None
    keep_surface: ExactEngine | Literal["any"] | None = None
    priority: float = 0.0

    known: ClassVar[Keys] = {
        "edge-length": ("edge_length", Length()),
        "epsilon": ("epsilon_mm", Number()),
        # 3 is the energy of the regular tetrahedron: no mesh gets there.
        "stop-energy": ("stop_energy", Number(3.0)),
        "iterations": ("iterations", Number(1, 1000, may_be_least=True, whole=True)),
        "coarsen": ("coarsen", Flag()),
        "fit": ("fit", Flag()),
        "max-tets": ("max_tets", Number(1, may_be_least=True, whole=True)),
        "attempts": ("attempts", Number(1, 10, may_be_least=True, whole=True)),
        "time-limit": ("time_limit_s", Number()),
        "memory": ("memory_gb", Number()),
        "min-dihedral": ("min_dihedral_deg", Number(0, 70, may_be_least=True)),
        "radius-ratio": ("radius_ratio", Number(0, 1, may_be_least=True)),
        "smallest-region": ("smallest_region", Number(0, may_be_least=True, whole=True)),
        "with-air": ("air", Air()),
        "keep-surface": ("keep_surface", Name((ANY_ENGINE, *get_args(ExactEngine)))),
        "priority": ("priority", Number(-1e9, 1e9)),
    }

    def air_box(self, lower: np.ndarray, upper: np.ndarray) -> Box | None:
        """Return the corners of the box of air around a model with these corners; None for no air.

        Raises
        ------
        UsageError
            If the box does not hold the model.
        """
        if self.air is None:
            return None
        numbers = _numbers_of_air(self.air, "with-air")
        if len(numbers) == 1:
            return lower - numbers[0], upper + numbers[0]
        box = np.array(numbers[:3]), np.array(numbers[3:])
        if (box[0] >= lower).any() or (box[1] <= upper).any():
            corners = " to ".join(f"({', '.join(f'{value:.6g}' for value in corner)})" for corner in (lower, upper))
            raise UsageError(f"with-air: the box does not hold the model, which reaches from {corners} mm")
        return box


# What a tissue may have of its own.
OF_A_TISSUE = ("edge-length", "priority")


def absolute_length(text: str, diagonal_mm: float, where: str = "edge-length") -> float:
    """Return a length in mm: ``"2.5"``, or ``"5%"`` of a diagonal.

    Raises
    ------
    UsageError
        If it is no positive length.
    """
    body = text.strip()
    try:
        value = float(body.removesuffix("%"))
    except ValueError:
        value = float("nan")
    if body.endswith("%"):
        value *= diagonal_mm / 100
    if not 0 < value < float("inf"):
        raise UsageError(f'{where}: expected a length above 0, in mm or as "5%" of the diagonal, not {text!r}')
    return value


def _numbers_of_air(text: str, where: str) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    box_is_wrong = len(numbers) == 6 and not all(low < high for low, high in zip(numbers[:3], numbers[3:], strict=True))
    if len(numbers) not in (1, 6) or not np.isfinite(numbers).all() or box_is_wrong:
        raise UsageError(f"{where}: expected a margin in mm, or x0,y0,z0,x1,y1,z1 of a box, not {text!r}")
    if len(numbers) == 1 and not numbers[0] > 0:
        raise UsageError(f"{where}: expected a margin above 0 mm, not {text!r}")
    return numbers
