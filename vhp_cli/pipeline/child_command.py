"""Another ``vhp`` as a child process, which ends when this one does."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Sequence

# What an interrupted child gets to end by itself, and to end when it is told once more.
_GRACE_S = (2.0, 10.0)


def run_command(arguments: Sequence[str]) -> int:
    """Run a command of vhp in a process of its own; what it prints on stdout is dropped.

    It lies in the process group of this one, so that Ctrl-C reaches both. If this process is killed, the child is too.

    Parameters
    ----------
    arguments
        The command line without the program's name.

    Returns
    -------
    int
        Its exit code; negative if a signal ended it.

    Raises
    ------
    KeyboardInterrupt
        If this process was interrupted; the child has ended then.
    """
    # The modules that this process can import, the child can import as well.
    path = os.pathsep.join(os.path.abspath(entry) for entry in sys.path)  # noqa: PTH100
    command = [sys.executable, "-P", "-m", "vhp_cli.child", str(os.getpid()), *arguments]
    null = subprocess.DEVNULL
    with subprocess.Popen(command, stdin=null, stdout=null, env={**os.environ, "PYTHONPATH": path}) as child:
        try:
            return child.wait()
        except BaseException:
            _end(child)
            raise


def _end(child: subprocess.Popen[bytes]) -> None:
    """Wait for a child that was interrupted too, then interrupt it, then kill it."""
    import signal

    for wait in _GRACE_S:
        with contextlib.suppress(subprocess.TimeoutExpired, KeyboardInterrupt):
            child.wait(wait)
            return
        if sys.platform != "win32":
            child.send_signal(signal.SIGINT)
    child.kill()
