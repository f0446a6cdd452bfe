"""The rule table: what can be wrong with a model, how bad it is, and why a solver minds."""

from __future__ import annotations

from dataclasses import dataclass

from vhp_cli.measures import Level


@dataclass(frozen=True, slots=True)
class Rule:
    """One row of the table.

    Parameters
    ----------
    code, name
        Stable identifier (letter of the family and three digits) and short name.
    level
        Default level; None: off unless a profile or the configuration turns it on.
    summary
        One line.
    why
        Why a solver chokes on it.
    example
        How it comes about.
    fix
        What to do; the hint of each finding.
    limit
        Default limit, if the rule compares a measure with one.
    unit
        Unit of the limit.
    """

    code: str
    name: str
    level: Level | None
    summary: str
    why: str = ""
    example: str = ""
    fix: str = ""
    limit: float | None = None
    unit: str = ""


_TABLE = (
    Rule(
        "F001",
        "unreadable-file",
        "error",
        "The file can't be read as a triangle mesh.",
        why=(
            "A tissue that can't be read is missing from the simulation, and an importer often says no more than that "
            "the file is invalid or empty."
        ),
        example=(
            "The file is a voxel volume, a zipped mesh or a web page with the extension .stl, or it may not be read by "
            "this user."
        ),
        fix="Export the tissue again as binary STL, PLY or OBJ, or take the file out of the model directory.",
    ),
    Rule(
        "F002",
        "truncated-file",
        "error",
        "The file ends before the facets it announces.",
        why="What is left has a hole where the missing facets were; some importers take it silently, others crash.",
        example="A download or a copy was cut off, or the disk was full during the export.",
        fix=(
            "Copy or export the file again and compare its size with the original; do not heal a truncated file, its "
            "shape is incomplete."
        ),
    ),
    Rule(
        "F003",
        "facet-count-mismatch",
        "error",
        "Header and contents disagree on the number of facets.",
        why=(
            "One reader trusts the header, another the length of the file, so that two solvers simulate two different "
            "bodies."
        ),
        example=(
            "A script appended facets to a binary STL without updating the count at byte 80, or an ASCII file was "
            "edited by hand."
        ),
        fix=(
            "Export the tissue again from its source; if the facets in the file are complete, vhp heal writes them "
            "with a correct header."
        ),
    ),
    Rule(
        "F004",
        "not-finite",
        "error",
        "Coordinates are NaN, infinite or absurdly large.",
        why=(
            "One NaN makes the bounding box, the octree and every intersection test of an importer meaningless; CAD "
            "kernels refuse or hang."
        ),
        example=(
            "A smoothing or projection step divided by zero, or the bytes of the file were shifted during a text-mode "
            "transfer."
        ),
        fix="Export the tissue again; look at the vertices named and repair the step that made them.",
    ),
    Rule(
        "F005",
        "empty-file",
        "error",
        "The file holds no triangle.",
        why=(
            "An empty object is dropped by most importers without a word, and its material is then missing from the "
            "model."
        ),
        example="A segmentation label without voxels was exported, or a Boolean operation removed the whole tissue.",
        fix="Segment or export the tissue again, or take the file out of the model directory.",
    ),
    Rule(
        "F006",
        "name-clash",
        "error",
        "Two files give the same tissue name.",
        why=(
            "Materials, priorities and results are assigned by name: with two tissues of one name, one replaces the "
            "other or gets its material."
        ),
        example=(
            "Liver.stl and Liver.ply lie in one directory, or two names differ only in characters that a solver "
            "replaces, such as a blank and an underscore."
        ),
        fix="Rename one of the files, or remove the one that is out of date.",
    ),
    Rule(
        "F007",
        "suspicious-unit",
        "warning",
        "The size suggests that the unit is not the millimetre.",
        why=(
            "STL has no unit: a solver that reads metres as millimetres simulates a body a thousand times too small, "
            "and its features fall below the smallest length of the CAD kernel (1e-6 units in HFSS)."
        ),
        example="A liver 0.2 wide was exported in metres, or one 20 wide in centimetres.",
        fix="Name the unit with --units (um, cm, in or m), or scale the file once and for all to millimetres.",
    ),
    Rule(
        "F008",
        "several-solids",
        "note",
        "The file holds several solids; they are read as one tissue.",
        why="Solvers differ here: some import each solid as an object of its own, some only the first.",
        example="An ASCII STL holds 'solid left' and 'solid right', as written by an export of a selection.",
        fix=(
            "If the solids are different tissues, write one file for each; otherwise nothing needs to be done, vhp "
            "writes one solid."
        ),
    ),
    Rule(
        "F009",
        "loose-syntax",
        "warning",
        "The file bends its format; other readers may refuse it.",
        why="vhp could read the file without a guess, but a stricter importer may refuse it or read it differently.",
        example=(
            "An ASCII STL lacks 'endsolid', has keywords in odd case or spacing, or a binary STL begins with the word "
            "'solid'."
        ),
        fix="Write the file anew in clean form: every file that vhp writes, such as the result of vhp heal, is.",
    ),
    Rule(
        "F010",
        "trailing-bytes",
        "warning",
        "Bytes follow the last facet.",
        why="A strict importer compares the length of the file with the facet count and refuses what does not agree.",
        example=(
            "Two files were joined with cat, an exporter padded the file to a block size, or a footer with colours "
            "follows."
        ),
        fix="Check that no facets are lost behind the end; then write the file anew, for instance with vhp heal.",
    ),
    Rule(
        "F011",
        "polygons",
        "note",
        "Faces with more than three corners were cut into triangles.",
        why=(
            "STL holds triangles only, and a polygon that is not flat can be cut in several ways, each giving a "
            "slightly different surface."
        ),
        example="An OBJ or PLY file from a modelling program with quadrilateral faces.",
        fix="Nothing needs to be done; to choose the cut yourself, triangulate before the export.",
    ),
    Rule(
        "F012",
        "not-processed",
        "error",
        "The tissue could not be processed.",
        why="What was not checked can't be called fit; the rest of the model was still checked.",
        example="The machine ran out of memory, or the file changed while it was being checked.",
        fix="Run the check again with more memory or with --jobs 1; the message says what went wrong.",
    ),
    Rule(
        "F013",
        "not-checked",
        "warning",
        "The directory holds meshes that are no part of the check.",
        why="A model passes as a whole or not at all: a tissue that nobody looked at may be the one that crosses.",
        example="A tissue was exported as OFF or glTF, is compressed, or lies in a subdirectory.",
        fix="Convert the files to STL, PLY or OBJ, use --recursive, or move them out of the model directory.",
    ),
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
    Rule(
        "M001",
        "label-lost",
        "error",
        "A tissue has no tetrahedra.",
        why=(
            "The tissue is missing from the simulation, and its place is taken by what lies around it, without a word "
            "from the solver."
        ),
        example=(
            "A thin capsule within the envelope of the mesher, a surface whose faces are stored twice in opposite "
            "directions, or a copy of another tissue."
        ),
        fix="Look at the surface with vhp check, heal it, and mesh again with a smaller --epsilon and edge length.",
    ),
    Rule(
        "M002",
        "label-volume",
        "error",
        "The volume of a label is far from that of its surface.",
        why=(
            "Mass, losses and absorbed power scale with the volume of a tissue; a solver has no way to see that the "
            "mesh holds less of it than the model."
        ),
        example="A wall thinner than twice the envelope collapsed, or an open surface let a tissue run out.",
        fix="Mesh with a smaller --epsilon or edge length for the tissue, and heal its surface first if it is open.",
        limit=0.05,
    ),
    Rule(
        "M003",
        "label-volume-drift",
        "warning",
        "The volume of a label differs from that of its surface.",
        why="A per cent of volume is a per cent of mass and of absorbed power, more than most solvers err by.",
        example="A thin vessel was meshed with edges as long as its diameter.",
        fix="Mesh with shorter edges or a smaller --epsilon; vhp.toml takes both a length for a tissue and this limit.",
        limit=0.01,
    ),
    Rule(
        "M004",
        "inverted-tetrahedron",
        "error",
        "A tetrahedron has no positive volume.",
        why=(
            "The Jacobian of the element is zero or negative: the stiffness matrix is singular or indefinite, and the "
            "solver stops or returns nonsense."
        ),
        example="A mesh was smoothed without a guard, or its corners are in the order of another program.",
        fix="Mesh again; if it comes back, heal the surfaces at the places listed.",
    ),
    Rule(
        "M005",
        "small-dihedral-angle",
        "warning",
        "A tetrahedron has a dihedral angle below the limit.",
        why=(
            "The condition of the stiffness matrix worsens and gradients lose accuracy as angles go to 0 or 180 "
            "degrees; one bad element is enough for an explicit solver's time step."
        ),
        example="Two surfaces at a very small angle, or a mesh made under a time limit.",
        fix="Mesh with a lower --stop-energy or more --attempts; separate or smooth the surfaces at the places listed.",
        limit=10,
        unit="deg",
    ),
    Rule(
        "M006",
        "low-radius-ratio",
        "warning",
        "More than 1 % of the tetrahedra of a tissue have a radius ratio below the limit.",
        why=(
            "The radius ratio, 3 r_in / r_out, bounds the error of linear elements: if many are flat, results are "
            "wrong over a region, not only in a point."
        ),
        example="A layer much thinner than the edge length was filled with one row of flat tetrahedra.",
        fix="Mesh with shorter edges in the tissue, or with a lower --stop-energy.",
        limit=0.35,
    ),
    Rule(
        "M007",
        "sliver-tetrahedron",
        "error",
        "A tetrahedron is almost flat: its scaled Jacobian is below the limit.",
        why="Many solvers refuse elements so flat, and none gives a result to be trusted in them.",
        example="Four points near a great circle of their circumsphere, at a surface that had to be kept exactly.",
        fix="Mesh without --keep-surface, or remesh the surface at the places listed with vhp heal.",
        limit=0.01,
    ),
    Rule(
        "M008",
        "non-conforming",
        "error",
        "Tetrahedra do not share whole faces.",
        why=(
            "Where a point lies within a neighbour's face, or tetrahedra overlap, the solution is torn or counted "
            "twice, and most solvers read the crack as an outer wall."
        ),
        example="Tissues that were meshed one by one and joined by a script.",
        fix="Mesh all tissues together, that is without --per-tissue.",
    ),
    Rule(
        "M009",
        "pinched-label-edge",
        "warning",
        "The boundary of a label is no 2-manifold: more than two of its triangles meet at an edge.",
        why=(
            "The volume mesh is sound, but the surface of the tissue can't be used as such, for contact, for boundary "
            "conditions or in a CAD kernel."
        ),
        example="Two parts of a tissue that touch along an edge where its surface crosses itself.",
        fix="Heal the surface at the places listed, or mesh with a smaller --epsilon.",
    ),
    Rule(
        "M010",
        "pinched-label-point",
        "note",
        "The boundary of a label pinches to a point.",
        why=(
            "A FEM solver does not mind; whoever takes the surface of the label out of the mesh has to split the point."
        ),
        example="Two parts of a tissue that touch in one point of the mesh.",
        fix="Nothing needs to be done for a solver on tetrahedra; heal the surface if its boundary is to be used.",
    ),
    Rule(
        "M011",
        "label-parts",
        "warning",
        "A label has more or fewer connected parts than its surface encloses.",
        why=("A vessel that is cut carries no current, and two parts that have merged carry one that does not exist."),
        example="A nerve thinner than the envelope broke into pieces.",
        fix="Mesh with a smaller --epsilon, or a shorter edge length in the tissue.",
    ),
    Rule(
        "M012",
        "defective-surface",
        "warning",
        "The surface of a tissue is defective, so that its inside had to be estimated.",
        why=(
            "Where a surface is open or crosses itself, winding numbers say what is most likely inside; the border of "
            "the tissue near the defect is a guess."
        ),
        example="An organ that was cut off by the border of the scan was meshed as it is.",
        fix="Run vhp heal on the model first, and mesh the result.",
    ),
    Rule(
        "M013",
        "overlap-shared-out",
        "warning",
        "Two tissues overlap, and the common volume went to one of them.",
        why="Which material fills the overlap was decided by a rule, not by anatomy.",
        example="Liver and kidney of one segmentation cross by a millimetre.",
        fix=(
            "Separate the two with vhp heal --clearance, or say with priority under [[tissue]] in vhp.toml which one "
            "gets the volume."
        ),
    ),
    Rule(
        "M014",
        "limits-relaxed",
        "warning",
        "The mesh was made with other settings than asked for, or keeps a limit that was set no more.",
        why="A mesh that a time limit made coarser may be too coarse for its purpose.",
        example="The first attempt ran out of time, and the second was made with longer edges and lower demands.",
        fix="Give more time or memory, longer edges, or a larger --epsilon; vhp decimate makes surfaces lighter.",
    ),
    Rule(
        "B001",
        "breathing-crossing",
        "error",
        "Two tissues cross or touch in a frame, and do not at rest.",
        why="A solver refuses a frame with crossing tissues, or fills the common volume with either of two materials.",
        example="A lung that grows into a rib which does not make room for it.",
        fix=(
            "Ask for a smaller volume change or travel, move the lungs less forward, or give the tissue that is in the "
            "way a role that lets it move (breathe = { role = ... } in vhp.toml)."
        ),
    ),
    Rule(
        "B002",
        "breathing-gap",
        "error",
        "Two tissues come closer in a frame than the limit, and than at rest.",
        why="A gap below what the mesher resolves closes at some frame, and that frame fails as if tissues crossed.",
        example="The stomach is pushed to within 0.4 mm of the left kidney at full inhalation.",
        fix="Set the gap that the solver needs with --gap, or ask for a smaller breath.",
    ),
    Rule(
        "B003",
        "breathing-unproven",
        "error",
        "It is not proven that two tissues stay apart between the frames.",
        why=(
            "Frames are samples: two tissues that slide past each other fast and closely may cross between two that "
            "pass, and a sweep at other times would fail."
        ),
        example="Two surfaces 0.001 mm apart that move by millimetres.",
        fix="Heal the model with a clearance, or ask for a larger --gap, so that gaps exceed the bounds of travel.",
    ),
    Rule(
        "B004",
        "lung-volume",
        "error",
        "The lungs do not gain the volume that was asked for.",
        why="The volume is what the breath is defined by; another one is another experiment.",
        example="The published sequence played on other lungs than those that it was made for.",
        fix="Fit the sequence to this model, or state the targets of the sequence that is played.",
    ),
    Rule(
        "B005",
        "diaphragm-travel",
        "error",
        "The lungs' lowest point does not travel as far as was asked for.",
        why="The travel of the diaphragm is what the breath is defined by, beside the volume.",
        example="The published sequence played on lungs of another height.",
        fix="Fit the sequence to this model, or state the targets of the sequence that is played.",
    ),
    Rule(
        "B006",
        "breathing-mass",
        "error",
        "The mass of the model changes with breath by more than the limit.",
        why=(
            "A body that gains tissue as it breathes in absorbs more; the change is then of the model, not of "
            "breathing."
        ),
        example="Lungs that grow by 0.3 l within a skin that stays.",
        fix="Fit the shells anew, check the densities and the convention for the lungs, or set --mass-tolerance.",
    ),
    Rule(
        "B007",
        "bone-deformed",
        "error",
        "A bone changes its shape with breath.",
        why="Bones are rigid; one that is scaled gains or loses mass and no longer fits its neighbours.",
        example="A sequence that scales a rib.",
        fix="Move bones by rotations and translations alone.",
    ),
    Rule(
        "B008",
        "rest-contact-worse",
        "error",
        "Two tissues that are in contact at rest have more volume in common in a frame.",
        why="What is wrong with the model at rest must not grow with breath.",
        example="A costal cartilage that overlaps its rib by 2 mm3 at rest and by 9 mm3 at full inhalation.",
        fix="Heal the model with a clearance first.",
    ),
    Rule(
        "B009",
        "moved-at-rest",
        "error",
        "The sequence moves tissues at t = 0.",
        why="The first frame is then not the model, and all differences to it count twice.",
        example="A polynomial with a constant that is not the identity, as printed for rib 1.",
        fix="Play the recommended readings, or pin the curves to the identity at t = 0.",
    ),
    Rule(
        "B010",
        "vertices-joined",
        "error",
        "Vertices of a tissue fall together in a frame when its coordinates are rounded.",
        why="The frame then has other topology than the model, and collapsed triangles.",
        example="A mesh with edges of a nanometre, written as STL with float32 coordinates.",
        fix="Decimate or heal the tissue, or keep the model in PLY, which holds all digits.",
    ),
    Rule(
        "B011",
        "rest-contact",
        "warning",
        "Two tissues are in contact at rest.",
        why="Nothing can be proven of a pair that is in contact already; it is only watched for not getting worse.",
        example="A rib and its cartilage that were segmented as neighbours.",
        fix="vhp heal --clearance separates tissues.",
    ),
    Rule(
        "B012",
        "density-unknown",
        "note",
        "The density of a tissue is not known; that of muscle is taken.",
        why="The mass of the model is as good as the densities.",
        example="A tissue named tissue_17.",
        fix='State it in vhp.toml: [[tissue]] match = "tissue_17" breathe = { density = 1050 }.',
    ),
)

RULES: dict[str, Rule] = {rule.code: rule for rule in _TABLE}
