"""Better shaped triangles at the same topology: smoothing of tissue surfaces."""

from vhp_cli.stages.smooth.smoothing import smooth as smooth
