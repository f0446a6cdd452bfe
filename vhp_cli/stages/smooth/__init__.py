"""Better shaped triangles at the same topology: smoothing of tissue surfaces."""
