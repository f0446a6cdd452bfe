"""A procedural torso: sound tissue surfaces for tests, demonstrations and benchmarks, and planted defects."""

from __future__ import annotations

from vhp_cli.phantom.defects import plant_defects
from vhp_cli.phantom.file_defects import plant_file_defects
from vhp_cli.phantom.model import generate
from vhp_cli.phantom.sites import Planted

__all__ = ["Planted", "generate", "plant_defects", "plant_file_defects"]
