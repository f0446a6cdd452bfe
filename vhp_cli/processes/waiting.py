"""Time limits that a busy machine does not change: waiting for a processor is not charged for."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Iterable
from pathlib import Path

_LINUX = sys.platform == "linux"
# Times its limit that a call may wait for a processor without being charged for it.
_MOST_WAITING = 3


class Limit:
    """The time that a call may take, without that in which its process waited for a processor."""

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._start = time.monotonic()
        self._end = self._start + seconds
        self._process = 0
        self._waited: dict[str, float] = {}

    def watch(self, process: int) -> None:
        """Count from now on what a process and its children wait."""
        self._process = process
        self._waited = waiting_times([process])

    def left(self) -> float:
        """Return the seconds left, at least."""
        if time.monotonic() >= self._end:
            now = waiting_times([self._process, *descendants(self._process)])
            longest = max((total - self._waited.get(thread, 0.0) for thread, total in now.items()), default=0.0)
            self._end = self._start + self._seconds + min(longest, _MOST_WAITING * self._seconds)
        return self._end - time.monotonic()


def waiting_times(processes: Iterable[int]) -> dict[str, float]:
    """Return the seconds that each thread was ready to run and had no processor; nothing where that is unknown."""
    found: dict[str, float] = {}
    for process in processes if _LINUX else ():
        # Threads and processes come and go meanwhile; some kernels do not count.
        with contextlib.suppress(OSError, ValueError, IndexError):
            for thread in Path(f"/proc/{process}/task").iterdir():
                found[thread.name] = int((thread / "schedstat").read_text().split()[1]) * 1e-9
    return found


def descendants(process: int) -> list[int]:
    """Return the children of a process, theirs, and so on; nothing where that is unknown."""
    children: dict[int, list[int]] = {}
    for entry in Path("/proc").glob("[0-9]*") if _LINUX else ():
        with contextlib.suppress(OSError, ValueError, IndexError):
            # After the name, which may hold anything: state, parent.
            parent = int((entry / "stat").read_text(errors="replace").rpartition(")")[2].split()[1])
            children.setdefault(parent, []).append(int(entry.name))
    found = [process]
    for one in found:
        found += children.get(one, [])
    return found[1:]
