"""Let phantoms of rising size breathe by ``vhp breathe``: ``python benchmarks/breathe.py``."""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import models

sys.path.insert(0, str(models.REPOSITORY))

from check import table

Row = dict[str, Any]

TRIANGLES = (20_000, 40_000, 80_000, 160_000, 320_000)
TISSUES = 100
FRAMES = (3, 23, 45, 89)


def run(model: Path, out: Path, frames: int | None) -> Row:
    """Return time, memory and what the report says of one run in a process of its own."""
    command = [sys.executable, "-m", "vhp_cli", "--quiet", "breathe", str(model), "-o", str(out), "--no-cache"]
    if frames is not None:
        command += ["--frames", str(frames)]
    started = time.perf_counter()
    child = subprocess.Popen(command, cwd=models.REPOSITORY)
    _, status, usage = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    seconds = time.perf_counter() - started
    report = json.loads((out / "report.json").read_text())
    section, steps = report["breathe"], report["run"]["seconds"]
    return {
        "triangles": report["summary"]["triangles"],
        "tissues": report["summary"]["tissues"],
        "frames": len(section["frames"]),
        "exit": child.returncode,
        "total s": round(seconds, 1),
        "fit s": round(steps["fit"], 1),
        "proof s": round(steps["proof"], 1),
        "frames s": round(steps["frames"], 1),
        "cpu s": round(usage.ru_utime + usage.ru_stime, 1),
        "memory MB": round(usage.ru_maxrss / 1024),
        "pairs": section["proof"]["pairs"],
        "intervals": section["proof"]["intervals"],
        "unproven": len(section["proof"]["unproven"]),
        "least gap mm": round(min(frame["min_gap_mm"] or 99.0 for frame in section["frames"]), 3),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a table over triangles, and one over frames."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--triangles", type=int, nargs="+", default=TRIANGLES, help="sizes of the phantom")
    parser.add_argument("--tissues", type=int, default=TISSUES, help="tissues of the phantom")
    parser.add_argument("--frames", type=int, nargs="*", default=FRAMES, help="frames of the smallest phantom")
    parser.add_argument("--json", type=Path, help="write the rows to this file, too")
    chosen = parser.parse_args(arguments)
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        runs: list[tuple[int, int | None]] = [(triangles, None) for triangles in chosen.triangles]
        runs += [(min(chosen.triangles), frames) for frames in chosen.frames]
        for number, (triangles, frames) in enumerate(runs):
            model = Path(folder, f"phantom-{triangles}")
            if not model.exists():
                options = ["--triangles", str(triangles), "--tissues", str(chosen.tissues)]
                command = [sys.executable, "-m", "vhp_cli", "--quiet", "phantom", str(model), *options]
                subprocess.run(command, check=True, cwd=models.REPOSITORY)
            rows.append(run(model, Path(folder, f"out-{number}"), frames))
    for part in (rows[: len(chosen.triangles)], rows[len(chosen.triangles) :]):
        if part:
            print(table(list(part[0]), [[str(value) for value in row.values()] for row in part]))
            print()
    if chosen.json:
        chosen.json.write_text(json.dumps(rows, indent=2) + "\n")
    return 0 if all(row["exit"] == 0 for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
