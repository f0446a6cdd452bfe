"""Smooth one tissue: better triangles, the same shape, and nothing broken on the way."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from vhp_cli.inspection.deviation import deviation
from vhp_cli.kernels import surface
from vhp_cli.kernels.smoothing import Smoothing
from vhp_cli.measures import Action, SmoothingStep
from vhp_cli.mesh import Mesh
from vhp_cli.stages.heal.candidate import as_written, diagonal
from vhp_cli.stages.outcome import Outcome
from vhp_cli.stages.smooth.guard import Guard, Limits
from vhp_cli.stages.smooth.history import State, measured
from vhp_cli.stages.smooth.options import GUARDED, SmoothOptions
from vhp_cli.stages.smooth.relaxing import FLOOR, quality_floor, relaxed, rounded_off
from vhp_cli.stages.smooth.stepping import stepped
from vhp_cli.stages.smooth.textbook import TextbookSettings, smooth_textbook

# Shares of the allowed deviation; the next one where the result does not keep a limit after all.
_SHARES = (0.7, 0.4, 0.2, 0.1, 0.05)
# The guarded method stops after so many iterations in which neither mean nor least q rose by more than this.
_PATIENCE = 3
_LEAST_RISE = 1e-3
# Less is no gain, and the tissue stays as it is.
_LEAST_GAIN = 1e-4
_WORDS = {"relax": "relaxed along the surface", "round off": "sharp edges rounded off"}


def smooth(mesh: Mesh, options: SmoothOptions) -> Outcome:
    """Smooth one tissue.

    Parameters
    ----------
    mesh
        The surface as read from its file, in mm. It may be open or have defects: these stay as they are.
    options
        Method and limits.

    Returns
    -------
    Outcome
        ``changed`` with the smoothed mesh, whose coordinates are float32 values but for unguarded methods;
        ``unchanged`` if there is nothing to gain; ``refused`` if the surface meets itself in too many places.
    """
    if options.unguarded:
        return _unguarded(mesh, options)
    given = _prepared(mesh)
    if not len(given.faces):
        return Outcome(None, "unchanged")
    floor = quality_floor(given)
    limit = options.max_deviation_mm or min(1e-3 * diagonal(mesh), 0.1)
    limits = Limits(limit, floor, options.min_edge_mm)
    guard = Guard(given, limits, _features(given, options.feature_angle_deg))
    if not guard.complete:
        return Outcome(None, "refused", "it meets itself in more places than can be kept apart; heal it first")
    start = measured(given, "input", 0, sharp_deg=options.max_dihedral_deg)
    for share in _SHARES:
        history = _smoothed(guard.narrowed(share), start, options)
        best = history[-1]
        if not _is_gain(start, best, options):
            return Outcome(None, "unchanged", history=[state.entry for state in history])
        if best.min_edge_mm < min(start.min_edge_mm, options.min_edge_mm):
            continue
        if guard.volume_error(best.mesh) > options.volume_tolerance:
            continue
        apart = deviation(mesh, best.mesh, lost_limit_mm=limit)
        if apart["max"] <= limit:
            entries = [state.entry for state in history]
            return Outcome(best.mesh, "changed", "", _actions(entries, options), apart, entries)
    return Outcome(None, "unchanged", history=[start.entry])


def _unguarded(mesh: Mesh, options: SmoothOptions) -> Outcome:
    if not len(mesh.faces):
        return Outcome(None, "unchanged")
    settings = TextbookSettings(_smoothing(options), options.with_flips, options.most_iterations, options.until_quality)
    found = smooth_textbook(mesh, settings, _features(mesh, options.feature_angle_deg))
    start, end = measured(mesh, "input", 0).entry, measured(found.mesh, options.method, found.chosen).entry
    entries: list[SmoothingStep] = [
        {
            "iteration": step.number,
            "step": "input" if step.number == 0 else options.method,
            "min_q": step.min_q,
            "mean_q": step.mean_q,
            "volume_mm3": step.volume_mm3,
            "max_turn_deg": start["max_turn_deg"] if step.number == 0 else None,
            "flips": step.flips,
            "moves": len(mesh.vertices) if step.number else 0,
            "held": 0,
        }
        for step in found.history
    ]
    entries[-1]["max_turn_deg"] = end["max_turn_deg"]
    if not found.chosen or not np.isfinite(found.mesh.vertices).all():
        return Outcome(None, "unchanged", history=entries)
    apart = deviation(mesh, found.mesh, lost_limit_mm=options.max_deviation_mm or min(1e-3 * diagonal(mesh), 0.1))
    return Outcome(found.mesh, "changed", "", _actions(entries, options), apart, entries)


def _smoothed(guard: Guard, start: State, options: SmoothOptions) -> list[State]:
    """Return the states from the given surface to the one to take."""
    if options.method == GUARDED:
        states = relaxed(guard, flips=options.with_flips)
        history = _up_to_best([start, *_until(states, start, options, patience=_PATIENCE)], options)
        mesh = guard.restore_volume(history[-1].mesh, options.volume_tolerance)
        if mesh is not history[-1].mesh:
            history.append(_measured(mesh, "volume", history[-1].entry["iteration"], options))
    else:
        states = stepped(guard, _smoothing(options), options.volume_tolerance, flips=options.with_flips)
        history = [start, *_until(states, start, options)]
    if options.max_dihedral_deg is not None:
        rounding = rounded_off(guard, history[-1], options.max_dihedral_deg, options.volume_tolerance)
        history += islice(rounding, options.most_iterations)
    # What was done last may have cost more quality than there was to begin with.
    while history[-1].mean_quality < start.mean_quality or history[-1].min_quality < start.min_quality:
        history.pop()
    return history


def _until(
    states: Iterable[State], start: State, options: SmoothOptions, *, patience: int | None = None
) -> Iterator[State]:
    """Yield states until the goal is reached, the iterations are used up, or q has not risen for a while."""
    best_min, best_mean, waited = start.min_quality, start.mean_quality, 0
    reached = options.until_quality is not None and start.min_quality >= options.until_quality
    for state in islice(states, 0 if reached else options.most_iterations):
        yield state
        if options.until_quality is not None and state.min_quality >= options.until_quality:
            return
        rises = state.min_quality > best_min + _LEAST_RISE or state.mean_quality > best_mean + _LEAST_RISE
        best_min, best_mean = max(best_min, state.min_quality), max(best_mean, state.mean_quality)
        waited = 0 if rises else waited + 1
        if patience is not None and waited >= patience:
            return


def _up_to_best(history: list[State], options: SmoothOptions) -> list[State]:
    """Return the states up to the one with the best triangles, or the one that reached the goal."""
    if options.until_quality is not None and history[-1].min_quality >= options.until_quality:
        return history
    best = max(range(len(history)), key=lambda i: (min(history[i].min_quality, FLOOR) + history[i].mean_quality, -i))
    return history[: best + 1]


def _is_gain(start: State, best: State, options: SmoothOptions) -> bool:
    if best is start:
        return False
    if options.method != GUARDED or best.excess < start.excess:
        return True
    return max(best.min_quality - start.min_quality, best.mean_quality - start.mean_quality) > _LEAST_GAIN


def _measured(mesh: Mesh, step: str, iteration: int, options: SmoothOptions) -> State:
    return measured(mesh, step, iteration, sharp_deg=options.max_dihedral_deg)


def _smoothing(options: SmoothOptions) -> Smoothing:
    return Smoothing(options.method, options.update, correction=options.correction, tangential=options.tangential)


def _prepared(mesh: Mesh) -> Mesh:
    """Return a mesh as it is written, without vertices that belong to no face."""
    written = as_written(mesh)
    used = np.zeros(len(written.vertices), dtype=np.bool_)
    used[written.faces.ravel()] = True
    numbers = np.cumsum(used) - 1
    return Mesh(written.vertices[used], numbers[written.faces])


def _features(mesh: Mesh, angle_deg: float | None) -> NDArray[np.bool_] | None:
    """Return the ends of the edges at which the surface turns by more than an angle; None without one."""
    if angle_deg is None:
        return None
    joined = surface.topology(mesh.vertices, mesh.faces)
    turns = 180.0 - surface.dihedral_angles(mesh.vertices, mesh.faces, joined.inner_edges, joined.inner_edge_faces)
    fixed = np.zeros(len(mesh.vertices), dtype=np.bool_)
    fixed[joined.inner_edges[turns > angle_deg]] = True
    return fixed


def _actions(entries: Sequence[SmoothingStep], options: SmoothOptions) -> list[Action]:
    """Say what was done, in one action for each kind of step."""
    first, actions = entries[0], []
    by_step: dict[str, list[SmoothingStep]] = {}
    for entry in entries[1:]:
        by_step.setdefault(entry["step"], []).append(entry)
    for step, done in by_step.items():
        last = done[-1]
        flips, moves = sum(entry["flips"] for entry in done), sum(entry["moves"] for entry in done)
        parts = [
            f"min q {first['min_q']:.2g} -> {last['min_q']:.2g}",
            f"mean q {first['mean_q']:.3f} -> {last['mean_q']:.3f}",
        ]
        if step == "round off" and first["max_turn_deg"] is not None and last["max_turn_deg"] is not None:
            parts = [f"sharpest turn {first['max_turn_deg']:.0f} -> {last['max_turn_deg']:.0f} degrees"]
        if step == "volume":
            parts = ["volume restored"]
        elif flips:
            parts.append(f"{flips} flips")
        rounds = f"{_WORDS.get(step, f'{step} smoothing')}, {len(done)} iterations: " if step != "volume" else ""
        actions.append(
            Action(step=step.replace(" ", "-"), message=rounds + ", ".join(parts), count=max(moves, 1), places=[])
        )
        first = last
    return actions
