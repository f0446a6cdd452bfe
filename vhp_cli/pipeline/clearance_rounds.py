"""Which tissues are to be done again, and which have shown that they do not give way."""

from __future__ import annotations

from collections.abc import Mapping

from vhp_cli.measures import Report
from vhp_cli.pipeline.clearance_plan import Plan
from vhp_cli.pipeline.clearance_report import reached
from vhp_cli.pipeline.journal import Entry
from vhp_cli.stages.clearance.cutting import SQUEEZED
from vhp_cli.stages.clearance.options import ClearanceOptions


def held_back(entries: Mapping[str, Entry]) -> tuple[list[str], list[str]]:
    """Return the tissues that could not be brought into their rooms, and those that could a part of the way only.

    What took too long, or failed otherwise, is as it was: others give way for it, too.
    """
    stuck = [name for name, entry in entries.items() if _stayed(entry) and not _is_squeezed(entry)]
    return stuck, [name for name, entry in entries.items() if _is_squeezed(entry)]


def too_close(plan: Plan, report: Report, entries: Mapping[str, Entry], options: ClearanceOptions) -> list[str]:
    """Return the tissues that are still too close to another one and that may come out better, done again.

    Parameters
    ----------
    plan
        How they are to lie to each other.
    report
        Of the check of what was written.
    entries
        What became of them so far.
    options
        Of the run.
    """
    hopeful = {
        name
        for name, entry in entries.items()
        if entry.level < options.rounds and not _stayed(entry) and not _is_squeezed(entry)
    }
    found: set[str] = set()
    wanted = {(pair.a, pair.b): pair for pair in plan.pairings}
    for pair in report["pairs"]:
        pairing = wanted.get((pair["a"], pair["b"]))
        if pairing is not None and pairing.kind not in ("identical", "kept") and not reached(pairing, pair, aimed=True):
            found.update(name for name in (pairing.a, pairing.b) if pairing.share_of(name) > 0)
    return [tissue["name"] for tissue in report["tissues"] if tissue["name"] in found & hopeful]


def _stayed(entry: Entry) -> bool:
    return entry.status in ("refused", "failed")


def _is_squeezed(entry: Entry) -> bool:
    """Tell whether a tissue has a part of the gap only, by this run or as an earlier one left it."""
    return SQUEEZED in entry.reason or any(action["step"] == SQUEEZED for action in entry.actions)
