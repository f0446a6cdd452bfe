"""Decimate one tissue: collapses of least error, then flips and relaxation for well shaped triangles."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vhp_cli.inspection.deviation import deviation
from vhp_cli.kernels.decimating import Decimated, want_volumes, wanted_volumes
from vhp_cli.kernels.decimating import decimate as collapse
from vhp_cli.kernels.measuring import closest
from vhp_cli.kernels.remeshing import Remesher
from vhp_cli.kernels.spatial import Tree
from vhp_cli.measures import Action, Deviation
from vhp_cli.mesh import Mesh
from vhp_cli.stages.decimate.options import DecimateOptions
from vhp_cli.stages.heal.candidate import Candidate, as_written, diagonal, face_areas, judge
from vhp_cli.stages.outcome import Outcome

# The default for the deviation, as shares of the diagonal and of the mean edge.
_DIAGONAL_SHARE = 5e-3
_EDGE_SHARE = 0.25
# What the guards of the collapses are told, as shares of the allowed deviation, until a result is within it: nothing,
# which is the fastest and mostly does, where there is a target; then less and less, as they look at some points only.
_SHARES = (math.inf, 0.9, 0.6, 0.3)
# Flips and moves may take the surface this many times as far as the collapses did; farther only while there are
# triangles below the target, and then for these alone.
_ROOMS = (1.1, 1.5, 2.5)
# ... and to this share of the limit, as they are looked at in a few points only;
_LIMIT_SHARE = 0.8
# ... but never less than this share of the mean edge.
_LEAST_ROOM = 0.005
# Collapses may leave triangles of this share of the target for q: flips and moves bring them up.
_FLOOR_SHARE = 2 / 3
# Change of the volume that is as good as none; and the most, but for the last attempt, which is nearest to the input.
_VOLUME_TOLERANCE = 1e-3
_MOST_VOLUME = 0.02
# The quality phase works on triangles below this q, so that what it leaves lies well above the target.
_WORK_BELOW = 0.45
# Bound on the time of the quality phase: boxes and triangles looked at, for each triangle, and at least.
_WORK_EACH, _WORK_LEAST = 20_000, 50_000_000
_ENDINGS = {
    "topology": "what is left can't be collapsed and stay manifold",
    "quality": "triangles would be worse than the target for q",
    "normal": "triangles would turn over",
    "envelope": "there is no good place for a vertex",
    "contact": "the surface would cross or touch itself",
    "deviation": "the surface would move farther than allowed",
}


def decimate(mesh: Mesh, options: DecimateOptions) -> Outcome:
    """Reduce the number of triangles of one tissue.

    Parameters
    ----------
    mesh
        The surface as read from its file, in mm.
    options
        Target, limits and method.

    Returns
    -------
    Outcome
        ``changed`` with the new surface, whose coordinates are float32 values, and as reason why the target was not
        reached, if so; ``unchanged`` if there are no more triangles than wanted; ``refused`` with the reason if none
        could go.
    """
    given = judge(mesh, may_be_open=True)
    target = _target(given.mesh, options)
    if len(given.mesh.faces) <= target:
        return Outcome(None, "unchanged")
    limit = options.limit_share * (options.max_deviation_mm or default_limit(given))
    for share in _SHARES if options.targets else _SHARES[1:]:
        collapsed = _collapsed(given.mesh, target, share * limit, options)
        if not len(collapsed.errors):
            reason = _why_not(collapsed, len(collapsed.faces), target, options)
            return Outcome(None, "refused", f"no triangle removed: {reason}")
        found = _best(given, collapsed, limit, options)
        if found is not None and (share == _SHARES[-1] or _volume_error(given, found.candidate) <= _MOST_VOLUME):
            actions = _actions(given, found.candidate, target, options)
            # The quality phase takes a few triangles more away.
            reason = _why_not(collapsed, len(found.candidate.mesh.faces), target, options)
            return Outcome(found.candidate.mesh, "changed", reason, actions, found.deviation)
    return Outcome(None, "refused", f"no result lies within {limit:.3g} mm of the input, or is as sound as that")


def default_limit(given: Candidate) -> float:
    """Return how far a surface may move in mm where nothing is said.

    0.5 % of the diagonal of its box, or a quarter of its mean edge, which is the more where the triangles are few; but
    not more than volume over area: half of the radius of a tube, and of the thickness of a plate.
    """
    edge, measures = given.measures["edge_mm"], given.measures
    limit = max(_DIAGONAL_SHARE * diagonal(given.mesh), _EDGE_SHARE * (edge["mean"] if edge else 0.0))
    area = float(face_areas(given.mesh).sum())
    if measures["closed"] and measures["volume_mm3"] and area:
        limit = min(limit, abs(measures["volume_mm3"]) / area)
    return limit


def error_curve(mesh: Mesh) -> NDArray[np.float64]:
    """Estimate the error of a decimation of a tissue.

    Returns
    -------
    (C,) float64
        Largest quadric error in mm up to each collapse, which takes away two triangles; none beyond those that
        leave the surface manifold.
    """
    given = as_written(mesh)
    if not len(given.faces):
        return np.empty(0)
    return collapse(given.vertices, given.faces, check_contacts=False).errors


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """A result that keeps the limits."""

    candidate: Candidate
    deviation: Deviation


def _target(mesh: Mesh, options: DecimateOptions) -> int:
    """Return the number of triangles wanted; 0: as few as the limits allow."""
    if options.triangles is not None:
        return options.triangles
    if options.ratio is not None:
        return max(round(options.ratio * len(mesh.faces)), 4)
    return 0


def _collapsed(mesh: Mesh, target: int, max_deviation: float, options: DecimateOptions) -> Decimated:
    return collapse(
        mesh.vertices,
        mesh.faces,
        target_triangles=target,
        edge_length=options.edge_length_mm or math.inf,
        max_deviation=max_deviation,
        method=options.method,
        min_quality=_FLOOR_SHARE * options.target_quality,
    )


def _why_not(collapsed: Decimated, left: int, target: int, options: DecimateOptions) -> str:
    """Return why the target was not reached; empty if it was, or if the limits are the target."""
    if collapsed.ending != "refused" or not options.targets or left <= target:
        return ""
    guard = max(collapsed.last_refused, key=lambda name: collapsed.last_refused[name])
    wanted = (
        f"{target} triangles were asked for" if target else f"edges of {options.edge_length_mm:g} mm were asked for"
    )
    return f"{wanted}, {left} triangles are left: {_ENDINGS[guard]}"


def _best(given: Candidate, collapsed: Decimated, limit: float, options: DecimateOptions) -> _Found | None:
    """Return the result in the best shape that keeps the limit and is as sound as the input, if there is one."""
    reached, nearest = _reached(given.mesh, collapsed)
    if reached > limit:
        return None
    candidates = [judge(Mesh(collapsed.vertices, collapsed.faces), may_be_open=True)]
    for shaped in _shaped(given.mesh, collapsed, reached, nearest, limit, options):
        candidates.append(judge(shaped, may_be_open=True))
        if _rank(given, candidates[-1], options)[:2] == (True, options.target_quality):
            break
    for candidate in sorted(candidates, key=lambda one: _rank(given, one, options), reverse=True):
        if candidate.sound or not given.sound:
            measured = deviation(given.mesh, candidate.mesh, lost_limit_mm=limit)
            if measured["max"] <= limit:
                return _Found(candidate, measured)
    return None


def _reached(given: Mesh, collapsed: Decimated) -> tuple[float, NDArray[np.int32]]:
    """Return how far the surfaces lie apart at vertices and centres of faces, and the new face nearest to each vertex.

    It is never more than what `deviation` finds, by some percent less, and costs a tenth.
    """
    centres = collapsed.vertices[collapsed.faces].mean(axis=1)
    there = closest(Tree(collapsed.vertices, collapsed.faces), given.vertices)
    back = closest(Tree(given.vertices, given.faces), np.concatenate([collapsed.vertices, centres]))
    return float(max(there.distances.max(), back.distances.max())), there.faces


def _rank(given: Candidate, candidate: Candidate, options: DecimateOptions) -> tuple[bool, float, float]:
    return (
        _volume_error(given, candidate) <= _VOLUME_TOLERANCE,
        min(candidate.min_quality, options.target_quality),
        candidate.mean_quality,
    )


def _volume_error(given: Candidate, made: Candidate) -> float:
    """Return the change of the volume as a part of it; 0 where there is none."""
    before, after = given.measures, made.measures
    if not before["closed"] or not after["closed"] or not before["volume_mm3"]:
        return 0.0
    return abs(abs(after["volume_mm3"]) / abs(before["volume_mm3"]) - 1)


def _shaped(
    reference: Mesh,
    collapsed: Decimated,
    reached: float,
    nearest: NDArray[np.int32],
    limit: float,
    options: DecimateOptions,
) -> Iterator[Mesh]:
    """Yield surfaces of ever better shaped triangles, by flips and moves that take them ever farther away."""
    vertices, faces, volumes = collapsed.vertices, collapsed.faces, collapsed.volumes
    sizes = _edge_lengths(vertices, faces)
    wanted = sizes[faces[nearest]].mean(axis=1)
    least = _LEAST_ROOM * float(np.median(sizes))
    for room in _ROOMS:
        remesher = Remesher(
            vertices,
            faces,
            sizes=sizes,
            reference=(reference.vertices, reference.faces),
            reference_sizes=wanted,
            deviation=min(max(room * reached, least), max(_LIMIT_SHARE * limit, reached)),
            target_quality=max(_WORK_BELOW, options.target_quality),
            floor=max(0.35, options.target_quality),
            min_edge=0.0,
            max_triangles=len(faces),
            max_work=max(_WORK_EACH * len(faces), _WORK_LEAST),
        )
        want_volumes(remesher, volumes)
        if room == _ROOMS[0]:
            remesher.flip()
        remesher.improve()
        remesher.restore_volume()
        vertices, faces, sizes, volumes = *remesher.result_with_sizes(), wanted_volumes(remesher)
        yield Mesh(vertices, faces)


def _edge_lengths(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.float64]:
    """Return the mean length of the edges at each vertex in mm (V,)."""
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    length = np.linalg.norm(vertices[start] - vertices[end], axis=1)
    total = np.zeros(len(vertices))
    for ends in (start, end):
        total += np.bincount(ends, weights=length, minlength=len(vertices))
    count = np.bincount(start, minlength=len(vertices)) + np.bincount(end, minlength=len(vertices))
    lengths: NDArray[np.float64] = np.maximum(total / np.maximum(count, 1), 1e-30)
    return lengths


def _actions(given: Candidate, made: Candidate, target: int, options: DecimateOptions) -> list[Action]:
    n_before, n_after = given.measures["triangles"], made.measures["triangles"]
    asked = f" ({target} asked for)" if target else ""
    volume = ""
    if given.measures["closed"] and made.measures["closed"] and given.measures["volume_mm3"]:
        change = abs(made.measures["volume_mm3"]) / abs(given.measures["volume_mm3"]) - 1
        volume = f", volume {100 * change:+.3f} %"
    message = (
        f"{options.method}: {n_before} -> {n_after} triangles{asked}, "
        f"min q {given.min_quality:.2g} -> {made.min_quality:.2g}, "
        f"mean q {given.mean_quality:.2f} -> {made.mean_quality:.2f}{volume}"
    )
    return [{"step": "decimate", "message": message, "count": n_before - n_after, "places": []}]
