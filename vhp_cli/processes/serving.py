"""The child's side: calls functions, and answers with what they return."""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import os
import signal
import sys
import threading
import time
from collections.abc import Sequence
from typing import Any

from vhp_cli.processes.messages import Part, encode, receive, send

_LINUX = sys.platform == "linux"
_LONGEST_DETAIL = 400
_PR_SET_PDEATHSIG = 1


def serve(parent: int, memory_gb: float) -> None:
    """Answer requests until there are no more; the life of a child."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    die_with(parent)
    requests, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
    os.dup2(2, 1)
    _limit(memory_gb)
    while True:
        try:
            target, arguments = receive(requests)
        except EOFError:
            return
        except MemoryError:
            raise
        except Exception as error:
            # The message was read to its end: only its content can't be rebuilt here.
            send(answers, encode(("error", _described(error))))
            continue
        message = _answer(target, arguments)
        del arguments
        try:
            send(answers, message)
        except BrokenPipeError:
            return


def _answer(target: str, arguments: Sequence[Any]) -> list[Part]:
    try:
        module, _, name = target.partition(":")
        result = getattr(importlib.import_module(module), name)(*arguments)
        return encode(("result", result))
    except MemoryError as error:
        return encode(("memory", str(error) or "out of memory"))
    except (Exception, SystemExit) as error:
        return encode(("error", _described(error)))


def _described(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}"[:_LONGEST_DETAIL]


def die_with(parent: int) -> None:
    """Let this process be killed when its parent ends, however that ends."""
    if _LINUX:
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
        if os.getppid() != parent:
            os._exit(1)
    elif sys.platform != "win32":

        def watch() -> None:
            while os.getppid() == parent:
                time.sleep(0.5)
            os._exit(1)

        threading.Thread(target=watch, daemon=True).start()


def _limit(memory_gb: float) -> None:
    if sys.platform == "win32":
        return
    import resource

    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if not _LINUX:
        return
    with contextlib.suppress(OSError), open("/proc/self/oom_score_adj", "w", encoding="ascii") as file:  # noqa: PTH123
        # When the machine runs out of memory, this process has to go before the one that can tell.
        file.write("500")
    if memory_gb:
        with open("/proc/self/statm", encoding="ascii") as file:  # noqa: PTH123
            taken = int(file.read().split()[0]) * resource.getpagesize()
        most = taken + int(memory_gb * 2**30)
        hard = resource.getrlimit(resource.RLIMIT_AS)[1]
        if hard != resource.RLIM_INFINITY:
            most = min(most, hard)
        resource.setrlimit(resource.RLIMIT_AS, (most, hard))
