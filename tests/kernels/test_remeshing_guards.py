"""No guarded operation may make a mesh worse than it was, whatever the mesh."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from kernels.remeshing_checks import assert_valid, distances, is_closed, measure, n_contacts, single, tube
from shapes import box, flipped, joined, moved, sphere

from vhp_cli.kernels import surface
from vhp_cli.kernels.remeshing import Remesher

SHAPES = ("flat", "spiky", "thread", "noisy", "coarse grid", "pinched", "far away")


def random_surface(seed):
    """Return a sphere deformed in one of many ways, with slivers: often a valid mesh, often one with contacts."""
    rng = np.random.default_rng(seed)
    kind = SHAPES[rng.integers(len(SHAPES))]
    mesh = sphere(10, subdivisions=int(rng.integers(0, 4)))
    vertices = mesh.vertices.copy()
    if kind == "flat":
        vertices *= [1, 1, rng.uniform(0.005, 0.1)]
    elif kind == "spiky":
        vertices *= (1 + 0.3 * rng.standard_normal((len(vertices), 1))).clip(0.1, 3)
    elif kind == "thread":
        vertices *= [20, 0.1, 0.1]
    elif kind == "noisy":
        vertices += rng.normal(0, 0.3, vertices.shape)
    elif kind == "coarse grid":
        vertices = np.round(vertices * rng.integers(1, 4)) / 2
    elif kind == "pinched":
        vertices = vertices**3 / 100
    else:
        vertices += rng.uniform(-800, 800, 3)
    vertices, faces = single(vertices).tolist(), mesh.faces.tolist()
    for _ in range(int(rng.integers(0, 40))):
        at = int(rng.integers(len(faces)))
        a, b, c = faces[at]
        weights = rng.dirichlet([0.1, 0.5, 1])
        vertices.append(single(weights @ np.array([vertices[a], vertices[b], vertices[c]])).tolist())
        new = len(vertices) - 1
        faces[at] = [a, b, new]
        faces += [[b, c, new], [c, a, new]]
    return np.array(vertices), np.array(faces, np.int32)


def rows(array):
    return {tuple(row) for row in np.asarray(array).tolist()}


def edge_places(vertices, edges):
    return {tuple(sorted((tuple(vertices[a]), tuple(vertices[b])))) for a, b in edges.tolist()}


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    size=st.floats(0.4, 2.0),
    log_deviation=st.floats(-2.5, 0.3),
    share_frozen=st.sampled_from([0.0, 0.0, 0.2]),
    share_missing=st.sampled_from([0.0, 0.0, 0.1]),
)
@example(seed=50, size=1.0, log_deviation=-0.2, share_frozen=0.0, share_missing=0.1)  # new edges at pinched vertices
@example(seed=682, size=1.0, log_deviation=-0.6, share_frozen=0.0, share_missing=0.1)
def test_nothing_gets_worse(seed, size, log_deviation, share_frozen, share_missing):
    vertices, faces = random_surface(seed)
    rng = np.random.default_rng(seed + 1)
    frozen = rng.random(len(vertices)) < share_frozen
    faces = faces[rng.random(len(faces)) >= share_missing]
    before, quality_before = measure(vertices, faces)
    contacts = n_contacts(vertices, faces)
    size = size * before.edge_length_mean
    remesher = Remesher(
        vertices,
        faces,
        sizes=size,
        deviation=10**log_deviation,
        min_edge=0.05 * size,
        edge_floor=0.05 * size,
        frozen=frozen,
        max_triangles=4000,
    )
    remesher.run(3)
    # (Offsets that restore the volume know no floor for edges.)
    shortest = measure(*remesher.result())[0].edge_length_min
    assert shortest >= min(0.05 * size, before.edge_length_min) * (1 - 1e-12)
    remesher.restore_volume()
    new_vertices, new_faces = remesher.result()
    after, quality_after = measure(new_vertices, new_faces)

    assert n_contacts(new_vertices, new_faces) <= contacts
    assert (new_vertices.astype(np.float32) == new_vertices).all()
    assert after.n_referenced == len(new_vertices)
    assert len(quality_after.degenerate) <= len(quality_before.degenerate)
    assert after.euler == before.euler
    assert after.n_components == before.n_components
    if is_closed(before):
        assert is_closed(after)
    # What is frozen, or on an edge that is not sound, is where it was.
    for edges in ("boundary_edges", "nonmanifold_edges", "inconsistent_edges"):
        assert edge_places(new_vertices, getattr(after, edges)) == edge_places(vertices, getattr(before, edges))
    assert len(after.duplicate_faces) <= len(before.duplicate_faces)
    used = np.zeros(len(vertices), bool)
    used[faces.ravel()] = True
    assert rows(vertices[frozen & used]) <= rows(new_vertices)


@pytest.mark.parametrize("gap", [0.5, 0.02, 0.001])
def test_walls_nearer_than_the_deviation_do_not_touch(gap):
    """Two wavy sheets, one just above the other: with this deviation each could be flattened through the other."""
    n = 14
    x, y = np.meshgrid(np.arange(n, dtype=float), np.arange(n, dtype=float), indexing="ij")
    z = 0.6 * np.sin(1.3 * x) * np.cos(1.1 * y)
    at = np.arange(n * n).reshape(n, n)
    quads = np.stack([at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]], -1).reshape(-1, 4)
    sheet = np.vstack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    lower = single(np.stack([x, y, z], -1).reshape(-1, 3))
    upper = single(lower + np.array([0, 0, gap]))
    vertices, faces = np.vstack([lower, upper]), np.vstack([sheet, sheet[:, ::-1] + n * n])
    assert n_contacts(vertices, faces) == 0
    remesher = Remesher(vertices, faces, sizes=2.5, deviation=1.0)
    counts = remesher.run()
    assert counts.refused_contact > 0
    assert counts.collapses > 20
    assert n_contacts(*remesher.result()) == 0


def test_topology_survives_wanted_lengths_larger_than_the_body():
    """A ring with a triangle for a cross-section: every edge around it would cut it through."""
    rings, sides = 24, 3
    around, across = np.arange(rings) * 2 * np.pi / rings, np.arange(sides) * 2 * np.pi / sides
    radius = 10 + np.cos(across)[None, :]
    vertices = np.stack(
        [radius * np.cos(around)[:, None], radius * np.sin(around)[:, None], np.tile(np.sin(across), (rings, 1))], -1
    ).reshape(-1, 3)
    faces = []
    for i in range(rings):
        for k in range(sides):
            p, q = i * sides + k, i * sides + (k + 1) % sides
            r, s = (i + 1) % rings * sides + k, (i + 1) % rings * sides + (k + 1) % sides
            faces += [(p, r, q), (q, r, s)]
    vertices, faces = single(vertices), np.array(faces)
    assert_valid(vertices, faces)
    remesher = Remesher(vertices, faces, sizes=100.0, deviation=20.0, min_edge=5.0, floor=0.0)
    remesher.run()
    remesher.collapse(1e3, least_quality=0.0, longest=1e3)
    vertices, faces = remesher.result()
    topology, _ = assert_valid(vertices, faces)
    assert topology.euler == 0
    assert remesher.counts.collapses > 10
    assert remesher.counts.refused_topology > 0


@pytest.mark.parametrize("mesh", [sphere(1, subdivisions=0), box(upper=(1, 1, 1))])
def test_smallest_solids_survive(mesh):
    remesher = Remesher(mesh.vertices, mesh.faces, sizes=50.0, deviation=10.0, min_edge=20.0, floor=0.0)
    remesher.run()
    for _ in range(5):
        remesher.collapse(1e3, least_quality=0.0, longest=1e3)
    topology, _ = assert_valid(*remesher.result())
    assert topology.euler == 2
    assert remesher.n_triangles >= 4


def test_a_spike_is_not_lost():
    """The surface without it would be within the envelope; only the reference would not be."""
    mesh = sphere(10, subdivisions=3)
    vertices = mesh.vertices.copy()
    tip = int(np.argmax(vertices[:, 2]))
    vertices[tip] *= 1.5
    vertices = single(vertices)
    remesher = Remesher(vertices, mesh.faces, sizes=4.0, deviation=0.3, floor=0.0)
    counts = remesher.run()
    assert counts.refused_coverage > 0
    assert distances(vertices[[tip]], *remesher.result())[0] <= 0.3


@pytest.mark.parametrize("size", [2.0, 4.0, 8.0])
@pytest.mark.parametrize("deviation", [0.3, 1.0])
def test_edges_are_not_folded(size, deviation):
    """A lens 0.1 mm thick: the larger the triangles, the sharper its rim."""
    mesh = sphere(10, subdivisions=3)
    vertices = single(mesh.vertices * [1, 1, 0.005])
    remesher = Remesher(vertices, mesh.faces, sizes=size, deviation=deviation, floor=0.0)
    remesher.run()
    remesher.collapse(3, least_quality=0.0, longest=9)
    vertices, faces = remesher.result()
    topology, _ = assert_valid(vertices, faces)
    angles = surface.dihedral_angles(vertices, faces, topology.inner_edges, topology.inner_edge_faces)
    assert len(faces) < 0.2 * len(mesh.faces)
    assert 0.5 - 1e-6 <= angles.min() < 1


def test_a_surface_outside_the_envelope_is_left_alone():
    inner, outer = sphere(10, subdivisions=3), sphere(10.5, subdivisions=3)
    remesher = Remesher(
        outer.vertices,
        outer.faces,
        sizes=3.0,
        reference=(inner.vertices, inner.faces),
        reference_sizes=3.0,
        deviation=0.2,
    )
    counts = remesher.run()
    assert counts.collapses == counts.flips == counts.relocations == 0
    assert counts.refused_envelope > 100


def test_nothing_happens_among_frozen_vertices():
    mesh = sphere(10, subdivisions=3)
    given_vertices = single(mesh.vertices * [4, 1, 1])
    for share in (1.0, 0.0):
        frozen = np.full(len(given_vertices), share > 0)
        remesher = Remesher(given_vertices, mesh.faces, sizes=1.0, deviation=1.0, frozen=frozen)
        remesher.run()
        remesher.restore_volume()
        vertices, faces = remesher.result()
        if share:
            np.testing.assert_array_equal(vertices, given_vertices)
            np.testing.assert_array_equal(faces, mesh.faces)
    assert remesher.counts.flips > 50  # of the same mesh, not frozen


def test_contacts_of_the_input_are_not_multiplied():
    mesh = joined(sphere(10, subdivisions=2), moved(sphere(10, subdivisions=2), (12, 1, 0)))
    vertices = single(mesh.vertices)
    before = n_contacts(vertices, mesh.faces)
    assert before > 50
    remesher = Remesher(vertices, mesh.faces, sizes=1.0, deviation=0.3)
    counts = remesher.run()
    vertices, faces = remesher.result()
    assert counts.collapses > 100
    assert is_closed(measure(vertices, faces)[0])
    assert n_contacts(vertices, faces) <= before


def test_frozen_vertices_and_the_edges_between_them_stay():
    mesh = sphere(10, subdivisions=3)
    frozen = np.abs(mesh.vertices[:, 2]) < 1.5
    topology, _ = measure(mesh.vertices, mesh.faces)
    kept = topology.inner_edges[frozen[topology.inner_edges].all(axis=1)]
    remesher = Remesher(mesh.vertices, mesh.faces, sizes=3.0, deviation=0.5, frozen=frozen)
    remesher.run()
    remesher.restore_volume()
    vertices, faces = remesher.result()
    after, _ = assert_valid(vertices, faces)
    assert len(kept) > 50
    assert rows(mesh.vertices[frozen]) <= rows(vertices)
    assert edge_places(mesh.vertices, kept) <= edge_places(vertices, after.inner_edges)
    assert len(faces) < 0.5 * len(mesh.faces)


def test_the_rim_of_an_open_surface_stays():
    mesh = sphere(10, subdivisions=3)
    open_faces = mesh.faces[mesh.vertices[mesh.faces][:, :, 2].max(axis=1) < 4]
    before, _ = measure(mesh.vertices, open_faces)
    remesher = Remesher(mesh.vertices, open_faces, sizes=0.7, deviation=0.1)
    remesher.run()
    assert np.isnan(remesher.volumes()[0]).all()
    assert remesher.restore_volume() == 0
    vertices, faces = remesher.result()
    after, quality = measure(vertices, faces)
    assert len(before.boundary_edges) > 20
    assert edge_places(vertices, after.boundary_edges) == edge_places(mesh.vertices, before.boundary_edges)
    assert not len(after.nonmanifold_edges)
    assert not len(after.nonmanifold_vertices)
    assert n_contacts(vertices, faces) == 0
    assert quality.q.mean() > 0.9


def test_inward_surfaces_are_treated_alike():
    mesh = tube(radius=1, length=40, rings=20)
    results = []
    for solid in (mesh, flipped(mesh)):
        remesher = Remesher(solid.vertices, solid.faces, sizes=0.6, deviation=0.05)
        remesher.run()
        remesher.restore_volume()
        results.append(assert_valid(*remesher.result())[1])
    assert results[0].volume > 0 > results[1].volume
    assert results[1].volume == pytest.approx(-results[0].volume, rel=1e-3)


def test_vertices_with_hundreds_of_faces():
    """More than the remesher moves at once: they stay until flips have thinned them out."""
    sides = 700
    angle = np.arange(sides) * 2 * np.pi / sides
    rim = np.column_stack([10 * np.cos(angle), 10 * np.sin(angle), np.zeros(sides)])
    vertices = single(np.vstack([rim, [0, 0, 5], [0, 0, -5]]))
    here, there = np.arange(sides), (np.arange(sides) + 1) % sides
    faces = np.vstack(
        [
            np.column_stack([here, there, np.full(sides, sides)]),
            np.column_stack([there, here, np.full(sides, sides + 1)]),
        ]
    )
    before = assert_valid(vertices, faces)[1]
    remesher = Remesher(vertices, faces, sizes=1.5, deviation=0.1)
    remesher.run()
    remesher.restore_volume()
    _, quality = assert_valid(*remesher.result())
    assert before.q.min() < 0.05
    assert quality.q.min() > 0.3
    assert quality.volume == pytest.approx(before.volume, rel=1e-3)


def test_large_triangles_beside_small_ones():
    """A block of 100 mm with a knob of triangles of 0.1 mm on one face, joined through a fan."""
    block, knob = box(upper=(100, 100, 100)), sphere(0.5, subdivisions=3)
    mesh = joined(block, moved(knob, (50, 50, 100.75)))
    mesh_vertices = single(mesh.vertices)
    remesher = Remesher(mesh_vertices, mesh.faces, sizes=np.r_[np.full(8, 20.0), np.full(len(knob.vertices), 0.1)],
                        deviation=0.1)  # fmt: skip
    remesher.run()
    vertices, faces = remesher.result()
    topology, quality = assert_valid(vertices, faces)
    assert topology.n_components == 2
    assert quality.q.min() > 0.4
