"""A procedural torso: sound tissue surfaces for tests, demonstrations and benchmarks, and planted defects."""

from __future__ import annotations

from vhp_cli.phantom.defects import RULES, plant_defects
from vhp_cli.phantom.file_defects import FILE_PLANTS, plant_file_defects
from vhp_cli.phantom.model import generate
from vhp_cli.phantom.sites import Planted

PLANTED_RULES = (*RULES, *FILE_PLANTS)

__all__ = ["PLANTED_RULES", "Planted", "generate", "plant_defects", "plant_file_defects"]
