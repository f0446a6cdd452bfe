"""Take tissues apart by `vhp separate` and by its peers: ``python benchmarks/clearance.py``.

Models are phantoms with planted overlaps, and directories of healed tissues. Everything that comes out is rounded to
float32, written, read back and judged by `vhp check`, whose contacts are exact; CPU time is that of the processes.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import resource
import shutil
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import models
import numpy as np

sys.path.insert(0, str(models.REPOSITORY))

from check import table

from vhp_cli.config import load_settings
from vhp_cli.formats import read_mesh, write_mesh
from vhp_cli.inspection.deviation import deviation
from vhp_cli.kernels.spatial import Tree, gap
from vhp_cli.mesh import Mesh
from vhp_cli.model import find_model
from vhp_cli.phantom import generate, plant_defects
from vhp_cli.pipeline.check import check_model
from vhp_cli.stages.clearance.stiffness import default_yielding
from vhp_cli.stages.heal.candidate import judge
from vhp_cli.tissues import guess_type

GAP = 1.0
LOW = 0.3
WORK = models.CACHE / "clearance"
# Planted: so many tissues are pushed so deep (mm) into others, of those no farther away than the reach.
PUSHED, DEPTHS, REACH = 14, (0.2, 2.2), 12.0
SMALL_CONTACTS = ("P001", "P002", "P003", "P005")
Row = dict[str, Any]
Meshes = dict[str, Mesh]


# ---------------------------------------------------------------------------------------------------- models


def overlapping_phantom(seed: int, triangles: int = 20_000, tissues: int = 60) -> Meshes:
    """Return a phantom in which soft tissues were pushed into neighbours, and some touch or come too near."""
    sound = generate(triangles, tissues)
    random = np.random.default_rng(seed)
    made = dict(sound)
    trees = {name: Tree(mesh.vertices, mesh.faces) for name, mesh in sound.items()}
    soft = [name for name in sound if guess_type(name) not in ("bone", "shell", "cartilage")]
    others = [name for name in sound if guess_type(name) != "shell"]
    pushed: set[str] = set()
    for name in random.permutation(soft):
        if len(pushed) == PUSHED:
            break
        near = []
        for other in others:
            if other == name or other in pushed:
                continue
            found = gap(trees[name], trees[other], REACH)
            if found is not None and not found.contact_kind:
                near.append((other, found))
        if near:
            other, found = near[random.integers(len(near))]
            start, end = (np.asarray(point) for point in found.points)
            depth = random.uniform(*DEPTHS)
            step = (end - start) * (1 + depth / max(found.distance, 1e-9))
            made[name] = Mesh((sound[name].vertices + step).astype(np.float32).astype(float), sound[name].faces)
            pushed.add(str(name))
    # Small contacts in what is left; a vertex that was pulled through its own surface is none.
    left = {name: mesh for name, mesh in made.items() if name not in pushed}
    spoilt, _ = plant_defects(left, seed, count=8, kinds=SMALL_CONTACTS)
    return made | {name: mesh for name, mesh in spoilt.items() if mesh is left.get(name) or judge(mesh).sound}


def written(meshes: Meshes, directory: Path) -> Path:
    """Write a model, unless it lies there."""
    if not directory.is_dir():
        fresh = directory.with_name(directory.name + ".new")
        shutil.rmtree(fresh, ignore_errors=True)
        fresh.mkdir(parents=True)
        for name, mesh in meshes.items():
            write_mesh(fresh / f"{name}.stl", mesh)
        fresh.rename(directory)
    return directory


# ---------------------------------------------------------------------------------------------------- peers


def by_priority(meshes: Meshes) -> list[str]:
    """Return the tissues, those that give way least first, as the peers go through them."""
    yielding = default_yielding()
    return sorted(meshes, key=lambda name: (yielding[guess_type(name)], len(meshes[name].faces), name))


def neighbours(meshes: Meshes, names: Sequence[str]) -> list[tuple[str, str]]:
    """Return the pairs (keeps, gives way) whose boxes overlap, in order of priority."""
    boxes = {name: (meshes[name].vertices.min(axis=0), meshes[name].vertices.max(axis=0)) for name in names}
    return [
        (first, second)
        for index, first in enumerate(names)
        for second in names[index + 1 :]
        if (boxes[first][0] <= boxes[second][1]).all() and (boxes[second][0] <= boxes[first][1]).all()
    ]


def contained(inner: Mesh, outer: Mesh) -> bool:
    """Tell whether most of a tissue lies in another one, from which it must not be cut."""
    return bool((Tree(outer.vertices, outer.faces).inside(inner.vertices) == 1).mean() > 0.6)


def by_manifold(meshes: Meshes) -> Meshes:
    """Subtract from each tissue what gives way less, by manifold3d."""
    import manifold3d

    def solid(mesh: Mesh) -> Any:
        vertices, faces = np.array(mesh.vertices, order="C"), np.array(mesh.faces, np.uint64, order="C")
        return manifold3d.Manifold(manifold3d.Mesh64(vert_properties=vertices, tri_verts=faces))

    solids, cut = {name: solid(mesh) for name, mesh in meshes.items()}, set()
    for first, second in neighbours(meshes, by_priority(meshes)):
        if not contained(meshes[first], meshes[second]) and not contained(meshes[second], meshes[first]):
            made = solids[second] - solids[first]
            if made.status() == manifold3d.Error.NoError and not made.is_empty():
                solids[second] = made
                cut.add(second)
    found = {name: solids[name].to_mesh64() for name in cut}
    return {
        name: Mesh(np.array(found[name].vert_properties)[:, :3], np.array(found[name].tri_verts, np.int32))
        if name in cut
        else mesh
        for name, mesh in meshes.items()
    }


def by_offset(meshes: Meshes) -> Meshes:
    """Move the vertices of all but bones inward along their normals, by the gap."""
    made = {}
    for name, mesh in meshes.items():
        corners = mesh.vertices[mesh.faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        sums = np.zeros_like(mesh.vertices)
        np.add.at(sums, mesh.faces.ravel(), np.repeat(normals, 3, axis=0))
        unit = sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-300)
        made[name] = mesh if guess_type(name) == "bone" else Mesh(mesh.vertices - GAP * unit, mesh.faces)
    return made


def by_meshlib(meshes: Meshes) -> Meshes:
    """Subtract from each tissue what gives way less, grown by the gap, by MeshLib."""
    from meshlib import mrmeshnumpy, mrmeshpy

    solids = {name: mrmeshnumpy.meshFromFacesVerts(mesh.faces, mesh.vertices) for name, mesh in meshes.items()}
    grown: dict[str, Any] = {}
    cut = set()
    settings = mrmeshpy.OffsetParameters()
    settings.voxelSize = GAP / 2
    for first, second in neighbours(meshes, by_priority(meshes)):
        if contained(meshes[first], meshes[second]) or contained(meshes[second], meshes[first]):
            continue
        if first not in grown:
            grown[first] = mrmeshpy.offsetMesh(solids[first], GAP, settings)
        made = mrmeshpy.boolean(solids[second], grown[first], mrmeshpy.BooleanOperation.DifferenceAB)
        if made.valid() and made.mesh.topology.numValidFaces():
            solids[second] = made.mesh
            cut.add(second)
    for name in cut:
        solids[name].pack()
    return {
        name: Mesh(mrmeshnumpy.getNumpyVerts(solids[name]), mrmeshnumpy.getNumpyFaces(solids[name].topology))
        if name in cut
        else mesh
        for name, mesh in meshes.items()
    }


PEERS: dict[str, tuple[str, Callable[[Meshes], Meshes]]] = {
    "subtraction (manifold3d)": ("manifold3d", by_manifold),
    "inward offset": ("numpy", by_offset),
    "offset and subtraction (MeshLib)": ("meshlib", by_meshlib),
}


# ---------------------------------------------------------------------------------------------------- judging


def judged(model: Path, out: Path) -> Row:
    """Return what `vhp check` says of a result, beside the model."""
    settings = load_settings(limits={"P005": GAP}, gap_search_mm=2 * GAP + 2)
    before, after = (check_model(find_model([path]), settings, paths=[path]).report for path in (model, out))
    old, new = ({tissue["name"]: tissue for tissue in report["tissues"]} for report in (before, after))
    pairs = [pair for pair in after["pairs"] if pair["min_gap_mm"] is not None]
    kinds = {name: tissue["tissue_type"] for name, tissue in old.items()}
    rigid = [pair for pair in pairs if kinds[pair["a"]] == kinds[pair["b"]] == "bone"]
    soft = [pair for pair in pairs if pair not in rigid]
    changes = [
        abs(abs(new[name]["volume_mm3"]) / abs(old[name]["volume_mm3"]) - 1) for name in old if old[name]["volume_mm3"]
    ]
    moved = [
        deviation(read_mesh(model / old[name]["file"]).mesh, read_mesh(out / new[name]["file"]).mesh, lost_limit_mm=1)
        for name in old
        if kinds[name] == "bone" and old[name]["sha256"] != new[name]["sha256"]
    ]
    return {
        "tissues": len(old),
        "triangles": before["summary"]["triangles"],
        "crossing_before": sum(pair["relation"] in ("crossing", "touching", "identical") for pair in before["pairs"]),
        "crossing": sum(pair["relation"] in ("crossing", "touching", "identical") for pair in after["pairs"]),
        "pairs": len(pairs),
        "wide": sum(pair["min_gap_mm"] >= GAP * (1 - 1e-4) for pair in pairs),
        "soft_pairs": len(soft),
        "soft_wide": sum(pair["min_gap_mm"] >= GAP * (1 - 1e-4) for pair in soft),
        "low": sum(pair["min_gap_mm"] < LOW * (1 - 1e-4) for pair in soft),
        "volume_median": statistics.median(changes),
        "volume_within": sum(change < 0.02 for change in changes) / len(changes),
        "volume_worst": max(changes),
        "bones": sum(kind == "bone" for kind in kinds.values()),
        "bones_moved": sum(far["max"] > 0.01 for far in moved),
        "worse": sum(_worse(old[name], new[name]) for name in old),
        "nesting_lost": sum(
            after["nesting"].get(name) != parent for name, parent in before["nesting"].items() if parent is not None
        ),
    }


def _worse(old: Any, new: Any) -> bool:
    """Tell whether a tissue breaks a rule on single tissues that it kept, or more often."""

    def counts(tissue: Any) -> dict[str, int]:
        found: dict[str, int] = {}
        for item in tissue["findings"]:
            if item["rule"][0] in "FTXQ":
                found[item["rule"]] = found.get(item["rule"], 0) + item["count"]
        return found

    before, after = counts(old), counts(new)
    return any(count > before.get(rule, 0) for rule, count in after.items())


def run(name: str, model: Path, out: Path, options: Sequence[str]) -> Row:
    """Run one contestant in a process of its own and judge what it wrote."""
    shutil.rmtree(out, ignore_errors=True)
    if name == "vhp separate":
        command = [
            sys.executable,
            "-m",
            "vhp_cli",
            "-q",
            "separate",
            str(model),
            "-o",
            str(out),
            "--no-cache",
            *options,
        ]
    else:
        command = [sys.executable, __file__, "--peer", name, str(model), str(out)]
    started, used = time.perf_counter(), _children()
    done = subprocess.run(command, capture_output=True, text=True, env=models.environment())
    seconds, cpu = time.perf_counter() - started, _children() - used
    if not out.is_dir() or len(models.stl_files(out)) != len(models.stl_files(model)):
        return {"by": name, "model": model.name, "error": done.stderr.strip()[-300:] or f"exit code {done.returncode}"}
    row = {"by": name, "model": model.name, "cpu_s": cpu, "wall_s": seconds, **judged(model, out)}
    report = out / "report.json"
    if report.is_file():
        row["unreached"] = len(json.loads(report.read_text())["clearance"]["unreached"])
    return row


def _children() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def summary(rows: Sequence[Row]) -> str:
    """Return the figures by model and contestant, as a Markdown table."""
    header = [
        "", "crossing pairs", ">= 1 mm %", "... of not two bones", "below 0.3 mm", "volume % median", "within 2 %",
        "worst %", "bones changed", "tissues worse", "nesting lost", "CPU s",
    ]  # fmt: skip
    lines = []
    for row in rows:
        label = f"{row['model']}: {row['by']}"
        if "error" in row:
            lines.append([label, row["error"].splitlines()[-1][:60], *["-"] * (len(header) - 2)])
            continue
        lines.append([
            label,
            f"{row['crossing_before']} -> {row['crossing']}",
            f"{100 * row['wide'] / max(row['pairs'], 1):.1f}",
            f"{100 * row['soft_wide'] / max(row['soft_pairs'], 1):.1f}",
            str(row["low"]),
            f"{100 * row['volume_median']:.2f}",
            f"{100 * row['volume_within']:.0f} %",
            f"{100 * row['volume_worst']:.1f}",
            f"{row['bones_moved']} of {row['bones']}",
            str(row["worse"]),
            str(row["nesting_lost"]),
            f"{row['cpu_s']:.0f}",
        ])  # fmt: skip
    return table(header, lines)


def main() -> int:
    """Run what the command line asks for and print the table."""
    parser = argparse.ArgumentParser(description="Take tissues apart by vhp separate and by its peers.")
    parser.add_argument("--models", type=Path, nargs="*", default=[], help="directories of healed STL files")
    parser.add_argument("--seeds", type=int, default=10, help="number of phantoms with planted overlaps (default: 10)")
    parser.add_argument("--first-seed", type=int, default=1, help="(default: 1)")
    parser.add_argument("--peers", default=",".join(PEERS), help="separated by commas")
    parser.add_argument("--options", default="", help="of vhp separate, in quotation marks")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all rows")
    parser.add_argument("--peer", nargs=3, metavar=("NAME", "MODEL", "OUT"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.peer:
        name, model, out = arguments.peer
        made = PEERS[name][1]({path.stem: read_mesh(path).mesh for path in sorted(Path(model).glob("*.stl"))})
        written(made, Path(out))
        return 0
    wanted = [name for name in arguments.peers.split(",") if name]
    if unknown := {*wanted} - {*PEERS}:
        parser.error(f"no such peer: {', '.join(sorted(unknown))}; there are {', '.join(PEERS)}")
    peers = [name for name in wanted if importlib.util.find_spec(PEERS[name][0]) is not None]
    for name in set(wanted) - set(peers):
        print(f"{name}: not installed", file=sys.stderr)
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    found = [path.resolve() for path in arguments.models]
    found += [written(overlapping_phantom(seed), WORK / f"phantom-{seed}") for seed in seeds]
    rows: list[Row] = []
    for model in found:
        for name in ("vhp separate", *peers):
            out = WORK / "out" / model.name / name.split()[0]
            out.parent.mkdir(parents=True, exist_ok=True)
            rows.append(run(name, model, out, arguments.options.split()))
            print(f"{model.name}: {name}: {rows[-1].get('error', rows[-1].get('cpu_s'))}", file=sys.stderr)
    print(summary(rows))
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=1), encoding="utf-8")
    return 0


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    sys.exit(main())
