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


class TetrahedronShape(TypedDict):
    """Shape of tetrahedra; see `vhp_cli.inspection.tetrahedra`."""

    min_dihedral_deg: float
    min_dihedral_p01_deg: float  # 1 % of the tetrahedra have a smaller least angle
    max_dihedral_deg: float
    radius_ratio_min: float
    radius_ratio_p01: float
    radius_ratio_p05: float
    radius_ratio_p50: float
    scaled_jacobian_min: float
    inverted: int  # with no positive volume
    mean_edge_mm: float


class LabelBoundary(TypedDict):
    """The surface of a label in the tetrahedral mesh."""

    triangles: int
    area_mm2: float
    nonmanifold_edges: int
    nonmanifold_vertices: int


class TetmeshLabel(TypedDict):
    """One tissue in the tetrahedral mesh."""

    name: str
    label: int
    tets: int
    volume_mm3: float
    surface_volume_mm3: float  # within its surface and outside of the tissues in it
    surface_volume_exact: bool  # False: estimated, as surfaces are open or overlap
    enclosed_mm3: float  # of all tetrahedra within its surface, whichever tissue they belong to
    surface_enclosed_mm3: float  # within its surface
    volume_error: float | None  # of the first where it is exact, else of the second; None: neither is defined
    parts: int  # connected by faces
    expected_parts: int | None  # None: can't be told from the surfaces
    boundary: LabelBoundary | None
    quality: TetrahedronShape | None
    relabelled_tets: int  # given to this label when crumbs and non-manifold edges were tidied
    defects: list[str]  # rules that its input surface breaks
    file: NotRequired[str]  # of its own mesh, with one for each tissue
    surface_file: NotRequired[str]


class TetmeshInterface(TypedDict):
    """The common surface of two labels."""

    a: str
    b: str  # empty: what is outside of the mesh
    area_mm2: float
    triangles: int


class TetmeshAttempt(TypedDict):
    """One call of the mesher."""

    cluster: int  # from 1
    tissue: str  # empty: several together
    edge_length_mm: float
    epsilon_mm: float
    stop_energy: float
    iterations: int
    coarsen: bool
    tets: int | None  # None: it failed
    min_dihedral_deg: float | None
    radius_ratio_p01: float | None
    failure: str
    chosen: bool


class TetmeshCluster(TypedDict):
    """Tissues that were meshed together, as they stand apart from all others."""

    tissues: list[str]
    tets: int
    edge_length_mm: float
    epsilon_mm: float
    epsilon_reason: str
    failure: str  # why there is no mesh; empty: there is one


class TetmeshOverlap(TypedDict):
    """Two tissues that overlap and do not lie in each other."""

    a: str
    b: str
    overlap_mm3: float  # 0: not known
    winner: str  # the one that got the common volume


class TetmeshInput(TypedDict):
    """What the gate says of the surfaces that were meshed."""

    passed: bool
    errors: int
    warnings: int
    notes: int
    counts: dict[str, int]
    findings: list[Finding]


class Tetmesh(TypedDict):
    """The tetrahedral mesh of a model."""

    engine: str
    reproducible: bool  # whether the engine gives the same mesh twice
    per_tissue: bool
    tets: int
    points: int
    edge_length_mm: float | None  # None: there is no mesh
    epsilon_mm: float | None  # of the cluster with the largest one
    epsilon_reason: str
    clusters: list[TetmeshCluster]
    labels: list[TetmeshLabel]
    air: TetmeshLabel | None
    quality: TetrahedronShape | None  # of all tissues, air left out
    conforming: bool
    nonconforming: dict[str, int]  # by what is wrong
    interfaces: list[TetmeshInterface]
    attempts: list[TetmeshAttempt]
    overlaps: list[TetmeshOverlap]
    notes: list[str]  # on what was done
    relaxed: list[str]  # how the mesh falls short of what was asked for
    files: list[str]
    input: TetmeshInput


class BreathSpread(TypedDict):
    """Largest and mean value."""

    max: float
    mean: float


class BreathTissueFrame(TypedDict):
    """What became of a tissue in one frame."""

    displacement_mm: BreathSpread  # of its vertices from rest
    volume_mm3: float | None  # None: the surface is open
    min_q: float
    mean_q: float


class BreathContact(TypedDict):
    """Two tissues that meet, or come nearer than they may."""

    a: str
    b: str
    x: float
    crossing_faces: int  # 0 of a pair that is apart, or of which one lies within the other
    overlap_mm3: float | None
    gap_mm: float
    xyz_mm: Point


class BreathFrame(TypedDict):
    """One frame of a breath, as written."""

    index: int
    x: float  # sweep variable, 0 to N
    time_over_T: float
    directory: str
    passed: bool
    reasons: list[str]  # why it was rejected
    lung_volume_l: float
    diaphragm_travel_mm: float
    mass_kg: float
    mass_change: float  # as a share of the mass at rest
    crossings: int  # pairs of tissues
    contacts: list[BreathContact]
    min_gap_mm: float | None  # None: above the search limit
    min_gap_pair: list[str] | None
    gaps_below_limit: int
    tissues: dict[str, BreathTissueFrame]  # those that move


class BreathProof(TypedDict):
    """What is proven of all moments between the frames."""

    pairs: int
    far_pairs: int  # further apart than both ever travel
    intervals: int
    least_gap_mm: float | None  # a lower bound at every moment
    unproven: list[dict[str, object]]
    joined: list[list[str]]  # in contact at rest, and carried along unchanged
    bounded: list[list[str]]  # in contact at rest, and never more so than a frame may be
    excused: list[list[str]]  # in contact at rest, and tested in the frames alone


class Breathe(TypedDict):
    """A breathing model."""

    passed: bool
    frames: list[BreathFrame]
    limits: dict[str, object]
    sequence: dict[str, object]
    axes: dict[str, object]
    roles: dict[str, str]
    motions: dict[str, str]  # of the tissues that move: by what
    lungs: dict[str, object]
    rib_angles_deg: dict[str, list[float]]  # by number: lift and spread at full inhalation
    mass: dict[str, object]
    rest_contacts: list[dict[str, object]]
    proof: BreathProof
    infeasible: list[dict[str, object]]  # where the fit found no room
    notes: list[str]


class ClearanceState(TypedDict):
    """How two tissues lie to each other at one time."""

    relation: Relation
    min_gap_mm: float | None  # None: above the search limit
    overlap_mm3: float


class ClearancePair(TypedDict):
    """Two tissues that were, or are, closer than they should be."""

    a: str
    b: str
    kind: Literal["apart", "nested", "conflict", "identical", "kept"]
    inner: str  # of a nested pair
    winner: str  # of a conflict
    gap_mm: float  # that was asked for
    share: float  # by which a gives way; b gives way by the rest
    before: ClearanceState
    after: ClearanceState
    reached: bool
    reason: str  # why not, or what the conflict is
    places: list[Place]  # where the two are nearest, if that is too near


class ClearanceTissue(TypedDict):
    """How a tissue was deformed."""

    name: str
    yielding: float
    fixed: bool
    status: str
    level: int  # how often it was done anew, more finely
    max_mm: float
    mean_mm: float
    xyz_mm: Point | None  # where it is farthest from where it was
    volume_change: float | None


class Clearance(TypedDict):
    """What came of taking tissues apart."""

    pairs: list[ClearancePair]
    tissues: list[ClearanceTissue]  # those that had to change
    close_before: int
    close_after: int
    crossing_before: int
    crossing_after: int
    unreached: list[ClearancePair]
    conflicts: list[str]


class PipelineStage(TypedDict):
    """One stage of a pipeline."""

    directory: str  # of its results, below the output directory
    command: str
    options: dict[str, object]  # as given, by long name
    given: str  # the directory whose surfaces it was given; empty: the model
    outcome: Literal["passed", "errors", "failed", "refused", "not run"]
    exit_code: int | None  # None: not run, as the pipeline had ended
    on_error: Literal["stop", "continue"]
    decides: bool  # whether errors that it found count for the whole
    report: str | None  # its own report, below the output directory
    summary: Summary | None  # of that report
    left_alone: list[dict[str, str]]  # tissues that were refused or failed: name, status, reason


class PipelineSection(TypedDict):
    """What a pipeline did, stage by stage."""

    name: str  # the file, or the preset
    stages: list[PipelineStage]
    surfaces: str | None  # the directory of the final surfaces, below the output directory; None: there are none
    surfaces_of: str | None  # the stage they come from
    exit_code: int


class ExportFile(TypedDict):
    """One file of an export."""

    file: str  # below the output directory, with forward slashes
    format: str
    bytes: int
    sha256: str
    tissues: list[str]


class ExportTissue(TypedDict):
    """One tissue of an export: what it is called in the files, and what it is made of."""

    name: str
    object: str
    source: str
    source_sha256: str
    triangles: int
    vertices: int
    inside: str | None  # the smallest tissue that contains it
    rounding_mm: float | None  # by which coordinates were rounded at most
    own_volume_mm3: float | None  # without the tissues within it; None of an open surface
    mass_kg: float | None
    material: str  # empty: none is known
    permittivity: float | None  # relative, at the frequency of the export
    conductivity: float | None  # S/m
    density: float | None  # kg/m3
    dielectric_source: str
    density_source: str


class Export(TypedDict):
    """What was exported."""

    target: str
    passed: bool
    refused: bool  # nothing was written
    forced: bool  # written although the gate failed
    unit: str
    mm_per_unit: float
    frequency_hz: float | None
    files: list[ExportFile]
    tissues: list[ExportTissue]
    without_material: list[str]
    without_density: list[str]
    mass_kg: float  # of the tissues with a density
    left_out: list[str]  # tissues with nothing to write
    notes: list[str]


class ShellRecord(TypedDict):
    """An inner shell that was made of a body surface."""

    name: str
    thickness_mm: dict[str, float]  # min and max of what was asked for, after it was made gentle
    gap_mm: float  # from the surface around it, exact
    gap_xyz_mm: list[float]  # where that is
    depth: dict[str, float]  # of points of the shell, as a share of the thickness there: min, median, p99, max
    ends: list[dict[str, object]]  # parts of the surface around under which it ends: area_mm2, distance_mm, xyz_mm
    dropped: list[dict[str, object]]  # separate pieces left out: volume_mm3, xyz_mm


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
    tetmesh: NotRequired[Tetmesh]
    breathe: NotRequired[Breathe]
    clearance: NotRequired[Clearance]
    shells: NotRequired[list[ShellRecord]]
    export: NotRequired[Export]
    pipeline: NotRequired[PipelineSection]
