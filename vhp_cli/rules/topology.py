"""Rules T: closed, manifold, oriented surfaces."""

from __future__ import annotations

from vhp_cli.rules.rule import Rule

RULES = (
    Rule(
        "T001",
        "open-edge",
        "error",
        "The surface has holes: edges with a face on one side only.",
        why=(
            "A surface with a hole has no inside: CAD importers take it for a sheet, which gets no volume material, "
            "and a tetrahedral mesher leaks through the hole and loses the region."
        ),
        example=(
            "A segmentation that ends at the border of the scan, a deleted bad triangle, or vertices that differ in "
            "the last digit so that neighbours do not join."
        ),
        fix=(
            "vhp heal closes holes; a wide opening, such as a vessel cut off by the scan, is better capped by hand "
            "where the tissue should end."
        ),
    ),
    Rule(
        "T002",
        "non-manifold-edge",
        "error",
        "More than two faces meet at an edge.",
        why=(
            "Solid modellers accept only surfaces where each edge has two faces; HFSS does not mesh a non-manifold "
            "object, and inside and outside are undefined along the edge."
        ),
        example=(
            "Two lobes that meet in an edge after marching cubes, an inner wall left by a Boolean union, or a fin of "
            "stray triangles."
        ),
        fix=(
            "vhp heal separates the sheets or removes the inner wall; by hand, delete the superfluous faces at the "
            "places listed and close the hole."
        ),
    ),
    Rule(
        "T003",
        "non-manifold-vertex",
        "error",
        "The faces around a vertex do not form one fan.",
        why=(
            "The surface pinches to a point without thickness there; CAD kernels reject such a body and element size "
            "goes to zero around the point in a tetrahedral mesh."
        ),
        example="Two parts of a segmentation that touch in one voxel corner share a vertex.",
        fix="vhp heal splits the vertex and moves the two fans apart.",
    ),
    Rule(
        "T004",
        "inconsistent-orientation",
        "error",
        "Neighbouring faces are oriented against each other.",
        why=(
            "Normals tell the solver where the inside is; where they change sides the volume is computed wrong and the "
            "importer flips, splits or refuses the body."
        ),
        example=(
            "Two patches of different orientation were stitched together, or triangles were added by hand in the wrong "
            "order."
        ),
        fix=(
            "vhp heal turns the faces of each part to one side; a one-sided surface (Moebius band) can't be oriented "
            "and has to be cut."
        ),
    ),
    Rule(
        "T005",
        "inward-orientation",
        "error",
        "A closed part is turned inside out.",
        why=(
            "The part has a negative volume: a solver takes its outside for the inside, and a signed-distance or "
            "winding-number test answers the opposite of the truth."
        ),
        example=(
            "A mirrored left-right copy whose triangles were not reversed, or an exporter with y and z exchanged. An "
            "inner wall of a hollow tissue does point inwards and is not reported."
        ),
        fix="vhp heal turns the part over; by hand, use 'flip normals' in any mesh editor.",
    ),
    Rule(
        "T006",
        "duplicate-face",
        "error",
        "A face is stored more than once.",
        why=(
            "Two faces in one place make every edge between them belong to four faces or enclose no volume; "
            "tetrahedral meshers stop with duplicate facets."
        ),
        example="A surface was exported twice into one file, or a merge kept both copies of a common wall.",
        fix="vhp heal keeps one of the copies, or none where two opposite ones cancel out.",
    ),
    Rule(
        "T007",
        "several-components",
        "note",
        "The tissue has more separate parts than expected.",
        why=(
            "Loose bits far from the tissue cost mesh cells and can hide a forgotten fragment of another tissue; HFSS "
            "imports them as one object of several lumps."
        ),
        example=(
            "Specks left by thresholding a scan; but paired organs, such as kidneys in one file, have two parts "
            "rightly."
        ),
        fix=(
            "Remove the specks before the export, or set the limit of T007 for the tissue in vhp.toml to the number of "
            "parts it has."
        ),
        limit=1,
    ),
    Rule(
        "T008",
        "unexpected-genus",
        None,
        "The surface has more handles than expected.",
        why=(
            "A handle or tunnel that anatomy does not have is a segmentation error and makes current paths that do not "
            "exist."
        ),
        example="Two gyri of the cortex touch and fuse to a bridge; the aorta closes to a ring.",
        fix=(
            "Correct the segmentation at the bridge, or set the limit of T008 for the tissue in vhp.toml to the genus "
            "it has."
        ),
        limit=0,
    ),
    Rule(
        "T009",
        "unreferenced-vertex",
        "note",
        "Vertices belong to no face.",
        why=(
            "The stray points do no harm to a solver that reads faces, but they spoil bounding boxes, point clouds and "
            "file size."
        ),
        example="Faces were deleted from a PLY or OBJ file, their vertices were not.",
        fix="Nothing needs to be done: whatever vhp writes holds the used vertices only.",
    ),
)
