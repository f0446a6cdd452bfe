"""Tetrahedral mesh files, read back by libraries that did not write them."""

from __future__ import annotations

import contextlib
import importlib
import io
import itertools
import json
import re
import subprocess
import sys
import time
import tracemalloc

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from tetrahedron_grids import labelled_grid

from vhp_cli.errors import UsageError, VhpError
from vhp_cli.formats.volume import FORMS, check_form, write_volume, written_names
from vhp_cli.formats.volume.regions import FormatLimit, Naming, valid_names
from vhp_cli.volume import VolumeMesh, volumes

AIR_NUMBER = 5
NAMES = ("liver", 'Spleen "left"', "größe & <b>/\\", "empty")


@pytest.fixture
def mesh() -> VolumeMesh:
    """A mesh with air, with names that need care, and with a name that has no tetrahedra."""
    full = labelled_grid(NAMES[:3], air=True)
    return VolumeMesh(full.points, full.tetrahedra, full.labels, NAMES)


def numbers(mesh):
    return np.where(mesh.labels == 0, AIR_NUMBER, mesh.labels)


def written(mesh, form, tmp_path):
    path = tmp_path / f"mesh{FORMS[form].suffix}"
    return path, write_volume(path, mesh, form)


def need(module):
    if form_needs := {"med": "h5py"}.get(module):
        module = form_needs
    return pytest.importorskip(module, reason=f"{module} is not installed", exc_type=ImportError)


def meshio_reading(path):
    meshio = pytest.importorskip("meshio", reason="meshio is not installed")
    # It prints an empty line for Gmsh files.
    with contextlib.redirect_stdout(io.StringIO()):
        return meshio.read(path)


# With meshio


CELL_DATA = {
    "vtu": "label",
    "msh": "gmsh:physical",
    "msh22": "gmsh:physical",
    "bdf": "nastran:ref",
    "comsol": "nastran:ref",
    "med": "cell_tags",
    "xdmf": "label",
}
NAMED_IN_FIELD_DATA = ("vtu", "msh", "msh22", "xdmf")
GROUPED = ("msh", "inp")  # tetrahedra lie together by label


@pytest.mark.parametrize("form", [form for form in FORMS if form != "mat"])
def test_meshio_reads_the_same_mesh(mesh, form, tmp_path):
    need(form if form == "med" else "meshio")
    path, renamed = written(mesh, form, tmp_path)
    found = meshio_reading(path)
    exact = form not in ("bdf", "comsol")
    assert found.points == pytest.approx(mesh.points, abs=0 if exact else 1e-12, rel=0)
    order = np.argsort(numbers(mesh), kind="stable") if form in GROUPED else np.arange(len(mesh.labels))
    assert {block.type for block in found.cells} == {"tetra"}
    tetrahedra = np.concatenate([block.data for block in found.cells])
    # The first three corners run the other way round in MED.
    corners = [0, 2, 1, 3] if form == "med" else [0, 1, 2, 3]
    assert np.array_equal(tetrahedra[:, corners], mesh.tetrahedra[order])
    expected = {number: renamed.get(name, name) for number, name in [*enumerate(NAMES[:3], 1), (AIR_NUMBER, "air")]}
    assert written_names(mesh, form) == expected
    if form == "inp":
        sizes = {name: [len(part) for part in parts] for name, parts in found.cell_sets.items()}
        counts = [int((numbers(mesh) == number).sum()) for number in expected]
        assert sizes == {name: [n * (i == j) for j, n in enumerate(counts)] for i, name in enumerate(expected.values())}
        return
    labels = np.concatenate(found.cell_data[CELL_DATA[form]])
    assert np.array_equal(np.abs(labels), numbers(mesh)[order])
    if form in NAMED_IN_FIELD_DATA:
        assert {int(value[0]): name for name, value in found.field_data.items()} == expected
    elif form == "med":
        assert {-int(number): names for number, names in found.cell_tags.items()} == {
            number: [name] for number, name in expected.items()
        }
    else:
        text = path.read_text()
        assert all(f"$ PID {number} = {name}\n" in text for number, name in expected.items())


# With Gmsh, which wants a process of its own


GMSH = """
import gmsh, json, sys
gmsh.initialize()
gmsh.option.setNumber("General.Terminal", 0)
gmsh.open(sys.argv[1])
tags, points, _ = gmsh.model.mesh.getNodes()
order = tags.argsort()
groups = {}
for _, volume in gmsh.model.getEntities(3):
    (kind,), (elements,), (corners,) = gmsh.model.mesh.getElements(3, volume)
    assert kind == 4
    physical = gmsh.model.getPhysicalGroupsForEntity(3, volume)
    name = gmsh.model.getPhysicalName(3, physical[0]) if len(physical) else None
    groups[volume] = [name, elements.tolist(), corners.reshape(-1, 4).tolist()]
    assert min(gmsh.model.mesh.getElementQualities(elements, "minDetJac")) > 0
json.dump({"tags": tags[order].tolist(), "points": points.reshape(-1, 3)[order].tolist(), "groups": groups}, sys.stdout)
"""


@pytest.fixture(scope="module")
def gmsh():
    """Skip where Gmsh or a system library that it loads is missing."""
    done = subprocess.run(
        [sys.executable, "-c", "import gmsh"], capture_output=True, text=True, timeout=60, check=False
    )
    if done.returncode:
        pytest.skip(f"gmsh can't be imported: {done.stderr.strip().splitlines()[-1]}")


@pytest.mark.parametrize("form", ["msh", "msh22", "bdf", "comsol", "med"])
def test_gmsh_reads_the_same_mesh(gmsh, mesh, form, tmp_path):
    need(form if form == "med" else "numpy")
    path, _ = written(mesh, form, tmp_path)
    code = [sys.executable, "-c", GMSH, str(path)]
    done = subprocess.run(code, capture_output=True, text=True, encoding="utf-8", timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["tags"] == list(range(1, len(mesh.points) + 1))
    assert np.array(found["points"]) == pytest.approx(mesh.points, abs=1e-12)
    expected = written_names(mesh, form)
    assert {int(number) for number in found["groups"]} == set(expected)
    for number, (name, elements, corners) in found["groups"].items():
        own = np.flatnonzero(numbers(mesh) == int(number))
        assert name == (None if form in ("bdf", "comsol") else expected[int(number)])
        if form == "med":
            assert len(elements) == len(own)  # MED has no numbers
        else:
            assert np.array_equal(np.array(elements) - 1, own)
        assert np.array_equal(np.array(corners) - 1, mesh.tetrahedra[own])


# With the reader of one format


def test_scipy_reads_what_matlab_would(mesh, tmp_path):
    scipy_io = pytest.importorskip("scipy.io")
    path, renamed = written(mesh, "mat", tmp_path)
    assert not renamed
    found = scipy_io.loadmat(path, mat_dtype=True)
    assert {name for name in found if not name.startswith("_")} == {"P", "t", "label", "names"}
    assert found["P"].dtype == found["t"].dtype == found["label"].dtype == np.float64
    assert np.array_equal(found["P"], mesh.points)
    assert np.array_equal(found["t"], mesh.tetrahedra + 1)
    assert np.array_equal(found["label"], numbers(mesh)[:, None])
    assert found["names"].shape == (5, 1)
    assert [str(name[0]) for name in found["names"].ravel()] == [*NAMES, "air"]
    stored = scipy_io.loadmat(path)
    assert stored["t"].dtype == stored["label"].dtype == np.int32


def test_a_matlab_file_of_many_names_and_odd_sizes(tmp_path):
    scipy_io = pytest.importorskip("scipy.io")
    names = tuple("x" * (length + 1) for length in range(20))
    mesh = labelled_grid(names, cells=1)
    path, _ = written(mesh, "mat", tmp_path)
    found = scipy_io.loadmat(path)
    assert [str(name[0]) for name in found["names"].ravel()] == list(names)
    assert found["label"].ravel().tolist() == mesh.labels.tolist()


def test_nastran_cards_have_their_columns(mesh, tmp_path):
    path, _ = written(mesh, "bdf", tmp_path)
    lines = path.read_text(encoding="ascii").splitlines()
    assert max(map(len, lines)) <= 80
    assert lines[-1] == "ENDDATA"
    first = lines.index("BEGIN BULK") + 1
    cards = [line for line in lines[first:-1] if not line.startswith("$")]
    grids = [(a, b) for a, b in itertools.pairwise(cards) if a.startswith("GRID*")]
    assert len(grids) == len(mesh.points)
    for index, (upper, lower) in enumerate(grids):
        assert int(upper[8:24]) == index + 1
        assert upper[24:40].strip() == ""
        assert lower[:8] == "*       "
        xyz = [float(field) for field in (upper[40:56], upper[56:72], lower[8:24])]
        assert xyz == pytest.approx(mesh.points[index].tolist(), abs=1e-12)
    solids = {int(card[8:16]): int(card[16:24]) for card in cards if card.startswith("PSOLID")}
    materials = {int(card[8:16]) for card in cards if card.startswith("MAT1")}
    # COMSOL parts the domains by material.
    assert solids == {number: number for number in materials}
    tetrahedra = [[int(card[8 * k : 8 * k + 8]) for k in range(1, 7)] for card in cards if card.startswith("CTETRA")]
    assert np.array_equal(np.array(tetrahedra)[:, 2:] - 1, mesh.tetrahedra)
    assert [row[1] for row in tetrahedra] == numbers(mesh).tolist()
    assert {row[1] for row in tetrahedra} == set(solids)


def test_pynastran_reads_the_same_mesh(mesh, tmp_path):
    reader = pytest.importorskip("pyNastran.bdf.bdf", reason="pyNastran is not installed", exc_type=ImportError)
    path, _ = written(mesh, "bdf", tmp_path)
    found = reader.read_bdf(str(path), debug=None, xref=True)
    assert len(found.nodes) == len(mesh.points)
    assert [found.elements[index + 1].pid for index in range(len(mesh.labels))] == numbers(mesh).tolist()
    measured = [found.elements[index + 1].Volume() for index in range(len(mesh.labels))]
    assert measured == pytest.approx(volumes(mesh.points, mesh.tetrahedra), rel=1e-9)


def test_med_is_what_the_format_says(mesh, tmp_path):
    h5py = need("h5py")
    path, _ = written(mesh, "med", tmp_path)
    with h5py.File(path) as file:
        step = file["ENS_MAA/mesh/-0000000000000000001-0000000000000000001"]
        assert step["NOE/COO"][()].reshape(3, -1).T.tolist() == mesh.points.tolist()
        assert step["MAI/TE4/NOD"][()].reshape(4, -1).T[:, [0, 2, 1, 3]].tolist() == (mesh.tetrahedra + 1).tolist()
        assert step["MAI/TE4/FAM"][()].tolist() == (-numbers(mesh)).tolist()
        groups = {family.attrs["NUM"]: family["GRO/NOM"][()] for family in file["FAS/mesh/ELEME"].values()}
        assert {number: bytes(names[0].astype("u1")).rstrip(b"\0") for number, names in groups.items()} == {
            -number: name.encode() for number, name in written_names(mesh, "med").items()
        }


# Large, repeated and impossible


@pytest.mark.parametrize("form", list(FORMS))
def test_the_same_mesh_gives_the_same_bytes(mesh, form, tmp_path):
    need(form if form == "med" else "numpy")
    path, _ = written(mesh, form, tmp_path)
    first = path.read_bytes()
    if form == "med":
        time.sleep(1.1)  # HDF5 may store times in seconds
    write_volume(path, mesh, form)
    assert path.read_bytes() == first
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


@pytest.mark.slow
@pytest.mark.parametrize("form", list(FORMS))
def test_a_large_mesh_takes_seconds(form, tmp_path):
    need(form if form == "med" else "numpy")
    mesh = labelled_grid(cells=40, air=True)
    assert len(mesh.tetrahedra) == 384_000
    started = time.process_time()
    written(mesh, form, tmp_path)
    assert time.process_time() - started < 5


@pytest.mark.slow
@pytest.mark.parametrize("form", ["msh22", "vtu", "mat"])
def test_a_large_mesh_takes_little_memory(form, tmp_path):
    mesh = labelled_grid(cells=40, air=True)
    size = mesh.points.nbytes + mesh.tetrahedra.nbytes + mesh.labels.nbytes
    tracemalloc.start()
    try:
        written(mesh, form, tmp_path)
        assert tracemalloc.get_traced_memory()[1] < 4 * size + 20e6
    finally:
        tracemalloc.stop()


def test_text_of_more_rows_than_are_written_at_once(tmp_path):
    mesh = labelled_grid(cells=15)
    assert len(mesh.tetrahedra) > 1 << 14
    for form in ("msh22", "xdmf", "vtu"):
        path, _ = written(mesh, form, tmp_path)
        found = meshio_reading(path)
        assert np.array_equal(found.points, mesh.points)
        assert np.array_equal(found.cells[0].data, mesh.tetrahedra)
        assert np.array_equal(found.cell_data[CELL_DATA[form]][0], mesh.labels)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 999.9999999999999, 1e5, 1e11])
def test_nastran_coordinates_fill_their_field(scale, tmp_path):
    mesh = labelled_grid(cells=1)
    largest = np.abs(mesh.points).max()
    scaled = VolumeMesh(-mesh.points / largest * scale, mesh.tetrahedra, mesh.labels, mesh.names)
    path, _ = written(scaled, "bdf", tmp_path)
    upper = [line for line in path.read_text().splitlines() if line.startswith("GRID*")]
    assert {len(line) for line in upper} == {72}
    x = np.array([float(line[40:56]) for line in upper])
    assert np.abs(x - scaled.points[:, 0]).max() <= 0.5 * 10.0 ** -(16 - 2 - len(str(int(scale + 1))))


def test_what_a_format_cannot_hold_is_refused(tmp_path):
    mesh = labelled_grid(cells=1)
    huge = VolumeMesh(mesh.points * 1e15, mesh.tetrahedra, mesh.labels, mesh.names)
    with pytest.raises(VhpError, match=r"mesh\.bdf: a coordinate is beyond 1e12 mm"):
        written(huge, "bdf", tmp_path)
    broken = mesh.points.copy()
    broken[3, 1] = np.nan
    with pytest.raises(VhpError, match="point 3 is not finite"):
        written(VolumeMesh(broken, mesh.tetrahedra, mesh.labels, mesh.names), "vtu", tmp_path)
    with pytest.raises(VhpError, match="no tetrahedra"):
        written(VolumeMesh(mesh.points, np.empty((0, 4)), np.empty(0), mesh.names), "vtu", tmp_path)
    with pytest.raises(UsageError, match="no such format of tetrahedral meshes: stl"):
        write_volume(tmp_path / "mesh.stl", mesh, "stl")
    assert not list(tmp_path.iterdir())


def test_a_large_array_is_refused_before_matlab_can_misread_it(tmp_path, monkeypatch):
    matlab = importlib.import_module("vhp_cli.formats.volume.matlab")
    monkeypatch.setattr(matlab, "_LARGEST", 1000)
    with pytest.raises(VhpError, match="more than 2 GiB") as caught:
        written(labelled_grid(), "mat", tmp_path)
    assert isinstance(caught.value.__cause__, FormatLimit)
    assert not list(tmp_path.iterdir())


def test_med_without_h5py_says_what_to_do(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "h5py", None)
    for attempt in (lambda: check_form("med"), lambda: written(labelled_grid(), "med", tmp_path)):
        with pytest.raises(UsageError, match="the format med needs h5py, which can't be loaded") as caught:
            attempt()
        assert "pip install 'vhp-cli[med]'" in caught.value.hint
    assert not list(tmp_path.iterdir())


# Names


PLAIN = Naming(r"[^A-Za-z0-9_]", 8, letter_first=True, ignores_case=True)


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["liver", "kidney"], ["liver", "kidney"]),
        (["2nd rib", "a-b"], ["T2nd_rib", "a_b"]),
        (["a b", "a_b", "a-b"], ["a_b_2", "a_b", "a_b_3"]),
        (["Liver", "liver"], ["Liver", "liver_2"]),
        (["abcdefghi", "abcdefghj", "abcdefgh"], ["abcdef_2", "abcdef_3", "abcdefgh"]),
        (["", "é"], ["T_", "T__2"]),
    ],
)
def test_names_are_made_valid_and_unique(names, expected):
    found = valid_names(names, PLAIN)
    assert found == expected
    assert len({name.casefold() for name in found}) == len(found)


def test_names_are_cut_between_letters():
    assert valid_names(["größe", "größer"], Naming("[/]", 5)) == ["grö", "gr_2"]


def test_air_steps_back_where_a_tissue_has_its_name(tmp_path):
    mesh = labelled_grid(("Air", "liver"), air=True)
    assert written_names(mesh, "msh") == {1: "Air", 2: "liver", 3: "air outside"}
    assert written(mesh, "inp", tmp_path)[1] == {"air outside": "air_outside"}


@pytest.mark.parametrize("form", list(FORMS))
def test_any_name_can_be_written(form, tmp_path):
    need(form if form == "med" else "numpy")
    names = ("\udcff", "a\nb", "]]>", '"', "x" * 300, "*NODE", "ä" * 200)
    mesh = labelled_grid(names, cells=2)
    path, renamed = written(mesh, form, tmp_path)
    assert renamed["\udcff"] in ("?", "_", "T_")
    if form == "mat":
        scipy_io = pytest.importorskip("scipy.io")
        found = [str(name[0]) for name in scipy_io.loadmat(path)["names"].ravel()]
        assert found == list(written_names(mesh, form).values())
        return
    assert len(np.concatenate([block.data for block in meshio_reading(path).cells])) == len(mesh.tetrahedra)


@given(st.lists(st.text(max_size=12), min_size=1, max_size=8, unique=True))
@example(["A", "a", "a_2", "T_"])
def test_valid_names_are_what_a_format_takes(names):
    found = valid_names(names, PLAIN)
    assert len(found) == len({name.casefold() for name in found}) == len(names)
    for name, valid in zip(names, found, strict=True):
        assert re.fullmatch("[A-Za-z][A-Za-z0-9_]{0,7}", valid)
        clashes = [other for other in names if other != name and other.casefold() == name.casefold()]
        if re.fullmatch("[A-Za-z][A-Za-z0-9_]{0,7}", name) and not clashes:
            assert valid == name
