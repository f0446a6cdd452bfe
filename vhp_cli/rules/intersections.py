"""Rules X: surfaces that cross or touch themselves."""

from __future__ import annotations

from vhp_cli.rules.rule import Rule

RULES = (
    Rule(
        "X001",
        "self-crossing",
        "error",
        "Faces of one tissue cross each other.",
        why=(
            "A surface that cuts through itself encloses no definite volume: CST rejects it in its self-intersection "
            "check, TetGen and Netgen stop with intersecting facets, and HFSS fails when it meshes the object."
        ),
        example=(
            "Smoothing or decimation of a thin tissue pushed one wall through the opposite one; joined nerve segments "
            "overlap at their ends."
        ),
        fix="vhp heal resolves the crossings; by hand, remesh or move the vertices of the faces listed.",
    ),
    Rule(
        "X002",
        "coplanar-overlap",
        "error",
        "Faces of one tissue overlap in one plane.",
        why=(
            "Faces that overlap in one plane make a wall of no thickness; a mesher can't decide which of them bounds "
            "the volume."
        ),
        example="A decimated flat region whose triangles slid over each other, or two boxes joined at a common wall.",
        fix="vhp heal resolves the overlap; by hand, delete the faces listed and fill the hole anew.",
    ),
    Rule(
        "X003",
        "folded-edge",
        "error",
        "Two faces at an edge lie flat on each other.",
        why=(
            "The two faces enclose an angle of zero, so that no tetrahedron fits between them; TetGen refuses facets "
            "that overlap at a shared edge."
        ),
        example="An edge flip or a collapsed vertex folded a triangle back onto its neighbour.",
        fix="vhp heal unfolds or removes the pair; by hand, delete both faces and fill the hole.",
    ),
    Rule(
        "X004",
        "self-touch",
        "error",
        "Faces of one tissue touch where they are not joined.",
        why=(
            "Where the surface touches itself the body is not a manifold, although each edge has two faces: CAD "
            "kernels with a tolerance merge the points and get a non-manifold body."
        ),
        example=(
            "A vertex of one fold of the cortex lies exactly on a face of the next one, often after rounding to a grid "
            "or to float32."
        ),
        fix=(
            "vhp heal moves the touching walls apart; by hand, pull the vertex listed off the face by more than the "
            "tolerance of the CAD kernel."
        ),
    ),
    Rule(
        "X005",
        "sharp-fold",
        "warning",
        "The surface is folded back almost onto itself.",
        why=(
            "Tetrahedra in the fold get dihedral angles as small as the fold itself; solvers converge slowly or reject "
            "the mesh, and below about 0.1 degree TetGen takes the faces for overlapping."
        ),
        example="A sliver at the rim of a thin tissue that was smoothed or decimated.",
        fix="vhp heal or vhp smooth opens the fold; by hand, collapse the short edge opposite the fold.",
        limit=0.1,
        unit="deg",
    ),
)
