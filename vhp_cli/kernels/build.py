"""Compile the C kernels into one shared library: ``python -m vhp_cli.kernels.build``.

Standard library only: the wheel build loads this file before anything else is installed.
"""

from __future__ import annotations

import importlib.util
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

SOURCE_DIR = Path(__file__).resolve().parent
SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
LIBRARY = SOURCE_DIR / f"_kernels{SUFFIX}"

# Contraction stays off: a fused multiply-add would break the error-free transformations
# on which the exact predicates rest.
FLAGS = ["-std=c11", "-O3", "-fPIC", "-shared", "-ffp-contract=off", "-fno-math-errno", "-fvisibility=hidden"]
WARNINGS = ["-Wall", "-Wextra", "-Wshadow", "-Wvla"]
SANITIZE = ["-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=undefined", "-fno-omit-frame-pointer"]


def find_compiler() -> list[str] | None:
    """Return the command of a C compiler: ``$CC``, the system's, or ziglang's; None if there is none."""
    if os.environ.get("CC"):
        return shlex.split(os.environ["CC"])
    for name in ("cc", "gcc", "clang"):
        if path := shutil.which(name):
            return [path]
    if importlib.util.find_spec("ziglang"):
        # zig adds its own sanitizer unless told not to.
        return [sys.executable, "-m", "ziglang", "cc", "-fno-sanitize=undefined"]
    return None


def compile_kernels(target: Path = LIBRARY, *, extra: list[str] | None = None) -> Path:
    """Compile every ``*.c`` of this directory into `target`.

    Raises
    ------
    RuntimeError
        If there is no compiler, or it fails; the message carries what it printed.
    """
    compiler = find_compiler()
    if compiler is None:
        raise RuntimeError("no C compiler found: install gcc or clang, or `pip install ziglang`, or set CC")
    sources = sorted(str(path) for path in SOURCE_DIR.glob("*.c"))
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=target.parent, prefix=".build-") as scratch:
        fresh = Path(scratch) / target.name
        command = [*compiler, *FLAGS, *WARNINGS, *(extra or []), "-o", str(fresh), *sources, "-lm"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(f"{shlex.join(command)}\n{done.stdout}{done.stderr}")
        if done.stderr:
            print(done.stderr, file=sys.stderr)
        fresh.replace(target)
    return target


if __name__ == "__main__":
    print(compile_kernels(extra=SANITIZE if "--sanitize" in sys.argv[1:] else None))
