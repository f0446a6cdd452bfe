"""Which motion of a sequence is that of a tissue."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from vhp_cli.stages.breathe.nesting import ancestors
from vhp_cli.stages.breathe.roles import SHELLS
from vhp_cli.stages.breathe.sequence import Motion
from vhp_cli.stages.breathe.sequence import Sequence as Breath
from vhp_cli.stages.breathe.tissue import Tissue
from vhp_cli.tissues import words


def motions_of(
    sequence: Breath, tissues: Sequence[Tissue], parents: Mapping[str, str | None] | None = None
) -> dict[str, Motion]:
    """Return the motion of each tissue that has one, under the tissue's name.

    A motion that names its tissues is theirs alone; any other is that of all tissues of its role, side, number and word
    in the name. With `parents`, what lies within a tissue that moves goes along, unless that one is a shell.
    """
    found: dict[str, Motion] = {}
    for tissue in tissues:
        motion = next((m for m in sequence.motions if tissue.name in m.tissues), None)
        if motion is None:
            motion = next((m for m in sequence.motions if not m.tissues and _fits(m, tissue)), None)
        if motion is not None and (motion.operations or motion.fields):
            found[tissue.name] = replace(motion, name=tissue.name)
    if parents is not None:
        shells = {tissue.name for tissue in tissues if tissue.role.part in SHELLS}
        own = dict(found)
        for tissue in tissues:
            if tissue.name not in own and tissue.name not in shells:
                around = next((a for a in ancestors(tissue.name, dict(parents)) if a not in shells and a in own), None)
                if around is not None:
                    found[tissue.name] = replace(own[around], name=tissue.name)
    return found


def _fits(motion: Motion, tissue: Tissue) -> bool:
    role = tissue.role
    return (
        motion.role == role.part
        and motion.side in ("", role.side)
        and motion.number in (None, role.number)
        and (not motion.name_has or motion.name_has.lower() in words(tissue.name))
    )
