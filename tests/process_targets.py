"""Functions that the tests of child processes call there."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np

from vhp_cli.processes import Child


def add(a, b):
    return a + b


def process_id():
    return os.getpid()


def environment(name):
    return os.environ.get(name)


def sleep(seconds):
    time.sleep(seconds)


def hold_the_interpreter():
    """Never return, and never let another thread of Python run."""
    ctypes.PyDLL(None).pause()


def allocate(gigabytes):
    return len(np.ones(int(gigabytes * 2**27)))


def allocate_and_abort():
    os.write(2, b"terminate called after throwing an instance of 'std::bad_alloc'\n")
    os.abort()


def crash():
    os.write(2, b"about to crash\n")
    ctypes.string_at(0)


def leave(code):
    os._exit(code)


def exit_softly():
    sys.exit("gave up")


def fail():
    raise ValueError("the mesh is upside down")


def unpicklable():
    return threading.Lock()


def make_noise(megabytes):
    line = b"noise " * 1000 + b"\n"
    for _ in range(int(megabytes * 1e6 / len(line))):
        os.write(1, line)
        os.write(2, line)
    print("printed")
    return sys.stdin.read()


def scatter_files():
    Path("stray.txt").write_text("x")
    return str(Path.cwd())


def scaled(array, factor):
    array *= factor
    return array


def nested(seconds):
    """Start a child of the child, tell its number through a file, and wait for it."""
    with Child(name="inner") as child:
        inner = child.call("process_targets:process_id")
        Path("inner").write_text(str(inner))
        child.call("process_targets:sleep", seconds)
    return inner


def nested_timeout():
    with Child(name="inner") as child:
        child.call("process_targets:sleep", 60, timeout_s=0.5)


def start_sleeper():
    """Start a process that is no Child, and leave it behind."""
    return subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"]).pid


def mesh_nothing(vertices, faces, options):
    """In place of an engine: never return, as some surfaces make it do."""
    hold_the_interpreter()


def crash_while_meshing(vertices, faces, options):
    Path("stray.stl").write_text("x")
    crash()


def mesh_small_surfaces_only(vertices, faces, options):
    """In place of an engine: crash on boxes, hang on what is more than 18 mm wide, and mesh the others."""
    from vhp_cli.engines.tetwild import tetrahedralize

    if len(faces) == 12:
        crash()
    if vertices.max() - vertices.min() > 18:
        hold_the_interpreter()
    return tetrahedralize(vertices, faces, options)


def fail_to_mesh(vertices, faces, options):
    raise ValueError("these triangles make no sense")


def no_tetrahedra(vertices, faces, options):
    return vertices, np.empty((0, 4), np.int32)


def wild_points(vertices, faces, options):
    return np.full((4, 3), np.nan), np.array([[0, 1, 2, 3]], np.int32)


def lost_corners(vertices, faces, options):
    return vertices, np.array([[0, 1, 2, len(vertices)]], np.int32)
