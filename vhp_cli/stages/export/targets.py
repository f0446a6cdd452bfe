"""The programs that models are exported for: files, names, limits and scripts of each."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from vhp_cli.errors import UsageError
from vhp_cli.formats.surfaces import check_forms
from vhp_cli.formats.volume.regions import Naming, valid_names

# Letters, digits and underscores, a letter first: taken by every program, and by every file system as a file's name.
# Case is ignored: ANSYS and Windows do not tell names by it. MATLAB ends names at 63 characters.
NAMING = Naming(r"[^A-Za-z0-9_]+", 60, letter_first=True, ignores_case=True)
# Devices of Windows, which no file may be called after, and the names of files that hold a whole model.
_RESERVED = {
    *("con", "prn", "aux", "nul", "model", "manifest", "report"),
    *(f"{port}{number}" for port in ("com", "lpt") for number in range(10)),
}


@dataclass(frozen=True, slots=True)
class Target:
    """A program that models are exported for.

    Parameters
    ----------
    forms
        Formats, keys of `vhp_cli.formats.surfaces.FORMS`.
    profile
        Of the gate.
    scripts
        Scripts to be written, keys of `vhp_cli.stages.export.scripts.SCRIPTS`.
    smallest_feature
        In units of the exported model, below which the program's geometry kernel goes wrong; 0: none is known.
    largest_size
        The same above which.
    description
        What it is, in one clause.
    """

    forms: tuple[str, ...]
    profile: str
    scripts: tuple[str, ...] = ()
    smallest_feature: float = 0.0
    largest_size: float = float("inf")
    description: str = ""


TARGETS: Mapping[str, Target] = MappingProxyType(
    {
        "hfss": Target(
            ("stl",), "hfss", ("hfss-pyaedt", "hfss-native"), 1e-3, 1e4, "ANSYS HFSS: STL, scripts with materials"
        ),
        "cst": Target(("stl",), "cst", ("cst",), 1e-3, 1e4, "CST Studio Suite: STL, a macro with materials"),
        "matlab": Target(("mat", "mat-all"), "matlab", ("matlab",), description="MATLAB: P, t, normals; a loader"),
        "comsol": Target(("nas",), "comsol", description="COMSOL Multiphysics: Nastran shells"),
        "print": Target(("stl", "3mf"), "print", description="3-D printing: STL and 3MF"),
        "generic": Target(("stl", "ply", "bdf", "vtp"), "generic", description="anything else: STL, PLY, Nastran, VTK"),
    }
)


def object_names(tissues: Iterable[str]) -> list[str]:
    """Return a name for each tissue that every program and file system takes; no two the same but for case.

    A tissue whose name is fine keeps it. The names depend on the tissues and their order alone.
    """
    return valid_names([f"{name}_tissue" if name.casefold() in _RESERVED else name for name in tissues], NAMING)


def chosen_forms(target: Target, said: Iterable[str]) -> tuple[str, ...]:
    """Return the formats of an export: those of the target, or those that are named; ``+ply`` adds one to them.

    Raises
    ------
    UsageError
        If one is not known.
    """
    said = list(said)
    replacing = [form for form in said if not form.startswith("+")]
    adding = [form.removeprefix("+") for form in said if form.startswith("+")]
    forms = tuple(dict.fromkeys([*(replacing or target.forms), *adding]))
    check_forms(forms)
    if {"bdf", "nas"} <= set(forms):
        raise UsageError("the formats bdf and nas are the same under two names", hint="choose one of them")
    return forms
