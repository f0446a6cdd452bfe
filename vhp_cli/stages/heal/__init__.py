"""Heal tissue surfaces."""

from vhp_cli.stages.heal.cascade import heal as heal
