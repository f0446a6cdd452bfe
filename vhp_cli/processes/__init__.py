"""Functions called in child processes, under limits of time and memory.

Third-party engines can hang, crash, print, write files where they stand, and take all memory. Here each runs
in a process of its own that can be killed at any moment, and whatever happens there becomes one exception.

The child is ``python -m vhp_cli.processes``. A request goes to its standard input, the answer comes back on
its standard output, both pickled; what libraries print is caught apart and kept for the message of a crash.
"""

from vhp_cli.processes.calling import CallFailed, CallsStopped, Child, stop_all

__all__ = ["CallFailed", "CallsStopped", "Child", "stop_all"]
