"""Compile the C kernels into one shared library: ``python -m vhp_cli.kernels.build``.

Standard library only: the wheel build loads this file before anything else is installed.
"""

from __future__ import annotations

import argparse
import functools
import hashlib
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
SANITIZE = [
    "-O1",
    "-g",
    "-fsanitize=address,undefined,float-cast-overflow",
    "-fno-sanitize-recover=all",
    "-fno-omit-frame-pointer",
]
if sys.platform == "darwin":
    FLAGS.append("-mmacosx-version-min=11.0")

# Compiled along with the kernels: refuses a compiler whose arithmetic would make the exact
# predicates wrong, and carries the fingerprint of the sources.
STAMP = """\
#include <float.h>
#if FLT_EVAL_METHOD != 0
#error "double arithmetic must round to double (on 32-bit x86: -msse2 -mfpmath=sse)"
#endif
#if defined(__FAST_MATH__)
#error "-ffast-math breaks the exact predicates"
#endif
#if defined(_WIN32)
__declspec(dllexport)
#else
__attribute__((visibility("default")))
#endif
const char *vhp_sources(void);
const char *vhp_sources(void) {{ return "{fingerprint}"; }}
"""

PROBE = "#include <math.h>\n#include <stdlib.h>\ndouble probe(double x);\ndouble probe(double x) { return sqrt(x); }\n"


def sources() -> list[Path]:
    """Return the C files to compile; none in an installed wheel."""
    return sorted(SOURCE_DIR.glob("*.c"))


def fingerprint() -> str:
    """Return a hash of the C files, their headers and the flags; empty where there are no C files."""
    files = sources()
    if not files:
        return ""
    found = hashlib.sha256(" ".join(FLAGS).encode())
    for path in [*files, *sorted(SOURCE_DIR.glob("*.h"))]:
        found.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return found.hexdigest()[:32]


def ziglang_command() -> list[str] | None:
    """Return the command of the C compiler in the package ziglang, or None if it isn't installed."""
    if importlib.util.find_spec("ziglang") is None:
        return None
    # zig would compile for this very processor and add its own sanitizer.
    return [sys.executable, "-m", "ziglang", "cc", "-mcpu=baseline", "-fno-sanitize=undefined"]


@functools.cache
def find_compiler() -> list[str] | None:
    """Return the command of a C compiler: ``$CC``, the system's, or ziglang's; None if there is none.

    A system compiler counts only if it can make a library: some have no C library headers beside them.
    """
    if os.environ.get("CC"):
        return shlex.split(os.environ["CC"])
    for name in ("cc", "gcc", "clang"):
        if (path := shutil.which(name)) and _works([path]):
            return [path]
    return ziglang_command()


def _works(compiler: list[str]) -> bool:
    with tempfile.TemporaryDirectory(prefix="vhp-build-") as scratch:
        source = Path(scratch) / "probe.c"
        source.write_text(PROBE, encoding="utf-8")
        try:
            return _run([*compiler, *FLAGS, "-o", str(source.with_suffix(SUFFIX)), str(source), "-lm"]).returncode == 0
        except OSError:
            return False


def _run(command: list[str], cache: str = "") -> subprocess.CompletedProcess[str]:
    environment = dict(os.environ)
    if cache:
        # zig writes into the home directory unless told where else; there may be none, or a read-only one.
        environment.setdefault("ZIG_GLOBAL_CACHE_DIR", cache)
        environment.setdefault("ZIG_LOCAL_CACHE_DIR", cache)
    return subprocess.run(command, capture_output=True, text=True, errors="replace", check=False, env=environment)


def compile_kernels(
    target: Path = LIBRARY, *, extra: list[str] | None = None, compiler: list[str] | None = None
) -> Path:
    """Compile every ``*.c`` of this directory into `target`, which is replaced only by a complete library.

    Parameters
    ----------
    target
        The library to write.
    extra
        Further compiler options.
    compiler
        Command of the compiler; found by `find_compiler` if None.

    Raises
    ------
    RuntimeError
        If there is no compiler, or it fails; the message carries what it printed.
    """
    compiler = compiler or find_compiler()
    if compiler is None:
        raise RuntimeError("no C compiler found: install gcc or clang, or `pip install ziglang`, or set CC")
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=target.parent, prefix=".build-") as scratch:
        stamp = Path(scratch) / "stamp.c"
        stamp.write_text(STAMP.format(fingerprint=fingerprint()), encoding="utf-8")
        fresh = Path(scratch) / target.name
        files = [str(path) for path in [*sources(), stamp]]
        command = [*compiler, *FLAGS, *WARNINGS, *(extra or []), "-o", str(fresh), *files, "-lm"]
        try:
            done = _run(command, cache=str(Path(scratch) / "cache"))
        except OSError as error:
            raise RuntimeError(f"{shlex.join(command)}\n{error}") from error
        if done.returncode:
            raise RuntimeError(f"{shlex.join(command)}\n{done.stdout}{done.stderr}")
        if done.stderr:
            print(done.stderr, file=sys.stderr)
        fresh.replace(target)
    return target


def main() -> int:
    """Compile from the command line."""
    parser = argparse.ArgumentParser(description="Compile the C kernels into one shared library.")
    parser.add_argument("-o", "--output", type=Path, help="the library to write (default: beside the sources)")
    parser.add_argument("--sanitize", action="store_true", help="add the address and undefined-behaviour sanitizers")
    parser.add_argument("--check", action="store_true", help="treat compiler warnings as errors")
    arguments = parser.parse_args()
    if arguments.sanitize and arguments.output is None:
        parser.error("--sanitize needs --output: the result must not take the place of the ordinary library")
    extra = [*(SANITIZE if arguments.sanitize else []), *(["-Werror"] if arguments.check else [])]
    try:
        print(compile_kernels(arguments.output or LIBRARY, extra=extra))
    except RuntimeError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
