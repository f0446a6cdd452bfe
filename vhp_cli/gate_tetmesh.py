"""The gate of tetrahedral meshes: measures and settings in, findings by the rules of M out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from vhp_cli.config import Settings
from vhp_cli.gate import findings_of
from vhp_cli.measures import Finding, Place, Tetmesh, TetmeshLabel

# By rule.
Places = Mapping[str, list[Place]]
_Broken = tuple[str, int, str, list[Place]]


def tetmesh_findings(mesh: Tetmesh, places: Mapping[str, Places], settings: Settings) -> list[Finding]:
    """Return what is wrong with a tetrahedral mesh.

    Parameters
    ----------
    mesh
        What was measured on it.
    places
        Where the worst or first occurrences of each rule are, by tissue.
    settings
        Levels and limits.
    """
    findings: list[Finding] = []
    for label in mesh["labels"]:
        name = label["name"]
        findings += findings_of(settings, [name], _label(label, places.get(name, {}), settings))
    for overlap in mesh["overlaps"]:
        message = f"{overlap['winner']} got the common volume"
        if overlap["overlap_mm3"]:
            message += f", {overlap['overlap_mm3']:.4g} mm3"
        findings += findings_of(settings, [overlap["a"], overlap["b"]], [("M013", 1, message, [])])
    return findings + findings_of(settings, [], _whole(mesh))


def _label(label: TetmeshLabel, places: Places, settings: Settings) -> Iterator[_Broken]:
    name = label["name"]
    if label["defects"]:
        yield "M012", len(label["defects"]), f"the surface breaks {', '.join(label['defects'])}", []
    quality, boundary = label["quality"], label["boundary"]
    if not label["tets"] or quality is None or boundary is None:
        volume = label["surface_volume_mm3"]
        yield "M001", 1, f"no tetrahedra; the surface encloses {volume:.4g} mm3", []
        return
    error = label["volume_error"]
    if error is not None:
        for code in ("M002", "M003"):
            limit = settings.rule(code, name).limit
            if limit is not None and abs(error) > limit:
                yield code, 1, f"{error:+.2%} against the surface, at most {limit:.3g} asked", []
                break  # the worse of the two says it all
    if quality["inverted"]:
        yield "M004", quality["inverted"], f"{quality['inverted']:,} without a positive volume", _at(places, "M004")
    for code, value, what in (
        ("M005", quality["min_dihedral_deg"], "smallest dihedral angle {:.3g} deg"),
        ("M006", quality["radius_ratio_p01"], "1 % of the radius ratios are below {:.3g}"),
        ("M007", quality["scaled_jacobian_min"], "smallest scaled Jacobian {:.3g}"),
    ):
        limit = settings.rule(code, name).limit
        if limit is not None and value < limit:
            yield code, 1, f"{what.format(value)}, at least {limit:g} asked", _at(places, code)
    if count := boundary["nonmanifold_edges"]:
        yield "M009", count, f"{count:,} edges of the boundary have more than two triangles", _at(places, "M009")
    if count := boundary["nonmanifold_vertices"]:
        yield "M010", count, f"the boundary pinches in {count:,} points", _at(places, "M010")
    expected = label["expected_parts"]
    if expected is not None and label["parts"] != expected:
        message = f"{label['parts']} parts, {expected} expected"
        yield "M011", abs(label["parts"] - expected), message, _at(places, "M011")


def _whole(mesh: Tetmesh) -> Iterator[_Broken]:
    if mesh["nonconforming"]:
        kinds = mesh["nonconforming"].items()
        yield "M008", sum(mesh["nonconforming"].values()), ", ".join(f"{count:,} {kind}" for kind, count in kinds), []
    relaxed = mesh["relaxed"]
    if relaxed:
        yield "M014", len(relaxed), "; ".join(relaxed), []


def _at(places: Places, code: str) -> list[Place]:
    return list(places.get(code, []))
