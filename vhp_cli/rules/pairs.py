"""Rules P: how tissues lie to each other."""

from __future__ import annotations

from vhp_cli.rules.rule import Rule

RULES = (
    Rule(
        "P001",
        "tissues-cross",
        "error",
        "Two tissues cross each other.",
        why=(
            "One point can't be of two materials: HFSS refuses to solve with intersecting parts, CST silently gives "
            "the overlap to the tissue of higher priority, and a conforming tetrahedral mesher stops."
        ),
        example="Tissues were segmented or smoothed one by one, so that neighbouring walls ran through each other.",
        fix=(
            "vhp heal --clearance separates the tissues; by hand, move the walls apart at the places listed or "
            "subtract one tissue from the other with a gap."
        ),
    ),
    Rule(
        "P002",
        "tissues-touch",
        "error",
        "Two tissues touch.",
        why=(
            "A contact in a point or along a line makes the union of the two bodies non-manifold, and whether a solver "
            "sees a contact or a crossing depends on its tolerance."
        ),
        example="Bones in a joint, or organs drawn up to each other, meet in single vertices.",
        fix="vhp heal --clearance opens a gap; if the contact is meant, name the two as [[may-touch]] in vhp.toml.",
    ),
    Rule(
        "P003",
        "coincident-faces",
        "error",
        "Two tissues share a piece of surface.",
        why=(
            "Each body brings its own copy of the common wall; unless both are triangulated alike, a solver finds "
            "thousands of tiny crossings, and if alike, doubled faces."
        ),
        example=(
            "Two labels of one segmentation share a boundary, such as grey and white matter from one marching-cubes "
            "run."
        ),
        fix=(
            "vhp heal --clearance opens a gap between the two; for a solver that wants shared walls, mesh them "
            "together with vhp tetmesh."
        ),
    ),
    Rule(
        "P004",
        "identical-tissues",
        "error",
        "Two tissues are copies of one surface.",
        why=(
            "Two bodies fill the same space: one of the materials is ignored, and which one depends on the order of "
            "import."
        ),
        example="A file was copied under a second name, or left and right were exported from the same label.",
        fix="Remove one of the two, or export the tissue that was meant.",
    ),
    Rule(
        "P005",
        "gap",
        "error",
        "Two tissues are closer than the gap that the solver needs.",
        why=(
            "Within a narrow gap a mesher needs cells as small as the gap, and rounding or CAD tolerance can close it; "
            "a gap of 1 mm, the thickness of the membranes between tissues, keeps a model portable between solvers."
        ),
        example="Neighbouring organs at 0.05 mm after independent smoothing.",
        fix="vhp heal --clearance keeps the gap asked for; or set the limit in vhp.toml to what the solver resolves.",
        limit=1.0,
        unit="mm",
    ),
    Rule(
        "P006",
        "not-nested",
        "error",
        "A tissue is not inside the one that should enclose it.",
        why=(
            "Solvers find the material of a shell by subtracting what lies inside; a tissue that sticks out or lies "
            "elsewhere makes them subtract too much or nothing."
        ),
        example=(
            "White matter that pierces grey matter at one gyrus, or a tissue exported in another coordinate system."
        ),
        fix=(
            "Bring the tissue inside by hand or with vhp heal --clearance, or correct the [[nested]] entry in vhp.toml."
        ),
    ),
    Rule(
        "P007",
        "undecided-nesting",
        "warning",
        "A tissue lies in the mouth of an open surface.",
        why=(
            "Whether a point is inside an open surface has no answer, so the nesting of this pair, and with it the "
            "material between the two, is unknown."
        ),
        example="A lung lies in a thorax shell that is open at the neck.",
        fix="Close the outer surface (see T001) and check again.",
    ),
)
