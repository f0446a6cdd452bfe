"""Scripts that build the parametric sweep in other programs, all from one list of affine operations."""

from __future__ import annotations

from collections.abc import Iterable

from vhp_cli.stages.breathe.scripts import aedt_native, aedt_pyaedt, cst, matlab
from vhp_cli.stages.breathe.scripts.plan import Model, Part

__all__ = ["TARGETS", "Model", "Part", "write"]

TARGETS = ("aedt", "aedt-native", "cst", "matlab")


def write(model: Model, targets: Iterable[str] = TARGETS) -> dict[str, str]:
    """Return the text of the scripts by file name.

    Parameters
    ----------
    model
        What they are written for.
    targets
        Some of `TARGETS`.

    Returns
    -------
    dict
        To be written as UTF-8 with the line ends as they are.

    Raises
    ------
    KeyError
        If a target is not known.
    """
    makers = {
        "aedt": lambda: {"aedt_pyaedt.py": aedt_pyaedt.write(model)},
        "aedt-native": lambda: {"aedt_native.py": aedt_native.write(model)},
        "cst": lambda: {"cst_breathe.bas": cst.write(model)},
        "matlab": lambda: matlab.write(model),
    }
    files: dict[str, str] = {}
    for target in targets:
        files |= makers[target]()
    return files
