"""Which tissue lies within which at rest."""

from __future__ import annotations

from collections.abc import Sequence

from vhp_cli.stages.breathe.tissue import Tissue


def lies_inside(inner: Tissue, outer: Tissue) -> bool:
    """Tell if a tissue lies wholly within another that it does not touch: one vertex of each part decides."""
    if not outer.closed or (inner.lower < outer.lower).any() or (inner.upper > outer.upper).any():
        return False
    return bool((outer.tree.inside(inner.mesh.vertices[inner.representatives]) == 1).all())


def parents(tissues: Sequence[Tissue]) -> dict[str, str | None]:
    """Return for each tissue the smallest one that contains it; None: nothing does.

    Meaningful where surfaces do not cross.
    """
    by_volume = sorted(
        (tissue for tissue in tissues if tissue.closed), key=lambda tissue: (tissue.volume_mm3, tissue.name)
    )
    found: dict[str, str | None] = {}
    for tissue in tissues:
        found[tissue.name] = next(
            (
                other.name
                for other in by_volume
                if other is not tissue and other.volume_mm3 > tissue.volume_mm3 and lies_inside(tissue, other)
            ),
            None,
        )
    return found


def ancestors(name: str, parent: dict[str, str | None]) -> list[str]:
    """Return what contains a tissue, the smallest first."""
    found: list[str] = []
    above = parent.get(name)
    while above is not None and above not in found:
        found.append(above)
        above = parent.get(above)
    return found
