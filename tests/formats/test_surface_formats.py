"""Files of surfaces for other programs, read back by libraries that did not write them."""

from __future__ import annotations

import base64
import hashlib
import re
import xml.etree.ElementTree as ET
import zipfile
import zlib

import meshio
import numpy as np
import pytest
import scipy.io
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from shapes import box, flipped, sphere

from vhp_cli.errors import UsageError, VhpError
from vhp_cli.formats.surfaces import FORMS, UNIT_WORDS, NamedSurface, nastran, write_surfaces
from vhp_cli.formats.surfaces.named import combined
from vhp_cli.mesh import Mesh

UNEVEN = Mesh(
    sphere(7, (100, -20, 0.3)).vertices * [1.0, 0.1, 3.3] + 1e-3,  # no float32 values
    sphere(7).faces,
)
SURFACES = (
    NamedSurface("liver", sphere(10, subdivisions=1)),
    NamedSurface("Rib_1", box((20, 0, 0), (23, 40, 3))),
    NamedSurface("T_3rd", UNEVEN),
)


def written(tmp_path, form, surfaces=SURFACES, unit="mm"):
    path = tmp_path / f"model{FORMS[form].suffix}"
    write_surfaces(path, surfaces, form, unit)
    assert [found.name for found in tmp_path.iterdir()] == [path.name]
    return path


def corners(vertices, faces):
    return np.asarray(vertices, float)[np.asarray(faces)]


def outward_volume(vertices, faces):
    a, b, c = np.moveaxis(corners(vertices, faces), 1, 0)
    return np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6


def normals(mesh):
    return np.array(trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).face_normals)


@pytest.mark.parametrize("surface", SURFACES, ids=lambda surface: surface.name)
@pytest.mark.parametrize("form", ["stl", "ply", "obj"])
def test_one_tissue_a_file(form, surface, tmp_path):
    found = trimesh.load(written(tmp_path, form, [surface]), process=False)
    meant = corners(surface.mesh.vertices, surface.mesh.faces)
    if form == "stl":
        meant = meant.astype(np.float32)
        assert np.abs(found.face_normals - normals(surface.mesh)).max() < 1e-4
    assert np.array_equal(found.triangles, meant)


def test_matlab_one_tissue(tmp_path):
    for surface in SURFACES:
        read = scipy.io.loadmat(written(tmp_path, "mat", [surface]))
        assert {key for key in read if not key.startswith("__")} == {"P", "t", "normals", "unit"}
        assert np.array_equal(read["P"], surface.mesh.vertices) and read["P"].dtype == float
        assert np.array_equal(read["t"], surface.mesh.faces + 1)
        assert np.abs(read["normals"] - normals(surface.mesh)).max() < 1e-12
        assert read["unit"].tolist() == ["mm"]
        # By t, as a program would use it: counter-clockwise from outside.
        a, b, c = np.moveaxis(read["P"][read["t"].astype(int) - 1], 1, 0)
        assert (np.einsum("ij,ij->i", np.cross(b - a, c - a), read["normals"]) > 0).all()


def test_matlab_all_tissues_by_equation_2_16(tmp_path):
    read = scipy.io.loadmat(written(tmp_path, "mat-all", unit="cm"))
    first, second, third = (surface.mesh for surface in SURFACES)
    n1, n2 = len(first.vertices), len(second.vertices)
    assert np.array_equal(read["P"], np.vstack([first.vertices, second.vertices, third.vertices]))
    assert np.array_equal(read["t"], np.vstack([first.faces + 1, second.faces + 1 + n1, third.faces + 1 + n1 + n2]))
    assert read["tissue"].shape == (len(read["t"]), 1)
    assert [str(cell[0][0]) for cell in read["names"]] == [surface.name for surface in SURFACES]
    for number, surface in enumerate(SURFACES, start=1):
        mine = read["t"][read["tissue"][:, 0] == number].astype(int) - 1
        assert np.array_equal(corners(read["P"], mine), corners(surface.mesh.vertices, surface.mesh.faces))
    assert read["unit"].tolist() == ["cm"]


def test_nastran_by_pynastran(tmp_path):
    pynastran = pytest.importorskip("pyNastran.bdf.bdf", reason="pyNastran is not installed", exc_type=ImportError)
    path = written(tmp_path, "bdf")
    model = pynastran.read_bdf(str(path), xref=False, debug=None, punch=False)
    assert sorted(model.properties) == [1, 2, 3] and all(card.type == "PSHELL" for card in model.properties.values())
    assert {card.type for card in model.elements.values()} == {"CTRIA3"}
    for number, surface in enumerate(SURFACES, start=1):
        cards = [card for _, card in sorted(model.elements.items()) if card.pid == number]
        points = np.array([[model.nodes[node].xyz for node in card.nodes] for card in cards])
        assert np.abs(points - corners(surface.mesh.vertices, surface.mesh.faces)).max() < 1e-10


@pytest.mark.parametrize("form", ["bdf", "nas"])
def test_nastran_by_meshio(form, tmp_path):
    path = written(tmp_path, form)
    read = meshio.nastran.read(path)
    [cells] = read.cells
    assert cells.type == "triangle"
    meant = combined(SURFACES)
    assert np.array_equal(cells.data, meant.faces)
    assert np.abs(read.points - meant.vertices).max() < 1e-10
    assert np.array_equal(read.cell_data["nastran:ref"][0], meant.tissue)
    names = dict(re.findall(r"^\$ PID (\d+) = (.*)$", path.read_text(), re.M))
    assert names == {"1": "liver", "2": "Rib_1", "3": "T_3rd"}
    assert all(len(line) <= 80 for line in path.read_text().splitlines())


def test_nastran_read_back_by_its_own_reader(tmp_path):
    found = nastran.parse(written(tmp_path, "nas").read_bytes())
    for mesh, surface in zip(found, SURFACES, strict=True):
        assert np.array_equal(mesh.faces, surface.mesh.faces)
        assert np.abs(mesh.vertices - surface.mesh.vertices).max() < 1e-10
    cut = (tmp_path / "model.nas").read_bytes()[:-20]
    with pytest.raises(ValueError, match="cut short"):
        nastran.parse(cut)


UNITS_3MF = {"um": "micron", "mm": "millimeter", "cm": "centimeter", "in": "inch", "m": "meter"}


@pytest.mark.parametrize("unit", UNITS_3MF)
def test_3mf_by_the_library_of_the_consortium(unit, tmp_path):
    lib3mf = pytest.importorskip("lib3mf", reason="lib3mf is not installed", exc_type=ImportError)
    path = written(tmp_path, "3mf", unit=unit)
    wrapper = lib3mf.get_wrapper()
    model = wrapper.CreateModel()
    reader = model.QueryReader("3mf")
    reader.SetStrictModeActive(True)
    reader.ReadFromFile(str(path))
    assert reader.GetWarningCount() == 0
    assert model.GetUnit() == getattr(
        lib3mf.ModelUnit, {"um": "MicroMeter", "mm": "MilliMeter", "cm": "CentiMeter", "in": "Inch", "m": "Meter"}[unit]
    )
    objects = model.GetMeshObjects()
    assert objects.Count() == len(SURFACES)
    for surface in SURFACES:
        assert objects.MoveNext()
        found = objects.GetCurrentMeshObject()
        assert found.GetName() == surface.name and found.IsManifoldAndOriented()
        faces = [list(face.Indices) for face in found.GetTriangleIndices()]
        assert np.array_equal(faces, surface.mesh.faces)
        points = np.array([list(vertex.Coordinates) for vertex in found.GetVertices()])
        assert np.array_equal(points, surface.mesh.vertices.astype(np.float32))
    items = model.GetBuildItems()
    assert items.Count() == len(SURFACES)


def test_3mf_by_trimesh(tmp_path):
    pytest.importorskip("lxml", reason="lxml is not installed", exc_type=ImportError)
    pytest.importorskip("networkx", reason="networkx is not installed", exc_type=ImportError)
    scene = trimesh.load(written(tmp_path, "3mf"), process=False)
    assert scene.units == "millimeter"
    assert set(scene.geometry) == {surface.name for surface in SURFACES}
    for surface in SURFACES:
        found = scene.geometry[surface.name]
        assert np.array_equal(found.triangles, corners(surface.mesh.vertices, surface.mesh.faces))


def test_3mf_is_the_package_that_the_standard_asks_for(tmp_path):
    awkward = [NamedSurface('a <b> & "c"', box())]
    with zipfile.ZipFile(written(tmp_path, "3mf", awkward)) as archive:
        assert archive.testzip() is None
        assert archive.namelist() == ["[Content_Types].xml", "_rels/.rels", "3D/3dmodel.model"]
        assert {entry.date_time for entry in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
        root = ET.fromstring(archive.read("3D/3dmodel.model"))
        core = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"
        [found] = root.iter(f"{core}object")
        assert found.get("name") == 'a <b> & "c"' and found.get("type") == "model"
        assert [item.get("objectid") for item in root.iter(f"{core}item")] == [found.get("id")]
        relation = ET.fromstring(archive.read("_rels/.rels"))[0]
        assert relation.get("Target") == "/3D/3dmodel.model"


def vtk_arrays(path):
    """Decode the arrays of a VTK XML file by the description of the format."""
    root = ET.parse(path).getroot()
    assert root.get("type") == "PolyData" and root.get("header_type") == "UInt64"
    kinds = {"Float64": "<f8", "Int32": "<i4", "Int64": "<i8"}
    found = {}
    for array in root.iter("DataArray"):
        if array.get("format") == "ascii":
            found[array.get("Name")] = int(array.text)
            continue
        text = array.text.strip()
        count = int(np.frombuffer(base64.b64decode(text[:12])[:8], "<u8")[0])
        length = -(-8 * (3 + count) // 3) * 4
        header = np.frombuffer(base64.b64decode(text[:length]), "<u8")
        data, body = base64.b64decode(text[length:]), b""
        for size in header[3 : 3 + count]:
            body, data = body + zlib.decompress(data[: int(size)]), data[int(size) :]
        found[array.get("Name")] = np.frombuffer(body, kinds[array.get("type")])
    return root.find("PolyData/Piece"), found


def test_vtk_by_the_description_of_the_format(tmp_path):
    piece, found = vtk_arrays(written(tmp_path, "vtp"))
    meant = combined(SURFACES)
    assert piece.get("NumberOfPoints") == str(len(meant.vertices))
    assert piece.get("NumberOfPolys") == str(len(meant.faces))
    assert np.array_equal(found["Points"].reshape(-1, 3), meant.vertices)
    assert np.array_equal(found["connectivity"].reshape(-1, 3), meant.faces)
    assert np.array_equal(found["offsets"], np.arange(1, len(meant.faces) + 1) * 3)
    assert np.array_equal(found["tissue"], meant.tissue)
    assert [found[surface.name] for surface in SURFACES] == [1, 2, 3]


def test_vtk_by_vtk(tmp_path):
    vtk_io = pytest.importorskip("vtkmodules.vtkIOXML", reason="vtk is not installed", exc_type=ImportError)
    from vtkmodules.util.numpy_support import vtk_to_numpy

    reader = vtk_io.vtkXMLPolyDataReader()
    reader.SetFileName(str(written(tmp_path, "vtp")))
    reader.Update()
    data = reader.GetOutput()
    meant = combined(SURFACES)
    assert np.array_equal(vtk_to_numpy(data.GetPoints().GetData()), meant.vertices)
    assert np.array_equal(vtk_to_numpy(data.GetPolys().GetConnectivityArray()).reshape(-1, 3), meant.faces)
    assert np.array_equal(vtk_to_numpy(data.GetCellData().GetArray("tissue")), meant.tissue)
    assert data.GetFieldData().GetArray("Rib_1").GetValue(0) == 2


@pytest.mark.parametrize("form", FORMS)
def test_same_surfaces_same_bytes(form, tmp_path, monkeypatch):
    surfaces = SURFACES if FORMS[form].scope == "model" else SURFACES[2:]
    first = hashlib.sha256(written(tmp_path, form, surfaces).read_bytes())
    # Neither the time nor the zone may stand in a file.
    monkeypatch.setattr("time.time", lambda: 2e9)
    monkeypatch.setattr("time.localtime", lambda *_: (2033, 5, 18, 3, 33, 20, 2, 138, 0))
    assert hashlib.sha256(written(tmp_path, form, surfaces).read_bytes()).digest() == first.digest()


@pytest.mark.parametrize("form", ["stl", "ply", "obj", "mat", "mat-all", "bdf", "vtp"])
@pytest.mark.parametrize("unit", UNIT_WORDS)
def test_files_name_their_unit(form, unit, tmp_path):
    head = written(tmp_path, form, SURFACES[:1], unit).read_bytes()[:400]
    assert UNIT_WORDS[unit].encode() in head or f"unit: {unit} ".encode() in head


def test_what_can_not_be_written_is_refused(tmp_path):
    with pytest.raises(UsageError, match="no such format of surfaces: 'step'"):
        write_surfaces(tmp_path / "a.step", SURFACES, "step")
    broken = np.array(UNEVEN.vertices)
    broken[3, 1] = np.nan
    for form in FORMS:
        with pytest.raises(VhpError, match="vertex 3 of T is not finite"):
            write_surfaces(tmp_path / "a", [NamedSurface("T", Mesh(broken, UNEVEN.faces))], form)
    with pytest.raises(VhpError, match="beyond 1e12 cm, too large for a Nastran field"):
        write_surfaces(tmp_path / "a", [NamedSurface("T", Mesh(UNEVEN.vertices * 1e15, UNEVEN.faces))], "bdf", "cm")
    assert not list(tmp_path.iterdir())


def test_faces_keep_their_side(tmp_path):
    """A surface turned inside out stays so in every format: nothing is mended on the way out."""
    inside_out = [NamedSurface("a", flipped(box()))]
    read = scipy.io.loadmat(written(tmp_path, "mat", inside_out))
    assert outward_volume(read["P"], read["t"].astype(int) - 1) == pytest.approx(-1000)
    (tmp_path / "model.mat").unlink()
    _, found = vtk_arrays(written(tmp_path, "vtp", inside_out))
    assert outward_volume(found["Points"].reshape(-1, 3), found["connectivity"].reshape(-1, 3)) == pytest.approx(-1000)


@settings(max_examples=40)
@given(
    hnp.arrays(
        np.float64, st.tuples(st.integers(3, 12), st.just(3)), elements=st.floats(-1e4, 1e4, allow_subnormal=False)
    )
)
def test_any_coordinates_survive(tmp_path_factory, vertices):
    """Nastran rounds to its columns, the others are exact."""
    folder = tmp_path_factory.mktemp("any")
    mesh = Mesh(vertices, [[0, 1, 2]])
    surfaces = [NamedSurface("a", mesh)]
    read = scipy.io.loadmat(written(folder, "mat", surfaces))
    assert np.array_equal(read["P"], vertices)
    (folder / "model.mat").unlink()
    [found] = nastran.parse(written(folder, "bdf", surfaces).read_bytes())
    # A mesh ends with the last vertex that a face uses.
    assert np.abs(found.vertices - vertices[:3]).max() <= 1e-9
    (folder / "model.bdf").unlink()
    with zipfile.ZipFile(written(folder, "3mf", surfaces)) as archive:
        root = ET.fromstring(archive.read("3D/3dmodel.model"))
    stored = [[float(vertex.get(axis)) for axis in "xyz"] for vertex in root.iter() if vertex.tag.endswith("}vertex")]
    assert np.array_equal(stored, vertices)
