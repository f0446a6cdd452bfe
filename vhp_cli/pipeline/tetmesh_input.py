"""What the mesher is told of a checked model: its tissues, and how they lie to each other."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from vhp_cli import formats
from vhp_cli.config import Settings
from vhp_cli.errors import VhpError
from vhp_cli.measures import Report, TissueRecord
from vhp_cli.model import Model, TissueFile
from vhp_cli.pipeline.measuring import parse_in_mm
from vhp_cli.stages.tetmesh.options import TetmeshOptions
from vhp_cli.stages.tetmesh.tissues import Relations, Tissue

_CONTACTS = ("crossing", "touching", "identical")


def read_tissues(
    model: Model,
    report: Report,
    settings: Settings,
    options_of: Callable[[str], TetmeshOptions],
    common_length: str,
) -> list[Tissue]:
    """Return the tissues that can be meshed: those of which the check could measure something.

    Parameters
    ----------
    model, report
        The model, and its check.
    settings
        How files are read.
    options_of
        The options for a tissue of this name.
    common_length
        The edge length that a tissue has unless it has one of its own.
    """
    in_contact = {
        name
        for pair in report["pairs"]
        if pair["relation"] in _CONTACTS or pair["undecided"]
        for name in (pair["a"], pair["b"])
    }
    defects: dict[str, list[str]] = {}
    for finding in report["findings"]:
        if len(finding["tissues"]) == 1 and finding["level"] == "error" and finding["rule"][0] in "TX":
            defects.setdefault(finding["tissues"][0], []).append(finding["rule"])
    found = []
    for source, record in zip(model.tissues, report["tissues"], strict=True):
        if not record["bounds_mm"]:
            continue
        data = formats.read_bytes(source.path)
        if formats.sha256(data) != record["sha256"]:
            raise VhpError(f"{source.file} changed during the run", hint="run the command again")
        options = options_of(source.name)
        own = options.edge_length != common_length
        found.append(_tissue(source, record, data, settings, options, own, source.name in in_contact, defects))
    return found


def _tissue(
    source: TissueFile,
    record: TissueRecord,
    data: bytes,
    settings: Settings,
    options: TetmeshOptions,
    own_length: bool,
    in_contact: bool,
    defects: Mapping[str, list[str]],
) -> Tissue:
    crosses_itself = record["self_intersections"]["pairs"] > 0
    sound = record["closed"] and record["manifold"] and record["oriented"] and not crosses_itself
    # Of a surface in one part it does not matter which way it faces.
    solid = sound and (record["outward"] or record["components"] == 1)
    return Tissue(
        source.name,
        parse_in_mm(source.path, data, settings).mesh,
        abs(record["volume_mm3"]) if solid else None,
        clean=sound and record["outward"] and not in_contact,
        defects=tuple(defects.get(source.name, ())),
        priority=options.priority,
        edge_length=options.edge_length if own_length else None,
    )


def relations_of(report: Report) -> Relations:
    """Return how the tissues of a checked model lie to each other."""
    containers: dict[str, set[str]] = {}
    overlaps: dict[tuple[str, str], float] = {}
    gaps: dict[tuple[str, str], float] = {}
    distances: dict[tuple[str, str], float] = {}
    # Of a pair that could not be checked, nothing is known.
    contacts = {
        (finding["tissues"][0], finding["tissues"][1])
        for finding in report["findings"]
        if finding["rule"] == "F012" and len(finding["tissues"]) == 2
    }
    for pair in report["pairs"]:
        a, b = pair["a"], pair["b"]
        if pair["inside"]:
            inner, outer = (a, b) if pair["inside"] == "a" else (b, a)
            containers.setdefault(inner, set()).add(outer)
        elif pair["relation"] in ("crossing", "identical"):
            overlaps[a, b] = pair["overlap_mm3"]
        if pair["relation"] == "touching" or pair["undecided"]:
            contacts.add((a, b))
        if pair["min_gap_mm"] and pair["relation"] in ("a_inside_b", "b_inside_a"):
            gaps[a, b] = pair["min_gap_mm"]
        elif pair["min_gap_mm"] and pair["relation"] == "disjoint":
            distances[a, b] = pair["min_gap_mm"]
    inside = {name: frozenset(found) for name, found in containers.items()}
    return Relations(inside, overlaps, gaps, distances, frozenset(contacts))
