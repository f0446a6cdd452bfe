"""Smooth sound meshes by `vhp smooth` and by its peers: ``python benchmarks/smooth.py``.

Everyone does ten iterations, but for the guarded method, which stops by itself. What comes out is rounded to float32
and judged by the gate of vhp; distances are those of `vhp_cli.inspection.deviation`.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import statistics
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import models
import numpy as np

sys.path.insert(0, str(models.REPOSITORY))

from check import table

from vhp_cli.formats import read_mesh
from vhp_cli.inspection.deviation import deviation
from vhp_cli.kernels.smoothing import METHODS, smooth_vertices
from vhp_cli.mesh import Mesh
from vhp_cli.phantom import generate
from vhp_cli.stages.heal.candidate import Candidate, judge
from vhp_cli.stages.smooth import smooth
from vhp_cli.stages.smooth.options import SmoothOptions

ITERATIONS = 10
GROUPS = ("real", "thin")
THIN = ("nerve", "artery", "vein", "plexus")
# Change of the volume beyond which a tissue is another one.
VOLUME_TOLERANCE = 1e-3
Row = dict[str, Any]


def by_vhp(options: SmoothOptions, mesh: Mesh) -> Mesh:
    """Return what vhp makes of a mesh; what it leaves alone stays."""
    return smooth(mesh, options).mesh or mesh


def by_meshlab(name: str, parameters: dict[str, Any], mesh: Mesh) -> Mesh:
    """Return what a filter of MeshLab makes of a mesh."""
    import pymeshlab

    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.add_mesh(pymeshlab.Mesh(mesh.vertices, mesh.faces))
    for _ in range(parameters.pop("times", 1)):
        meshes.apply_filter(name, **parameters)
    made = meshes.current_mesh()
    return Mesh(made.vertex_matrix(), made.face_matrix())


def by_trimesh(name: str, parameters: dict[str, Any], mesh: Mesh) -> Mesh:
    """Return what a filter of trimesh makes of a mesh."""
    import trimesh

    made = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    getattr(trimesh.smoothing, name)(made, **parameters)
    return Mesh(np.array(made.vertices), mesh.faces)


def by_meshlib(name: str, mesh: Mesh) -> Mesh:
    """Return what a relaxation of MeshLib makes of a mesh."""
    from meshlib import mrmeshnumpy, mrmeshpy

    made = mrmeshnumpy.meshFromFacesVerts(mesh.faces, mesh.vertices)
    parameters = mrmeshpy.MeshRelaxParams()
    parameters.iterations = ITERATIONS
    getattr(mrmeshpy, name)(made, parameters)
    return Mesh(mrmeshnumpy.getNumpyVerts(made), mrmeshnumpy.getNumpyFaces(made.topology))


@dataclass(frozen=True, slots=True)
class Smoother:
    """One way to smooth, and the module that it needs."""

    module: str
    run: Callable[[Mesh], Mesh]


def vhp(**options: Any) -> Smoother:
    """Return a contestant of our own."""
    iterations = {} if options.get("method", "guarded") == "guarded" else {"iterations": ITERATIONS}
    return Smoother("vhp_cli", partial(by_vhp, SmoothOptions(**options, **iterations)))


LAPLACIAN = {"stepsmoothnum": ITERATIONS, "cotangentweight": False, "boundary": True}
SMOOTHERS = {
    "vhp guarded": vhp(),
    "vhp standard": vhp(method="standard"),
    "vhp standard, tangential, flips": vhp(method="standard", tangential=True, flips=True),
    "vhp cvt, HC": vhp(method="cvt", correction="hc"),
    "vhp wcc": vhp(method="wcc"),
    "standard, unguarded": vhp(method="standard", unguarded=True),
    "standard, HC, unguarded": vhp(method="standard", correction="hc", unguarded=True),
    "standard, Taubin, unguarded": vhp(method="standard", correction="taubin", unguarded=True),
    "wcc, unguarded": vhp(method="wcc", unguarded=True),
    "pymeshlab Laplacian": Smoother("pymeshlab", partial(by_meshlab, "apply_coord_laplacian_smoothing", LAPLACIAN)),
    "pymeshlab HC": Smoother(
        "pymeshlab", lambda mesh: by_meshlab("apply_coord_hc_laplacian_smoothing", {"times": ITERATIONS}, mesh)
    ),
    "pymeshlab Taubin": Smoother(
        "pymeshlab", partial(by_meshlab, "apply_coord_taubin_smoothing", {"stepsmoothnum": ITERATIONS})
    ),
    "trimesh Laplacian": Smoother("trimesh", partial(by_trimesh, "filter_laplacian", {"iterations": ITERATIONS})),
    "trimesh HC": Smoother("trimesh", partial(by_trimesh, "filter_humphrey", {"iterations": ITERATIONS})),
    "trimesh Taubin": Smoother("trimesh", partial(by_trimesh, "filter_taubin", {"iterations": ITERATIONS})),
    "MeshLib relax": Smoother("meshlib", partial(by_meshlib, "relax")),
    "MeshLib relaxKeepVolume": Smoother("meshlib", partial(by_meshlib, "relaxKeepVolume")),
}


def sound_meshes(directory: Path, every: int, most: int) -> Iterator[tuple[str, Candidate]]:
    """Yield every so-many-th STL file that is sound, rounded as it is read back."""
    files = sorted([*directory.glob("*.stl"), *directory.glob("*/*.stl")])
    for path in files[::every]:
        candidate = judge(read_mesh(path).mesh)
        if candidate.sound and 100 <= len(candidate.mesh.faces) <= most:
            yield path.relative_to(directory).as_posix(), candidate


def thin_meshes(triangles: int) -> Iterator[tuple[str, Candidate]]:
    """Yield the nerves and vessels of the phantom."""
    for name, mesh in generate(triangles).items():
        if any(word in name for word in THIN):
            yield name, judge(mesh)


def judged(before: Candidate, made: Mesh) -> Row:
    """Return the figures of one result."""
    if not np.isfinite(made.vertices).all():
        return {"error": "coordinates that are not finite"}
    after = judge(made)
    far = deviation(before.mesh, after.mesh, lost_limit_mm=1.0)
    return {
        "sound": after.sound,
        "crossing": after.measures["self_intersections"]["pairs"] > 0,
        "min_q": after.min_quality,
        "mean_q": after.mean_quality,
        "mean_rises": after.mean_quality > before.mean_quality,
        "min_falls": after.min_quality < before.min_quality,
        "max_mm": far["max"],
        "volume": after.measures["volume_mm3"] / before.measures["volume_mm3"] - 1,
    }


def rows_of(group: str, name: str, before: Candidate, names: Sequence[str]) -> list[Row]:
    """Return the figures of all contestants for one mesh."""
    rows = []
    for smoother in names:
        started = time.process_time()
        try:
            made = SMOOTHERS[smoother].run(before.mesh)
            seconds = time.process_time() - started
            row = judged(before, made) | {"cpu_s": seconds}
        except Exception as error:
            row = {"error": str(error)}
        rows.append({"group": group, "mesh": name, "by": smoother, "triangles": len(before.mesh.faces), **row})
    return rows


def summary(rows: Sequence[Row], names: Sequence[str]) -> str:
    """Return the figures by contestant, as a Markdown table."""
    header = [
        "", "meshes", "valid %", "crossing", "volume kept %", "volume % (worst)", "min q", "q>=.3 %", "min q fell",
        "mean q", "mean q rose %", "max mm", "us/triangle",
    ]  # fmt: skip
    lines = []
    for name in names:
        found = [row for row in rows if row["by"] == name]
        done = [row for row in found if "error" not in row]
        if not done:
            continue
        volumes = [100 * abs(row["volume"]) for row in done]

        def share(key: Callable[[Row], bool], rows: Sequence[Row] = done, of: int = len(found)) -> str:
            return f"{100 * sum(map(key, rows)) / of:.1f}"

        lines.append([
            name,
            str(len(found)),
            share(lambda row: row["sound"]),
            str(sum(row["crossing"] for row in done)),
            share(lambda row: abs(row["volume"]) <= VOLUME_TOLERANCE),
            f"{statistics.median(volumes):.3f} ({max(volumes):.2f})",
            f"{statistics.median(row['min_q'] for row in done):.3f}",
            share(lambda row: row["min_q"] >= 0.3),
            str(sum(row["min_falls"] for row in done)),
            f"{statistics.median(row['mean_q'] for row in done):.3f}",
            share(lambda row: row["mean_rises"]),
            f"{statistics.median(row['max_mm'] for row in done):.3f}",
            f"{1e6 * sum(row['cpu_s'] for row in done) / sum(row['triangles'] for row in done):.0f}",
        ])  # fmt: skip
    return table(header, lines)


def as_given(before: Candidate) -> Row:
    """Return the figures of an input, as a contestant that does nothing."""
    return {"by": "input", **judged(before, before.mesh), "triangles": len(before.mesh.faces), "cpu_s": 0.0}


def speed(iterations: int = 20) -> str:
    """Return vertex updates per second of each method of the kernel, in millions, on a grid of 250,000 vertices."""
    side = 500
    number = np.arange(side * side).reshape(side, side)
    a, b, c, d = (part.ravel() for part in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])]).astype(np.int32)
    x, y = np.meshgrid(np.linspace(0, 100, side), np.linspace(0, 100, side), indexing="ij")
    vertices = np.column_stack([x.ravel(), y.ravel(), 5 * np.sin(x.ravel() / 7) * np.cos(y.ravel() / 5)])
    lines = []
    for method in METHODS:
        seconds = []
        for _ in range(3):
            started = time.process_time()
            smooth_vertices(vertices, faces, method=method, iterations=iterations)
            seconds.append(time.process_time() - started)
        lines.append([method, f"{iterations * len(vertices) / min(seconds) / 1e6:.1f}"])
    return table(["method", "million updates/s"], lines)


def main() -> int:
    """Run what the command line asks for and print the tables."""
    parser = argparse.ArgumentParser(description="Smooth sound meshes by vhp smooth and by its peers.")
    parser.add_argument("--data", type=Path, default=models.REAL_DATA, help="directory of STL files")
    parser.add_argument("--groups", default=",".join(GROUPS), help="real: files; thin: nerves and vessels of a phantom")
    parser.add_argument("--every", type=int, default=8, help="take every N-th file (default: 8)")
    parser.add_argument("--most", type=int, default=20_000, help="leave out larger meshes (default: 20000 triangles)")
    parser.add_argument("--phantom", type=int, default=30_000, help="triangles of the phantom (default: 30000)")
    parser.add_argument(
        "--only", default="", metavar="TEXT", help="contestants whose names hold one of these, by comma"
    )
    parser.add_argument("--speed", action="store_true", help="only time the kernel")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all rows")
    arguments = parser.parse_args()
    if arguments.speed:
        print(speed())
        return 0
    wanted = [part for part in arguments.only.split(",") if part]
    names = [name for name in SMOOTHERS if not wanted or any(part in name for part in wanted)]
    missing = {name for name in names if importlib.util.find_spec(SMOOTHERS[name].module) is None}
    for name in sorted(missing):
        print(f"{name}: not installed", file=sys.stderr)
    names = [name for name in names if name not in missing]
    sources = {
        "real": sound_meshes(arguments.data, arguments.every, arguments.most),
        "thin": thin_meshes(arguments.phantom),
    }
    rows: list[Row] = []
    for group in arguments.groups.split(","):
        mine: list[Row] = []
        for name, before in sources[group]:
            if not rows and not mine:
                rows_of(group, name, before, names)  # loads the libraries
            mine += [as_given(before), *rows_of(group, name, before, names)]
        print(f"\n## {group}\n\n{summary(mine, ['input', *names])}")
        for row in mine:
            if "error" in row:
                print(f"- {row['mesh']}, {row['by']}: {row['error']}")
        rows += mine
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=1), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
