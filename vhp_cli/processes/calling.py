"""The parent's side: child processes, and calls of functions in them."""

from __future__ import annotations

import contextlib
import functools
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import weakref
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import IO, Any, Literal

from vhp_cli.errors import VhpError
from vhp_cli.processes.messages import Part, encode, receive, send
from vhp_cli.processes.waiting import Limit

Reason = Literal["timeout", "memory", "crash", "error"]
# One thread each: sums come out the same on every machine, and the pipeline decides how many children run at once.
_ENVIRONMENT = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "VECLIB_MAXIMUM_THREADS": "1",
    "PYTHONHASHSEED": "0",
    "QT_QPA_PLATFORM": "offscreen",
}
_LONGEST_DETAIL = 400
_KEPT_OUTPUT = 4096


class CallFailed(VhpError):
    """A call in a child process came to no result.

    Parameters
    ----------
    reason
        ``"timeout"`` or ``"memory"``: a limit was broken; ``"crash"``: the process ended without an answer;
        ``"error"``: the function raised an exception.
    detail
        What happened, in one line.
    """

    def __init__(self, reason: Reason, detail: str) -> None:
        super().__init__(detail)
        self.reason = reason
        self.detail = detail

    def __reduce__(self) -> tuple[type[CallFailed], tuple[Reason, str]]:
        return CallFailed, (self.reason, self.detail)


class CallsStopped(VhpError):
    """The program is being interrupted: `stop_all` was called, and no child process is started any more."""


class Child:
    """A child process that runs functions under limits of time and memory.

    Started at the first call and reused; killed when a limit is broken or the call is interrupted, and started
    anew by the next call. Calls from several threads wait for each other. The functions see an empty directory as
    the current and the temporary one, which goes away with the process. The child dies with its parent.

    Parameters
    ----------
    memory_gb
        Address space that the functions may take, beyond what an idle child has; None: no limit. Enforced on
        Linux only.
    name
        What to call the process in messages.
    on_output
        Called with what the libraries in the child print, piece by piece, from another thread.
    """

    def __init__(
        self,
        *,
        memory_gb: float | None = None,
        name: str = "worker",
        on_output: Callable[[bytes], None] | None = None,
    ) -> None:
        if memory_gb is not None and not memory_gb > 0:
            raise ValueError(f"memory_gb must be above 0, not {memory_gb}")
        self._memory_gb = memory_gb
        self._name = name
        self._on_output = on_output
        self._lock = threading.Lock()
        self._process: _Process | None = None

    def __enter__(self) -> Child:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def pid(self) -> int | None:
        """Process number; None while no process runs."""
        return None if self._process is None else self._process.pid

    def close(self) -> None:
        """End the process; a later call starts it anew."""
        with self._lock:
            self._stop()

    def call(self, target: str, *arguments: Any, timeout_s: float | None = None) -> Any:
        """Return what a function returns.

        Parameters
        ----------
        target
            The function, as ``"package.module:function"``.
        arguments
            Its arguments; they and the result must be picklable.
        timeout_s
            Time limit in seconds, start of the process included; None: no limit. Where the system tells (Linux), time
            that the process spends waiting for a processor does not count, up to three times the limit, so that a
            busy machine does not change what comes out.

        Raises
        ------
        CallFailed
            If there is no result. After ``"error"`` the process goes on, else it is replaced.
        CallsStopped
            After `stop_all`.
        """
        limit = None if timeout_s is None else Limit(timeout_s)
        request = encode((target, arguments))
        with self._lock:
            try:
                if self._process is None or not self._process.alive:
                    self._stop()
                    self._process = _Process(self._memory_gb, self._on_output)
                outcome = self._process.exchange(request, limit)
            except BaseException:
                self._stop()
                raise
            if outcome is None:
                self._stop()
                raise CallFailed("timeout", f"{self._name} took more than {timeout_s:g} s")
            if isinstance(outcome, BaseException):
                reason, detail = self._process.cause_of_death()
                self._stop()
                if _stopped.is_set():
                    raise CallsStopped(f"{self._name} was stopped")
                raise CallFailed(reason, f"{self._name} {detail}")
            status, value = outcome
            if status == "memory":
                # What the function left behind may be large.
                self._stop()
            if status != "result":
                raise CallFailed(status, f"{self._name}: {value}")
            return value

    def _stop(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process = None


def stop_all() -> None:
    """Kill every child process of this program, and let running and later calls raise `CallsStopped`.

    For the thread that was interrupted while others wait for their calls.
    """
    _stopped.set()
    with _running_lock:
        processes = list(_running)
    for process in processes:
        process.signal_death()


_stopped = threading.Event()
_running: weakref.WeakSet[_Process] = weakref.WeakSet()
_running_lock = threading.Lock()


@functools.cache
def _starter(owner: int) -> ThreadPoolExecutor:
    """Return the thread of process `owner` that starts its children.

    On Linux a child is told to die when the thread that started it ends, so this thread must last.
    """
    return ThreadPoolExecutor(max_workers=1, thread_name_prefix="start-children")


def _kill_when_started(future: Future[subprocess.Popen[bytes]]) -> None:
    if future.exception() is None:
        future.result().kill()


class _Process:
    """One running child; nothing of it is left after `kill`."""

    def __init__(self, memory_gb: float | None, on_output: Callable[[bytes], None] | None) -> None:
        if _stopped.is_set():
            raise CallsStopped("the program is being interrupted")
        self._directory = tempfile.mkdtemp(prefix="vhp-")
        try:
            self._popen = self._started(memory_gb)
        except BaseException:
            shutil.rmtree(self._directory, ignore_errors=True)
            raise
        self.pid = self._popen.pid
        self._output = bytearray()
        arguments = (self._popen.stderr, self._output, on_output)
        self._listener = threading.Thread(target=_keep_tail, args=arguments, daemon=True)
        self._listener.start()
        self._finalizer = weakref.finalize(self, _end, self._popen, self._directory, self._listener)
        with _running_lock:
            _running.add(self)
        if _stopped.is_set():
            self.signal_death()

    def _started(self, memory_gb: float | None) -> subprocess.Popen[bytes]:
        # The modules that the parent can import, the child can import as well.
        path = [str(os.path.abspath(entry)) for entry in sys.path]  # noqa: PTH100
        environment = {**os.environ, **_ENVIRONMENT, "PYTHONPATH": os.pathsep.join(path)}
        environment |= dict.fromkeys(("TMPDIR", "TEMP", "TMP"), self._directory)
        options: dict[str, Any] = {"start_new_session": True}
        if sys.platform == "win32":
            options = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW}
        command = [sys.executable, "-P", "-m", "vhp_cli.processes", str(os.getpid()), str(memory_gb or 0)]

        def start() -> subprocess.Popen[bytes]:
            pipe = subprocess.PIPE
            return subprocess.Popen(
                command, stdin=pipe, stdout=pipe, stderr=pipe, cwd=self._directory, env=environment, **options
            )

        future = _starter(os.getpid()).submit(start)
        try:
            return future.result()
        except BaseException:
            future.add_done_callback(_kill_when_started)
            raise

    @property
    def alive(self) -> bool:
        return self._popen.poll() is None

    def exchange(self, request: Sequence[Part], limit: Limit | None) -> Any:
        """Return the answer to a request, the exception on the way to it, or None when time is up."""
        outcomes: list[Any] = []
        if limit is not None:
            limit.watch(self.pid)

        def work() -> None:
            stdin, stdout = self._popen.stdin, self._popen.stdout
            assert stdin is not None and stdout is not None
            try:
                send(stdin, request)
                outcomes.append(receive(stdout))
            except BaseException as error:
                outcomes.append(error)

        # A thread of its own, as neither writing to nor reading from a pipe can be given up on every platform.
        worker = threading.Thread(target=work, daemon=True)
        worker.start()
        try:
            while worker.is_alive():
                left = 0.5 if limit is None else limit.left()
                if left <= 0:
                    break
                # Not too often, as a process that waits gets a little more time at each look.
                worker.join(min(max(left, 0.05), 0.5))
            # An answer that came in the last moment counts.
            return outcomes[0] if outcomes else None
        finally:
            if worker.is_alive():
                self.signal_death()
                worker.join()

    def cause_of_death(self) -> tuple[Reason, str]:
        """Tell why the process ended without an answer."""
        try:
            code = self._popen.wait(timeout=5)
        except subprocess.TimeoutExpired:
            return "crash", "closed its end of the connection"
        self._listener.join(1)
        output = bytes(self._output).decode(errors="replace")
        last_lines = " | ".join(line.strip() for line in output.splitlines() if line.strip())[-_LONGEST_DETAIL:]
        if "bad_alloc" in output or "MemoryError" in output:
            return "memory", f"ran out of memory: {last_lines}"
        if code == -9:
            return "memory", "was killed from outside, most likely because the machine ran out of memory"
        cause = f"ended with exit code {code}"
        if code < 0:
            with contextlib.suppress(ValueError):
                cause = f"crashed with {signal.Signals(-code).name}"
        return "crash", f"{cause}: {last_lines}" if last_lines else cause

    def signal_death(self) -> None:
        _kill_group(self._popen)

    def kill(self) -> None:
        self._finalizer()


def _kill_group(popen: subprocess.Popen[bytes]) -> None:
    if popen.returncode is not None:
        return
    if sys.platform == "win32":
        popen.kill()
        return
    # Not yet waited for, so the number still belongs to this process.
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(popen.pid, signal.SIGKILL)


def _end(popen: subprocess.Popen[bytes], directory: str, listener: threading.Thread) -> None:
    _kill_group(popen)
    popen.wait()
    listener.join(1)
    for stream in (popen.stdin, popen.stdout, popen.stderr):
        if stream is not None:
            # A half-sent request is still in the buffer.
            with contextlib.suppress(OSError, ValueError):
                stream.close()
    shutil.rmtree(directory, ignore_errors=True)


def _keep_tail(stream: IO[bytes], kept: bytearray, on_output: Callable[[bytes], None] | None) -> None:
    with contextlib.suppress(OSError, ValueError):
        while chunk := os.read(stream.fileno(), 1 << 16):
            kept += chunk
            del kept[:-_KEPT_OUTPUT]
            if on_output is not None:
                # Whatever goes wrong there, the pipe must not fill up.
                with contextlib.suppress(Exception):
                    on_output(chunk)
