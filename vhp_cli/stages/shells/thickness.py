"""How thick the fat is, at every vertex of the skin."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vhp_cli.errors import UsageError
from vhp_cli.kernels import surface
from vhp_cli.mesh import Mesh

Floats = NDArray[np.float64]

# Thickness changes by at most this much per mm of surface: below 1, or shells would not be nested.
STEEPEST = 0.4
_NEAREST_MM = 1.0


@cache
def table() -> tuple[tuple[str, ...], Mapping[str, tuple[float, ...]]]:
    """Return the age groups of Table 5.1 of the thesis, and the thickness in mm by place for each of them."""
    path = Path(__file__).parents[2] / "data" / "fat_thickness.toml"
    found = tomllib.loads(path.read_text(encoding="utf-8"))
    return tuple(found["age_groups"]), {name: tuple(values) for name, values in found["thickness_mm"].items()}


@dataclass(frozen=True, slots=True)
class FatPoint:
    """Thickness in mm of the fat at a point of the skin, xyz in mm."""

    xyz: tuple[float, float, float]
    thickness_mm: float


def from_map(values: Mapping[str, object], where: str) -> list[FatPoint]:
    """Return the points of a map of the fat.

    Parameters
    ----------
    values
        ``point``: tables with ``xyz`` in mm and either ``thickness`` in mm or the name of a ``place`` of Table 5.1;
        ``age``: its age group, such as ``"30-39"``, needed with places.
    where
        For the messages.

    Raises
    ------
    UsageError
        If it says something that is not understood.
    """
    groups, places = table()
    rows = values.get("point")
    if not isinstance(rows, list) or not rows:
        raise UsageError(f"{where}: needs [[point]] tables with xyz and thickness or place")
    points = []
    for index, row in enumerate(rows):
        here = f"{where}: point[{index}]"
        xyz = row.get("xyz") if isinstance(row, dict) else None
        if not isinstance(xyz, list) or len(xyz) != 3 or not all(isinstance(one, int | float) for one in xyz):
            raise UsageError(f"{here}: xyz: expected three numbers")
        place, thickness = row.get("place"), row.get("thickness")
        if (place is None) == (thickness is None):
            raise UsageError(f"{here}: needs either thickness or place")
        if place is not None:
            age = values.get("age")
            known = next((name for name in places if name.casefold() == str(place).casefold()), None)
            if known is None:
                raise UsageError(f"{here}: place {place!r} is not known", hint=f"places: {', '.join(places)}")
            if age not in groups:
                raise UsageError(f"{where}: age: expected one of {', '.join(groups)}, not {age!r}")
            thickness = places[known][groups.index(str(age))]
        if isinstance(thickness, bool) or not isinstance(thickness, int | float) or not 0 < thickness < 1e3:
            raise UsageError(f"{here}: thickness: expected a number above 0, not {thickness!r}")
        points.append(FatPoint((float(xyz[0]), float(xyz[1]), float(xyz[2])), float(thickness)))
    return points


def interpolated(mesh: Mesh, points: Sequence[FatPoint]) -> Floats:
    """Return the thickness at each vertex (V,): the mean of all points by 1 / distance squared (Shepard 1968)."""
    places = np.array([point.xyz for point in points])
    values = np.array([point.thickness_mm for point in points])
    total, weights = np.zeros(len(mesh.vertices)), np.zeros(len(mesh.vertices))
    for place, value in zip(places, values, strict=True):
        weight = 1.0 / np.maximum(((mesh.vertices - place) ** 2).sum(axis=1), _NEAREST_MM**2)
        total += weight * value
        weights += weight
    return total / weights


def at_vertices(mesh: Mesh, values: Floats, where: str) -> Floats:
    """Return the thickness at each vertex, of a list of numbers for the vertices or for the triangles of the skin.

    Raises
    ------
    UsageError
        If there are not as many numbers as either, or one is not above 0.
    """
    if not (np.isfinite(values) & (values > 0)).all():
        raise UsageError(f"{where}: thickness has to be finite and above 0 everywhere")
    if len(values) == len(mesh.vertices):
        return values
    if len(values) != len(mesh.faces):
        raise UsageError(
            f"{where}: {len(values)} numbers, but the skin has {len(mesh.vertices)} vertices "
            f"and {len(mesh.faces)} triangles"
        )
    sums = np.bincount(mesh.faces.ravel(), np.repeat(values, 3), len(mesh.vertices))
    return sums / np.maximum(np.bincount(mesh.faces.ravel(), minlength=len(mesh.vertices)), 1)


def gentle(mesh: Mesh, values: Floats) -> Floats:
    """Return a thickness that changes by at most `STEEPEST` along edges: lowered where it is too steep.

    It is the largest such function that is nowhere above the given one.
    """
    topology = surface.topology(mesh.vertices, mesh.faces)
    first, second = np.concatenate([topology.inner_edges, topology.boundary_edges]).T
    rise = STEEPEST * np.linalg.norm(mesh.vertices[first] - mesh.vertices[second], axis=1)
    found = values.astype(np.float64).copy()
    while True:
        before = found.copy()
        np.minimum.at(found, first, before[second] + rise)
        np.minimum.at(found, second, before[first] + rise)
        if np.array_equal(found, before):
            return found
