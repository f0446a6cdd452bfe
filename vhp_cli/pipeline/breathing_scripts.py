"""Scripts beside the frames: what builds the parametric sweep in other programs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from vhp_cli.formats.atomic import atomic_write_text, refused
from vhp_cli.measures import BreathFrame
from vhp_cli.pipeline.breathing_frames import SCRIPTS
from vhp_cli.pipeline.breathing_model import BreathingModel
from vhp_cli.stages.breathe import scripts
from vhp_cli.stages.breathe.sequence import Motion
from vhp_cli.stages.breathe.sequence import Sequence as Breath


def write_scripts(
    out: Path,
    model: BreathingModel,
    sequence: Breath,
    motions: Mapping[str, Motion],
    frames: Sequence[BreathFrame],
    targets: Iterable[str] = scripts.TARGETS,
) -> str:
    """Write the scripts to the output directory, beside the frames that they import.

    Parameters
    ----------
    out
        The output directory, which holds the frames.
    model, sequence, motions
        What breathes, and how.
    frames
        Records of the frames.
    targets
        Some of `scripts.TARGETS`.

    Returns
    -------
    str
        Why none were written; empty if they were.

    Raises
    ------
    VhpError
        If the file system refuses.
    """
    if model.mm_per_unit != 1.0 or not np.array_equal(model.axes.to_lps, np.eye(3)):
        return f"no scripts: they are made for models in mm and LPS, this one is in {model.axes.name}"
    at_step = {frame["x"]: frame["directory"] for frame in reversed(frames) if frame["passed"]}
    steps = [float(step) for step in range(sequence.steps + 1)]
    if missing := [f"{step:g}" for step in steps if step not in at_step]:
        return f"no scripts: they need a frame that passed at every whole step, and {', '.join(missing[:5])} has none"
    parts = tuple(
        scripts.Part(tissue.name, source.place, motions.get(tissue.name))
        for tissue, source in zip(model.tissues, model.sources, strict=True)
    )
    try:
        texts = scripts.write(
            scripts.Model(sequence, parts, tuple((step, f"../{at_step[step]}") for step in steps)), targets
        )
    except ValueError as error:
        return f"no scripts: {error}"
    folder = out / SCRIPTS
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise refused(folder, error) from error
    for name, text in texts.items():
        atomic_write_text(folder / name, text)
    return ""
