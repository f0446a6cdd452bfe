"""The rule table: what can be wrong with a model, how bad it is, and why a solver minds."""

from __future__ import annotations

from vhp_cli.rules import breathing, files, intersections, pairs, quality, tetrahedra, topology
from vhp_cli.rules.rule import Rule

__all__ = ["RULES", "Rule"]

RULES: dict[str, Rule] = {
    rule.code: rule
    for family in (files, topology, intersections, quality, pairs, tetrahedra, breathing)
    for rule in family.RULES
}
