"""What every script says, before it is put into the words of a program."""

from __future__ import annotations

import re
from dataclasses import dataclass

from vhp_cli.formats.volume.regions import valid_names
from vhp_cli.stages.export.dielectric import frequency_text
from vhp_cli.stages.export.materials import Properties
from vhp_cli.stages.export.targets import NAMING

WARNING = (
    "Written by vhp export. What it says was read back and compared with the model; it was not run in the program",
    "itself. Compare names, units and materials of the first import.",
)


@dataclass(frozen=True, slots=True)
class Part:
    """One object.

    Parameters
    ----------
    name
        Of the object.
    file
        Path of its STL, seen from the script, with forward slashes.
    properties
        Of its tissue.
    parent
        Name of the smallest object that contains it; empty if none does.
    """

    name: str
    file: str
    properties: Properties
    parent: str = ""


@dataclass(frozen=True, slots=True)
class Material:
    """A material of a script; density None if it is not known."""

    name: str
    permittivity: float
    conductivity: float
    density: float | None


@dataclass(frozen=True, slots=True)
class Scene:
    """What a script is written for.

    Parameters
    ----------
    title
        Name of the model.
    unit
        Of the files: ``"mm"`` and so on.
    frequency_hz
        Of the materials' properties; None: the tissues have none but those that the user gave.
    parts
        The objects, in the order of the model.
    """

    title: str
    unit: str
    frequency_hz: float | None
    parts: tuple[Part, ...]

    @property
    def comment(self) -> str:
        """The title, fit for a comment in any language."""
        return re.sub(r"[^\w .,()+-]", "_", self.title) or "the model"

    @property
    def at(self) -> str:
        """The clause on the frequency."""
        return "" if self.frequency_hz is None else f" at {frequency_text(self.frequency_hz)}"

    def outermost_first(self) -> tuple[Part, ...]:
        """Return the parts so that none comes before what contains it, else in their order."""
        parents = {part.name: part.parent for part in self.parts}

        def depth(name: str) -> int:
            steps = 0
            while (name := parents.get(name, "")) and steps <= len(parents):
                steps += 1
            return steps

        return tuple(sorted(self.parts, key=lambda part: depth(part.name)))

    def materials(self) -> tuple[tuple[Material, ...], dict[str, str]]:
        """Return the materials, and which one each object has by its name; an object without one is not in there.

        Tissues of the same material with other values, such as another density, have materials of their own.
        """
        keys: dict[tuple[str, float, float, float | None], None] = {}
        of_part = {}
        for part in self.parts:
            found = part.properties
            if found.permittivity is not None and found.conductivity is not None:
                key = (found.material, found.permittivity, found.conductivity, found.density)
                keys[key] = None
                of_part[part.name] = key
        where = "" if self.frequency_hz is None else "_" + frequency_text(self.frequency_hz).replace(" ", "")
        names = valid_names([f"vhp_{key[0].replace('(', '').replace(')', '')}{where}" for key in keys], NAMING)
        named = dict(zip(keys, names, strict=True))
        materials = tuple(Material(named[key], *key[1:]) for key in keys)
        return materials, {name: named[key] for name, key in of_part.items()}


def listed(name: str, rows: object) -> list[str]:
    """Return a Python list, one row a line."""
    assert isinstance(rows, list | tuple)
    return [f"{name} = [", *(f"    {row!r}," for row in rows), "]"]


def python_lists(scene: Scene) -> list[str]:
    """Return the lists that the scripts for ANSYS begin with."""
    materials, of_part = scene.materials()
    return [
        # ANSYS writes the metre out.
        f"UNIT = {('meter' if scene.unit == 'm' else scene.unit)!r}",
        "",
        f"# name, relative permittivity, conductivity (S/m), density (kg/m3; 0: not known){scene.at}",
        *listed(
            "MATERIALS", [(item.name, item.permittivity, item.conductivity, item.density or 0) for item in materials]
        ),
        "",
        "# object, mesh file, material (empty: none is known, the program's own is left); outer ones first",
        *listed("OBJECTS", [(part.name, part.file, of_part.get(part.name, "")) for part in scene.outermost_first()]),
    ]
