"""Rules M: tetrahedral meshes."""

from __future__ import annotations

from vhp_cli.rules.rule import Rule

RULES = (
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
)
