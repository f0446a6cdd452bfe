"""One entry of the phantom's catalogue."""

from __future__ import annotations

from dataclasses import dataclass

from vhp_cli.phantom.surface import Surface


@dataclass(frozen=True, slots=True)
class Part:
    """A tissue, or a pair of tissues that are mirror images in the plane x = 0.

    Parameters
    ----------
    name
        Tissue name; with ``{side}`` for a pair, for which `surface` is the left one.
    surface
        Its shape.
    rank
        The lower, the earlier the tissue is taken when only some are wanted.
    """

    name: str
    surface: Surface
    rank: int

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the tissues, the left one first."""
        if "{side}" not in self.name:
            return (self.name,)
        return (self.name.format(side="left"), self.name.format(side="right"))
