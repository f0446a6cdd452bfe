from __future__ import annotations

import hashlib
import itertools
import subprocess
import sys

import numpy as np
import pytest
from exact import Distances, components, directed_edges, is_closed_and_oriented, quality, shortest_edge, volume, winding
from hypothesis import example, given
from hypothesis import strategies as st

from vhp_cli.errors import UsageError
from vhp_cli.phantom import generate
from vhp_cli.phantom.curves import monotone_curve, smooth_path
from vhp_cli.phantom.shapes import tube
from vhp_cli.phantom.triangles import flip_edges, sew, triangle_quality

MIN_GAP = 1.02
SHELLS = ["skin", "fat", "average_body"]
# What encloses the further tissues; all else lies in the average body and in nothing else.
ENCLOSED = {
    "bronchus": "lung",
    "pulmonary": "lung",
    "heart_": "heart",
    "hepatic_vein": "liver",
    "portal_vein": "liver",
    "renal_pelvis": "kidney",
}
SIZES = [(60_000, 60), (100_000, None), (100_000, 250), (300_000, None), (1_000_000, 60), (1_000_000, 250)]


def digest(tissues):
    total = hashlib.sha256()
    for name, mesh in tissues.items():
        total.update(name.encode() + mesh.vertices.tobytes() + mesh.faces.tobytes())
    return total.hexdigest()


def check_shapes(tissues):
    for name, mesh in tissues.items():
        edges = directed_edges(mesh.faces)
        assert is_closed_and_oriented(mesh.faces), name
        assert components(len(mesh.vertices), edges) == 1, name
        # One component with the Euler number of a sphere: also no pinched vertex.
        assert len(mesh.vertices) - len(edges) // 2 + len(mesh.faces) == 2, name
        assert len(np.unique(mesh.vertices, axis=0)) == len(mesh.vertices), name
        assert volume(mesh) > 0, name
        assert np.array_equal(mesh.vertices, mesh.vertices.astype(np.float32)), name
        q = quality(mesh)
        assert q.min() >= 0.3 and q.mean() > 0.53, (name, q.min(), q.mean())
        assert shortest_edge(mesh) > 0.05, name


def check_gaps(tissues):
    distances = Distances(tissues)
    close = {
        (a, b): distances.gap(a, b) for a, b in itertools.combinations(tissues, 2) if distances.near(a, b, MIN_GAP)
    }
    assert close
    assert {pair: gap for pair, gap in close.items() if gap < MIN_GAP} == {}


def container(name):
    """The smallest tissue that should enclose another one."""
    if name in SHELLS:
        return SHELLS[SHELLS.index(name) - 1] if name != "skin" else None
    for prefix, organ in ENCLOSED.items():
        if name.startswith(prefix):
            sides = [side for side in ("left", "right") if side in name and organ in ("lung", "kidney")]
            return "_".join([organ, *sides])
    return "average_body"


def check_nesting(tissues):
    for name, mesh in tissues.items():
        point = mesh.vertices[0]
        around = {
            other
            for other, body in tissues.items()
            if other != name
            and (body.vertices.min(axis=0) < point).all()
            and (body.vertices.max(axis=0) > point).all()
            and round(winding(body, point)) == 1
        }
        expected, outer = set(), container(name)
        while outer is not None:
            expected.add(outer)
            outer = container(outer)
        assert around == expected, name


@pytest.fixture(scope="module")
def small():
    return generate(20_000)


def test_surfaces_are_sound(small):
    check_shapes(small)


def test_gaps(small):
    check_gaps(small)


def test_nesting(small):
    check_nesting(small)


def test_further_tissues_are_sound_and_nested():
    tissues = generate(60_000, 250)
    assert len(tissues) == 250
    check_shapes(tissues)
    check_gaps(tissues)
    check_nesting(tissues)


@pytest.mark.slow
@pytest.mark.parametrize(("triangles", "number"), SIZES)
def test_other_sizes(triangles, number):
    tissues = generate(triangles, number)
    assert sum(len(mesh.faces) for mesh in tissues.values()) == pytest.approx(triangles, rel=0.1)
    check_shapes(tissues)
    check_gaps(tissues)


@pytest.mark.slow
def test_all_tissues_keep_their_distance_at_many_sizes():
    for triangles in np.geomspace(45_000, 500_000, 4).astype(int):
        tissues = generate(int(triangles), 282)
        check_shapes(tissues)
        check_gaps(tissues)
        check_nesting(tissues)


def test_tissues_and_their_places(small):
    names = list(small)
    assert 85 <= len(names) <= 110
    assert names[:3] == SHELLS
    for side, sign in (("left", 1), ("right", -1)):
        for stem in (
            *(f"rib_{{}}_{k:02d}" for k in range(1, 13)),
            *(f"costal_cartilage_{{}}_{k:02d}" for k in range(1, 11)),
            *("lung_{}", "kidney_{}", "pectoralis_major_{}", "rectus_abdominis_{}", "erector_spinae_{}"),
            *("phrenic_nerve_{}", "vagus_nerve_{}", "internal_thoracic_artery_{}"),
        ):
            assert (sign * small[stem.format(side)].vertices[:, 0] > 0).all(), stem
    middle = {name: 0.5 * (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) for name, mesh in small.items()}
    # LPS: left is +x, back is +y, up is +z.
    assert middle["liver"][0] < 0 < middle["spleen"][0] and middle["stomach"][0] > 0 and middle["heart"][0] > 0
    assert middle["sternum"][1] < middle["heart"][1] < middle["vertebra_t07"][1]
    levels = [middle[f"vertebra_t{k:02d}"][2] for k in range(1, 13)]
    assert (np.diff(levels) < 0).all()
    assert small["diaphragm"].vertices[:, 2].max() < small["lung_left"].vertices[:, 2].max()
    litres = sum(volume(small[f"lung_{side}"]) for side in ("left", "right")) / 1e6
    fine = sum(volume(generate(100_000, 6)[f"lung_{side}"]) for side in ("left", "right")) / 1e6
    assert 3.6 < litres < fine < 5.0 and fine > 4.0
    for side in ("left", "right"):
        assert 200 < np.ptp(small[f"lung_{side}"].vertices[:, 2]) < 260


def test_ribs_slope_down_from_their_heads_to_the_front(small):
    for k in range(1, 13):
        points = small[f"rib_left_{k:02d}"].vertices
        behind = points[points[:, 1] > points[:, 1].mean()] if k < 11 else points
        head = behind[np.argmin(behind[:, 0])]
        tip = points[np.argmin(points[:, 1])] if k < 11 else points[np.argmax(points[:, 0])]
        spine = small[f"vertebra_t{k:02d}"].vertices
        assert 1.02 < head[0] - spine[:, 0].max() < 8 and abs(head[2] - spine[:, 2].mean()) < 10, k
        assert head[2] - tip[2] > 20, k


def test_thin_nerves_stay_round(small):
    for name in ("phrenic_nerve_left", "vagus_nerve_right"):
        mesh = small[name]
        corners = mesh.vertices[mesh.faces]
        area = (
            0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
        )
        # volume / area of a long round rod is radius / 2; of one with six sides 0.43 radii.
        assert 0.41 < volume(mesh) / area < 0.5


@pytest.mark.parametrize("triangles", [20_000, 33_333, 100_000])
def test_number_of_triangles(triangles):
    assert sum(len(mesh.faces) for mesh in generate(triangles).values()) == pytest.approx(triangles, rel=0.1)


def test_few_tissues_are_the_most_important_ones_in_the_same_order(small):
    few = list(generate(20_000, 40))
    assert len(few) == 40
    assert {"skin", "lung_left", "lung_right", "rib_left_05", "heart", "liver"} <= set(few)
    assert [name for name in small if name in few] == few


def test_impossible_wishes_are_refused():
    with pytest.raises(UsageError, match="1 to 282"):
        generate(100_000, 283)
    with pytest.raises(UsageError):
        generate(100_000, 0)
    with pytest.raises(UsageError, match="need at least"):
        generate(5_000)


def test_the_same_bytes_every_time(small):
    assert digest(generate(20_000)) == digest(small)
    code = (
        "import sys; sys.path.insert(0, 'tests/phantom'); from test_torso import digest;"
        "from vhp_cli.phantom import generate; print(digest(generate(20_000)))"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == digest(small)


@given(st.lists(st.integers(3, 30), min_size=2, max_size=8), st.integers(0, 1))
def test_sewn_rings_are_closed(counts, first):
    numbers = np.array([1, *counts, 1])
    faces = sew(numbers, 0.5 * ((np.arange(len(numbers)) + first) % 2))
    assert len(faces) == 2 * sum(counts)
    edges = directed_edges(faces)
    back = {(b, a) for a, b in edges.tolist()}
    assert {tuple(edge) for edge in edges.tolist()} == back
    assert numbers.sum() - len(edges) // 2 + len(faces) == 2


@given(st.lists(st.floats(-50, 50), min_size=3, max_size=8))
@example([0.0, 1.1125369292536007e-308, 1.0])
def test_monotone_curves_stay_between_neighbouring_knots(values):
    knots = np.arange(len(values), dtype=float)
    curve = monotone_curve(knots, np.array(values))
    assert curve(knots) == pytest.approx(values, abs=1e-9)
    for i, (a, b) in enumerate(itertools.pairwise(values)):
        between = curve(np.linspace(i, i + 1, 21))
        assert (between >= min(a, b) - 1e-9).all() and (between <= max(a, b) + 1e-9).all()
        assert (np.diff(between) * np.sign(b - a) >= -1e-9).all()


def test_smooth_path_meets_its_points_at_even_steps():
    points = np.array([[0, 0, 0], [10, 5, 0], [20, 0, 8], [30, -5, 0.0]])
    path = smooth_path(points, 301)
    for point in points:
        assert np.linalg.norm(path - point, axis=1).min() < 0.15
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    assert steps.max() / steps.min() < 1.01


def test_volume_of_a_fine_tube():
    from vhp_cli.mesh import Mesh

    surface = tube(np.array([[0, 0, 0], [0, 0, 50], [0, 0, 100.0]]), 5.0)
    mesh = Mesh(*surface.mesh(surface.plan(0.7)))
    assert volume(mesh) == pytest.approx(np.pi * 25 * 100 + 4 / 3 * np.pi * 125, rel=0.01)


def test_flips_improve_and_keep_the_surface_closed():
    surface = tube(np.array([[0, 0, 0], [0, 3, 50], [0, 0, 100.0]]), 9.0)
    vertices, faces = surface.mesh(surface.plan(3.0))
    moved = vertices + np.random.default_rng(1).normal(size=vertices.shape) * 0.4
    flipped = flip_edges(moved, faces)
    assert is_closed_and_oriented(flipped)
    assert not np.array_equal(flipped, faces)
    assert triangle_quality(moved[flipped]).min() >= triangle_quality(moved[faces]).min()
