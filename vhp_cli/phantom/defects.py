"""Plant defects in a sound model, each in tissues that have none yet, and say where they are."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator

import numpy as np

from vhp_cli.kernels.spatial import Tree, gap
from vhp_cli.mesh import Mesh
from vhp_cli.phantom.pair_defects import PAIR_PLANTS, PairPlant
from vhp_cli.phantom.sites import MAX_EDGE, Array, Planted, Site
from vhp_cli.phantom.tissue_defects import PLANTS

IDENTICAL = "P004"
RULES = (*PLANTS, *PAIR_PLANTS, IDENTICAL)

# Distance in mm that what is moved keeps from all other tissues, as in the sound model.
CLEARANCE = 1.02
# Farthest that a part of one tissue is moved to another one, in mm.
REACH = 9.0
TRIALS = 6


def plant_defects(
    tissues: dict[str, Mesh], seed: int, count: int | None = None, kinds: Collection[str] = RULES
) -> tuple[dict[str, Mesh], list[Planted]]:
    """Spoil some tissues of a sound model.

    Parameters
    ----------
    tissues
        Closed surfaces that keep their distance from each other.
    seed
        Decides what is planted and where; the same seed gives the same defects.
    count
        Number of defects; default: 8 to 14, each kind once as far as the number goes.
    kinds
        The rules that may be broken; others of them than `RULES` are left out.

    Returns
    -------
    dict of str to Mesh
        The model, in the same order; a copy of a tissue comes last.
    list of Planted
        What was done. It is shorter than asked for only if there was no room left.
    """
    return _Planter(tissues, seed).plant(count, [rule for rule in RULES if rule in kinds])


class _Planter:
    def __init__(self, tissues: dict[str, Mesh], seed: int) -> None:
        self.tissues = dict(tissues)
        self.random = np.random.default_rng(seed)
        self.free = list(tissues)  # tissues without a defect
        self.lower = {name: mesh.vertices.min(axis=0) for name, mesh in tissues.items()}
        self.upper = {name: mesh.vertices.max(axis=0) for name, mesh in tissues.items()}
        self.trees: dict[str, Tree] = {}

    def plant(self, count: int | None, kinds: list[str]) -> tuple[dict[str, Mesh], list[Planted]]:
        number = int(self.random.integers(8, 15)) if count is None else count
        rounds = -(-number // len(kinds)) if kinds else 0
        rules = [str(rule) for _ in range(rounds) for rule in self.random.permutation(kinds)]
        # Defects between tissues first: they need two neighbours without a defect.
        wanted = sorted(rules[:number], key=lambda rule: rule not in PAIR_PLANTS)
        planted = [done for rule in wanted if (done := self._plant_one(rule)) is not None]
        return self.tissues, planted

    def _plant_one(self, rule: str) -> Planted | None:
        if rule == IDENTICAL:
            return self._copy()
        if rule in PAIR_PLANTS:
            return self._in_pair(rule, PAIR_PLANTS[rule])
        variants = PLANTS[rule]
        return self._in_tissue(rule, variants[int(self.random.integers(len(variants)))])

    def _shuffled(self) -> list[str]:
        return [self.free[i] for i in self.random.permutation(len(self.free))]

    def _in_tissue(self, rule: str, plant: Callable[[Mesh, int], Site | None]) -> Planted | None:
        for name in self._shuffled():
            mesh = self.tissues[name]
            for face in self._faces(mesh, rule):
                site = plant(mesh, face)
                if site is not None and self._is_clear(site.changed, {name}):
                    return self._done(rule, (name,), site)
        return None

    def _faces(self, mesh: Mesh, rule: str) -> list[int]:
        """Pick a few faces at which to try, small enough that each is one place."""
        corners = mesh.vertices[mesh.faces]
        sides = np.roll(corners, -1, axis=1) - corners
        small = np.flatnonzero(np.linalg.norm(sides, axis=2).max(axis=1) < MAX_EDGE)
        if rule in ("X002", "X003", "X004") and len(small):
            # These need a face at right angles to an axis: the flattest ones.
            tilt = np.ptp(corners[small], axis=1).min(axis=1)
            small = small[np.argsort(tilt, kind="stable")[: 2 * TRIALS]]
        picked = self.random.permutation(len(small))[:TRIALS]
        return [int(face) for face in small[picked]]

    def _in_pair(self, rule: str, plant: PairPlant) -> Planted | None:
        for a in self._shuffled():
            for b, face_a, face_b in self._neighbours(a):
                site = plant(self.tissues[a], self.tissues[b], face_a, face_b)
                if site is not None and self._is_clear(site.changed, {a, b}):
                    self.free.remove(b)
                    return self._done(rule, (a, b), site)
        return None

    def _neighbours(self, a: str) -> Iterator[tuple[str, int, int]]:
        """Yield other free tissues that are near, and the two nearest faces."""
        for b in self._shuffled():
            if a == b or self._apart(self.lower[a], self.upper[a], b) > REACH:
                continue
            near = gap(self._tree(a), self._tree(b), REACH)
            if near is not None and near.distance > 0:
                yield b, *near.faces

    def _copy(self) -> Planted | None:
        if not self.free:
            return None
        name = self._shuffled()[0]
        mesh = self.tissues[name]
        copy = f"{name}_copy"
        self.tissues[copy] = Mesh(mesh.vertices, mesh.faces[::-1])
        self.free.remove(name)
        return Planted(IDENTICAL, (name, copy), _place(mesh.vertices[0]), "stored the tissue a second time")

    def _done(self, rule: str, names: tuple[str, ...], site: Site) -> Planted:
        self.tissues[names[0]] = site.mesh
        self.trees.pop(names[0], None)
        self.lower[names[0]], self.upper[names[0]] = site.mesh.vertices.min(axis=0), site.mesh.vertices.max(axis=0)
        self.free.remove(names[0])
        return Planted(rule, names, _place(site.xyz), site.note)

    def _is_clear(self, changed: Array, spared: set[str]) -> bool:
        """Tell if faces (k, 3, 3) keep their distance from all tissues but the spared ones."""
        if not len(changed):
            return True
        points = changed.reshape(-1, 3)
        tree = Tree(points, np.arange(len(points)).reshape(-1, 3))
        lower, upper = points.min(axis=0), points.max(axis=0)
        return all(
            name in spared
            or self._apart(lower, upper, name) > CLEARANCE
            or gap(tree, self._tree(name), CLEARANCE) is None
            for name in self.lower
        )

    def _apart(self, lower: Array, upper: Array, name: str) -> float:
        """Distance of a box from that of a tissue along the axis on which they are farthest apart."""
        return float(np.maximum(self.lower[name] - upper, lower - self.upper[name]).max())

    def _tree(self, name: str) -> Tree:
        if name not in self.trees:
            mesh = self.tissues[name]
            self.trees[name] = Tree(mesh.vertices, mesh.faces)
        return self.trees[name]


def _place(xyz: Array) -> tuple[float, float, float]:
    x, y, z = (round(float(value), 4) for value in xyz)
    return x, y, z
