"""Progress of the mesher, from what it prints."""

from __future__ import annotations

import math
import re
from collections.abc import Callable

# Called with step, number done and number in all.
Progress = Callable[[str, int, int], None]


class Watch:
    """Turns what the engine prints into progress: the energy falls, pass by pass, to the one that is asked for."""

    def __init__(self, progress: Progress | None, stop_energy: float) -> None:
        self._progress = progress
        self._stop = stop_energy
        self._line = ""
        self._first = 0.0
        self._shown = 0

    def read(self, output: bytes) -> None:
        """Take in some more of what the engine printed."""
        text = self._line + output.decode(errors="replace")
        *lines, self._line = text.split("\n")
        for line in lines:
            if found := re.match(r"max_energy = ([0-9.e+]+)", line):
                self._show(float(found[1]))

    def _show(self, energy: float) -> None:
        self._first = max(self._first, energy)
        whole = math.log(self._first / self._stop) if self._first > self._stop else 0.0
        share = 1 - math.log(max(energy, self._stop) / self._stop) / whole if whole else 1.0
        # It may rise again, and the end takes a while.
        self._shown = max(self._shown, min(int(100 * share), 99))
        if self._progress:
            self._progress("meshing (%)", self._shown, 100)
