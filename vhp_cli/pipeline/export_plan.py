"""Which files an export writes, what they hold, and what the target asks of the model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from vhp_cli.config import UNITS, Settings
from vhp_cli.errors import UsageError
from vhp_cli.formats.surfaces import FORMS
from vhp_cli.measures import Report
from vhp_cli.model import Model
from vhp_cli.pipeline.export_job import Job
from vhp_cli.pipeline.export_manifest import MANIFEST
from vhp_cli.stages.export.scripts import SCRIPTS
from vhp_cli.stages.export.targets import TARGETS, object_names

MATERIALS = "materials.csv"
# What a script imports.
NEEDS = {"hfss-pyaedt": "stl", "hfss-native": "stl", "cst": "stl", "matlab": "mat"}


@dataclass(frozen=True, slots=True)
class Planned:
    """One file of meshes: its path below the output directory, its format, and the tissues in it by their place."""

    file: str
    form: str
    tissues: tuple[int, ...]


def planned_files(model: Model, job: Job) -> list[tuple[str, list[str]]]:
    """Return the files that an export writes below the output directory, each with the tissues in it."""
    names = [tissue.name for tissue in model.tissues]
    planned = [(file.file, [names[place] for place in file.tissues]) for file in plan(object_names(names), job.forms)]
    return [*planned, *((name, names) for name in (*script_files(job), MATERIALS, MANIFEST))]


def gate_settings(settings: Settings, job: Job) -> Settings:
    """Return the settings with limits of gap and edge that are no less than the smallest feature of the target."""
    smallest = TARGETS[job.target].smallest_feature * UNITS[job.unit]
    rules = dict(settings.rules)
    for code in ("Q002", "P005"):
        rules[code] = replace(rules[code], limit=max(rules[code].limit or 0.0, smallest))
    return replace(settings, rules=rules)


def plan(objects: Sequence[str], forms: Sequence[str]) -> list[Planned]:
    """Return the files of meshes for objects of these names, in formats that are keys of `FORMS`."""
    planned = []
    for form in forms:
        suffix = FORMS[form].suffix
        if FORMS[form].scope == "model":
            planned.append(Planned(f"model{suffix}", form, tuple(range(len(objects)))))
        else:
            planned += [Planned(f"{form}/{name}{suffix}", form, (place,)) for place, name in enumerate(objects)]
    return planned


def script_keys(job: Job) -> list[str]:
    """Return the scripts of the target that find what they import, keys of `SCRIPTS`."""
    return [script for script in TARGETS[job.target].scripts if NEEDS[script] in job.forms]


def script_files(job: Job) -> list[str]:
    """Return the names of the scripts that are written."""
    return [SCRIPTS[script][0] for script in script_keys(job)]


def refuse_size(report: Report, job: Job) -> None:
    """Refuse a unit in which coordinates are beyond what the target takes, by `UsageError`."""
    boxes = [record["bounds_mm"] for record in report["tissues"] if record["bounds_mm"]]
    largest = max((abs(value) for box in boxes for value in (*box["min"], *box["max"])), default=0.0)
    limit = TARGETS[job.target].largest_size
    if largest / UNITS[job.unit] > limit:
        raise UsageError(
            f"the model reaches to {largest / UNITS[job.unit]:.4g} {job.unit}, {job.target} takes {limit:g} at most",
            hint="choose a larger unit by --out-units",
        )
