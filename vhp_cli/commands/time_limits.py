"""Time limits that go with the size of what is worked on."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import click
from click.core import ParameterSource

if TYPE_CHECKING:
    from vhp_cli.pipeline.stage import Limits

# Some ten times what tissues take on a machine that is not busy, or 30 triangles a second.
_LEAST_TIMEOUT_S, _BYTES_PER_SECOND = 600.0, 1_500.0


def by_size(ctx: click.Context, limits: Limits) -> Limits:
    """Return the limits with more time, the more for large tissues, unless ``--timeout`` asks for a limit."""
    if ctx.get_parameter_source("timeout") is not ParameterSource.DEFAULT:
        return limits
    return replace(limits, timeout_s=_LEAST_TIMEOUT_S, bytes_per_second=_BYTES_PER_SECOND)
