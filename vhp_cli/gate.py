"""The gate: measures and settings in, findings out."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Protocol

from vhp_cli.config import LEVELS, Settings, matches
from vhp_cli.measures import Defect, Defects, Finding, PairRecord, Place, TissueMeasures, TissueRecord
from vhp_cli.rules import RULES

# Longest side in mm of a tissue, and of a model, outside which the unit is hardly the millimetre.
TISSUE_SIZE_MM = (0.5, 3000.0)
MODEL_SIZE_MM = (10.0, 3000.0)

# Computed gaps are good to about 1e-12 of the coordinates; a gap exactly at the limit must pass.
GAP_ROUNDING = 1e-9

_DEFECT_NOUNS = {
    "T001": ("open edge", "open edges"),
    "T002": ("non-manifold edge", "non-manifold edges"),
    "T003": ("non-manifold vertex", "non-manifold vertices"),
    "T004": ("inconsistently oriented edge", "inconsistently oriented edges"),
    "T005": ("part turned inside out", "parts turned inside out"),
    "T006": ("duplicate face", "duplicate faces"),
    "X001": ("pair of crossing faces", "pairs of crossing faces"),
    "X002": ("pair of faces overlapping in a plane", "pairs of faces overlapping in a plane"),
    "X003": ("pair of faces folded flat on each other", "pairs of faces folded flat on each other"),
    "X004": ("pair of touching faces", "pairs of touching faces"),
    "X005": ("edge folded back", "edges folded back"),
    "Q001": ("badly shaped triangle", "badly shaped triangles"),
    "Q002": ("short edge", "short edges"),
    "Q003": ("face without area", "faces without area"),
}


class FileIssue(Protocol):
    """What a reader says of a file (see `vhp_cli.formats`)."""

    @property
    def rule(self) -> str: ...  # noqa: D102
    @property
    def count(self) -> int: ...  # noqa: D102
    @property
    def detail(self) -> str: ...  # noqa: D102


def tissue_findings(
    name: str,
    measures: TissueMeasures,
    defects: Defects,
    issues: Sequence[FileIssue],
    clashes: Sequence[str],
    settings: Settings,
) -> list[Finding]:
    """Return what is wrong with one tissue by itself.

    Parameters
    ----------
    name
        The tissue.
    measures, defects
        What was measured and found on it.
    issues
        What its reader had to say.
    clashes
        Files whose names can't be told from this one's.
    settings
        Levels and limits.
    """
    return findings_of(settings, [name], _tissue(name, measures, defects, issues, clashes, settings))


def failure_findings(a: str, b: str, error: str, settings: Settings) -> list[Finding]:
    """Return the finding for a pair of tissues that could not be processed."""
    return findings_of(settings, [a, b], [("F012", 1, error, [])])


def pair_findings(pair: PairRecord, settings: Settings) -> list[Finding]:
    """Return what is wrong between two tissues."""
    return findings_of(settings, [pair["a"], pair["b"]], _pair(pair, settings))


def model_findings(
    tissues: Sequence[TissueRecord], pairs: Iterable[PairRecord], unread: Sequence[str], settings: Settings
) -> list[Finding]:
    """Return what is wrong with the model as a whole; `unread` are mesh files that were left out."""
    findings = findings_of(settings, [], _model(tissues, unread, settings))
    inside = {
        (pair["a"], pair["b"]) if pair["inside"] == "a" else (pair["b"], pair["a"]) for pair in pairs if pair["inside"]
    }
    names = [tissue["name"] for tissue in tissues]
    for declared in settings.nested:
        for pattern in (declared.first, declared.second):
            if not any(matches(name, pattern) for name in names):
                message = f"{pattern!r} is declared to be nested, and no tissue has such a name"
                findings += findings_of(settings, [], [("P006", 1, message, [])])
        for inner in names:
            for outer in names:
                if inner != outer and declared.matches(inner, outer) and (inner, outer) not in inside:
                    message = "the first is declared to lie inside the second, and does not"
                    findings += findings_of(settings, [inner, outer], [("P006", 1, message, [])])
    return findings


def sort_findings(findings: Iterable[Finding], order: Sequence[str]) -> list[Finding]:
    """Return findings by level, rule and the tissues' order in the report."""
    position = {name: index for index, name in enumerate(order)}
    return sorted(
        findings,
        key=lambda finding: (
            LEVELS.index(finding["level"]),
            finding["rule"],
            [position.get(name, -1) for name in finding["tissues"]],
        ),
    )


# A broken rule: code, count, message, places.
_Broken = tuple[str, int, str, list[Place]]


def findings_of(settings: Settings, names: list[str], broken: Iterable[_Broken]) -> list[Finding]:
    """Return the findings whose rules are on."""
    findings: list[Finding] = []
    for code, count, message, places in broken:
        level = settings.rule(code, *names).level
        if level is not None:
            findings.append(
                {
                    "rule": code,
                    "level": level,
                    "tissues": names,
                    "count": count,
                    "message": message,
                    "places": places,
                    "hint": RULES[code].fix,
                }
            )
    return findings


def _tissue(
    name: str,
    measures: TissueMeasures,
    defects: Defects,
    issues: Sequence[FileIssue],
    clashes: Sequence[str],
    settings: Settings,
) -> Iterator[_Broken]:
    if clashes:
        yield "F006", len(clashes), f"solvers can't tell the name from that of {', '.join(clashes)}", []
    for issue in issues:
        yield issue.rule, issue.count, issue.detail, []
    if measures["triangles"] == 0:
        if not any(issue.rule in ("F001", "F012") for issue in issues):
            yield "F005", 1, "no triangle in the file", []
        return
    if bounds := measures["bounds_mm"]:
        side = max(high - low for low, high in zip(bounds["min"], bounds["max"], strict=True))
        if not TISSUE_SIZE_MM[0] <= side <= TISSUE_SIZE_MM[1]:
            yield "F007", 1, f"the longest side is {side:.4g} mm; is the unit the millimetre?", []
    for code, defect in defects.items():
        message = _defect_message(code, defect, settings.rule(code, name).limit)
        yield code, defect["count"], message, defect["places"]
    components, expected = measures["components"], settings.rule("T007", name).limit
    if expected is not None and components > expected:
        yield "T007", components, f"{components} separate parts, {expected:g} expected", []
    genus, handles = measures["genus"], settings.rule("T008", name).limit
    if genus is not None and handles is not None and genus != handles:
        yield "T008", abs(genus - int(handles)), f"genus {genus}, {handles:g} expected", []
    if unreferenced := measures["topology"]["unreferenced_vertices"]:
        yield "T009", unreferenced, f"{_count(unreferenced, 'vertex', 'vertices')} of the file in no face", []
    quality, least = measures["quality"], settings.rule("Q004", name).limit
    if quality and least is not None and quality["mean"] < least:
        yield "Q004", 1, f"mean q {quality['mean']:.3g}, at least {least:g} asked", []
    budget = settings.rule("Q005", name).limit
    if budget is not None and measures["triangles"] > budget:
        yield "Q005", measures["triangles"], f"{measures['triangles']:,} triangles, at most {budget:,.0f} asked", []


def _pair(pair: PairRecord, settings: Settings) -> Iterator[_Broken]:
    names = (pair["a"], pair["b"])
    places = _pair_places(pair)
    relation = pair["relation"]
    if relation == "identical":
        yield "P004", pair["contact_faces"], "both are the same surface", places
    elif relation == "crossing":
        faces = pair["crossing_faces"] or pair["contact_faces"]
        overlap = f", common volume {pair['overlap_mm3']:.4g} mm3" if pair["overlap_mm3"] else ""
        what = f"{_count(faces, 'face', 'faces')} of the two cross" if faces else "parts of one lie inside the other"
        yield "P001", max(1, faces), what + overlap, places
    if pair["undecided"]:
        yield "P007", 1, "one surface is open, so inside and outside can't be told there", places
    if any(pattern.matches(*names) or pattern.matches(*names[::-1]) for pattern in settings.may_touch):
        return
    if pair["coplanar_faces"] and relation != "identical":
        faces = pair["coplanar_faces"]
        yield "P003", faces, f"{_count(faces, 'face', 'faces')} of the two lie on each other", places
    elif relation == "touching":
        faces = pair["contact_faces"]
        yield "P002", faces, f"{_count(faces, 'face', 'faces')} of the two touch", places
    gap, limit = pair["min_gap_mm"], settings.rule("P005", *names).limit
    apart = relation in ("disjoint", "a_inside_b", "b_inside_a")
    if apart and gap is not None and limit is not None and gap < limit * (1 - GAP_ROUNDING):
        yield "P005", 1, f"the gap is {gap:.4g} mm, at least {limit:g} mm asked", places


def _model(tissues: Sequence[TissueRecord], unread: Sequence[str], settings: Settings) -> Iterator[_Broken]:
    if unread:
        shown = ", ".join(unread[:5]) + (f" and {len(unread) - 5} more" if len(unread) > 5 else "")
        yield "F013", len(unread), f"not part of the check: {shown}", []
    total, budget = sum(tissue["triangles"] for tissue in tissues), settings.rules["Q006"].limit
    if budget is not None and total > budget:
        yield "Q006", total, f"{total:,} triangles in all, at most {budget:,.0f} asked", []
    boxes = [tissue["bounds_mm"] for tissue in tissues if tissue["bounds_mm"]]
    if boxes:
        side = max(max(box["max"][axis] for box in boxes) - min(box["min"][axis] for box in boxes) for axis in range(3))
        if not MODEL_SIZE_MM[0] <= side <= MODEL_SIZE_MM[1]:
            yield "F007", 1, f"the longest side of the model is {side:.4g} mm; is the unit the millimetre?", []


def _defect_message(code: str, defect: Defect, limit: float | None) -> str:
    unit = f" {RULES[code].unit}" if RULES[code].unit else ""
    text = _count(defect["count"], *_DEFECT_NOUNS[code])
    if limit is not None:
        text += f" below {limit:g}{unit}"
    if "value" in defect:
        text += f", the worst {defect['value']:.3g}{unit}"
    return f"{text}: {defect['detail']}" if defect.get("detail") else text


def _count(number: int, singular: str, plural: str) -> str:
    return f"{number:,} {singular if number == 1 else plural}"


def _pair_places(pair: PairRecord) -> list[Place]:
    if not pair["points_mm"] or not pair["faces"]:
        return []
    return [
        {"xyz_mm": xyz, "face": face, "tissue": name}
        for xyz, face, name in zip(pair["points_mm"], pair["faces"], (pair["a"], pair["b"]), strict=True)
    ]
