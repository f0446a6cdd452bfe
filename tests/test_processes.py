from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from vhp_cli.processes import CallFailed, CallsStopped, Child, calling, stop_all, waiting

posix_only = pytest.mark.skipif(sys.platform == "win32", reason="needs POSIX signals")
linux_only = pytest.mark.skipif(sys.platform != "linux", reason="enforced on Linux only")


@pytest.fixture
def child():
    with Child(name="worker") as found:
        yield found


@pytest.fixture(autouse=True)
def temporary_directory(tmp_path, monkeypatch):
    """Keep the directories of the children apart, so that what they leave behind is seen."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    yield tmp_path
    assert not list(tmp_path.glob("vhp-*"))


def wait_until(condition, seconds=10.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "did not happen in time"
        time.sleep(0.02)


def is_gone(pid):
    """Tell whether a process has ended, whether or not somebody waited for it."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    if sys.platform == "linux":
        try:
            return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
        except FileNotFoundError:
            return True
    return False


def failure(child, *arguments, **limits):
    with pytest.raises(CallFailed) as caught:
        child.call(*arguments, **limits)
    return caught.value.reason, caught.value.detail


def test_call_returns_the_result_and_reuses_the_process(child):
    assert child.pid is None
    assert child.call("process_targets:add", 2, 3) == 5
    first = child.call("process_targets:process_id")
    assert first == child.pid != os.getpid()
    assert child.call("process_targets:process_id") == first
    assert child.call("math:hypot", 3, 4) == 5.0


def test_close_ends_the_process_and_a_later_call_starts_another(child):
    first = child.call("process_targets:process_id")
    child.close()
    assert child.pid is None
    assert is_gone(first)
    assert child.call("process_targets:process_id") != first


def test_timeout_kills_the_process(child):
    first = child.call("process_targets:process_id")
    begin = time.monotonic()
    assert failure(child, "process_targets:sleep", 60, timeout_s=0.3) == ("timeout", "worker took more than 0.3 s")
    assert time.monotonic() - begin < 5
    assert is_gone(first)
    assert child.call("process_targets:add", 1, 1, timeout_s=30) == 2


def test_waiting_for_a_processor_is_no_time_of_the_call(child, monkeypatch):
    child.call("process_targets:add", 1, 1)
    waited = iter([0.0, 2.0, 2.0, 2.0])
    monkeypatch.setattr(waiting, "waiting_times", lambda _: {"1": next(waited)})
    assert child.call("process_targets:sleep", 0.6, timeout_s=0.3) is None


def test_a_call_that_waits_without_end_is_ended_too(child, monkeypatch):
    child.call("process_targets:add", 1, 1)
    monkeypatch.setattr(waiting, "waiting_times", lambda _: {"1": time.monotonic() * 1e3})
    start = time.monotonic()
    assert failure(child, "process_targets:sleep", 60, timeout_s=0.2)[0] == "timeout"
    assert 0.75 < time.monotonic() - start < 10


@linux_only
def test_who_has_no_processor_waits():
    before = waiting.waiting_times([os.getpid()])
    assert str(os.getpid()) in before
    crowd = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(4 * (os.cpu_count() or 1))]
    try:
        end = time.monotonic() + 1.0
        while time.monotonic() < end:
            pass
        after = waiting.waiting_times([os.getpid()])
    finally:
        for process in crowd:
            process.kill()
            process.wait()
    assert after[str(os.getpid())] > before[str(os.getpid())] + 0.1


@linux_only
def test_the_family_of_a_process_is_found(child):
    child.call("process_targets:start_sleeper")
    assert len(waiting.descendants(os.getpid())) >= 2
    assert len(waiting.descendants(child.pid)) == 1


@posix_only
def test_timeout_of_a_function_that_holds_the_interpreter(child):
    assert failure(child, "process_targets:hold_the_interpreter", timeout_s=0.5)[0] == "timeout"


@posix_only
def test_timeout_kills_what_the_function_started(child):
    other = child.call("process_targets:start_sleeper")
    assert not is_gone(other)
    assert failure(child, "process_targets:sleep", 60, timeout_s=0.3)[0] == "timeout"
    wait_until(lambda: is_gone(other))


@linux_only
def test_memory_limit():
    with Child(memory_gb=0.5) as child:
        assert child.call("process_targets:allocate", 0.25) == 2**25
        reason, detail = failure(child, "process_targets:allocate", 1)
        assert reason == "memory"
        assert "allocate" in detail
        assert child.call("process_targets:add", 1, 1) == 2


@linux_only
def test_memory_limit_on_the_arguments():
    with Child(memory_gb=0.2) as child:
        assert failure(child, "process_targets:scaled", np.ones(2**26), 2.0)[0] == "memory"
        assert child.call("process_targets:add", 1, 1) == 2


@posix_only
def test_abort_for_lack_of_memory_is_told_from_a_crash(child):
    reason, detail = failure(child, "process_targets:allocate_and_abort")
    assert reason == "memory"
    assert "bad_alloc" in detail


def test_memory_limit_must_be_positive():
    with pytest.raises(ValueError, match="above 0"):
        Child(memory_gb=0)


@posix_only
def test_crash_carries_the_signal_and_what_was_printed(child):
    reason, detail = failure(child, "process_targets:crash")
    assert reason == "crash"
    assert detail == "worker crashed with SIGSEGV: about to crash"
    assert child.call("process_targets:add", 1, 1) == 2


def test_exit_is_a_crash(child):
    assert failure(child, "process_targets:leave", 7) == ("crash", "worker ended with exit code 7")


@posix_only
def test_kill_from_outside_is_taken_for_lack_of_memory(child):
    pid = child.call("process_targets:process_id")
    timer = threading.Timer(0.3, os.kill, (pid, signal.SIGKILL))
    timer.start()
    reason, detail = failure(child, "process_targets:sleep", 60)
    timer.join()
    assert reason == "memory"
    assert "killed from outside" in detail


@posix_only
def test_death_between_two_calls_goes_unnoticed(child):
    pid = child.call("process_targets:process_id")
    os.kill(pid, signal.SIGKILL)
    wait_until(lambda: is_gone(pid))
    assert child.call("process_targets:process_id") != pid


@pytest.mark.parametrize(
    ("target", "message"),
    [
        ("process_targets:fail", "worker: ValueError: the mesh is upside down"),
        ("process_targets:exit_softly", "worker: SystemExit: gave up"),
        ("process_targets:missing", "has no attribute 'missing'"),
        ("no_such_module:function", "No module named 'no_such_module'"),
        ("process_targets:unpicklable", "cannot pickle"),
    ],
)
def test_exceptions_carry_their_message_and_leave_the_process_alive(child, target, message):
    reason, detail = failure(child, target)
    assert reason == "error"
    assert message in detail
    pid = child.pid
    assert child.call("process_targets:process_id") == pid


def test_arguments_that_cannot_be_pickled_are_refused_at_once(child):
    with pytest.raises(TypeError):
        child.call("process_targets:add", threading.Lock(), 1)
    assert child.pid is None


def test_nothing_printed_reaches_the_user(child, capfd):
    assert child.call("process_targets:make_noise", 5, timeout_s=30) == ""
    assert capfd.readouterr() == ("", "")


def test_stray_files_go_away(child, tmp_path):
    directory = Path(child.call("process_targets:scatter_files"))
    assert directory.parent == tmp_path
    assert (directory / "stray.txt").exists()
    assert child.call("process_targets:environment", "TMPDIR") == str(directory)
    child.close()
    assert not directory.exists()


def test_libraries_run_with_one_thread(child, monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "8")
    assert child.call("process_targets:environment", "OMP_NUM_THREADS") == "1"
    assert os.environ["OMP_NUM_THREADS"] == "8"


def test_large_arrays_both_ways(child):
    array = np.arange(12_500_000, dtype=np.float64)
    doubled = child.call("process_targets:scaled", array, 2.0)
    assert doubled.flags.writeable
    assert np.array_equal(doubled, array * 2)
    assert array[-1] == 12_499_999


def test_failures_can_be_pickled():
    again = pickle.loads(pickle.dumps(CallFailed("timeout", "too slow")))
    assert (again.reason, again.detail, str(again)) == ("timeout", "too slow", "too slow")


def test_calls_from_several_threads(child):
    results: list[int] = []
    with Child() as other:
        # The child outlives the thread that started it.
        starter = threading.Thread(target=other.call, args=("process_targets:process_id",))
        starter.start()
        starter.join()
        pid = other.pid
        assert other.call("process_targets:process_id") == pid

        def work(number):
            mine = child if number % 2 else other
            results.append(mine.call("process_targets:add", number, 100))

        threads = [threading.Thread(target=work, args=(number,)) for number in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert sorted(results) == list(range(100, 108))


def test_forgotten_children_are_ended():
    child = Child()
    pid = child.call("process_targets:process_id")
    del child
    wait_until(lambda: is_gone(pid))


def test_nested_children(child):
    inner = child.call("process_targets:nested", 0, timeout_s=30)
    assert inner not in (os.getpid(), child.pid)
    assert is_gone(inner)
    reason, detail = failure(child, "process_targets:nested_timeout", timeout_s=30)
    assert (reason, detail) == ("error", "worker: CallFailed: inner took more than 0.5 s")


@linux_only
def test_timeout_ends_nested_children_too(child):
    directory = Path(child.call("process_targets:scatter_files"))
    inner: list[int] = []

    def note_inner():
        wait_until((directory / "inner").exists)
        wait_until(lambda: (directory / "inner").read_text() != "")
        inner.append(int((directory / "inner").read_text()))

    watcher = threading.Thread(target=note_inner)
    watcher.start()
    assert failure(child, "process_targets:nested", 60, timeout_s=2)[0] == "timeout"
    watcher.join()
    wait_until(lambda: is_gone(inner[0]))


PARENT = """
import sys, threading
from vhp_cli.processes import Child
def report(): print(child.pid, flush=True)
child = Child()
child.call("process_targets:process_id")
report()
child.call("process_targets:{function}"{arguments})
"""


def parent_of(function, arguments, tmp_path):
    """Start a program that waits for a call in a child; return it and the number of the child."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "TMPDIR": str(tmp_path)}
    source = PARENT.format(function=function, arguments=arguments)
    program = subprocess.Popen(
        [sys.executable, "-c", source],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
        start_new_session=True,
    )
    return program, int(program.stdout.readline())


@linux_only
@pytest.mark.parametrize(("function", "arguments"), [("sleep", ", 60"), ("hold_the_interpreter", "")])
def test_child_dies_with_its_parent(function, arguments, tmp_path):
    program, pid = parent_of(function, arguments, tmp_path)
    time.sleep(0.3)
    assert not is_gone(pid)
    program.kill()
    program.communicate()
    wait_until(lambda: is_gone(pid))
    for left in tmp_path.glob("vhp-*"):
        left.rmdir()  # empty; nobody was left to remove it


@posix_only
def test_interrupt_ends_parent_and_child(tmp_path):
    program, pid = parent_of("sleep", ", 60", tmp_path)
    time.sleep(0.3)
    # As from a terminal: also the child must not answer it with a traceback of its own.
    os.kill(pid, signal.SIGINT)
    time.sleep(0.2)
    assert not is_gone(pid)
    os.killpg(program.pid, signal.SIGINT)
    errors = program.communicate(timeout=10)[1]
    assert "KeyboardInterrupt" in errors
    assert program.returncode != 0
    wait_until(lambda: is_gone(pid))


def test_stop_all_ends_calls_of_other_threads(child, monkeypatch):
    monkeypatch.setattr(calling, "_stopped", threading.Event())
    child.call("process_targets:process_id")
    caught: list[BaseException] = []

    def work():
        try:
            child.call("process_targets:sleep", 60)
        except CallsStopped as error:
            caught.append(error)

    thread = threading.Thread(target=work)
    thread.start()
    time.sleep(0.2)
    stop_all()
    thread.join(10)
    assert len(caught) == 1
    with pytest.raises(CallsStopped):
        child.call("process_targets:add", 1, 1)
