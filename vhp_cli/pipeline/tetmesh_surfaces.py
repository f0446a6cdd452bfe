"""The boundaries of labels as surfaces that pass the gate: healed, and set apart by a gap."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from vhp_cli import formats
from vhp_cli.config import Settings
from vhp_cli.formats.atomic import make_directory
from vhp_cli.measures import Report
from vhp_cli.mesh import Mesh
from vhp_cli.model import Model, TissueFile
from vhp_cli.pipeline.check import Progress
from vhp_cli.pipeline.healed_clearance import heal_and_separate
from vhp_cli.pipeline.stage import Limits, Stage
from vhp_cli.stages.clearance.options import ClearanceOptions
from vhp_cli.stages.heal.options import HealOptions

_HEAL = "vhp_cli.stages.heal:heal"
# Of files beyond some 100 kB, so that large tissues have the time that they need.
_BYTES_PER_SECOND = 5_000.0


@dataclass(frozen=True, slots=True)
class Apart:
    """How surfaces are set apart.

    Parameters
    ----------
    settings
        What they have to pass; its gap (P005) is what they are set apart by.
    timeout_s, memory_gb
        Limits for one tissue.
    """

    settings: Settings
    timeout_s: float = 300.0
    memory_gb: float = 4.0

    @property
    def gap_mm(self) -> float:
        """The gap."""
        return self.settings.rules["P005"].limit or 0.0


@dataclass(frozen=True, slots=True)
class SetApart:
    """The report on surfaces that were set apart, and whether a tissue could not be processed."""

    report: Report
    failed: bool

    @property
    def passed(self) -> bool:
        """Whether all is as it should be."""
        return not self.failed and self.report["summary"]["passed"]


def set_apart(
    surfaces: Mapping[str, Mesh],
    files: Mapping[str, str],
    out: Path,
    how: Apart,
    *,
    jobs: int | None = None,
    cache_directory: Path | None = None,
    progress: Progress | None = None,
) -> SetApart:
    """Heal surfaces that share their interfaces, set them apart, and write them.

    Parameters
    ----------
    surfaces
        By tissue.
    files
        Where each is to be written, below `out`.
    out
        The directory to write to.
    how
        By how much, and what they have to pass.
    jobs, cache_directory, progress
        As of `vhp_cli.pipeline.staged.run_and_check`.
    """
    raw = out.with_name(f".{out.name}.raw")
    shutil.rmtree(raw, ignore_errors=True)
    try:
        tissues = []
        for name, mesh in surfaces.items():
            path = raw / files[name]
            make_directory(path.parent)
            formats.write_mesh(path, mesh)
            tissues.append(TissueFile(name, path, files[name]))
        options = HealOptions().changed(how.settings.stages.get("heal", {}), "heal")

        def options_of(name: str) -> HealOptions:
            mine = options
            for where, values in how.settings.stage_tables("heal", name):
                mine = mine.changed(values, where)
            return mine

        done = heal_and_separate(
            Model(tuple(tissues)),
            out,
            Stage("heal", _HEAL, options_of, options.as_dict(), most_gentle=2),
            ClearanceOptions().changed(how.settings.stages.get("clearance", {}), "clearance"),
            how.settings,
            paths=[raw],
            jobs=jobs,
            limits=Limits(how.timeout_s, how.memory_gb, _BYTES_PER_SECOND),
            overwrite=True,
            cache_directory=cache_directory,
            progress=None if progress is None else lambda step, done, total: progress(f"surfaces: {step}", done, total),
        )
    finally:
        shutil.rmtree(raw, ignore_errors=True)
    return SetApart(done.report, done.failed)
