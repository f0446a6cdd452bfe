"""Build hook of the wheel: compile the C kernels and tag the wheel with the platform."""

from __future__ import annotations

import importlib.util
import os
import platform
import sys
import sysconfig
import tempfile
from pathlib import Path
from types import ModuleType
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

# The oldest glibc that a release wheel asks for (PEP 600: manylinux_2_17 is RHEL 7 and later).
GLIBC = (2, 17)


def load_build_module(root: Path) -> ModuleType:
    """Load ``vhp_cli/kernels/build.py`` by path: the package itself needs numpy, which isn't here."""
    spec = importlib.util.spec_from_file_location("vhp_kernels_build", root / "vhp_cli" / "kernels" / "build.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def wants_manylinux() -> bool:
    """Return whether ``VHP_MANYLINUX=1`` asks for a wheel that runs on old Linux distributions."""
    return os.environ.get("VHP_MANYLINUX", "") not in ("", "0")


class KernelBuildHook(BuildHookInterface[Any]):
    """Compile the kernels into the wheel, or into the source tree for an editable install.

    The library is loaded by ctypes and knows nothing of Python, so that one wheel per platform
    serves every Python version.
    """

    def dependencies(self) -> list[str]:
        """Ask for the compiler of the package ziglang where the system has none."""
        build = load_build_module(Path(self.root))
        return ["ziglang>=0.13"] if wants_manylinux() or build.find_compiler() is None else []

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile, and put the library and the tag into `build_data`."""
        build = load_build_module(Path(self.root))
        if version == "editable":
            build.compile_kernels()
            return
        self._scratch = tempfile.TemporaryDirectory(prefix="vhp-build-")
        library = Path(self._scratch.name) / build.LIBRARY.name
        if wants_manylinux():
            build.compile_kernels(library, compiler=self._manylinux_compiler(build))
        else:
            build.compile_kernels(library)
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{self._platform_tag()}"
        build_data["force_include"][str(library)] = f"vhp_cli/kernels/{library.name}"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove the compiled library, which now is in the wheel."""
        if version != "editable":
            self._scratch.cleanup()

    @staticmethod
    def _manylinux_compiler(build: ModuleType) -> list[str]:
        if not sys.platform.startswith("linux"):
            raise RuntimeError("VHP_MANYLINUX=1 works on Linux only")
        compiler = build.ziglang_command()
        if compiler is None:
            raise RuntimeError("VHP_MANYLINUX=1 needs ziglang: `pip install ziglang`")
        major, minor = GLIBC
        return [*compiler, "-target", f"{platform.machine()}-linux-gnu.{major}.{minor}", "-s"]

    @staticmethod
    def _platform_tag() -> str:
        if wants_manylinux():
            major, minor = GLIBC
            return f"manylinux_{major}_{minor}_{platform.machine()}"
        if sys.platform == "darwin":
            # As -mmacosx-version-min in build.py; one architecture even under a universal Python.
            return f"macosx_11_0_{platform.machine()}"
        return sysconfig.get_platform().replace("-", "_").replace(".", "_")
