"""Rules Q: shape, size and number of triangles."""

from __future__ import annotations

from vhp_cli.rules.rule import Rule

RULES = (
    Rule(
        "Q001",
        "low-quality",
        "error",
        "A triangle is badly shaped: q = 2 r_in / r_out.",
        why=(
            "The quality of a surface triangle (1 equilateral, 0 degenerate) bounds that of the tetrahedra on it: "
            "needles and caps give badly conditioned matrices, tiny time steps, and failed imports where the height "
            "falls below the CAD tolerance."
        ),
        example="Thin tubes built from segments, such as nerves (7e-07 for one median nerve), or raw marching cubes.",
        fix="vhp smooth raises the quality and keeps the shape; vhp heal collapses what smoothing can't save.",
        limit=0.01,
    ),
    Rule(
        "Q002",
        "short-edge",
        "error",
        "An edge is shorter than the solver resolves.",
        why=(
            "CAD kernels merge points closer than their tolerance and tear the surface (HFSS resolves 1e-6 units, and "
            "advises features above 1e-3); an adaptive mesher refines down to the edge and runs out of memory."
        ),
        example=(
            "Two nearly equal vertices left where parts were joined, or marching cubes cutting a corner of a voxel."
        ),
        fix=(
            "vhp heal or vhp decimate collapses such edges; lower the limit in vhp.toml only if the solver resolves "
            "them."
        ),
        limit=0.01,
        unit="mm",
    ),
    Rule(
        "Q003",
        "degenerate-face",
        "error",
        "A face has no area.",
        why=(
            "A face without area has no normal: importers drop it, which leaves a hole or a T-junction, or stop with "
            "an error."
        ),
        example=(
            "Two corners are the same point, or the three lie on one line, often after rounding coordinates to few "
            "digits."
        ),
        fix="vhp heal removes the face and keeps its neighbours joined; export with full float32 precision.",
    ),
    Rule(
        "Q004",
        "low-mean-quality",
        "warning",
        "The triangles of the tissue are badly shaped on average.",
        why=(
            "A tissue of mostly poor triangles needs more cells for the same accuracy, even if none of them is bad "
            "enough to fail."
        ),
        example="A raw marching-cubes surface, or a decimation by edge collapse without regard to shape.",
        fix="vhp smooth MODEL -o OUT, or remesh the tissue with a uniform edge length.",
        limit=0.5,
    ),
    Rule(
        "Q005",
        "face-budget",
        None,
        "The tissue has more triangles than the solver takes in.",
        why=(
            "CST converts every STL triangle to a CAD face, and other CAD kernels do much the same: import and meshing "
            "time grow from seconds to hours."
        ),
        example="A full-resolution segmentation of the skin with a million triangles.",
        fix="vhp decimate MODEL -o OUT reduces the tissue to a budget without new defects.",
        limit=100_000,
    ),
    Rule(
        "Q006",
        "model-face-budget",
        None,
        "The model has more triangles than the solver takes in.",
        why=(
            "All tissues are loaded together: the sum decides whether the model can be opened and meshed at all in the "
            "memory of a workstation."
        ),
        example="Each tissue keeps to its budget, but there are 300 of them.",
        fix="vhp decimate MODEL -o OUT; start with the tissues that have the smallest triangles for their size.",
        limit=1_000_000,
    ),
)
