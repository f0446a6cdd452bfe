"""vhp: make directories of tissue surface meshes fit for simulation."""

__version__ = "0.1.0"
