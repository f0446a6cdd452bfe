"""A tissue, or some of its faces, on its way: where it is at a time, and how far it travels in between."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from vhp_cli.kernels.spatial import Tree
from vhp_cli.stages.breathe.blend import Blend
from vhp_cli.stages.breathe.operations import Operation, Scale
from vhp_cli.stages.breathe.sequence import Motion
from vhp_cli.stages.breathe.tissue import Tissue

Array = NDArray[np.float64]
Faces = NDArray[np.int32]


class Body:
    """Faces that move; may be used by any number of threads.

    Parameters
    ----------
    vertices : (V, 3) float64
        At rest, in mm.
    faces : (F, 3) int32
        All of the tissue's, or some.
    motion
        None: they stay.
    steps
        N.
    tree
        Of the faces at rest, if there is one.
    moved_at_rest
        Whether the motion may not be the identity at t = 0.
    """

    def __init__(
        self,
        vertices: Array,
        faces: Faces,
        motion: Motion | None,
        steps: int,
        tree: Tree | None = None,
        *,
        moved_at_rest: bool = False,
    ) -> None:
        self.vertices, self.faces, self.motion = vertices, faces, motion
        self._still = motion is None or not moved_at_rest
        self._rest = tree
        self._trees: dict[float, Tree] = {}
        self._travels: dict[tuple[float, float], float] = {}
        self._points = self._hull()
        self.grid = np.arange(steps + 1, dtype=np.float64)
        if motion is not None:
            for t, bound in enumerate(motion.travel_bounds(self._points, self.grid).tolist()):
                self._travels[float(t), float(t + 1)] = bound

    @classmethod
    def of(cls, tissue: Tissue, motion: Motion | None, steps: int, *, moved_at_rest: bool = False) -> Body:
        """Return a whole tissue."""
        mesh = tissue.mesh
        return cls(mesh.vertices, mesh.faces, motion, steps, tissue.tree, moved_at_rest=moved_at_rest)

    def part(self, chosen: NDArray[np.bool_]) -> Body:
        """Return some of the faces, (F,) bool, as a body of their own."""
        return Body(
            self.vertices, np.ascontiguousarray(self.faces[chosen]), self.motion, len(self.grid) - 1,
            moved_at_rest=not self._still,
        )  # fmt: skip

    def _hull(self) -> Array:
        """Return points whose convex hull holds the faces; of what bends, the vertices, between which it is linear."""
        used = self.vertices[np.unique(self.faces)]
        if not len(used) or (self.motion is not None and self.motion.fields):
            return used
        return np.array(list(product(*np.stack([used.min(axis=0), used.max(axis=0)], axis=1))))

    def travel(self, start: float, end: float) -> float:
        """Return an upper bound of the length of path of any point between two times, in mm."""
        if self.motion is None:
            return 0.0
        found = self._travels.get((start, end))
        if found is None:
            found = self._travels[start, end] = self.motion.travel_bound(self._points, start, end)
        return found

    def whole_travel(self) -> float:
        """Return the bound of the whole way from 0 to N."""
        return sum(self.travel(t, t + 1.0) for t in self.grid[:-1].tolist())

    def place(self, t: float) -> Array:
        """Return the vertices at a time, (V, 3)."""
        if self.motion is None or (t == 0.0 and self._still):
            return self.vertices
        return self.motion.apply(self.vertices, t)

    def tree(self, t: float) -> Tree:
        """Return the search tree at a time; those at whole steps, which every pair needs, are kept."""
        if self.motion is None or (t == 0.0 and self._still):
            if self._rest is None:
                self._rest = Tree(self.vertices, self.faces)
            return self._rest
        found = self._trees.get(t)
        if found is None:
            found = Tree(self.place(t), self.faces)
            if t == int(t):
                self._trees[t] = found
        return found

    @property
    def rigid(self) -> bool:
        """Whether lengths stay as they are."""
        motion = self.motion
        return motion is None or not (motion.fields or any(isinstance(step, Scale) for step in motion.operations))

    def carriers(self) -> list[tuple[tuple[Operation, ...], NDArray[np.bool_]]]:
        """Return the affine maps that faces follow exactly, and which faces do, (F,) bool each."""
        everything = np.ones(len(self.faces), dtype=bool)
        if self.motion is None:
            return [((), everything)]
        if not self.motion.fields:
            return [(self.motion.operations, everything)]
        if len(self.motion.fields) > 1 or not isinstance(self.motion.fields[0], Blend):
            return []
        holders = self.motion.fields[0].holders
        held = self.motion.fields[0].held(self.vertices)[self.faces]
        found: dict[tuple[Operation, ...], NDArray[np.bool_]] = {}
        for index, holder in enumerate(holders):
            own = (held == index).all(axis=1)
            found[holder.operations] = found.get(holder.operations, ~everything) | own
        return list(found.items())
