"""Tell the open ends of a solid, which are capped, from the borders of a surface that is no solid at all."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vhp_cli.inspection.places import point
from vhp_cli.kernels.surface import topology
from vhp_cli.measures import Action
from vhp_cli.mesh import Mesh
from vhp_cli.stages.heal.candidate import diagonal, face_areas
from vhp_cli.stages.heal.clean import compact
from vhp_cli.stages.heal.holes import Hole, holes

# Caps may invent this share of the closed surface; more only behind borders that were cut in a plane.
CAP_SHARE = 0.1
# A border counts as cut in a plane if its root mean square distance from one is below this share of its length, ...
PLANE_CUT = 0.045
# ... and as jagged, all the same, above this share if it also zigzags: its turns add up to so many full circles.
NEAR_PLANE = 0.015
ZIGZAG = 2.5
# Even plane caps make no solid of a sheet: it lies nearly in their plane, or they are larger than all of it. Volume
# over (area of caps)^1.5; half a ball has 0.38, a bowl of a tenth of its radius 0.03.
FLAT_BOWL = 0.02
# Isoperimetric quotient, 36 pi volume^2 / area^3: 1 for a ball, 0.6 for half of one, 0.3 for a tube of five diameters
# length. A wrinkled sheet with a border that happens to lie in a plane has next to none.
LEAST_ROUNDNESS = 0.08
# An open shard beside a solid is taken out if it has less than this share of the area; a larger one is a patch.
SHARD_SHARE = 0.02


# A hole is an opening, where a vessel or organ was cut, if it has so many edges and is so long around, over the
# diagonal of the box; else it is a defect.
OPENING_EDGES = 8
OPENING_SHARE = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A component of a mesh with its openings.

    Parameters
    ----------
    faces : (F,) bool
        Its faces.
    openings
        Its holes.
    area_mm2, cap_mm2, jagged_mm2
        Area of the component, of the caps that it needs, and of those with a jagged border.
    volume_mm3
        What it would enclose.
    """

    faces: NDArray[np.bool_]
    openings: tuple[Hole, ...]
    area_mm2: float
    cap_mm2: float
    jagged_mm2: float
    volume_mm3: float

    @property
    def flaw(self) -> str:
        """Why the part is no solid, in a clause; empty if it is one, or closed."""
        whole = self.area_mm2 + self.cap_mm2
        if not self.openings:
            return ""
        if self.jagged_mm2 > CAP_SHARE * whole:
            return f"an open patch: closing its jagged border would invent {100 * self.jagged_mm2 / whole:.0f} % of it"
        flat = abs(self.volume_mm3) < FLAT_BOWL * self.cap_mm2**1.5
        wrinkled = 36 * np.pi * self.volume_mm3**2 < LEAST_ROUNDNESS * whole**3
        if self.cap_mm2 > CAP_SHARE * whole and (flat or wrinkled or self.cap_mm2 > self.area_mm2):
            return "an open sheet: closed, it would enclose next to nothing but what was invented"
        return ""


def parts(mesh: Mesh) -> list[Part]:
    """Describe each component of a mesh that is oriented coherently."""
    component = topology(mesh.vertices, mesh.faces).component
    areas = face_areas(mesh)
    openings: dict[int, list[Hole]] = {}
    for hole in holes(mesh):
        openings.setdefault(hole.component, []).append(hole)
    found = []
    for number in range(int(component.max(initial=-1)) + 1):
        faces = component == number
        own = openings.get(number, [])
        found.append(
            Part(
                faces,
                tuple(own),
                float(areas[faces].sum()),
                sum(hole.area_mm2 for hole in own),
                sum(hole.area_mm2 for hole in own if is_jagged(mesh.vertices[hole.loop], hole.planarity)),
                _volume(mesh, faces, own),
            )
        )
    return found


def defects(mesh: Mesh) -> list[Hole]:
    """Return the holes of a mesh that are no openings."""
    least = OPENING_SHARE * diagonal(mesh)
    return [hole for hole in holes(mesh) if hole.edges < OPENING_EDGES or hole.length_mm < least]


def is_jagged(loop: NDArray[np.float64], planarity: float) -> bool:
    """Tell whether a border is that of a patch torn out of a surface rather than a cut through a solid.

    Parameters
    ----------
    loop : (n, 3) float64
        The border, in mm.
    planarity
        Its root mean square distance from a plane, over its length.
    """
    if planarity <= NEAR_PLANE:
        return False
    return planarity > PLANE_CUT or turns(loop) > ZIGZAG


def turns(loop: NDArray[np.float64]) -> float:
    """Return the angles by which a closed polygon turns at its corners, added up, in full circles (1: convex)."""
    edges = np.roll(loop, -1, axis=0) - loop
    edges = edges[(edges != 0).any(axis=1)]
    after = np.roll(edges, -1, axis=0)
    along = np.einsum("ij,ij->i", edges, after)
    across = np.linalg.norm(np.cross(edges, after), axis=1)
    return float(np.arctan2(across, along).sum() / (2 * np.pi))


def drop_shards(mesh: Mesh) -> tuple[Mesh, list[Action], str]:
    """Take out small open shards beside a solid.

    Returns
    -------
    mesh, actions
        What is left; each shard has an action with its size and place.
    refusal
        Why the surface is no solid, in a sentence; empty if it is one.
    """
    found = parts(mesh)
    total = sum(part.area_mm2 for part in found)
    bad = [part for part in found if part.flaw]
    shards = [part for part in bad if part.area_mm2 <= SHARD_SHARE * total]
    if len(shards) < len(bad):
        worst = max((part for part in bad if part.area_mm2 > SHARD_SHARE * total), key=lambda part: part.area_mm2)
        kept = 100 * worst.area_mm2 / total
        whole = "it is" if len(found) == 1 else f"a part with {kept:.0f} % of its area is"
        return mesh, [], f"{whole} {worst.flaw}"
    if not shards:
        return mesh, [], ""
    drop = np.zeros(len(mesh.faces), np.bool_)
    actions: list[Action] = []
    for shard in shards:
        drop |= shard.faces
        corners = mesh.vertices[mesh.faces[shard.faces]].reshape(-1, 3)
        size = float(np.linalg.norm(corners.max(axis=0) - corners.min(axis=0)))
        actions.append(
            {
                "step": "shards",
                "message": f"loose open shard of {shard.faces.sum()} faces removed, {size:.3g} mm wide",
                "count": int(shard.faces.sum()),
                "places": [{"xyz_mm": point(corners.mean(axis=0)), "face": None, "value": size}],
                "area_mm2": shard.area_mm2,
            }
        )
    return compact(Mesh(mesh.vertices, mesh.faces[~drop])), actions, ""


def _volume(mesh: Mesh, faces: NDArray[np.bool_], openings: list[Hole]) -> float:
    """Return the volume of a component with a fan in each of its holes."""
    if not faces.any():
        return 0.0
    origin = mesh.vertices[mesh.faces[faces][0, 0]]
    a, b, c = (mesh.vertices[mesh.faces[faces][:, k]] - origin for k in range(3))
    volume = float(np.einsum("ij,ij->", a, np.cross(b, c)))
    for hole in openings:
        loop = mesh.vertices[hole.loop] - origin
        volume += float((np.cross(loop, np.roll(loop, -1, axis=0)) @ (hole.centre - origin)).sum())
    return volume / 6
