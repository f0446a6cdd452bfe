"""Rules F: what a file can have wrong."""

from __future__ import annotations

from vhp_cli.rules.rule import Rule

RULES = (
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
)
