"""The rule table: what can be wrong with a model, how bad it is, and why a solver minds."""

from __future__ import annotations

from dataclasses import dataclass

from vhp_cli.measures import Level


@dataclass(frozen=True, slots=True)
class Rule:
    """One row of the table.

    Parameters
    ----------
    code, name
        Stable identifier (letter of the family and three digits) and short name.
    level
        Default level; None: off unless a profile or the configuration turns it on.
    summary
        One line.
    why
        Why a solver chokes on it.
    example
        How it comes about.
    fix
        What to do; the hint of each finding.
    limit
        Default limit, if the rule compares a measure with one.
    unit
        Unit of the limit.
    """

    code: str
    name: str
    level: Level | None
    summary: str
    why: str = ""
    example: str = ""
    fix: str = ""
    limit: float | None = None
    unit: str = ""


_TABLE = (
    Rule("F001", "unreadable-file", "error", "The file can't be read as a triangle mesh."),
    Rule("F002", "truncated-file", "error", "The file ends before the facets it announces."),
    Rule("F003", "facet-count-mismatch", "error", "Header and contents disagree on the number of facets."),
    Rule("F004", "not-finite", "error", "Coordinates are NaN, infinite or absurdly large."),
    Rule("F005", "empty-file", "error", "The file holds no triangle."),
    Rule("F006", "name-clash", "error", "Two files give the same tissue name."),
    Rule("F007", "suspicious-unit", "warning", "The size suggests that the unit is not the millimetre."),
    Rule("F008", "several-solids", "note", "The file holds several solids; they are read as one tissue."),
    Rule("F009", "loose-syntax", "warning", "The file bends its format; other readers may refuse it."),
    Rule("F010", "trailing-bytes", "warning", "Bytes follow the last facet."),
    Rule("F011", "polygons", "note", "Faces with more than three corners were cut into triangles."),
    Rule("T001", "open-edge", "error", "The surface has holes: edges with a face on one side only."),
    Rule("T002", "non-manifold-edge", "error", "More than two faces meet at an edge."),
    Rule("T003", "non-manifold-vertex", "error", "The faces around a vertex do not form one fan."),
    Rule("T004", "inconsistent-orientation", "error", "Neighbouring faces are oriented against each other."),
    Rule("T005", "inward-orientation", "error", "A closed part is turned inside out."),
    Rule("T006", "duplicate-face", "error", "A face is stored more than once."),
    Rule("T007", "several-components", "note", "The tissue has more separate parts than expected.", limit=1),
    Rule("T008", "unexpected-genus", None, "The surface has more handles than expected.", limit=0),
    Rule("T009", "unreferenced-vertex", "note", "Vertices belong to no face."),
    Rule("X001", "self-crossing", "error", "Faces of one tissue cross each other."),
    Rule("X002", "coplanar-overlap", "error", "Faces of one tissue overlap in one plane."),
    Rule("X003", "folded-edge", "error", "Two faces at an edge lie flat on each other."),
    Rule("X004", "self-touch", "error", "Faces of one tissue touch where they are not joined."),
    Rule("X005", "sharp-fold", "warning", "The surface is folded back almost onto itself.", limit=0.1, unit="deg"),
    Rule("Q001", "low-quality", "error", "A triangle is badly shaped: q = 2 r_in / r_out.", limit=0.01),
    Rule("Q002", "short-edge", "error", "An edge is shorter than the solver resolves.", limit=0.01, unit="mm"),
    Rule("Q003", "degenerate-face", "error", "A face has no area."),
    Rule("Q004", "low-mean-quality", "warning", "The triangles of the tissue are badly shaped on average.", limit=0.5),
    Rule("Q005", "face-budget", None, "The tissue has more triangles than the solver takes in.", limit=100_000),
    Rule("Q006", "model-face-budget", None, "The model has more triangles than the solver takes in.", limit=1_000_000),
    Rule("P001", "tissues-cross", "error", "Two tissues cross each other."),
    Rule("P002", "tissues-touch", "error", "Two tissues touch."),
    Rule("P003", "coincident-faces", "error", "Two tissues share a piece of surface."),
    Rule("P004", "identical-tissues", "error", "Two tissues are copies of one surface."),
    Rule("P005", "gap", "error", "Two tissues are closer than the gap that the solver needs.", limit=1.0, unit="mm"),
    Rule("P006", "not-nested", "error", "A tissue is not inside the one that should enclose it."),
    Rule("P007", "undecided-nesting", "warning", "A tissue lies in the mouth of an open surface."),
)

RULES: dict[str, Rule] = {rule.code: rule for rule in _TABLE}
