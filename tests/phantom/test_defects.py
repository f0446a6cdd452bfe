from __future__ import annotations

import itertools
import json

import numpy as np
import pytest
from click.testing import CliRunner
from exact import (
    Distances,
    cross,
    crossings,
    directed_edges,
    edge_uses,
    faces_near,
    fans,
    is_closed_and_oriented,
    minus,
    quality,
    rational,
    reread,
    segment_pierces,
    shortest_edge,
    side,
    strictly_inside,
    volume,
)

from vhp_cli.commands.phantom import phantom
from vhp_cli.phantom import generate, plant_defects, plant_file_defects
from vhp_cli.phantom.defects import RULES
from vhp_cli.phantom.file_defects import FILE_PLANTS

SEEDS = range(8)


@pytest.fixture(scope="module")
def sound():
    return generate(20_000)


@pytest.fixture(scope="module")
def planted(sound):
    """Every kind of defect once, for a few seeds: (model, list)."""
    return [plant_defects(sound, seed, len(RULES)) for seed in SEEDS]


def cases(planted, rule):
    """The planted defects of one kind, with their surfaces as a file would give them."""
    found = [
        (one, [reread(model[name]) for name in one.tissues], np.array(one.xyz_mm))
        for model, listed in planted
        for one in listed
        if one.rule == rule
    ]
    assert len(found) == len(SEEDS)
    return found


def near(points, place, reach=1e-3):
    return bool((np.linalg.norm(np.atleast_2d(points) - place, axis=1) < reach).any())


def pairs_of_faces(mesh, place, reach=0.5):
    """Pairs of faces near a place: the vertices they share, and their corners as fractions."""
    close = faces_near(mesh, place, reach)
    corners = {face: rational(mesh.vertices[mesh.faces[face]]) for face in close}
    for f, g in itertools.combinations(close, 2):
        yield set(mesh.faces[f]) & set(mesh.faces[g]), corners[f], corners[g]


def test_holes(planted):
    for _, (mesh,), place in cases(planted, "T001"):
        edges, uses = edge_uses(mesh.faces)
        rim = edges[uses == 1]
        assert len(rim) >= 3 and (uses <= 2).all()
        assert near(mesh.vertices[rim].mean(axis=(0, 1)), place)


def test_nonmanifold_edges(planted):
    for _, (mesh,), place in cases(planted, "T002"):
        edges, uses = edge_uses(mesh.faces)
        assert sorted(set(uses)) == [2, 4]
        assert near(mesh.vertices[edges[uses == 4]].mean(axis=1), place)


def test_nonmanifold_vertices(planted):
    for _, (mesh,), place in cases(planted, "T003"):
        _, uses = edge_uses(mesh.faces)
        assert (uses == 2).all()
        vertex = int(np.argmin(np.linalg.norm(mesh.vertices - place, axis=1)))
        assert near(mesh.vertices[vertex], place)
        assert fans(mesh.faces, vertex) == 2


def test_flipped_faces(planted):
    for _, (mesh,), place in cases(planted, "T004"):
        _, uses = edge_uses(mesh.faces)
        assert (uses == 2).all()
        edges, times = np.unique(directed_edges(mesh.faces), axis=0, return_counts=True)
        assert (times == 2).sum() == 3
        assert near(mesh.vertices[edges[times == 2]].mean(axis=1), place)


def test_inside_out(planted):
    for _, (mesh,), _ in cases(planted, "T005"):
        assert is_closed_and_oriented(mesh.faces) and volume(mesh) < 0


def test_duplicate_faces(planted):
    for _, (mesh,), place in cases(planted, "T006"):
        faces, times = np.unique(np.sort(mesh.faces, axis=1), axis=0, return_counts=True)
        assert (times == 2).sum() == 1
        assert near(mesh.vertices[faces[times == 2]].mean(axis=1), place)


def test_self_crossings(planted):
    notes = set()
    for one, (mesh,), place in cases(planted, "X001"):
        assert any(
            not shared
            and any(segment_pierces(p[k], p[k - 1], q) or segment_pierces(q[k], q[k - 1], p) for k in range(3))
            for shared, p, q in pairs_of_faces(mesh, place)
        )
        assert is_closed_and_oriented(mesh.faces)
        notes.add(one.note.split()[0])
    assert notes == {"pulled", "added"}


def test_coplanar_overlaps(planted):
    for _, (mesh,), place in cases(planted, "X002"):
        # Three corners in the plane and the inside of another face.
        assert any(
            not shared and (all(strictly_inside(c, q) for c in p) or all(strictly_inside(c, p) for c in q))
            for shared, p, q in pairs_of_faces(mesh, place)
        )


def test_folds(planted):
    for _, (mesh,), place in cases(planted, "X003"):
        assert is_closed_and_oriented(mesh.faces)
        folded = 0
        for shared, p, q in pairs_of_faces(mesh, place):
            if len(shared) == 2 and side(*p, next(c for c in q if c not in p)) == 0:
                (c,), (d,) = [v for v in p if v not in q], [v for v in q if v not in p]
                a, b = (v for v in p if v in q)
                normals = [cross(minus(b, a), minus(v, a)) for v in (c, d)]
                folded += sum(x * y for x, y in zip(*normals, strict=True)) > 0
        assert folded == 1


def test_self_touches(planted):
    for _, (mesh,), place in cases(planted, "X004"):
        assert is_closed_and_oriented(mesh.faces)
        assert any(
            not shared and (any(strictly_inside(c, q) for c in p) or any(strictly_inside(c, p) for c in q))
            for shared, p, q in pairs_of_faces(mesh, place)
        )
        assert crossings(mesh, mesh, place) == 0


def test_slivers(planted):
    for _, (mesh,), place in cases(planted, "Q001"):
        q = quality(mesh)
        assert is_closed_and_oriented(mesh.faces)
        assert (q < 0.01).sum() == 1 and q.min() > 0 and shortest_edge(mesh) > 0.01
        assert near(mesh.vertices[mesh.faces[np.argmin(q)]].mean(axis=0), place, 0.2)


def test_short_edges(planted):
    for _, (mesh,), place in cases(planted, "Q002"):
        assert is_closed_and_oriented(mesh.faces)
        assert 0 < shortest_edge(mesh) < 0.01
        edges, _ = edge_uses(mesh.faces)
        ends = mesh.vertices[edges]
        short = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1) < 0.01
        assert short.sum() == 1 and near(ends[short].mean(axis=1), place, 0.01)


def test_zero_areas(planted):
    for _, (mesh,), place in cases(planted, "Q003"):
        assert is_closed_and_oriented(mesh.faces)
        flat = [
            face
            for face in faces_near(mesh, place, 0.1)
            for a, b, c in [rational(mesh.vertices[mesh.faces[face]])]
            if cross(minus(b, a), minus(c, a)) == [0, 0, 0]
        ]
        assert len(flat) == 1
        assert near(mesh.vertices[mesh.faces[flat[0]]].mean(axis=0), place)


def test_crossing_tissues(planted):
    for _, (a, b), place in cases(planted, "P001"):
        assert crossings(a, b, place) > 0


def shared_points(a, b):
    return {tuple(p) for p in a.vertices.tolist()} & {tuple(p) for p in b.vertices.tolist()}


def test_touching_tissues(planted):
    for _, (a, b), place in cases(planted, "P002"):
        shared = shared_points(a, b)
        assert len(shared) == 1 and near(list(shared), place)
        assert crossings(a, b, place, 2.0) == 0


def test_coincident_faces(planted):
    for _, (a, b), place in cases(planted, "P003"):
        shared = shared_points(a, b)
        assert len(shared) == 3 and near(np.mean(list(shared), axis=0), place)
        for mesh in (a, b):
            numbers = {i for i, p in enumerate(mesh.vertices.tolist()) if tuple(p) in shared}
            assert sum(set(row) == numbers for row in mesh.faces.tolist()) == 1
        assert crossings(a, b, place, 2.0) == 0


def test_identical_tissues(planted):
    for one, (a, b), _ in cases(planted, "P004"):
        assert one.tissues[1] == f"{one.tissues[0]}_copy"
        assert np.array_equal(a.vertices, b.vertices)
        assert sorted(map(sorted, a.faces.tolist())) == sorted(map(sorted, b.faces.tolist()))
        assert volume(b) > 0


def test_narrow_gaps(planted):
    for one, meshes, _ in cases(planted, "P005"):
        distances = Distances(dict(zip(one.tissues, meshes, strict=True)))
        assert distances.gap(*one.tissues) == pytest.approx(0.5, abs=1e-3)


def test_all_else_is_as_it_was(sound, planted):
    for model, listed in planted:
        spoilt = [name for one in listed for name in one.tissues]
        assert len(spoilt) == len(set(spoilt))
        changed = {name for name, mesh in model.items() if name not in sound or mesh is not sound[name]}
        assert changed <= set(spoilt)
        assert list(model)[: len(sound)] == list(sound)


def test_no_third_tissue_is_met(sound, planted):
    for model, listed in planted[:3]:
        distances = Distances(model)
        for one in listed:
            if one.rule in ("P004", "Q003"):
                continue  # a copy lies where the tissue lay
            for name, other in itertools.product(one.tissues, sound):
                if other not in one.tissues and distances.near(name, other, 1.02):
                    assert distances.gap(name, other) >= 1.02, (one, other)


def test_the_seed_decides(sound):
    first, again, other = (plant_defects(sound, seed)[1] for seed in (5, 5, 6))
    assert first == again != other
    assert len(plant_defects(sound, 5, 3)[1]) == 3
    assert all(8 <= len(plant_defects(sound, seed)[1]) <= 14 for seed in range(20))


def test_small_models_have_room_for_few_defects(sound):
    few = {name: sound[name] for name in ("aorta", "rib_left_03")}
    model, listed = plant_defects(few, 0, 10)
    assert 1 <= len(listed) <= 2
    assert {name for one in listed for name in one.tissues} <= set(model)
    assert plant_defects({}, 0) == ({}, [])


def test_file_defects(tmp_path, sound):
    from vhp_cli.formats import write_mesh

    names = ["sternum", "heart", "rib_left_03", "aorta"]
    rules = set()
    for seed in range(12):
        directory = tmp_path / str(seed)
        directory.mkdir()
        for name in names:
            write_mesh(directory / f"{name}.stl", sound[name])
        before = {name: (directory / f"{name}.stl").read_bytes() for name in names}
        listed = plant_file_defects(directory, seed, avoid=["heart"])
        assert 1 <= len(listed) <= 2
        after = {name: (directory / f"{name}.stl").read_bytes() for name in names}
        spoilt = {one.tissues[0] for one in listed}
        assert {name for name in names if before[name] != after[name]} == spoilt and "heart" not in spoilt
        for one in listed:
            data = after[one.tissues[0]]
            announced, held = int.from_bytes(data[80:84], "little"), divmod(len(data) - 84, 50)
            rules.add(one.rule)
            if one.rule == "F002":
                assert held[0] < announced and held[1]
            elif one.rule == "F003":
                assert held[0] < announced and not held[1]
            elif one.rule == "F005":
                assert announced == 0 and held == (0, 0)
            else:
                records = np.frombuffer(data, np.dtype([("xyz", "<f4", 12), ("attribute", "<u2")]), offset=84)
                assert one.rule == "F004" and np.isnan(records["xyz"]).sum() == 1 and held == (announced, 0)
    assert rules == set(FILE_PLANTS)


def run(*arguments):
    return CliRunner().invoke(phantom, [str(argument) for argument in arguments])


def test_command_writes_a_model(tmp_path):
    result = run(tmp_path / "m", "--triangles", 20_000, "--tissues", 30)
    assert result.exit_code == 0 and result.stdout == ""
    assert "wrote 30 tissues" in result.stderr
    files = sorted((tmp_path / "m").iterdir())
    assert len(files) == 30 and all(path.suffix == ".stl" for path in files)
    facets = sum((path.stat().st_size - 84) // 50 for path in files)
    assert facets == pytest.approx(20_000, rel=0.1)


def test_command_refuses_a_directory_in_use(tmp_path):
    from vhp_cli.errors import UsageError

    (tmp_path / "mine.txt").write_text("keep me")
    result = run(tmp_path, "--triangles", 20_000)
    assert isinstance(result.exception, UsageError) and "not empty" in str(result.exception)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]
    assert run(tmp_path, "--triangles", 20_000, "--tissues", 5, "--overwrite").exit_code == 0
    assert (tmp_path / "mine.txt").read_text() == "keep me"


def test_command_lists_what_it_planted(tmp_path):
    result = run(tmp_path / "a", "--triangles", 20_000, "--defects", 4)
    assert result.exit_code == 0
    record = json.loads((tmp_path / "a" / "planted.json").read_text())
    assert record["seed"] == 4 and len(record["planted"]) == len(result.stdout.splitlines()) >= 9
    for one in record["planted"]:
        assert set(one) == {"rule", "tissues", "xyz_mm", "note"}
        assert all((tmp_path / "a" / f"{name}.stl").exists() for name in one["tissues"])
    assert any(one["rule"].startswith("F") for one in record["planted"])
    run(tmp_path / "b", "--triangles", 20_000, "--defects", 4)
    for path in (tmp_path / "a").iterdir():
        assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes()


def test_command_writes_other_formats(tmp_path):
    assert run(tmp_path, "--triangles", 20_000, "--tissues", 4, "--format", "ply", "--defects", 1).exit_code == 0
    assert {path.suffix for path in tmp_path.iterdir()} == {".ply", ".json"}
    rules = [one["rule"] for one in json.loads((tmp_path / "planted.json").read_text())["planted"]]
    assert rules and not any(rule.startswith("F") for rule in rules)


def test_the_kinds_of_defects_can_be_chosen(tmp_path):
    arguments = ("--triangles", 20_000, "--defects", 4, "--defect-rules", "t,X001,F003")
    assert run(tmp_path / "a", *arguments).exit_code == 0
    found = {one["rule"] for one in json.loads((tmp_path / "a" / "planted.json").read_text())["planted"]}
    assert found == {"T001", "T002", "T003", "T004", "T005", "T006", "X001", "F003"}
    for wrong in (["--defect-rules", "T"], ["--defects", 1, "--defect-rules", "T,Z"]):
        assert run(tmp_path / "b", *wrong).exit_code != 0 and not (tmp_path / "b").exists()
