"""Repair defective meshes by `vhp heal` and by its peers: ``python benchmarks/heal.py``.

Every call runs in a child process under a time limit, on one core, with its libraries already loaded. What comes
out is rounded to float32 and judged twice: by the gate of vhp and by other libraries (see `referee`).
"""

from __future__ import annotations

import argparse
import importlib.metadata
import importlib.util
import json
import os
import platform
import statistics
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import models

sys.path.insert(0, str(models.REPOSITORY))

import repairers
from check import table

from vhp_cli.processes import CallFailed, Child

GROUPS = ("made", "real")
EVERY = 4  # of the real meshes, unless all are asked for
REFEREE_TIMEOUT_S = 300.0
Row = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Task:
    """One mesh to be repaired.

    Parameters
    ----------
    group, name
        Which it is.
    load
        Returns vertices and faces, and those of the clean shape or None.
    """

    group: str
    name: str
    load: Callable[[], tuple[repairers.Arrays, repairers.Arrays | None]]


class Contestant:
    """One repairer in a child process of its own, which is kept from mesh to mesh."""

    def __init__(self, name: str, memory_gb: float, core: int) -> None:
        self._name, self._core = name, core
        self._child = Child(memory_gb=memory_gb, name=name)

    def close(self) -> None:
        """End the child process."""
        self._child.close()

    def run(self, mesh: repairers.Arrays, timeout_s: float) -> tuple[Row, repairers.Arrays | None]:
        """Repair one mesh; what failed has an `error` and no mesh."""
        try:
            if self._child.pid is None:
                self._child.call("repairers:one_core", self._core, timeout_s=REFEREE_TIMEOUT_S)
                self._child.call("repairers:warm_up", self._name, timeout_s=REFEREE_TIMEOUT_S)
            made, wall, cpu = self._child.call("repairers:timed", self._name, *mesh, timeout_s=timeout_s)
        except CallFailed as failed:
            return {"error": failed.reason, "reason": failed.detail}, None
        row = {"status": made["status"], "reason": made["reason"], "wall_s": wall, "cpu_s": cpu}
        return row, (made["vertices"], made["faces"])


class Bench:
    """All contestants and the referee, for one thread."""

    def __init__(self, names: Sequence[str], memory_gb: float, core: int) -> None:
        self._contestants = {name: Contestant(name, memory_gb, core) for name in names}
        self._referee = Child(name="the referee")

    def close(self) -> None:
        """End all child processes."""
        for contestant in self._contestants.values():
            contestant.close()
        self._referee.close()

    def rows(self, task: Task, turn: int, timeout_s: float) -> Iterator[Row]:
        """Yield what every contestant made of one mesh; another one goes first in each turn."""
        loaded, clean = task.load()
        mesh = self._referee.call("referee:written", *loaded, timeout_s=REFEREE_TIMEOUT_S)
        names = [*self._contestants]
        for name in names[turn % len(names) :] + names[: turn % len(names)]:
            row, made = self._contestants[name].run(mesh, timeout_s)
            if made is not None:
                try:
                    row |= self._referee.call("referee:judged", mesh, made, clean, timeout_s=REFEREE_TIMEOUT_S)
                except CallFailed as failed:
                    row |= {"error": f"referee: {failed.reason}", "reason": failed.detail}
            yield {"group": task.group, "mesh": task.name, "repairer": name, "triangles_in": len(mesh[1]), **row}


def made_tasks() -> list[Task]:
    """Return the made defects."""
    import damage

    def task(name: str) -> Task:
        def load() -> tuple[repairers.Arrays, repairers.Arrays | None]:
            made = damage.case(name)
            clean = None if made.clean is None else (made.clean.vertices, made.clean.faces)
            return (made.damaged.vertices, made.damaged.faces), clean

        return Task("made", name, load)

    return [task(name) for name in damage.CASES]


def real_tasks(directory: Path, every: int) -> list[Task]:
    """Return every so-many-th STL file of a directory and of the directories in it."""
    from vhp_cli.formats import read_mesh

    def task(path: Path) -> Task:
        def load() -> tuple[repairers.Arrays, None]:
            mesh = read_mesh(path).mesh
            return (mesh.vertices, mesh.faces), None

        return Task("real", path.relative_to(directory).as_posix(), load)

    files = sorted([*directory.glob("*.stl"), *directory.glob("*/*.stl")])
    return [task(path) for path in files[::every]]


def run(tasks: Sequence[Task], names: Sequence[str], arguments: argparse.Namespace) -> Iterator[list[Row]]:
    """Yield the rows of each mesh."""
    local = threading.local()
    benches: list[Bench] = []
    lock = threading.Lock()

    def repaired(turn: int) -> list[Row]:
        if not hasattr(local, "bench"):
            with lock:
                local.bench = Bench(names, arguments.memory, len(benches))
                benches.append(local.bench)
        task = tasks[turn]
        try:
            return list(local.bench.rows(task, turn, arguments.timeout))
        except Exception as error:
            # One unreadable file must not end the run.
            return [
                {"group": task.group, "mesh": task.name, "repairer": name, "error": "input", "reason": str(error)}
                for name in names
            ]

    try:
        with ThreadPoolExecutor(arguments.jobs) as executor:
            yield from executor.map(repaired, range(len(tasks)))
    finally:
        for bench in benches:
            bench.close()


def is_valid(row: Row) -> bool:
    """Tell if an output is a sound solid by all judges."""
    return bool(row.get("sound") and row.get("independent"))


def summary_table(rows: Sequence[Row], names: Sequence[str]) -> str:
    """Return success, quality, distance and time of every contestant."""
    header = [
        "", "valid %", "min q", "q>=.2 %", "mean q>=.85 %", "edge>=.01 %", "in->out mm", ">limit", "lost", "outside",
        "volume %", "worse", "tri out/in", "CPU s", "CPU max", "wall max", "tri/s",
    ]  # fmt: skip
    return table(header, [[name, *_summary([row for row in rows if row["repairer"] == name])] for name in names])


def _summary(rows: Sequence[Row]) -> list[str]:
    valid = [row for row in rows if is_valid(row)]
    timed = [row for row in rows if "cpu_s" in row]

    def share(holds: Callable[[Row], bool]) -> str:
        return f"{100 * sum(map(holds, valid)) / len(rows):.1f}"

    def count(holds: Callable[[Row], bool]) -> str:
        return str(sum(map(holds, valid)))

    volumes = [100 * abs(row["volume_change"]) for row in valid if row["volume_change"] is not None]
    return [
        share(lambda row: True),
        _middle((row["min_quality"] for row in valid), 3),
        share(lambda row: row["min_quality"] >= 0.2),
        share(lambda row: row["mean_quality"] >= 0.85),
        share(lambda row: row["min_edge_mm"] >= 0.01),
        _middle((row["to_output_mm"] for row in valid), 3),
        count(lambda row: row["to_output_mm"] > row["limit_mm"]),
        count(lambda row: row["to_output_mm"] > row["lost_limit_mm"]),
        count(lambda row: row["outside_mm"] > row["lost_limit_mm"]),
        f"{statistics.median(volumes):.3f} ({max(volumes):.3f})" if volumes else "-",
        str(sum(bool(row.get("new_flaws")) for row in rows)),
        _middle((row["triangles"] / row["triangles_in"] for row in valid), 2),
        _middle((row["cpu_s"] for row in timed), 2),
        f"{max((row['cpu_s'] for row in timed), default=0.0):.1f}",
        f"{max((row['wall_s'] for row in timed), default=0.0):.1f}" + ("+" if _timeouts(rows) else ""),
        _middle((row["triangles"] / max(row["cpu_s"], 1e-3) for row in valid), 0),
    ]


def _timeouts(rows: Iterable[Row]) -> int:
    return sum(row.get("error") == "timeout" for row in rows)


def _middle(values: Iterable[float], digits: int) -> str:
    found = list(values)
    return f"{statistics.median(found):.{digits}f}" if found else "-"


def truth_table(rows: Sequence[Row], names: Sequence[str]) -> str:
    """Return how near the outputs lie to the truth, where it is known."""
    lines = []
    for name in names:
        known = [row for row in rows if row["repairer"] == name and row.get("truth") and is_valid(row)]
        truths = [row["truth"] for row in known]
        lines.append([
            name,
            str(len(known)),
            str(sum(row["truth"]["output_mm"] <= row["truth"]["input_mm"] + row["limit_mm"] for row in known)),
            _middle((truth["output_mm"] for truth in truths), 3),
            f"{max((truth['output_mm'] for truth in truths), default=0.0):.2f}",
            str(sum(abs(truth["volume_error"]) <= 0.01 for truth in truths)),
            _middle((100 * abs(truth["volume_error"]) for truth in truths), 3),
        ])  # fmt: skip
    header = ["", "valid", "not farther", "from truth mm", "max", "volume within 1 %", "volume % off"]
    return table(header, lines)


def failure_table(rows: Sequence[Row], names: Sequence[str]) -> str:
    """Return why outputs are not valid, by contestant."""
    kinds = ("refused", "timeout", "memory", "crash", "error", "gate", "others only")
    lines = []
    for name in names:
        failed = [row for row in rows if row["repairer"] == name and not is_valid(row)]
        counts = dict.fromkeys(kinds, 0)
        for row in failed:
            counts[_failure(row)] += 1
        lines.append([name, str(len(failed)), *(str(counts[kind]) for kind in kinds)])
    return table(["", "not valid", *kinds], lines)


def _failure(row: Row) -> str:
    if "error" in row:
        return row["error"] if row["error"] in ("timeout", "memory", "crash") else "error"
    if row["status"] in ("refused", "failed"):
        return "refused"
    return "others only" if row["sound"] else "gate"


def remarks(rows: Sequence[Row], name: str) -> Iterator[str]:
    """Yield a line for each mesh that a contestant could not repair, or lost material of."""
    for row in rows:
        if row["repairer"] != name:
            continue
        if not is_valid(row):
            why = row.get("reason") or ", ".join(row.get("flaws", []))
            yield f"- {row['mesh']}: not valid: {row.get('error') or row['status']}: {why}"
        elif row["outside_mm"] > row["lost_limit_mm"]:
            place = ", ".join(f"{value:.1f}" for value in row["outside_at_mm"])
            yield f"- {row['mesh']}: material lost: {row['outside_mm']:.2f} mm away at ({place})"
        elif row["min_quality"] < 0.2 and name == "vhp":
            yield f"- {row['mesh']}: min q {row['min_quality']:.3g}"


def report(rows: Sequence[Row], names: Sequence[str], *, verbose: bool) -> str:
    """Return all tables of the rows, as Markdown."""
    parts = []
    for group in GROUPS:
        found = [row for row in rows if row["group"] == group]
        if not found:
            continue
        parts += [
            f"## {group}: {len({row['mesh'] for row in found})} meshes",
            summary_table(found, names),
            failure_table(found, names),
        ]
        if any(row.get("truth") for row in found):
            parts.append(truth_table(found, names))
        for name in names if verbose else ():
            lines = list(remarks(found, name))
            if lines:
                parts += [f"### {name}", "\n".join(lines)]
    return "\n\n".join(parts)


def host_facts(names: Iterable[str]) -> dict[str, Any]:
    """Return what the figures depend on."""
    versions = {}
    for package in sorted({package for name in names for package in repairers.REPAIRERS[name].packages}):
        try:
            versions[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            versions[package] = "this checkout"
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return {"platform": platform.platform(), "cores": cores, "python": platform.python_version(), "versions": versions}


def installed(name: str) -> bool:
    """Tell if every module of a repairer is there."""
    return all(importlib.util.find_spec(module) is not None for module in repairers.REPAIRERS[name].modules)


def main() -> int:
    """Run what the command line asks for and print the tables."""
    parser = argparse.ArgumentParser(description="Repair defective meshes by vhp heal and by its peers.")
    parser.add_argument("--groups", default=",".join(GROUPS), help="made, real (default: both)")
    parser.add_argument("--data", type=Path, default=models.REAL_DATA, help="directory of STL files for `real`")
    parser.add_argument("--every", type=int, default=EVERY, help=f"take every N-th real mesh (default: {EVERY})")
    parser.add_argument("--all", action="store_const", const=1, dest="every", help="take all real meshes")
    parser.add_argument("--limit", type=int, help="at most so many meshes of each group")
    parser.add_argument("--only", default="", help="meshes whose names contain this")
    parser.add_argument("--peers", default=",".join(repairers.REPAIRERS), help="repairers, separated by commas")
    parser.add_argument("--jobs", type=int, default=1, help="meshes at a time (default: 1)")
    parser.add_argument("--timeout", type=float, default=60.0, metavar="S", help="of each call (default: 60)")
    parser.add_argument("--memory", type=float, default=6.0, metavar="GB", help="of each call (default: 6)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all rows")
    parser.add_argument("--from-json", type=Path, metavar="FILE", help="print the tables of an earlier run")
    parser.add_argument("--verbose", action="store_true", help="name the meshes that were not repaired")
    arguments = parser.parse_args()
    names = [name for name in arguments.peers.split(",") if name]
    groups = [group for group in arguments.groups.split(",") if group]
    if unknown := {*names} - {*repairers.REPAIRERS}:
        parser.error(f"no such repairer: {', '.join(sorted(unknown))}; there are {', '.join(repairers.REPAIRERS)}")
    if unknown := {*groups} - {*GROUPS}:
        parser.error(f"no such group: {', '.join(sorted(unknown))}; there are {', '.join(GROUPS)}")
    if min(arguments.every, arguments.jobs) < 1:
        parser.error("--every and --jobs must be at least 1")
    if arguments.from_json:
        document = json.loads(arguments.from_json.read_bytes())
        present = [name for name in names if any(row["repairer"] == name for row in document["rows"])]
        print(report(document["rows"], present, verbose=arguments.verbose))
        return 0
    for name in names:
        if not installed(name):
            print(f"{name}: not installed (pip install {' '.join(repairers.REPAIRERS[name].packages)})")
    names = [name for name in names if installed(name)]
    tasks = []
    for group in groups:
        found = made_tasks() if group == "made" else real_tasks(arguments.data, arguments.every)
        if not found:
            print(f"{group}: skipped, no STL files in {arguments.data}")
        tasks += [task for task in found if arguments.only in task.name][: arguments.limit]
    facts = host_facts(names)
    versions = ", ".join(f"{package} {version}" for package, version in facts["versions"].items())
    print(f"{facts['platform']}, {facts['cores']} cores, Python {facts['python']}, {versions}\n")
    document = {"host": facts, "timeout_s": arguments.timeout, "rows": []}
    for number, rows in enumerate(run(tasks, names, arguments), 1):
        document["rows"] += rows
        print(f"{number}/{len(tasks)} {rows[0]['mesh']}", file=sys.stderr, flush=True)
        if arguments.json:
            # After each mesh: a long run may be stopped.
            arguments.json.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    print(report(document["rows"], names, verbose=arguments.verbose))
    # What the peers can't repair is a result; what vhp can't even answer is a failure.
    return int(any("error" in row for row in document["rows"] if row["repairer"].startswith("vhp")))


if __name__ == "__main__":
    sys.exit(main())
