"""The sweep variable over time."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vhp_cli.stages.breathe.time import PRESETS, even_frames, frames_at, full_cycle, sweep, time_over_period

# Table 3.1 of the thesis: x_n and t/T as printed.
X_N = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 10, 9, 8, 7, 6, 5, 4, 3, 2, 1, 0]
T_OVER_T = [
    0.0000, 0.1850, 0.2265, 0.2571, 0.2830, 0.3066, 0.3292, 0.3515, 0.3747, 0.4000, 0.4308, 0.5000,
    0.5692, 0.6000, 0.6253, 0.6485, 0.6708, 0.6934, 0.7170, 0.7429, 0.7735, 0.8150, 1.0000,
]  # fmt: skip


def test_full_cycle_is_table_3_1() -> None:
    cycle = full_cycle()
    assert [moment.x for moment in cycle] == X_N
    assert [f"{moment.time_over_period:.4f}" for moment in cycle] == [f"{value:.4f}" for value in T_OVER_T]
    assert [moment.index for moment in cycle] == list(range(23))


@given(st.integers(1, 60))
def test_full_cycle_has_the_frames_of_any_number_of_steps(steps: int) -> None:
    cycle = full_cycle(steps)
    assert len(cycle) == 2 * steps + 1
    times = np.array([moment.time_over_period for moment in cycle])
    assert (np.diff(times) > 0).all() and times[0] == 0.0 and times[-1] == 1.0
    assert np.allclose(sweep(times, steps), [moment.x for moment in cycle], atol=1e-12 * steps)


@given(st.floats(0.0, 11.0))
def test_time_and_sweep_are_inverse(x: float) -> None:
    time = time_over_period(x)
    assert 0.0 <= time <= 0.5
    assert sweep(time) == pytest.approx(x, abs=1e-12)


def test_exhalation_takes_longer() -> None:
    times = (np.arange(100000) + 0.5) / 100000
    assert (sweep(times) < 5.5).mean() == pytest.approx(0.636, abs=5e-4)


def test_whole_periods_are_at_rest() -> None:
    assert list(sweep([0.0, 1.0, 2.0, 7.0])) == [0.0] * 4
    frames = even_frames(9)
    assert (frames[0].x, frames[4].x, frames[8].x) == (0.0, 11.0, 0.0)


def test_frames_at_seconds() -> None:
    frames = frames_at([0.0, 1.25, 2.5, 7.5], period_s=5.0)
    assert [frame.x for frame in frames] == pytest.approx([0.0, 11 / 4, 11.0, 11.0])
    assert [frame.time_over_period for frame in frames] == [0.0, 0.25, 0.5, 1.5]
    assert all(0.0 <= frame.x <= 11.0 for frame in frames)


@pytest.mark.parametrize(("times", "period"), [([], 5.0), ([float("nan")], 5.0), ([1.0], 0.0), ([1.0], float("inf"))])
def test_unusable_times_are_refused(times: list[float], period: float) -> None:
    with pytest.raises(ValueError):
        frames_at(times, period)


def test_levels_outside_the_range_are_refused() -> None:
    for level in (-0.1, 11.1, float("nan")):
        with pytest.raises(ValueError, match="from 0 to 11"):
            time_over_period(level)
    with pytest.raises(ValueError, match="2 frames or more"):
        even_frames(1)


def test_presets_have_the_litres_per_mm_of_the_quiet_one() -> None:
    quiet = PRESETS["quiet"]
    assert (quiet.lung_volume_change_l, quiet.diaphragm_travel_mm) == (0.32, 20.0)
    for preset in PRESETS.values():
        assert preset.lung_volume_change_l / preset.diaphragm_travel_mm == pytest.approx(0.016)
    travels = [PRESETS[name].diaphragm_travel_mm for name in ("shallow", "quiet", "deep")]
    assert travels == sorted(travels)
