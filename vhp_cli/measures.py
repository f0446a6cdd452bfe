"""What vhp measures and finds, in the form in which it is reported.

Every record is a plain JSON value with a typed shape, so that rules, cache and reports share one
form and nothing is converted on the way. Lengths are in mm, areas in mm2, volumes in mm3.
"""

from __future__ import annotations

from typing import Literal, NotRequired, TypedDict

Level = Literal["error", "warning", "note"]
Relation = Literal["disjoint", "touching", "crossing", "a_inside_b", "b_inside_a", "identical"]
Point = list[float]


class Place(TypedDict):
    """Where a defect is: a point in mm, and a face of the tissue it concerns (None: no single face)."""

    xyz_mm: Point
    face: int | None
    tissue: NotRequired[str]  # named where a finding concerns several tissues
    value: NotRequired[float]  # the measured value there (q, edge length, gap, ...)


class Defect(TypedDict):
    """All occurrences of one kind of defect in one tissue, with the worst or first places."""

    count: int
    places: list[Place]
    detail: NotRequired[str]  # one clause for the message, such as "2 holes, the longest 31.4 mm around"
    value: NotRequired[float]  # the worst measured value


class Finding(TypedDict):
    """One broken rule."""

    rule: str
    level: Level
    tissues: list[str]
    count: int
    message: str
    places: list[Place]
    hint: str
    known: NotRequired[bool]  # already in the baseline: does not fail the gate


# What is wrong with one tissue by itself, by rule code.
Defects = dict[str, Defect]


class Topology(TypedDict):
    """How the faces of a tissue are joined."""

    boundary_edges: int
    boundary_loops: int
    nonmanifold_edges: int
    nonmanifold_vertices: int
    inconsistent_edges: int
    inward_components: int
    duplicate_faces: int
    degenerate_faces: int
    collapsed_faces: int
    unreferenced_vertices: int


class Quality(TypedDict):
    """q = 2 r_in / r_out of each triangle (thesis eq. 2.4)."""

    min: float
    p01: float
    p05: float
    p50: float
    mean: float
    histogram: list[int]  # 20 equal bins over [0, 1]


class Spread(TypedDict):
    """Smallest, mean and largest value."""

    min: float
    mean: float
    max: float


class Bounds(TypedDict):
    """Corners of the box that holds a tissue."""

    min: Point
    max: Point


class SelfIntersections(TypedDict):
    """Pairs of faces of one tissue that meet where the mesh does not join them."""

    faces: int
    pairs: int
    crossing: int
    coplanar: int
    folded: int
    duplicate: int
    touching: int
    complete: bool  # False: so many that counting stopped; the numbers are lower bounds


class TissueMeasures(TypedDict):
    """Everything measured on one tissue by itself; independent of name and rules."""

    triangles: int
    vertices: int
    components: int
    euler: int
    genus: int | None  # None unless the tissue is a closed oriented 2-manifold
    closed: bool
    manifold: bool
    oriented: bool
    outward: bool
    volume_mm3: float
    area_mm2: float
    bounds_mm: Bounds | None
    centroid_mm: Point | None
    topology: Topology
    quality: Quality | None
    size_mm: Spread | None  # r_out, the circumradius
    edge_mm: Spread | None
    min_dihedral_deg: float | None
    self_intersections: SelfIntersections


class Action(TypedDict):
    """One thing that a stage did to a tissue; what was added or removed has a size and a place."""

    step: str  # such as "weld", "holes", "union", "remesh"
    message: str  # what it did, in one clause
    count: int
    places: list[Place]  # of the first or largest; `value` is a size in mm
    area_mm2: NotRequired[float]  # of surface added or removed
    volume_mm3: NotRequired[float]  # of material added or removed


class Distance(TypedDict):
    """How far one surface lies from another, sampled densely on the first."""

    max: float
    mean: float
    xyz_mm: Point | None  # where it is farthest


class Deviation(TypedDict):
    """How far input and output of a stage lie apart, both ways."""

    max: float  # of both ways
    mean: float
    to_output: Distance  # from the input's surface to the output
    to_input: Distance  # from the output's surface to the input
    lost_area_mm2: float  # of the input's surface beyond `lost_limit_mm` from the output
    lost_outside_mm2: float  # the part of it that lies outside of the output: material that is gone
    lost_limit_mm: float
    lost_places: list[Place]  # the farthest place of each part that was lost; `value` is its distance


class SmoothingStep(TypedDict):
    """A surface after an iteration of smoothing; the first is the input."""

    iteration: int
    step: str  # "input", "relax", "round off", "volume", or the method
    min_q: float
    mean_q: float
    volume_mm3: float
    max_turn_deg: float | None  # the largest angle by which the surface turns at an edge; None: not measured
    flips: int
    moves: int  # of vertices
    held: int  # vertices that guards kept from going all the way


class Before(TissueMeasures):
    """The input of a stage, measured as its output is."""

    file: str
    sha256: str
    format: str
    findings: list[Finding]


class Introduced(TypedDict):
    """A defect that the output of a stage has, and the input had not, or not so often."""

    rule: str
    before: int
    after: int
    message: str
    tissues: list[str]


class TissueRecord(TissueMeasures):
    """One tissue of the report."""

    name: str
    file: str
    sha256: str
    format: str
    tissue_type: str
    findings: list[Finding]
    # After a stage:
    status: NotRequired[Literal["changed", "unchanged", "refused", "failed"]]
    reason: NotRequired[str]  # why it was refused or failed
    deviation_mm: NotRequired[Deviation | None]  # None: nothing could be compared
    volume_change: NotRequired[float | None]  # of the input's volume; None where that one is not defined
    actions: NotRequired[list[Action]]
    introduced: NotRequired[list[Introduced]]
    history: NotRequired[list[SmoothingStep]]  # of a stage with iterations
    before: NotRequired[Before]


class PairMeasures(TypedDict):
    """How two tissues lie to each other."""

    relation: Relation
    inside: Literal["a", "b", ""]  # which one lies within the other, also when they touch
    min_gap_mm: float | None  # None: above the search limit
    points_mm: list[Point] | None  # the two nearest points, on a and on b
    faces: list[int] | None  # the two nearest faces, of a and of b
    crossing_faces: int  # faces of either tissue in a transversal crossing
    contact_faces: int  # faces of either tissue in any contact
    coplanar_faces: int  # faces of either tissue that overlap a face of the other in its plane
    overlap_mm3: float
    undecided: bool  # one surface is open and the other lies in its mouth


class PairRecord(PairMeasures):
    """One pair of the report."""

    a: str
    b: str


class Summary(TypedDict):
    """The model in a few numbers."""

    passed: bool
    tissues: int
    triangles: int
    pairs: int
    errors: int
    warnings: int
    notes: int
    counts: dict[str, int]  # findings by rule
    status: NotRequired[dict[str, int]]  # after a stage: tissues by status


class Report(TypedDict):
    """The whole report; `run` is the only part that may differ between two runs on the same input."""

    schema: str
    tool: dict[str, object]
    command: str
    settings: dict[str, object]
    model: dict[str, object]
    summary: Summary
    tissues: list[TissueRecord]
    pairs: list[PairRecord]
    nesting: dict[str, str | None]  # tissue -> the smallest tissue that contains it
    findings: list[Finding]
    run: dict[str, object]
