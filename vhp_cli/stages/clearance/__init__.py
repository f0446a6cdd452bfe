"""Take tissues apart: no crossing, no contact, and the gap that a solver needs."""

from vhp_cli.stages.clearance.separation import separate as separate
