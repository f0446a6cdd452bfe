"""Progress from what the mesher prints."""

from __future__ import annotations

import pytest

from vhp_cli.stages.tetmesh.watching import Watch


def test_progress_never_falls_and_is_not_complete_before_the_end():
    shown = []
    watch = Watch(lambda step, done, total: shown.append((done, total)), 10.0)
    for energy in (1e5, 1e3, 2e4, 50, 12, 9, 8):
        text = f"#t = 14020\nmax_energy = {energy:g}\navg_energy = 7\n".encode()
        # In pieces, as it comes through a pipe.
        for start in range(0, len(text), 7):
            watch.read(text[start : start + 7])
    done = [value for value, _ in shown]
    assert done == sorted(done) and len(done) == 7
    assert done[0] == 0 and done[-1] == 99 and {total for _, total in shown} == {100}
    # Half of the way in orders of magnitude.
    assert done[1] == pytest.approx(50, abs=1)


def test_what_can_not_be_read_is_passed_over():
    shown = []
    watch = Watch(lambda *what: shown.append(what), 10.0)
    watch.read(b"\xff\xfe max_energy = 3\nmax_energy = nan\n\n")
    assert shown == []
