"""Inspection: meshes in, measures out. Nothing here knows of rules' levels, files or reports."""
