"""Refine tissue surfaces where a solution is worst or triangles are largest."""

from vhp_cli.stages.refine.refinement import refine as refine
