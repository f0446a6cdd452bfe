"""Decimate tissue surfaces."""

from vhp_cli.stages.decimate.decimation import decimate as decimate
from vhp_cli.stages.decimate.decimation import error_curve as error_curve
