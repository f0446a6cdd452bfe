"""The report of a stage: the check of what was written, and beside it what it was before and what was done."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import get_args

from vhp_cli.errors import VhpError
from vhp_cli.measures import Before, Deviation, Distance, Introduced, Report, TissueRecord
from vhp_cli.pipeline.journal import Entry
from vhp_cli.stages.outcome import Status

_CONTACTS = {"P001", "P002", "P003", "P004"}
_NOT_MEASURES = ("name", "file", "sha256", "format", "tissue_type", "findings")


def stage_report(
    before: Report, after: Report, entries: Sequence[Entry], *, command: str, options: Mapping[str, object]
) -> Report:
    """Put the report of a stage together.

    Parameters
    ----------
    before, after
        The checks of the model and of what was written, tissues in the same order.
    entries
        What became of each tissue, in the same order.
    command, options
        The stage and its options in full.

    Raises
    ------
    VhpError
        If a file is not the one that was processed.
    """
    introduced = _introduced_contacts(before, after, entries)
    tissues = []
    for old, new, entry in zip(before["tissues"], after["tissues"], entries, strict=True):
        for record, sha256 in ((old, entry.source), (new, entry.output)):
            # A check that failed has none.
            if record["sha256"] not in ("", sha256):
                raise VhpError(f"{record['file']} was changed during the run", hint="run the command again")
        tissues.append(_record(old, new, entry, [*entry.introduced, *introduced.get(new["name"], [])]))
    statuses = [entry.status for entry in entries]
    return {
        **after,
        "command": command,
        "settings": {**after["settings"], command: dict(options)},
        "model": before["model"],
        "summary": {
            **after["summary"],
            "status": {status: statuses.count(status) for status in get_args(Status)},
        },
        "tissues": tissues,
    }


def _record(old: TissueRecord, new: TissueRecord, entry: Entry, introduced: list[Introduced]) -> TissueRecord:
    measures = {key: value for key, value in old.items() if key not in _NOT_MEASURES}
    input_record: Before = {
        "file": old["file"],
        "sha256": old["sha256"],
        "format": old["format"],
        **measures,  # type: ignore[typeddict-item]
        "findings": old["findings"],
    }
    unchanged = entry.status != "changed" and bool(entry.output)
    record: TissueRecord = {
        **new,
        "status": entry.status,
        "reason": entry.reason,
        "deviation_mm": _no_deviation() if unchanged else entry.deviation,
        "volume_change": _volume_change(old, new),
        "actions": entry.actions,
        "introduced": introduced,
        "before": input_record,
    }
    if entry.history:
        record["history"] = entry.history
    return record


def _no_deviation() -> Deviation:
    way: Distance = {"max": 0.0, "mean": 0.0, "xyz_mm": None}
    return {
        "max": 0.0,
        "mean": 0.0,
        "to_output": way,
        "to_input": way.copy(),
        "lost_area_mm2": 0.0,
        "lost_outside_mm2": 0.0,
        "lost_limit_mm": 0.0,
        "lost_places": [],
    }


def _volume_change(old: TissueRecord, new: TissueRecord) -> float | None:
    """Return the change as a fraction of the input's volume; None where that one is not defined."""
    if not old["closed"] or not new["closed"] or not old["volume_mm3"]:
        return None
    return abs(new["volume_mm3"]) / abs(old["volume_mm3"]) - 1.0


def _introduced_contacts(before: Report, after: Report, entries: Sequence[Entry]) -> dict[str, list[Introduced]]:
    """Return the errors between tissues that the input had not, by each tissue that was changed."""
    changed = {
        record["name"] for record, entry in zip(after["tissues"], entries, strict=True) if entry.status == "changed"
    }
    old: dict[frozenset[str], set[str]] = {}
    for finding in before["findings"]:
        old.setdefault(frozenset(finding["tissues"]), set()).add(finding["rule"])
    introduced: dict[str, list[Introduced]] = {}
    for finding in after["findings"]:
        if finding["level"] != "error" or not finding["rule"].startswith("P"):
            continue
        known = old.get(frozenset(finding["tissues"]), set())
        if known & _CONTACTS:
            # A pair in contact is not worse for another kind of contact, or for coming apart by too little.
            known = known | _CONTACTS | {"P005"}
        if finding["rule"] in known:
            continue
        for name in finding["tissues"]:
            if name in changed:
                introduced.setdefault(name, []).append(
                    {
                        "rule": finding["rule"],
                        "before": 0,
                        "after": finding["count"],
                        "message": finding["message"],
                        "tissues": finding["tissues"],
                    }
                )
    return introduced
