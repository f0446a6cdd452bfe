"""Time `vhp check` beside its peers: ``python benchmarks/check.py``.

Every run is a fresh process, start-up and imports included. The contestants take turns, so that what else
the machine does hits all of them; ratios are taken within a round. Only the standard library is imported
here: the peak memory of this process is a floor under that of its children.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import importlib.util
import json
import math
import os
import platform
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import models
import peers

PEERS_SCRIPT = str(Path(peers.__file__).resolve())
MODELS_SCRIPT = str(Path(models.__file__).resolve())
VHP = (sys.executable, "-m", "vhp_cli")
STARTUP = {
    "python": (sys.executable, "-c", "pass"),
    "imports": (sys.executable, "-c", "import numpy, click"),
    "version": (*VHP, "--version"),
}
PHANTOM_TRIANGLES, PHANTOM_TISSUES = 700_000, 250
SCALE = (100_000, 300_000, 1_000_000, 3_000_000, 5_000_000)
HELP_RUNS = 10

# What the gate says of the model is a result like any other; only these exit codes are failures.
CHECKED = (0, 1)


@dataclass(frozen=True, slots=True)
class Run:
    """One process: CPU and wall seconds, peak memory in MB (2^20 bytes), exit code, what it printed."""

    cpu_s: float
    wall_s: float
    memory_mb: float
    code: int
    output: str
    errors: str


class RunFailed(Exception):
    """A process that was to be measured and failed."""


def measure(command: Sequence[str], *, accept: Sequence[int] = (0,), **variables: str) -> Run:
    """Run a command and return what it used, its own children included.

    Raises
    ------
    RunFailed
        If its exit code is not one of `accept`.
    """
    with tempfile.TemporaryFile() as output, tempfile.TemporaryFile() as errors:
        started = time.perf_counter()
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=output, stderr=errors, env={**models.environment(), **variables}
        )
        _, status, usage = os.wait4(process.pid, 0)
        wall = time.perf_counter() - started
        process.returncode = os.waitstatus_to_exitcode(status)
        output.seek(0)
        errors.seek(0)
        run = Run(
            cpu_s=usage.ru_utime + usage.ru_stime,
            wall_s=wall,
            memory_mb=usage.ru_maxrss / (2**20 if sys.platform == "darwin" else 2**10),
            code=process.returncode,
            output=output.read().decode(errors="replace"),
            errors=errors.read().decode(errors="replace"),
        )
    if run.code not in accept:
        raise RunFailed(f"{' '.join(command)}: exit code {run.code}: {run.errors.strip()[-500:]}")
    return run


def vhp_check(model: Path, report: Path, *options: str) -> tuple[str, ...]:
    """Return the command as a user types it."""
    return (*VHP, "-q", "check", str(model), "--report", str(report), *options)


def gate_limits() -> peers.Limits:
    """Return the limits of the gate, for the peers to apply too."""
    sys.path.insert(0, str(models.REPOSITORY))
    from vhp_cli.rules import RULES

    quality, edge, gap = (RULES[code].limit for code in ("Q001", "Q002", "P005"))
    if quality is None or edge is None or gap is None:
        raise RuntimeError("the rules Q001, Q002 and P005 have no limits")
    return peers.Limits(quality, edge, gap)


def installed(stack: str) -> bool:
    """Tell if every module of a stack is there."""
    return all(importlib.util.find_spec(module) is not None for module in peers.STACKS[stack].modules)


def compare(model: Path, stacks: Sequence[str], rounds: int, limits: peers.Limits, scratch: Path) -> dict[str, Any]:
    """Run vhp and its peers in turns on one model.

    Parameters
    ----------
    model
        Directory of STL files.
    stacks
        Names of installed peers.
    rounds
        Measured rounds; one more goes ahead, for the caches of the system and of Python.
    limits
        What counts as badly shaped or too near.
    scratch
        Where to put the report.

    Returns
    -------
    dict
        By contestant: `runs` (one a round) and `found`; or `error`.
    """
    report = scratch / "report.json"
    numbers = [repr(number) for number in asdict(limits).values()]
    commands: dict[str, tuple[str, ...]] = {"vhp": vhp_check(model, report, "--no-cache")}
    for stack in stacks:
        commands[stack] = (sys.executable, PEERS_SCRIPT, stack, str(model), "--limits", *numbers)
    results: dict[str, Any] = {name: {"runs": [], "found": None} for name in commands}
    for turn in range(rounds + 1):
        # Another one first in each round.
        order = [*commands][turn % len(commands) :] + [*commands][: turn % len(commands)]
        for name in order:
            if "error" in results[name]:
                continue
            try:
                run = measure(commands[name], accept=CHECKED if name == "vhp" else (0,))
                if turn == 0:
                    results[name]["found"] = _found(run, report if name == "vhp" else None, numbers)
                else:
                    results[name]["runs"].append(_used(run))
            except RunFailed as failure:
                results[name] = {"error": str(failure)}
    return results


def _found(run: Run, report: Path | None, limits: Sequence[str]) -> dict[str, int | None]:
    """Return what a run found; a report is read by another process, to keep this one small."""
    if report is not None:
        run = measure((sys.executable, PEERS_SCRIPT, "vhp", str(report), "--limits", *limits))
    # Libraries print their own lines first.
    found: dict[str, int | None] = json.loads(run.output.splitlines()[-1])
    return found


def _used(run: Run) -> dict[str, float]:
    return {"cpu_s": run.cpu_s, "wall_s": run.wall_s, "memory_mb": run.memory_mb}


def median(runs: Iterable[dict[str, float]], quantity: str) -> float:
    """Return the median of one quantity over the rounds."""
    return statistics.median(run[quantity] for run in runs)


def ratios(runs: Sequence[dict[str, float]], base: Sequence[dict[str, float]], quantity: str) -> list[float]:
    """Return the ratio of two contestants in each round, sorted."""
    return sorted(run[quantity] / other[quantity] for run, other in zip(runs, base, strict=True))


def spread(values: Sequence[float], digits: int = 2) -> str:
    """Return ``median (min-max)``."""
    middle, low, high = (f"{value:.{digits}f}" for value in (statistics.median(values), min(values), max(values)))
    return f"{middle} ({low}-{high})"


def exponent(sizes: Sequence[float], amounts: Sequence[float]) -> float:
    """Return the slope of a straight line through the logarithms: 1 is linear growth (least squares)."""
    x, y = [math.log(size) for size in sizes], [math.log(amount) for amount in amounts]
    return statistics.linear_regression(x, y).slope


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table, numbers to the right."""
    lines = [list(header), *(list(row) for row in rows)]
    widths = [max(3, *(len(line[column]) for line in lines)) for column in range(len(header))]

    def row(cells: Sequence[str]) -> str:
        others = [cell.rjust(width) for cell, width in zip(cells[1:], widths[1:], strict=True)]
        return "| " + " | ".join([cells[0].ljust(widths[0]), *others]) + " |"

    rule = "-" * (widths[0] + 2) + "|" + "".join("-" * (width + 1) + ":|" for width in widths[1:])
    return "\n".join([row(lines[0]), f"|{rule}", *(row(line) for line in lines[1:])])


def comparison_tables(results: dict[str, Any]) -> str:
    """Return time and memory of every contestant, and what each found, as two tables."""
    done = {name: result for name, result in results.items() if "error" not in result}
    base = done["vhp"]["runs"] if "vhp" in done else []
    rows = []
    for name, result in done.items():
        row = [name]
        for quantity, digits in (("cpu_s", 2), ("wall_s", 2), ("memory_mb", 0)):
            row.append(f"{median(result['runs'], quantity):.{digits}f}")
            row.append(spread(ratios(result["runs"], base, quantity)) if base else "-")
        rows.append(row)
    text = table(["", "CPU s", "/ vhp", "wall s", "/ vhp", "peak MB", "/ vhp"], rows)
    found = {name: result["found"] for name, result in done.items()}
    if found:
        counts = [
            [
                question.replace("_", " "),
                *("-" if found[name][question] is None else str(found[name][question]) for name in found),
            ]
            for question in next(iter(found.values()))
        ]
        text += "\n\n" + table(["found", *found], counts)
    errors = [f"{name} failed: {result['error']}" for name, result in results.items() if "error" in result]
    return "\n\n".join([text, *errors])


def scale(rounds: int, scratch: Path) -> dict[str, Any]:
    """Check phantoms of growing size."""
    sizes = []
    for triangles in SCALE:
        model = models.phantom(triangles)
        command = vhp_check(model, scratch / "report.json", "--no-cache")
        runs = [_used(measure(command, accept=CHECKED)) for _ in range(rounds)]
        sizes.append({"model": model.name, "triangles": models.triangle_count(model), "runs": runs})
    startup = [_used(measure(STARTUP["imports"])) for _ in range(HELP_RUNS)]
    return {"sizes": sizes, "startup": startup}


def scale_table(result: dict[str, Any]) -> str:
    """Return time and memory by size: in all, for each triangle, and how they grow from one size to the next."""
    quantities = ("cpu_s", "wall_s", "memory_mb")
    sizes = result["sizes"]
    used = [{quantity: median(size["runs"], quantity) for quantity in quantities} for size in sizes]
    triangles = [size["triangles"] for size in sizes]
    rows = []
    for index, (size, amounts) in enumerate(zip(sizes, used, strict=True)):
        row = [size["model"], f"{size['triangles']:,}"]
        for quantity, digits, scale_to, unit_digits in (
            ("cpu_s", 2, 1e6, 2),
            ("wall_s", 2, 1e6, 2),
            ("memory_mb", 0, 2**20, 0),
        ):
            row.append(f"{amounts[quantity]:.{digits}f}")
            row.append(f"{amounts[quantity] * scale_to / size['triangles']:.{unit_digits}f}")
            if index:
                ends = slice(index - 1, index + 1)
                row.append(f"{exponent(triangles[ends], [amount[quantity] for amount in used[ends]]):.2f}")
            else:
                row.append("")
        rows.append(row)
    header = [
        "model",
        "triangles",
        "CPU s",
        "us/tri",
        "power",
        "wall s",
        "us/tri",
        "power",
        "peak MB",
        "B/tri",
        "power",
    ]
    fixed = {quantity: median(result["startup"], quantity) for quantity in quantities}
    lines = [table(header, rows), ""]
    for quantity, label in zip(quantities, ("CPU", "wall", "memory"), strict=True):
        net = [amount[quantity] - fixed[quantity] for amount in used]
        line = f"- {label} over all sizes: power {exponent(triangles, [amount[quantity] for amount in used]):.2f}"
        if min(net) > 0:
            line += f", less the start of Python and its imports {exponent(triangles, net):.2f}"
        lines.append(line)
    return "\n".join(lines)


def warm(model: Path, rounds: int, scratch: Path) -> dict[str, list[dict[str, float]]]:
    """Check a model without a cache, again unchanged, and again after one tissue has changed.

    The tissue of median size and the largest are moved by 0.01 mm, to and fro.
    """
    copy, cache, report = scratch / "model", scratch / "cache", scratch / "report.json"
    models.link(model, copy)
    files = models.stl_files(model)
    changed = {"small changed": files[len(files) // 2], "largest changed": files[0]}
    steps = ("cold", "unchanged", *changed)
    result: dict[str, list[dict[str, float]]] = {step: [] for step in (*steps, *STARTUP)}
    command = vhp_check(copy, report)
    for turn in range(rounds + 1):
        shutil.rmtree(cache, ignore_errors=True)
        for step in steps:
            if step in changed:
                offset = ["0.01", "0", "0"] if turn % 2 else ["-0.01", "0", "0"]
                source = changed[step]
                measure((sys.executable, MODELS_SCRIPT, "moved", str(source), str(copy / source.name), *offset))
            run = measure(command, accept=CHECKED, VHP_CACHE_DIR=str(cache))
            if turn:
                result[step].append(_used(run))
        for name, start in STARTUP.items():
            if turn:
                result[name].append(_used(measure(start)))
    shutil.rmtree(copy)
    return result


def warm_table(result: dict[str, list[dict[str, float]]]) -> str:
    """Return each step as share of the cold run, with and without the start of Python and its imports."""
    rows = []
    for step in ("cold", "unchanged", "small changed", "largest changed", *STARTUP):
        row = [step]
        for quantity in ("cpu_s", "wall_s"):
            row.append(f"{median(result[step], quantity):.3f}")
            row.append(spread([100 * ratio for ratio in ratios(result[step], result["cold"], quantity)], 1))
            if step in STARTUP:
                row.append("")
                continue
            net = [
                100 * (run[quantity] - start[quantity]) / (cold[quantity] - start[quantity])
                for run, cold, start in zip(result[step], result["cold"], result["imports"], strict=True)
            ]
            row.append(spread(net, 1))
        rows.append(row)
    header = ["", "CPU s", "% of cold", "less start-up", "wall s", "% of cold", "less start-up"]
    return table(header, rows)


def help_time() -> dict[str, list[dict[str, float]]]:
    """Run ``vhp --help``, in turns with an interpreter that does nothing."""
    result: dict[str, list[dict[str, float]]] = {"python": [], "help": []}
    measure((*VHP, "--help"))
    for _ in range(HELP_RUNS):
        result["python"].append(_used(measure(STARTUP["python"])))
        result["help"].append(_used(measure((*VHP, "--help"))))
    return result


def host_facts(stacks: Iterable[str]) -> dict[str, Any]:
    """Return what the figures depend on: machine, load, versions."""
    packages = {package for stack in stacks for package in peers.STACKS[stack].packages}
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return {
        "platform": platform.platform(),
        "machine": platform.machine(),
        "cores": cores,
        "load": [round(value, 2) for value in os.getloadavg()],
        "python": platform.python_version(),
        "versions": {package: importlib.metadata.version(package) for package in sorted({*packages, "numpy"})},
    }


def main() -> int:
    """Run what the command line asks for and print the tables."""
    parser = argparse.ArgumentParser(description="Time vhp check beside its peers.")
    parser.add_argument(
        "--models", default="phantom,real", help="phantom, real or directories of STL files; '' for none"
    )
    parser.add_argument("--rounds", type=int, default=5, help="measured rounds (default: 5)")
    parser.add_argument("--peers", default=",".join(peers.STACKS), help="stacks, separated by commas; '' for none")
    parser.add_argument("--triangles", type=int, default=PHANTOM_TRIANGLES, help="of the phantom")
    parser.add_argument("--tissues", type=int, default=PHANTOM_TISSUES, help="of the phantom; 0: all it has")
    parser.add_argument("--scale", action="store_true", help="also: growth with the size of the model")
    parser.add_argument("--warm", action="store_true", help="also: checks again with the cache")
    parser.add_argument("--help-time", action="store_true", help="also: the time of vhp --help")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write every single figure")
    arguments = parser.parse_args()
    if arguments.rounds < 1:
        parser.error("--rounds must be at least 1")
    wanted = [name for name in arguments.peers.split(",") if name]
    if unknown := set(wanted) - set(peers.STACKS):
        parser.error(f"no such peer: {', '.join(sorted(unknown))}; there are {', '.join(peers.STACKS)}")
    stacks = [name for name in wanted if installed(name)]
    facts = host_facts(stacks)
    document: dict[str, Any] = {"host": facts, "models": {}, "warm": {}}
    versions = ", ".join(f"{name} {version}" for name, version in facts["versions"].items())
    print(f"{facts['platform']}, {facts['cores']} cores, load {facts['load'][0]}, Python {facts['python']}, {versions}")
    for name in wanted:
        if name not in stacks:
            print(f"{name}: not installed (pip install {' '.join(peers.STACKS[name].packages)})")
    failed = False
    with tempfile.TemporaryDirectory(prefix="vhp-bench-") as directory:
        scratch = Path(directory)
        for name in filter(None, arguments.models.split(",")):
            try:
                model = _model(name, arguments.triangles, arguments.tissues or None)
            except models.ModelMissing as missing:
                print(f"\n## {name}\n\nskipped: {missing}")
                continue
            size = f"{len(models.stl_files(model))} tissues, {models.triangle_count(model):,} triangles"
            print(f"\n## {name}: {size}\n", flush=True)
            results = compare(model, stacks, arguments.rounds, gate_limits(), scratch)
            document["models"][name] = results
            failed |= any("error" in result for result in results.values())
            print(comparison_tables(results), flush=True)
            if arguments.warm:
                document["warm"][name] = warm(model, arguments.rounds, scratch)
                print(f"\n### {name}: checked again\n\n{warm_table(document['warm'][name])}", flush=True)
        if arguments.scale:
            document["scale"] = scale(arguments.rounds, scratch)
            print(f"\n## Growth\n\n{scale_table(document['scale'])}", flush=True)
        if arguments.help_time:
            document["help"] = help_time()
            shown = {key: spread([run["cpu_s"] for run in runs], 3) for key, runs in document["help"].items()}
            print(f"\n## Start-up\n\n`vhp --help`: {shown['help']} CPU s; an empty Python: {shown['python']} CPU s")
    if arguments.json:
        arguments.json.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    return 1 if failed else 0


def _model(name: str, triangles: int, tissues: int | None) -> Path:
    if name == "phantom":
        return models.phantom(triangles, tissues)
    if name == "real":
        return models.real()
    directory = Path(name)
    if not directory.is_dir() or not models.stl_files(directory):
        raise models.ModelMissing(f"no STL files in {directory}")
    return directory.resolve()


if __name__ == "__main__":
    sys.exit(main())
