"""Make inner shells of a body surface: skin, fat, and the average body within (thesis 5.1.6)."""

from vhp_cli.stages.shells.offsetting import shells as shells
