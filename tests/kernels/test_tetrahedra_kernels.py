"""Tetrahedra bettered by the kernels."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tetrahedron_grids import grid

from vhp_cli.inspection.adjacency import adjacency
from vhp_cli.kernels.tetrahedra import Target, advance, equal_faces, relax, shape
from vhp_cli.volume import volumes

TARGET, UNUSED = Target(14.0, 0.4), Target(1.0, 0.01)


def shake(seed, scale, cells=4):
    """Return a grid with inner points out of place, a label on either side of a plane, and what the kernel asks for."""
    points, tetrahedra = grid(cells, float(cells))
    hull = np.unique(adjacency(tetrahedra).hull)
    inner = np.setdiff1d(np.arange(len(points)), hull)
    on_plane = points[:, 0] == cells // 2
    moved = points.copy()
    moved[inner] += np.random.default_rng(seed).uniform(-scale, scale, (len(inner), 3))
    moved[on_plane, 0] = cells // 2
    labels = (points[tetrahedra].mean(axis=1)[:, 0] > cells // 2).astype(np.int32)
    normals = np.where(on_plane[:, None], [1.0, 0, 0], 0.0)
    fixed = np.isin(np.arange(len(points)), hull)
    options = {"fixed": fixed, "border": on_plane, "normals": normals, "leash_mm": np.where(on_plane, 1e-9, -1.0)}
    return moved, tetrahedra, labels, options


def bettered(points, tetrahedra, labels, options, **others):
    used = np.ones(len(tetrahedra), np.bool_)
    return relax(
        points, tetrahedra, labels, used, **{"target": TARGET, "unused": UNUSED, "rounds": 20, **options, **others}
    )


def least_share(points, tetrahedra):
    volume, ratio, angle, *_ = shape(points, tetrahedra)
    share = np.minimum(angle / TARGET.min_dihedral_deg, ratio / TARGET.radius_ratio)
    return np.where(volume > 0, share, -1).min()


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([0.2, 0.35, 0.45]))
def test_what_comes_out_fills_the_same_space_and_is_no_worse(seed, scale):
    points, tetrahedra, labels, options = shake(seed, scale)
    made = bettered(points, tetrahedra, labels, options)
    if volumes(points, tetrahedra).min() <= 0:
        return
    sizes = volumes(made.points, made.tetrahedra)
    assert sizes.min() > 0 and sizes.sum() == pytest.approx(64)
    joined = adjacency(made.tetrahedra)
    assert joined.overfull == 0 and not len(joined.folded) and len(joined.hull) == 12 * 16
    # Both sides of the plane keep what they had.
    for label in (0, 1):
        assert sizes[made.labels == label].sum() == pytest.approx(32, abs=1e-6)
    assert least_share(made.points, made.tetrahedra) >= min(least_share(points, tetrahedra), 1)
    assert (made.points[options["fixed"]] == points[options["fixed"]]).all()


def test_the_same_input_gives_the_same_bytes():
    case = shake(3, 0.4)
    one, other = bettered(*case), bettered(*case)
    assert one.points.tobytes() == other.points.tobytes()
    assert one.tetrahedra.tobytes() == other.tetrahedra.tobytes() and min(one.swaps, one.moves) > 5


def flat_one(height):
    """Return a flat tetrahedron that has two faces on an interface, two tetrahedra above it, and two below."""
    points = np.array([[0, 0, 0], [2, 0, 0], [1, 1, height], [1, -1, height], [0, 0, 1], [1, 0, -1.0], [2, 0, 1]])
    tetrahedra = np.array([[0, 1, 2, 3], [0, 2, 3, 4], [1, 3, 2, 6], [0, 2, 1, 5], [0, 1, 3, 5]], np.int32)
    sizes = volumes(points, tetrahedra)
    tetrahedra[sizes < 0] = tetrahedra[sizes < 0][:, [0, 2, 1, 3]]
    return points, tetrahedra, np.array([7, 7, 7, 4, 4], np.int32)


@pytest.mark.parametrize(("leash", "swaps"), [(0.02, 1), (0.005, 0), (-1.0, 0)])
def test_a_flat_tetrahedron_on_an_interface_goes_to_the_other_side_within_the_leash(leash, swaps):
    points, tetrahedra, labels = flat_one(0.01)
    made = bettered(
        points, tetrahedra, labels,
        {
            "fixed": np.array([0, 0, 0, 0, 1, 1, 1], np.bool_), "border": np.array([1, 1, 1, 1, 0, 0, 0], np.bool_),
            "normals": np.zeros((7, 3)), "leash_mm": np.full(7, leash),
        },
        rounds=1, target=Target(5.0, 0.05),
    )  # fmt: skip
    assert made.swaps == swaps
    if swaps:
        assert sorted(made.labels) == [4, 4, 7, 7]
        edges = {frozenset((int(a), int(b))) for row in made.tetrahedra for a in row for b in row if a != b}
        assert frozenset((0, 1)) not in edges and frozenset((2, 3)) in edges
        assert volumes(made.points, made.tetrahedra).sum() == pytest.approx(volumes(points, tetrahedra).sum())


@pytest.mark.parametrize("owner", [4, 9])
def test_it_stays_where_that_would_pinch_or_mix_labels(owner):
    """What lies beside it belongs to others: it is all that joins, or parts them."""
    points, tetrahedra, labels = flat_one(0.01)
    labels[1] = owner
    made = bettered(
        points, tetrahedra, labels,
        {
            "fixed": np.array([0, 0, 0, 0, 1, 1, 1], np.bool_), "border": np.ones(7, np.bool_),
            "normals": np.zeros((7, 3)), "leash_mm": np.full(7, 0.02),
        },
        rounds=1,
    )  # fmt: skip
    assert made.swaps == 0


def test_points_advance_as_far_as_tetrahedra_allow():
    points, tetrahedra = grid(2, 2.0)
    used = np.ones(len(tetrahedra), np.bool_)
    middle = np.flatnonzero((points == 1).all(axis=1)).astype(np.int32)
    for way, part in (((0.1, 0, 0), 1), ((1.3, 0, 0), 0.5), ((9.0, 0, 0), 0.0), ((3.0, 0, 0), 0.25)):
        made, parts = advance(
            points, tetrahedra, used, target=Target(0, 0), unused=UNUSED, moving=middle, ways=np.array([way])
        )
        assert parts.tolist() == [part]
        assert made[middle[0]] == pytest.approx(points[middle[0]] + part * np.array(way))
        assert np.delete(made, middle, axis=0).tobytes() == np.delete(points, middle, axis=0).tobytes()
    # Unused tetrahedra may become much worse, used ones only as bad as the target.
    way = np.array([(0.9, 0, 0)])
    strict = {"target": Target(20.0, 0.4), "unused": UNUSED, "moving": middle, "ways": way}
    assert advance(points, tetrahedra, used, **strict)[1] < 1
    assert advance(points, tetrahedra, ~used, **strict)[1] == 1


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 60), st.integers(4, 30))
def test_equal_faces_are_found_by_sorting(seed, count, points):
    """Also in a heap of tetrahedra that is no mesh at all."""
    rng = np.random.default_rng(seed)
    tetrahedra = np.array([rng.choice(points, 4, replace=False) for _ in range(count)], np.int32)
    faces = np.sort(tetrahedra[:, [(1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)]].reshape(-1, 3), axis=1)
    order, equal = equal_faces(tetrahedra)
    assert order.tolist() == np.lexsort((*faces.T[::-1],)).tolist()
    ordered = faces[order]
    assert not equal[0] and equal[1:].tolist() == (ordered[1:] == ordered[:-1]).all(axis=1).tolist()


def test_nothing_at_all():
    nothing = np.empty((0, 3)), np.empty((0, 4), np.int32)
    none = np.empty(0, np.bool_)
    made = relax(
        *nothing, np.empty(0, np.int32), none, target=TARGET, unused=UNUSED, fixed=none, border=none,
        normals=np.empty((0, 3)), leash_mm=np.empty(0), rounds=3,
    )  # fmt: skip
    assert made.tetrahedra.shape == (0, 4) and made.points.shape == (0, 3)
    assert [len(column) for column in shape(*nothing)] == [0] * 6
    assert [len(column) for column in equal_faces(nothing[1])] == [0, 0]


def test_what_makes_no_sense_is_refused():
    points, tetrahedra, labels, options = shake(0, 0.1)
    with pytest.raises(ValueError, match="does not exist"):
        shape(points, tetrahedra + len(points))
    with pytest.raises(ValueError, match="shapes"):
        bettered(points, tetrahedra, labels[1:], options)
    with pytest.raises(ValueError, match="does not exist"):
        advance(
            points, tetrahedra, np.ones(len(tetrahedra), np.bool_), target=TARGET, unused=UNUSED,
            moving=np.array([len(points)]), ways=np.zeros((1, 3)),
        )  # fmt: skip
