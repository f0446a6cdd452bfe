"""What a stage made of one tissue."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from vhp_cli.measures import Action, Deviation, SmoothingStep
from vhp_cli.mesh import Mesh

Status = Literal["changed", "unchanged", "refused", "failed"]


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """The result of a stage for one tissue.

    Parameters
    ----------
    mesh
        The new surface, in mm; None: hand the input on.
    status
        ``"changed"``: `mesh` takes the place of the input; ``"unchanged"``: there was nothing to do;
        ``"refused"``: what the tissue needs would break a limit; ``"failed"``: something went wrong.
    reason
        Why it was refused or failed, or what a change falls short of, in one clause; else empty.
    actions
        What was done, in order.
    deviation
        How far input and output lie apart; None if nothing was changed.
    history
        What the surface was like after each iteration, for a stage that has some.
    """

    mesh: Mesh | None
    status: Status
    reason: str = ""
    actions: list[Action] = field(default_factory=list)
    deviation: Deviation | None = None
    history: list[SmoothingStep] = field(default_factory=list)
