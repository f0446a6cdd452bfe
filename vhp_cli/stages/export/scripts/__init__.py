"""Scripts that import an exported model into a program, each with the materials of its tissues."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from types import MappingProxyType

from vhp_cli.stages.export.scripts import cst, hfss_native, hfss_pyaedt, matlab
from vhp_cli.stages.export.scripts.scene import Part, Scene

__all__ = ["SCRIPTS", "Part", "Scene", "write"]

# File name and writer of each script.
SCRIPTS: Mapping[str, tuple[str, Callable[[Scene], str]]] = MappingProxyType(
    {
        "hfss-pyaedt": ("import_hfss_pyaedt.py", hfss_pyaedt.write),
        "hfss-native": ("import_hfss_native.py", hfss_native.write),
        "cst": ("import_cst.bas", cst.write),
        "matlab": ("load_model.m", matlab.write),
    }
)


def write(scene: Scene, scripts: Iterable[str]) -> dict[str, str]:
    """Return the texts of scripts by file name, to be written as UTF-8 with the line ends as they are.

    Raises
    ------
    KeyError
        If a script is not known.
    """
    return {SCRIPTS[script][0]: SCRIPTS[script][1](scene) for script in scripts}
