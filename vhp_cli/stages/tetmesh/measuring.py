"""Measure a labelled tetrahedral mesh: shape, volumes against the surfaces, conformity, boundaries, parts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vhp_cli.inspection.adjacency import OUTSIDE, Adjacency, Interfaces, adjacency, connected_parts, interfaces
from vhp_cli.inspection.places import MAX_PLACES, point
from vhp_cli.inspection.tetrahedra import TetrahedronQuality, tetrahedron_quality
from vhp_cli.kernels import surface
from vhp_cli.kernels.spatial import Tree
from vhp_cli.measures import LabelBoundary, Place, TetmeshInterface, TetmeshLabel, TetrahedronShape
from vhp_cli.stages.tetmesh.tissues import Relations, Tissue
from vhp_cli.volume import BACKGROUND, VolumeMesh

AIR = "air"

# By rule.
Places = dict[str, list[Place]]


@dataclass(frozen=True, slots=True)
class Measured:
    """What was measured on a mesh, as parts of `vhp_cli.measures.Tetmesh`.

    Parameters
    ----------
    labels, air, quality, nonconforming, interfaces
        As there.
    places
        Where the worst or first occurrences are, by label and rule, whether the rule is broken or not.
    tetrahedra
        Measures of each tetrahedron.
    """

    labels: list[TetmeshLabel]
    air: TetmeshLabel | None
    quality: TetrahedronShape | None
    nonconforming: dict[str, int]
    interfaces: list[TetmeshInterface]
    places: dict[int, Places]
    tetrahedra: TetrahedronQuality


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """What the surfaces say of each tissue.

    Parameters
    ----------
    volume_mm3, exact
        Within its surface and outside of the tissues that take precedence; whether that is exact.
    enclosed_mm3, enclosed_exact
        Within its surface.
    parts
        In how many connected parts it has to come out; None: not known.
    """

    volume_mm3: float
    exact: bool
    enclosed_mm3: float
    enclosed_exact: bool
    parts: int | None


def truths(
    tissues: Sequence[Tissue],
    sizes_mm3: Sequence[float],
    relations: Relations,
    order: Sequence[int],
    parts: Sequence[int | None],
) -> list[Truth]:
    """Return what the surfaces say of each tissue.

    Parameters
    ----------
    tissues
        The tissues.
    sizes_mm3
        The volume within each surface, an estimate where that is not defined.
    relations
        How they lie to each other.
    order
        How they are laid over each other.
    parts
        In how many parts each has to come out.
    """
    rank = {tissues[index].name: position for position, index in enumerate(order)}
    size = {tissue.name: value for tissue, value in zip(tissues, sizes_mm3, strict=True)}
    defined = {tissue.name: tissue.volume_mm3 is not None for tissue in tissues}
    around = {tissue.name: relations.containers.get(tissue.name, frozenset()) for tissue in tissues}
    in_overlap = {name for pair in relations.overlaps_mm3 for name in pair}
    found = []
    for tissue, part_count in zip(tissues, parts, strict=True):
        name = tissue.name
        inside = [other for other in around if name in around[other]]
        direct = [other for other in inside if not any(between in around[other] for between in inside)]
        taken = sum(size[other] for other in direct)
        for pair, overlap in relations.overlaps_mm3.items():
            if name in pair:
                other = pair[1] if pair[0] == name else pair[0]
                # What lies in a tissue within this one is taken away with that one.
                if rank[other] > rank[name] and not any(between in around[other] for between in inside):
                    taken += overlap
        exact = all(defined[each] and each not in in_overlap for each in (name, *direct))
        found.append(Truth(max(size[name] - taken, 0.0), exact, size[name], defined[name], part_count))
    return found


def measure_mesh(
    mesh: VolumeMesh,
    tissues: Sequence[Tissue],
    known: Sequence[Truth],
    enclosed_mm3: NDArray[np.float64],
    relabelled: Mapping[int, int],
) -> Measured:
    """Measure a labelled mesh.

    Parameters
    ----------
    mesh
        Label ``k`` is the tissue ``tissues[k - 1]``; 0 is air.
    tissues
        The tissues.
    known
        What their surfaces say.
    enclosed_mm3
        Volume of the tetrahedra within the surface of each tissue.
    relabelled
        Number of tetrahedra that were given to a label when it was tidied.
    """
    quality = tetrahedron_quality(mesh.points, mesh.tetrahedra)
    found = adjacency(mesh.tetrahedra)
    between = interfaces(found, mesh.labels)
    same = mesh.labels[found.pairs[:, 0]] == mesh.labels[found.pairs[:, 1]]
    region = connected_parts(len(mesh.labels), found.pairs[same])
    labels: list[TetmeshLabel] = []
    places: dict[int, Places] = {}
    for number, (tissue, truth) in enumerate(zip(tissues, known, strict=True), start=1):
        record, places[number] = _label(mesh, number, truth, quality, between, region)
        record["enclosed_mm3"] = float(enclosed_mm3[number - 1])
        if not truth.exact and truth.enclosed_exact and truth.enclosed_mm3 > 0:
            record["volume_error"] = record["enclosed_mm3"] / truth.enclosed_mm3 - 1
        record["relabelled_tets"] = relabelled.get(number, 0)
        record["defects"] = list(tissue.defects)
        labels.append(record)
    air = None
    if (mesh.labels == BACKGROUND).any():
        air, _ = _label(mesh, BACKGROUND, Truth(0.0, False, 0.0, False, None), quality, between, region)
    return Measured(
        labels,
        air,
        shape(quality, mesh.labels != BACKGROUND),
        nonconformity(mesh, found),
        _interface_areas(mesh, between),
        places,
        quality,
    )


def shape(quality: TetrahedronQuality, chosen: NDArray[np.bool_]) -> TetrahedronShape | None:
    """Return the shape of some tetrahedra in a few numbers; None for none."""
    if not chosen.any():
        return None
    angles, ratios = quality.min_dihedral_deg[chosen], quality.radius_ratio[chosen]
    p01, p05, p50 = np.quantile(ratios, (0.01, 0.05, 0.5))
    return {
        "min_dihedral_deg": float(angles.min()),
        "min_dihedral_p01_deg": float(np.quantile(angles, 0.01)),
        "max_dihedral_deg": float(quality.max_dihedral_deg[chosen].max()),
        "radius_ratio_min": float(ratios.min()),
        "radius_ratio_p01": float(p01),
        "radius_ratio_p05": float(p05),
        "radius_ratio_p50": float(p50),
        "scaled_jacobian_min": float(quality.scaled_jacobian[chosen].min()),
        "inverted": int((quality.volume[chosen] <= 0).sum()),
        "mean_edge_mm": float(quality.mean_edge_mm[chosen].mean()),
    }


def nonconformity(mesh: VolumeMesh, found: Adjacency) -> dict[str, int]:
    """Return what keeps tetrahedra from sharing whole faces, by kind; empty for a conforming mesh.

    A face may belong to two tetrahedra, on either side of it, or to one. Where a point lies within a face or an edge of
    another tetrahedron, or tetrahedra overlap, the faces that belong to one only meet; where they do is exact.
    """
    tree = Tree(mesh.points, found.hull)
    kinds = {
        "faces of three or more tetrahedra": found.overfull,
        "faces with both tetrahedra on one side": len(found.folded),
        "pairs of outer faces that meet": tree.self_hits(limit=0).n_pairs,
        "parts within others": _parts_within(mesh, found, tree),
    }
    return {kind: count for kind, count in kinds.items() if count}


def _parts_within(mesh: VolumeMesh, found: Adjacency, tree: Tree) -> int:
    """Return how many parts of the hull bound tetrahedra within others: they look out where cavities look in."""
    topology = surface.topology(mesh.points, found.hull)
    if topology.n_components < 2:
        return 0
    quality = surface.quality(mesh.points, found.hull, topology.component, topology.n_components)
    depths, undecided = tree.component_depths(topology.component, topology.n_components)
    return int((~undecided & ((quality.component_volume > 0) != (depths % 2 == 0))).sum())


def _label(
    mesh: VolumeMesh,
    number: int,
    truth: Truth,
    quality: TetrahedronQuality,
    between: Interfaces,
    region: NDArray[np.int32],
) -> tuple[TetmeshLabel, Places]:
    chosen = mesh.labels == number
    volume = float(quality.volume[chosen].sum())
    places: Places = {}
    regions, sizes = np.unique(region[chosen], return_counts=True)
    if truth.parts is not None and len(regions) > truth.parts:
        surplus = regions[np.argsort(sizes, kind="stable")[: len(regions) - truth.parts]]
        first = [int(np.flatnonzero(chosen & (region == each))[0]) for each in surplus[:MAX_PLACES]]
        places["M011"] = _at_tetrahedra(mesh, first)
    boundary = _boundary(mesh, between.boundary(number), places) if len(regions) else None
    if len(regions):
        _worst(mesh, chosen, quality, places)
    record: TetmeshLabel = {
        "name": AIR if number == BACKGROUND else mesh.names[number - 1],
        "label": number,
        "tets": int(chosen.sum()),
        "volume_mm3": volume,
        "surface_volume_mm3": truth.volume_mm3,
        "surface_volume_exact": truth.exact,
        "enclosed_mm3": 0.0,
        "surface_enclosed_mm3": truth.enclosed_mm3,
        "volume_error": volume / truth.volume_mm3 - 1 if truth.exact and truth.volume_mm3 > 0 else None,
        "parts": len(regions),
        "expected_parts": truth.parts,
        "boundary": boundary,
        "quality": shape(quality, chosen),
        "relabelled_tets": 0,
        "defects": [],
    }
    return record, places


def _boundary(mesh: VolumeMesh, triangles: NDArray[np.int32], places: Places) -> LabelBoundary:
    topology = surface.topology(mesh.points, triangles)
    edges, vertices = topology.nonmanifold_edges, topology.nonmanifold_vertices
    # A vertex on a non-manifold edge is no finding of its own.
    alone = np.setdiff1d(vertices, edges)
    if len(edges):
        places["M009"] = [{"xyz_mm": point(xyz), "face": None} for xyz in mesh.points[edges[:MAX_PLACES]].mean(axis=1)]
    if len(alone):
        places["M010"] = [{"xyz_mm": point(xyz), "face": None} for xyz in mesh.points[alone[:MAX_PLACES]]]
    a, b, c = (mesh.points[triangles[:, corner]] for corner in range(3))
    return {
        "triangles": len(triangles),
        "area_mm2": float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2),
        "nonmanifold_edges": len(edges),
        "nonmanifold_vertices": len(alone),
    }


def _worst(mesh: VolumeMesh, chosen: NDArray[np.bool_], quality: TetrahedronQuality, places: Places) -> None:
    """Note where the worst tetrahedra of a label are, by each measure."""
    own = np.flatnonzero(chosen)
    for rule, values in (
        ("M004", quality.volume),
        ("M005", quality.min_dihedral_deg),
        ("M006", quality.radius_ratio),
        ("M007", quality.scaled_jacobian),
    ):
        worst = own[np.argsort(values[own], kind="stable")[:MAX_PLACES]]
        places[rule] = _at_tetrahedra(mesh, worst, values[worst])


def _at_tetrahedra(
    mesh: VolumeMesh, tetrahedra: Sequence[int] | NDArray[np.int64], values: NDArray[np.float64] | None = None
) -> list[Place]:
    """Return the centroids of tetrahedra as places, with one measured value each if given."""
    centroids = mesh.points[mesh.tetrahedra[np.asarray(tetrahedra, dtype=np.int64)]].mean(axis=1)
    places: list[Place] = [{"xyz_mm": point(xyz), "face": None} for xyz in centroids]
    for place, value in zip(places, () if values is None else values, strict=False):
        place["value"] = float(value)
    return places


def _interface_areas(mesh: VolumeMesh, between: Interfaces) -> list[TetmeshInterface]:
    a, b, c = (mesh.points[between.triangles[:, corner]] for corner in range(3))
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    # The tissue first, then what it borders on: another tissue, air, nothing.
    low, high = np.sort(between.sides, axis=1).T
    first = np.where(low > BACKGROUND, low, high)
    second = np.where(low > BACKGROUND, high, low)
    pairs, index = np.unique(np.column_stack((first, second)), axis=0, return_inverse=True)
    total = np.bincount(index.ravel(), areas, len(pairs))
    counts = np.bincount(index.ravel(), minlength=len(pairs))

    def name(label: int) -> str:
        return "" if label == OUTSIDE else AIR if label == BACKGROUND else mesh.names[label - 1]

    return [
        {"a": name(int(one)), "b": name(int(other)), "area_mm2": float(area), "triangles": int(count)}
        for (one, other), area, count in zip(pairs, total, counts, strict=True)
    ]
