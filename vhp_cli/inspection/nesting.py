"""The nesting tree of a model: which tissue lies directly inside which."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from vhp_cli.measures import PairRecord


def nesting(names: Iterable[str], pairs: Iterable[PairRecord], volumes: Mapping[str, float]) -> dict[str, str | None]:
    """Return for every tissue the smallest tissue that contains it, None for the outermost.

    Parameters
    ----------
    names
        The tissues in the order of the report.
    pairs
        The pairs of the report.
    volumes
        Absolute volume of each tissue in mm3, which decides among several containers.
    """
    containers: dict[str, list[str]] = {name: [] for name in names}
    for pair in pairs:
        if pair["inside"] == "a":
            containers[pair["a"]].append(pair["b"])
        elif pair["inside"] == "b":
            containers[pair["b"]].append(pair["a"])
    return {
        name: min(found, key=lambda other: (volumes[other], other)) if found else None
        for name, found in containers.items()
    }
