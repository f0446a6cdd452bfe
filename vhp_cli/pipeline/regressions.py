"""Never worse: what a stage's output has that its input had not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from vhp_cli.config import Settings
from vhp_cli.gate import tissue_findings
from vhp_cli.measures import Defects, Introduced, TissueMeasures
from vhp_cli.pipeline.measuring import Issue

_NOTHING = {"min": 0.0, "mean": 0.0}


@dataclass(frozen=True, slots=True)
class Measured:
    """A tissue as read from a file and measured."""

    measures: TissueMeasures
    defects: Defects
    issues: Sequence[Issue]


def regressions(name: str, before: Measured, after: Measured, settings: Settings) -> list[Introduced]:
    """Return the respects of the gate in which a tissue got worse.

    Rules on files (F), topology (T) and self-intersection (X) count whether they are on or off: none may be broken
    that was not, nor in more places. Shapes (Q) count only for a tissue that had no such defect: a surface that
    was open and is now a closed one with a poor triangle is the better one. They got worse if there are more of
    them and the worst one is worse than before.
    """
    old, new = _counts(name, before, settings), _counts(name, after, settings)
    hard = [code for code in new if code[0] in "FTX" and new[code] > old.get(code, 0)]
    soft = []
    if not any(code[0] in "FTX" for code in old):
        soft = [code for code in new if code[0] == "Q" and new[code] > old.get(code, 0)]
        soft = [code for code in soft if _worst(code, after) < _worst(code, before)]
    return [
        {
            "rule": code,
            "before": old.get(code, 0),
            "after": new[code],
            "message": f"{code} {old.get(code, 0)} -> {new[code]}",
            "tissues": [name],
        }
        for code in sorted(hard + soft)
    ]


def _counts(name: str, measured: Measured, settings: Settings) -> dict[str, int]:
    counts = {code: defect["count"] for code, defect in measured.defects.items()}
    if "T001" in counts:
        # A rim that stays open may well be divided more finely.
        counts["T001"] = measured.measures["topology"]["boundary_loops"]
    # Expectations such as the number of parts are the user's: they count where they make an error.
    for finding in tissue_findings(name, measured.measures, {}, measured.issues, (), settings):
        if finding["level"] == "error" and finding["rule"] != "T008":
            counts[finding["rule"]] = finding["count"]
    return counts


def _worst(code: str, measured: Measured) -> float:
    """Return the measure that a rule on shapes looks at, such that less is worse."""
    measures = measured.measures
    if code == "Q001":
        return (measures["quality"] or _NOTHING)["min"]
    if code == "Q002":
        return (measures["edge_mm"] or _NOTHING)["min"]
    if code == "Q003":
        return -measures["topology"]["degenerate_faces"]
    if code == "Q004":
        return (measures["quality"] or _NOTHING)["mean"]
    return -measures["triangles"]
