"""Decimate sound meshes by `vhp decimate` and by its peers: ``python benchmarks/decimate.py``.

All peers are asked for the number of triangles that vhp left, as numbers of triangles differ by a few. What comes out
is rounded to float32 and judged by the gate of vhp; distances are those of `vhp_cli.inspection.deviation`.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import statistics
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import models
import numpy as np

sys.path.insert(0, str(models.REPOSITORY))

from check import table

from vhp_cli.formats import read_mesh
from vhp_cli.inspection.deviation import deviation
from vhp_cli.kernels.decimating import decimate as collapse
from vhp_cli.mesh import Mesh
from vhp_cli.stages.decimate import decimate
from vhp_cli.stages.decimate.options import DecimateOptions
from vhp_cli.stages.heal.candidate import diagonal, judge

# Distances below this share of the diagonal are taken as equal to it: all of them are none.
NONE = 1e-4
Row = dict[str, Any]


def by_meshlab(mesh: Mesh, target: int) -> Mesh:
    """Return what pymeshlab's quadric collapse makes of a mesh."""
    import pymeshlab

    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(mesh.vertices, mesh.faces))
    meshes.meshing_decimation_quadric_edge_collapse(targetfacenum=target, preservetopology=True, qualitythr=0.5)
    made = meshes.current_mesh()
    return Mesh(made.vertex_matrix(), made.face_matrix())


def by_fast_simplification(mesh: Mesh, target: int) -> Mesh:
    """Return what fast-simplification makes of a mesh."""
    import fast_simplification

    reduction = 1 - target / len(mesh.faces)
    return Mesh(*fast_simplification.simplify(mesh.vertices.copy(), mesh.faces.copy(), target_reduction=reduction))


def by_meshlib(mesh: Mesh, target: int) -> Mesh:
    """Return what MeshLib's decimation makes of a mesh."""
    from meshlib import mrmeshnumpy, mrmeshpy

    made = mrmeshnumpy.meshFromFacesVerts(mesh.faces, mesh.vertices)
    settings = mrmeshpy.DecimateSettings()
    settings.maxDeletedFaces = len(mesh.faces) - target
    settings.maxError = 1e9
    settings.packMesh = True
    mrmeshpy.decimateMesh(made, settings)
    return Mesh(mrmeshnumpy.getNumpyVerts(made), mrmeshnumpy.getNumpyFaces(made.topology))


def by_collapses(mesh: Mesh, target: int) -> Mesh:
    """Return what the guarded collapses of vhp make of a mesh, without flips and moves afterwards."""
    made = collapse(mesh.vertices, mesh.faces, target_triangles=target, min_quality=0.2)
    return Mesh(made.vertices, made.faces)


PEERS: dict[str, tuple[str, Callable[[Mesh, int], Mesh]]] = {
    "vhp collapses only": ("vhp_cli", by_collapses),
    "pymeshlab quadric": ("pymeshlab", by_meshlab),
    "fast-simplification": ("fast_simplification", by_fast_simplification),
    "MeshLib": ("meshlib", by_meshlib),
}


def sound_meshes(directory: Path, every: int, most: int) -> Iterator[tuple[str, Mesh]]:
    """Yield every so-many-th STL file that is sound, rounded as it is read back."""
    files = sorted([*directory.glob("*.stl"), *directory.glob("*/*.stl")])
    for path in files[::every]:
        candidate = judge(read_mesh(path).mesh)
        if candidate.sound and 300 <= len(candidate.mesh.faces) <= most:
            yield path.relative_to(directory).as_posix(), candidate.mesh


def judged(mesh: Mesh, made: Mesh, seconds: float) -> Row:
    """Return the figures of one result."""
    after, before = judge(made), judge(mesh)
    far = deviation(mesh, after.mesh, lost_limit_mm=1.0)
    return {
        "sound": after.sound,
        "crossing": after.measures["self_intersections"]["pairs"] > 0,
        "triangles": len(after.mesh.faces),
        "min_q": after.min_quality,
        "mean_q": after.mean_quality,
        "max_mm": far["max"],
        "mean_mm": far["mean"],
        "volume": after.measures["volume_mm3"] / before.measures["volume_mm3"] - 1,
        "cpu_s": seconds,
    }


def rows_of(name: str, mesh: Mesh, ratio: float, peers: Sequence[str]) -> list[Row]:
    """Return the figures of vhp and of its peers for one mesh."""
    started = time.process_time()
    outcome = decimate(mesh, DecimateOptions(ratio=ratio))
    seconds = time.process_time() - started
    if outcome.mesh is None:
        return [{"mesh": name, "by": "vhp", "error": f"{outcome.status}: {outcome.reason}"}]
    rows = [{"by": "vhp", "reached": not outcome.reason, **judged(mesh, outcome.mesh, seconds)}]
    for peer in peers:
        started = time.process_time()
        try:
            made = PEERS[peer][1](mesh, len(outcome.mesh.faces))
        except Exception as error:
            rows.append({"by": peer, "error": str(error)})
            continue
        rows.append({"by": peer, **judged(mesh, made, time.process_time() - started)})
    floor = NONE * diagonal(mesh)
    foreign = [row for row in rows if not row["by"].startswith("vhp") and "error" not in row]
    for row in rows:
        row |= {"mesh": name, "triangles_in": len(mesh.faces)}
        for key, least in (("max_mm", floor), ("mean_mm", floor / 5)):
            if "error" not in row and foreign:
                best = min(max(other[key], least) for other in foreign)
                row[f"{key}_ratio"] = max(row[key], least) / best
    return rows


def summary(rows: Sequence[Row], names: Sequence[str]) -> str:
    """Return the figures by contestant, as a Markdown table."""
    header = [
        "", "meshes", "valid %", "crossing", "min q", "q>=.2 %", "mean q", "max / best peer", "90 %",
        "mean / best peer", "volume % (worst)", "us/triangle",
    ]  # fmt: skip
    lines = []
    for name in names:
        found = [row for row in rows if row["by"] == name]
        done = [row for row in found if "error" not in row]
        if not done:
            continue
        far = [row["max_mm_ratio"] for row in done if "max_mm_ratio" in row]
        mean = [row["mean_mm_ratio"] for row in done if "mean_mm_ratio" in row]
        volumes = [100 * abs(row["volume"]) for row in done]
        lines.append([
            name,
            str(len(found)),
            f"{100 * sum(row['sound'] for row in done) / len(found):.1f}",
            str(sum(row["crossing"] for row in done)),
            f"{statistics.median(row['min_q'] for row in done):.3f}",
            f"{100 * sum(row['min_q'] >= 0.2 for row in done) / len(found):.1f}",
            f"{statistics.median(row['mean_q'] for row in done):.2f}",
            f"{statistics.median(far):.2f}" if far else "-",
            f"{np.quantile(far, 0.9):.2f}" if far else "-",
            f"{statistics.median(mean):.2f}" if mean else "-",
            f"{statistics.median(volumes):.3f} ({max(volumes):.2f})",
            f"{1e6 * sum(row['cpu_s'] for row in done) / sum(row['triangles_in'] for row in done):.1f}",
        ])  # fmt: skip
    return table(header, lines)


def main() -> int:
    """Run what the command line asks for and print the table."""
    parser = argparse.ArgumentParser(description="Decimate sound meshes by vhp decimate and by its peers.")
    parser.add_argument("--data", type=Path, default=models.REAL_DATA, help="directory of STL files")
    parser.add_argument("--every", type=int, default=8, help="take every N-th mesh (default: 8)")
    parser.add_argument("--ratio", type=float, default=0.34, help="part of the triangles that is left (default: 0.34)")
    parser.add_argument("--most", type=int, default=50_000, help="leave out larger meshes (default: 50000 triangles)")
    parser.add_argument("--peers", default=",".join(PEERS), help="separated by commas")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all rows")
    arguments = parser.parse_args()
    wanted = [name for name in arguments.peers.split(",") if name]
    if unknown := {*wanted} - {*PEERS}:
        parser.error(f"no such peer: {', '.join(sorted(unknown))}; there are {', '.join(PEERS)}")
    peers = [name for name in wanted if importlib.util.find_spec(PEERS[name][0]) is not None]
    for name in set(wanted) - set(peers):
        print(f"{name}: not installed", file=sys.stderr)
    rows: list[Row] = []
    for name, mesh in sound_meshes(arguments.data, arguments.every, arguments.most):
        if not rows:
            rows_of(name, mesh, arguments.ratio, peers)  # loads the libraries
        rows += rows_of(name, mesh, arguments.ratio, peers)
    print(summary(rows, ["vhp", *peers]))
    refused = [row for row in rows if "error" in row]
    for row in refused:
        print(f"- {row['mesh']}, {row['by']}: {row['error']}")
    short = [row for row in rows if row.get("reached") is False]
    print(f"\n{len(short)} times the limits of vhp came before the number of triangles; peers were given its number.")
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=1), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
