"""The report of `breathe`: its section, and the records of its frames."""

from __future__ import annotations

import math
from collections.abc import Sequence

from vhp_cli.config import Settings
from vhp_cli.gate import sort_findings
from vhp_cli.inspection.places import point
from vhp_cli.measures import BreathContact, Breathe, BreathFrame, BreathProof, Report
from vhp_cli.pipeline.breathing_findings import (
    TRAVEL_TOLERANCE_MM,
    VOLUME_TOLERANCE_L,
    BreathFacts,
    breathing_findings,
    lung_volume_l,
    mass_change,
)
from vhp_cli.pipeline.breathing_frames import EDGE_CHANGE, State
from vhp_cli.pipeline.check import with_findings
from vhp_cli.stages.breathe.frame_check import Contact, Narrow
from vhp_cli.stages.breathe.proof import Proof
from vhp_cli.stages.breathe.sequence import Motion
from vhp_cli.stages.breathe.time import Moment


def frame_record(
    state: State, start: State, moment: Moment, directory: str, reasons: list[str], lungs: Sequence[str]
) -> BreathFrame:
    """Return what the report says of a frame."""
    check = state.check
    return {
        "index": moment.index,
        "x": moment.x,
        "time_over_T": moment.time_over_period,
        "directory": directory,
        "passed": not reasons,
        "reasons": reasons,
        "lung_volume_l": lung_volume_l(state, lungs),
        "diaphragm_travel_mm": start.lowest_mm - state.lowest_mm,
        "mass_kg": state.mass_kg,
        "mass_change": mass_change(state, start),
        "crossings": len(check.contacts),
        "contacts": [_contact(item) for item in check.contacts] + [_narrow(item) for item in check.narrow],
        "min_gap_mm": check.min_gap_mm,
        "min_gap_pair": list(check.min_gap_pair) if check.min_gap_pair else None,
        "gaps_below_limit": len(check.narrow),
        "tissues": dict(state.tissues),
    }


def breathing_report(checked: Report, facts: BreathFacts, settings: Settings) -> Report:
    """Put the report together.

    Parameters
    ----------
    checked
        The check of the model at rest: of it, measures are kept, and what it found counts where it bears on breathing.
    facts
        What was found.
    settings
        Levels of the rules.
    """
    findings = sort_findings(breathing_findings(facts, settings), [tissue["name"] for tissue in checked["tissues"]])
    report: Report = {
        **checked,
        "command": "breathe",
        "settings": {**checked["settings"], "breathe": facts.options.as_dict()},
    }
    report = with_findings(report, findings)
    report["breathe"] = _section(facts, passed=report["summary"]["passed"])
    return report


def _section(facts: BreathFacts, *, passed: bool) -> Breathe:
    options, sequence, fitted = facts.options, facts.sequence, facts.fitted
    lungs = [name for name, role in facts.model.roles.items() if role.part == "lung"]
    full = facts.states[float(sequence.steps)]
    return {
        "passed": passed,
        "frames": list(facts.frames),
        "limits": {
            "gap_mm": options.gap_mm,
            "mass_tolerance": options.mass_tolerance,
            "lung_volume_change_l": sequence.targets.lung_volume_change_l,
            "lung_volume_tolerance_l": VOLUME_TOLERANCE_L,
            "diaphragm_travel_mm": sequence.targets.diaphragm_travel_mm,
            "diaphragm_travel_tolerance_mm": TRAVEL_TOLERANCE_MM,
            "bone_edge_change": EDGE_CHANGE,
            "crossings": 0,
        },
        "sequence": {
            "name": sequence.name,
            "description": sequence.description,
            "steps": sequence.steps,
            "period_s": sequence.period_s,
            "errata": list(sequence.errata),
        },
        "axes": {
            "name": facts.model.axes.name,
            "left_by": facts.model.axes.said_by[0],
            "back_by": facts.model.axes.said_by[1],
            "up_by": facts.model.axes.said_by[2],
            "mm_per_unit": facts.model.mm_per_unit,
        },
        "roles": {name: str(role) for name, role in facts.model.roles.items()},
        "motions": {name: _kind(motion) for name, motion in facts.motions.items()},
        "lungs": {
            "tissues": lungs,
            "volume_l": lung_volume_l(facts.states[0.0], lungs),
            "volume_change_l": lung_volume_l(full, lungs) - lung_volume_l(facts.states[0.0], lungs),
            "travel_mm": facts.states[0.0].lowest_mm - full.lowest_mm,
            **(
                {
                    "scale_across": fitted.lungs.across,
                    "scale_along": fitted.lungs.along,
                    "forward_mm": fitted.lungs.forward_mm,
                }
                if fitted
                else {}
            ),
        },
        "rib_angles_deg": {str(n): list(angles) for n, angles in fitted.angles.items()} if fitted else {},
        "mass": {
            "convention": options.lung_mass,
            "held": facts.held,
            "kg": facts.mass.kg(facts.mass.rest_mm3),
            "densities": {
                name: {"kg_per_m3": density.kg_per_m3, "source": density.source}
                for name, density in facts.densities.items()
            },
        },
        "rest_contacts": [
            {"a": c.a, "b": c.b, "overlap_mm3": _finite(c.overlap_mm3), "crossing_faces": c.faces}
            for c in facts.rest.contacts.values()
        ],
        "proof": _proof(facts.proof),
        "infeasible": [
            {
                "a": item.tissue,
                "b": item.other,
                "x": item.t,
                "missing_mm": None if item.crossing else item.missing_mm,
                "crossing": item.crossing,
                "xyz_mm": point(item.xyz_mm),
            }
            for item in (fitted.shortfalls if fitted else ())
        ],
        "notes": list(fitted.notes) if fitted else [],
    }


def _kind(motion: Motion) -> str:
    steps = [type(operation).__name__.lower() for operation in motion.operations]
    return ", ".join(steps or [f"field {field.name}" for field in motion.fields])


def _proof(proof: Proof) -> BreathProof:
    return {
        "pairs": proof.pairs,
        "far_pairs": proof.far,
        "intervals": proof.intervals,
        "least_gap_mm": proof.least_gap_mm,
        "unproven": [
            {
                "a": item.a,
                "b": item.b,
                "from_x": item.start,
                "to_x": item.end,
                "gaps_mm": list(item.gaps_mm),
                "travel_mm": item.reach_mm,
            }
            for item in proof.unproven
        ],
        "joined": [list(pair) for pair in proof.joined],
        "bounded": [list(pair) for pair in proof.bounded],
        "excused": [list(pair) for pair in proof.excused],
    }


def _contact(item: Contact) -> BreathContact:
    return {
        "a": item.a,
        "b": item.b,
        "x": item.x,
        "crossing_faces": item.faces,
        "overlap_mm3": _finite(item.overlap_mm3),
        "gap_mm": 0.0,
        "xyz_mm": point(item.xyz_mm),
    }


def _narrow(item: Narrow) -> BreathContact:
    return {
        "a": item.a,
        "b": item.b,
        "x": item.x,
        "crossing_faces": 0,
        "overlap_mm3": 0.0,
        "gap_mm": item.gap_mm,
        "xyz_mm": point(item.xyz_mm),
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
