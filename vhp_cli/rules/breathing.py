"""Rules B: a breath and its frames."""

from __future__ import annotations

from vhp_cli.rules.rule import Rule

RULES = (
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
