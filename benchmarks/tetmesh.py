"""Mesh nested bodies of known volume by `vhp tetmesh` and by its engines alone: ``python benchmarks/tetmesh.py``.

Each contestant meshes the same STL files in a process of its own, which reads them, meshes and writes the mesh. Labels
of the peers are told from the bodies themselves: the innermost one that holds the centroid of a tetrahedron.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import io
import itertools
import json
import math
import statistics
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import models

sys.path.insert(0, str(models.REPOSITORY))

from check import RunFailed, measure, table

VHP = (sys.executable, "-m", "vhp_cli")
Row = dict[str, Any]


@dataclass(frozen=True)
class Capsule:
    """All points within a radius of a segment, in mm; a ball where it has no length. It lies in `parent`."""

    name: str
    radius: float
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)
    length: float = 0.0
    parent: str = ""

    @property
    def volume(self) -> float:
        """Of the whole body, in mm3."""
        return math.pi * self.radius**2 * (4 / 3 * self.radius + self.length)


# From outside to inside.
BODIES = (
    Capsule("skin", 24.0),
    Capsule("fat", 21.0, parent="skin"),
    Capsule("liver", 9.0, (8.0, 0.0, 0.0), parent="fat"),
    Capsule("kidney", 4.0, (-9.0, 0.0, -6.0), 12.0, "fat"),
    Capsule("tumor", 3.0, (8.0, 0.0, -15.0), parent="fat"),
    Capsule("vessel", 2.0, (9.0, 0.0, -3.0), 6.0, "liver"),
)


def label_volume(body: Capsule) -> float:
    """Return what is left of a body without those directly inside of it, in mm3."""
    return body.volume - sum(other.volume for other in BODIES if other.parent == body.name)


def surface(body: Capsule, subdivisions: int) -> Any:
    """Return the surface of a body, with its volume: a subdivided octahedron, its halves moved apart and joined."""
    import numpy as np

    from vhp_cli.mesh import Mesh

    per_edge = 2**subdivisions
    quarter = [(i, j) for i in range(per_edge) for j in range(per_edge - i)]
    up = [((i, j), (i + 1, j), (i, j + 1)) for i, j in quarter]
    up += [((i + 1, j), (i + 1, j + 1), (i, j + 1)) for i, j in quarter if i + j < per_edge - 1]
    corners = np.array(up, dtype=float)
    corners = np.concatenate((corners, per_edge - corners.sum(axis=2, keepdims=True)), axis=2)
    corners /= np.linalg.norm(corners, axis=2, keepdims=True)
    facets = []
    for signs in np.array(np.meshgrid(*[(1, -1)] * 3)).T.reshape(-1, 3):
        mirrored = corners * signs
        facets.append(mirrored if signs.prod() > 0 else mirrored[:, ::-1])
    ball = np.concatenate(facets) * body.radius
    upper = (ball[:, :, 2] >= 0).all(axis=1)
    ball[upper, :, 2] += body.length
    if body.length:
        angle = np.arctan2(*(corners[:, :, axis][corners[:, :, 2] == 0] for axis in (1, 0)))
        angles = np.unique(np.round(np.concatenate([angle + turn * np.pi / 2 for turn in range(4)]) % (2 * np.pi), 12))
        ring = np.column_stack((np.cos(angles), np.sin(angles))) * body.radius
        heights = np.linspace(0, body.length, max(round(body.length * len(ring) / (2 * np.pi * body.radius)), 1) + 1)
        for low, high in itertools.pairwise(heights):
            a, b = ring, np.roll(ring, -1, axis=0)
            quad = [
                np.column_stack((side, np.full(len(ring), z))) for side, z in ((a, low), (b, low), (b, high), (a, high))
            ]
            ball = np.concatenate((ball, np.stack(quad[:3], axis=1), np.stack([quad[0], *quad[2:]], axis=1)))
    # The same corner is reckoned in several ways.
    vertices, index = np.unique(np.round(ball.reshape(-1, 3), 6), axis=0, return_inverse=True)
    # Inscribed, it would lack a part of its volume.
    enclosed = np.linalg.det(vertices[index.reshape(-1, 3)]).sum() / 6
    middle = np.array((0, 0, body.length / 2))
    vertices = middle + (vertices - middle) * np.cbrt(body.volume / enclosed)
    return Mesh(vertices + body.start, index.reshape(-1, 3).astype(np.int32))


def bodies_model(directory: Path, subdivisions: int) -> Path:
    """Write the bodies as STL files."""
    from vhp_cli.formats import write_mesh

    directory.mkdir()
    for body in BODIES:
        write_mesh(directory / f"{body.name}.stl", surface(body, subdivisions))
    return directory


# The peers: each in a process of its own, started by `main` with a hidden option


def soup(model: Path) -> Any:
    """Return all surfaces of a model as one mesh."""
    import numpy as np

    from vhp_cli.formats import read_mesh
    from vhp_cli.mesh import Mesh

    meshes = [read_mesh(file).mesh for file in models.stl_files(model)]
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts[:-1], strict=True)]),
    )


def by_pytetwild(model: Path, edge_mm: float, epsilon_mm: float) -> tuple[Any, Any]:
    """Mesh all surfaces together by fTetWild, the whole box."""
    import types

    import numpy as np

    if importlib.util.find_spec("pyvista") is None:
        sys.modules["pyvista"] = types.ModuleType("pyvista")
    import pytetwild

    mesh = soup(model)
    size = float(np.linalg.norm(mesh.vertices.max(axis=0) - mesh.vertices.min(axis=0)))
    return pytetwild.tetrahedralize(
        np.array(mesh.vertices),
        np.array(mesh.faces),
        edge_length_abs=edge_mm,
        epsilon=epsilon_mm / size,
        disable_filtering=True,
        vtk_ordering=True,
        num_threads=1,
    )


def by_tetgen(model: Path, edge_mm: float, epsilon_mm: float) -> tuple[Any, Any]:
    """Mesh between the triangles by TetGen with its usual quality settings; it keeps the triangles."""
    import numpy as np
    import tetgen

    mesh = soup(model)
    engine = tetgen.TetGen(np.array(mesh.vertices), np.array(mesh.faces))
    points, tetrahedra, _, _ = engine.tetrahedralize(
        nobisect=True,
        quality=True,
        minratio=1.5,
        mindihedral=10.0,
        fixedvolume=True,
        maxvolume=edge_mm**3 / (6 * math.sqrt(2)),
        steinerleft=-1,
    )
    return points, tetrahedra


def by_gmsh(model: Path, edge_mm: float, epsilon_mm: float) -> tuple[Any, Any]:
    """Mesh between the triangles by Gmsh with its defaults; it keeps the triangles."""
    import gmsh
    import numpy as np

    from vhp_cli.engines.gmsh import children
    from vhp_cli.kernels.surface import topology

    mesh = soup(model)
    found = topology(mesh.vertices, mesh.faces)
    inside = children(mesh.vertices, mesh.faces, found.component, found.n_components)
    gmsh.initialize(interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("General.NumThreads", 1)
    gmsh.option.setNumber("Mesh.MeshSizeMax", edge_mm)
    loops = []
    for component in range(found.n_components):
        own = mesh.faces[found.component == component]
        used = np.unique(own)
        tag = gmsh.model.addDiscreteEntity(2)
        gmsh.model.mesh.addNodes(2, tag, used + 1, mesh.vertices[used].ravel())
        gmsh.model.mesh.addElementsByType(tag, 2, [], own.astype(np.int64).ravel() + 1)
        loops.append(gmsh.model.geo.addSurfaceLoop([tag]))
    for component, within in enumerate(inside):
        gmsh.model.geo.addVolume([loops[component], *(loops[other] for other in within)])
    gmsh.model.geo.synchronize()
    gmsh.model.mesh.generate(3)
    tags, points, _ = gmsh.model.mesh.getNodes()
    place = np.zeros(int(tags.max()) + 1, np.int64)
    place[tags] = np.arange(len(tags))
    _, corners = gmsh.model.mesh.getElementsByType(4)
    return np.array(points).reshape(-1, 3), place[corners].reshape(-1, 4)


PEERS: dict[str, tuple[str, Callable[[Path, float, float], tuple[Any, Any]]]] = {
    "pytetwild": ("pytetwild", by_pytetwild),
    "tetgen": ("tetgen", by_tetgen),
    "gmsh": ("gmsh", by_gmsh),
}
# How vhp is called, and the library that it then needs.
OURS = {
    "vhp": ("pytetwild", ()),
    "vhp --keep-surface tetgen": ("tetgen", ("--keep-surface", "tetgen")),
    "vhp --keep-surface gmsh": ("gmsh", ("--keep-surface", "gmsh")),
}
# Whose engine does the same work alone; those that keep the surface have more done to the quality.
ALONE = {"vhp": "pytetwild"}


def command_of(name: str, model: Path, place: Path, edge_mm: float, epsilon_mm: float) -> list[str]:
    """Return how a contestant is started; it leaves its mesh in `place`."""
    if name in OURS:
        options = () if OURS[name][1] else ("--epsilon", str(epsilon_mm))
        return [
            *VHP, "-q", "tetmesh", str(model), "-o", str(place / "out"), "--edge-length", str(edge_mm),
            "--format", "vtu", "--no-cache", "--jobs", "1", *OURS[name][1], *options,
        ]  # fmt: skip
    run = ["--run", name, str(model), str(place / "mesh.npz")]
    return [sys.executable, __file__, *run, "--edge-lengths", str(edge_mm), "--epsilon", str(epsilon_mm)]


def result_of(name: str, place: Path) -> tuple[Any, Any, Any]:
    """Return points, tetrahedra and, of vhp, the name of the tissue of each."""
    import numpy as np

    if name not in OURS:
        with np.load(place / "mesh.npz") as stored:
            return stored["points"], stored["tetrahedra"], None
    import meshio

    (file,) = (place / "out").glob("*.vtu")
    mesh = meshio.read(file)
    names = {int(value[0]): key for key, value in mesh.field_data.items()}
    labels = np.concatenate(mesh.cell_data["label"])
    listed = np.array([names.get(number, "") for number in range(int(labels.max()) + 1)], dtype=object)
    return mesh.points, mesh.cells[0].data, listed[labels]


def named_by_bodies(points: Any, tetrahedra: Any) -> Any:
    """Return for each tetrahedron the innermost body that holds its centroid; empty for none."""
    import numpy as np

    centroids = points[tetrahedra].mean(axis=1)
    names = np.full(len(tetrahedra), "", dtype=object)
    for body in BODIES:
        apart = centroids - body.start
        apart[:, 2] -= np.clip(apart[:, 2], 0.0, body.length)
        names[np.linalg.norm(apart, axis=1) < body.radius] = body.name
    return names


def judged(points: Any, tetrahedra: Any, names: Any, known: bool) -> Row:
    """Return the figures of a mesh; errors of volumes only where they are known."""
    import numpy as np

    from vhp_cli.inspection.adjacency import adjacency
    from vhp_cli.inspection.tetrahedra import tetrahedron_quality
    from vhp_cli.volume import volumes

    if names is None and known:
        names = named_by_bodies(points, tetrahedra)
    if names is not None:
        kept = names != ""
        tetrahedra, names = tetrahedra[kept], names[kept]
    tetrahedra = np.asarray(tetrahedra, dtype=np.int32)
    if volumes(points, tetrahedra).sum() < 0:
        tetrahedra = np.ascontiguousarray(tetrahedra[:, [0, 2, 1, 3]])
    shape, joined = tetrahedron_quality(points, tetrahedra), adjacency(tetrahedra)
    row: Row = {
        "tets": len(tetrahedra),
        "min_dihedral": float(shape.min_dihedral_deg.min()),
        "ratio_p01": float(np.quantile(shape.radius_ratio, 0.01)),
        "min_jacobian": float(shape.scaled_jacobian.min()),
        "conforming": joined.overfull == 0 and not len(joined.folded),
    }
    if known:
        row["errors"] = {
            body.name: float(shape.volume[names == body.name].sum() / label_volume(body) - 1) for body in BODIES
        }
    return row


def row_of(name: str, model: Path, edge_mm: float, epsilon_mm: float, known: bool) -> Row:
    """Let a contestant mesh a model, and return its figures."""
    row: Row = {"by": name, "edge_mm": edge_mm}
    with tempfile.TemporaryDirectory() as scratch:
        place = Path(scratch)
        try:
            # 1: there is a mesh, but the gate has something against it.
            accept = (0, 1) if name in OURS else (0,)
            used = measure(command_of(name, model, place, edge_mm, epsilon_mm), accept=accept)
            judge = [sys.executable, __file__, "--judge", name, str(place), *(["--known"] if known else [])]
            row |= json.loads(measure(judge).output)
        except RunFailed as error:
            return {**row, "error": str(error)[-300:]}
    return {**row, "wall_s": used.wall_s, "cpu_s": used.cpu_s, "memory_mb": used.memory_mb}


def summary(rows: Sequence[Row]) -> str:
    """Return the figures by edge length and contestant, as a Markdown table; medians over the rounds."""
    header = [
        "", "edge mm", "tets", "s", "CPU s", "MB", "volume error %, worst", "min dihedral", "1 % r ratio", "min J",
        "conforming",
    ]  # fmt: skip
    lines = []
    for edge, name in dict.fromkeys((row["edge_mm"], row["by"]) for row in rows):
        done = [row for row in rows if (row["edge_mm"], row["by"]) == (edge, name) and "error" not in row]
        if not done:
            lines.append([name, f"{edge:g}", "failed", *["-"] * 8])
            continue

        def middle(key: str, done: Sequence[Row] = done) -> float:
            return statistics.median(row[key] for row in done)

        error = "-"
        if "errors" in done[0]:
            worst = max(
                ((name, value) for row in done for name, value in row["errors"].items()), key=lambda pair: abs(pair[1])
            )
            error = f"{100 * worst[1]:+.3f} ({worst[0]})"
        lines.append([
            name,
            f"{edge:g}",
            f"{middle('tets'):.0f}",
            f"{middle('wall_s'):.1f}",
            f"{middle('cpu_s'):.1f}",
            f"{middle('memory_mb'):.0f}",
            error,
            f"{min(row['min_dihedral'] for row in done):.1f}",
            f"{min(row['ratio_p01'] for row in done):.2f}",
            f"{min(row['min_jacobian'] for row in done):.3f}",
            "yes" if all(row["conforming"] for row in done) else "no",
        ])  # fmt: skip
    return table(header, lines)


def overheads(rows: Sequence[Row]) -> str:
    """Return how much longer vhp takes than the engine alone, as a Markdown table; medians over the rounds."""
    lines = []
    for edge, name in dict.fromkeys((row["edge_mm"], row["by"]) for row in rows if row["by"] in ALONE):
        times = {
            by: [row["cpu_s"] for row in rows if (row["edge_mm"], row["by"]) == (edge, by) and "error" not in row]
            for by in (name, ALONE[name])
        }
        if all(times.values()):
            ours, alone = (statistics.median(found) for found in times.values())
            lines.append([name, f"{edge:g}", f"{alone:.1f}", f"{ours:.1f}", f"{100 * (ours / alone - 1):+.0f}"])
    return table(["", "edge mm", "engine alone, CPU s", "vhp, CPU s", "overhead %"], lines)


def main() -> int:
    """Run what the command line asks for and print the tables."""
    parser = argparse.ArgumentParser(description="Mesh bodies of known volume by vhp tetmesh and its engines alone.")
    parser.add_argument("--model", type=Path, help="mesh the STL files of a directory instead")
    parser.add_argument("--edge-lengths", default="4,2", help="in mm, separated by commas (default: 4,2)")
    parser.add_argument("--epsilon", type=float, default=0.1, help="envelope of fTetWild in mm (default: 0.1)")
    parser.add_argument("--subdivisions", type=int, default=4, help="of the bodies' surfaces (default: 4)")
    parser.add_argument("--rounds", type=int, default=1, help="as fTetWild is not reproducible (default: 1)")
    parser.add_argument("--only", default=",".join((*OURS, *PEERS)), help="contestants, separated by commas")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all rows")
    # What this program starts itself for, as memory that it took would count as that of the processes it measures.
    parser.add_argument("--run", nargs=3, metavar=("PEER", "MODEL", "FILE"), help=argparse.SUPPRESS)
    parser.add_argument("--judge", nargs=2, metavar=("NAME", "DIRECTORY"), help=argparse.SUPPRESS)
    parser.add_argument("--known", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--bodies", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    edges = [float(text) for text in arguments.edge_lengths.split(",")]
    if arguments.run:
        import numpy as np

        name, model, file = arguments.run
        points, tetrahedra = PEERS[name][1](Path(model), edges[0], arguments.epsilon)
        np.savez(file, points=points, tetrahedra=tetrahedra)
        return 0
    if arguments.judge:
        name, place = arguments.judge
        with contextlib.redirect_stdout(io.StringIO()):
            row = judged(*result_of(name, Path(place)), arguments.known)
        print(json.dumps(row))
        return 0
    if arguments.bodies:
        bodies_model(arguments.bodies, arguments.subdivisions)
        return 0
    wanted = [name for name in arguments.only.split(",") if name]
    if unknown := {*wanted} - {*OURS, *PEERS}:
        parser.error(f"no such contestant: {', '.join(sorted(unknown))}; there are {', '.join((*OURS, *PEERS))}")
    present = [name for name in wanted if importlib.util.find_spec((OURS | PEERS)[name][0]) is not None]
    for name in set(wanted) - set(present):
        print(f"{name}: not installed", file=sys.stderr)
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as scratch:
        model = arguments.model or Path(scratch) / "bodies"
        if arguments.model is None:
            made = ["--bodies", str(model), "--subdivisions", str(arguments.subdivisions)]
            measure([sys.executable, __file__, *made])
        for edge in edges:
            for round_number in range(arguments.rounds):
                # Another one first in each round.
                turn = round_number % max(len(present), 1)
                for name in present[turn:] + present[:turn]:
                    rows.append(row_of(name, model, edge, arguments.epsilon, known=arguments.model is None))
                    print(f"{name}, {edge:g} mm: done", file=sys.stderr, flush=True)
                    if arguments.json:
                        arguments.json.write_text(json.dumps(rows, indent=1), encoding="utf-8")
    print(summary(rows))
    print()
    print(overheads(rows))
    for row in rows:
        if "error" in row:
            print(f"- {row['by']}, {row['edge_mm']:g} mm: {row['error']}")
    return 1 if any("error" in row for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
