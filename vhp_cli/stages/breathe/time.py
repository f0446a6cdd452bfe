"""From time to the sweep variable: one breath, its frames and its presets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vhp_cli.stages.breathe.sequence import STEPS, Targets

Array = NDArray[np.float64]

PERIOD_S = 5.0

# quiet: thesis 3.5 and 3.7. The others keep its litres per mm of diaphragm travel. deep: 37 mm, the least travel that
# is normal in deep breathing of women; shallow: 10 mm, the least in quiet breathing (Boussuges, Gole, Blanc 2009,
# Chest 135:391-400; 10 mm is also the low end of the quiet range that thesis 3.1 quotes).
PRESETS: dict[str, Targets] = {
    "quiet": Targets(0.32, 20.0),
    "deep": Targets(0.592, 37.0),
    "shallow": Targets(0.16, 10.0),
}


@dataclass(frozen=True, slots=True)
class Moment:
    """One frame of a breath.

    Parameters
    ----------
    index
        Of the frame, from 0.
    x
        The sweep variable, 0 (full exhalation) to N (full inhalation).
    time_over_period
        Time as a share of the period.
    """

    index: int
    x: float
    time_over_period: float


def sweep(time_over_period: ArrayLike, steps: int = STEPS) -> Array:
    """Return the sweep variable at a time: ``x = N sin^4(pi t / T)``.

    This is thesis eq. (3.1) with the phase and the sign that its Table 3.1 has: exhalation at t = 0, where the breath
    lingers (x < N/2 for 64 % of the period).

    Parameters
    ----------
    time_over_period
        t / T, any real numbers.
    steps
        N.
    """
    # Reduced first, so that whole periods give 0 exactly.
    share = np.mod(np.asarray(time_over_period, dtype=np.float64), 1.0)
    value: Array = steps * np.sin(np.pi * share) ** 4
    return value


def time_over_period(x: ArrayLike, steps: int = STEPS) -> Array:
    """Return when, while breathing in, the sweep variable is `x`: t / T, 0 to 1/2 (thesis 3.3).

    Raises
    ------
    ValueError
        If an `x` is not within 0..N.
    """
    level = np.asarray(x, dtype=np.float64)
    if not ((level >= 0.0) & (level <= steps)).all():
        raise ValueError(f"the sweep variable runs from 0 to {steps}")
    value: Array = np.arcsin((level / steps) ** 0.25) / np.pi
    return value


def full_cycle(steps: int = STEPS) -> tuple[Moment, ...]:
    """Return the 2N + 1 frames of a breath at whole values of x: 0, 1, ..., N, ..., 1, 0 (thesis Table 3.1)."""
    rise = time_over_period(np.arange(steps + 1), steps)
    times = np.concatenate([rise, 1.0 - rise[-2::-1]])
    levels = [*range(steps + 1), *range(steps - 1, -1, -1)]
    return tuple(
        Moment(index, float(level), float(time)) for index, (level, time) in enumerate(zip(levels, times, strict=True))
    )


def frames_at(times_s: Sequence[float], period_s: float = PERIOD_S, steps: int = STEPS) -> tuple[Moment, ...]:
    """Return the frames at given times in seconds.

    Raises
    ------
    ValueError
        If there is no time, one is not finite, or the period is not above 0.
    """
    shares = np.asarray(times_s, dtype=np.float64) / _checked_period(period_s)
    if shares.ndim != 1 or not len(shares) or not np.isfinite(shares).all():
        raise ValueError("frames need one finite time or more")
    levels = np.clip(sweep(shares, steps), 0.0, steps)
    return tuple(
        Moment(index, float(level), float(share))
        for index, (level, share) in enumerate(zip(levels, shares, strict=True))
    )


def even_frames(count: int, steps: int = STEPS) -> tuple[Moment, ...]:
    """Return `count` frames evenly spaced in time over one breath, the first and the last at rest.

    Raises
    ------
    ValueError
        If `count` is below 2.
    """
    if count < 2:
        raise ValueError(f"a breath needs 2 frames or more, not {count}")
    return frames_at([index / (count - 1) for index in range(count)], 1.0, steps)


def _checked_period(period_s: float) -> float:
    if not (np.isfinite(period_s) and period_s > 0.0):
        raise ValueError(f"the period must be above 0 seconds, not {period_s}")
    return period_s
