"""Running ``vhp heal`` in tests, with stages that do little or go wrong in place of the real one."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

from click.testing import CliRunner
from shapes import flipped, moved, sphere

from vhp_cli.commands import heal as command
from vhp_cli.formats import write_mesh

JOURNAL = ".vhp-run.jsonl"


def run(*arguments) -> tuple[int, dict]:
    """Return exit code and JSON report; the report on stdout is the one in the output directory."""
    options = ["--report", "-", *([] if "-j" in arguments else ["-j1"])]
    result = CliRunner().invoke(command.heal, [*map(str, arguments), *options])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    report = json.loads(result.stdout)
    written = Path(arguments[arguments.index("-o") + 1]) / "report.json"
    assert json.loads(written.read_text()) == report
    return result.exit_code, report


def tissue(report: dict, name: str) -> dict:
    return next(record for record in report["tissues"] if record["name"] == name)


def meshes(directory: Path) -> dict[str, bytes]:
    return {
        path.relative_to(directory).as_posix(): path.read_bytes()
        for path in sorted(directory.rglob("*"))
        if path.is_file() and path.suffix in (".stl", ".ply", ".obj")
    }


def rules(findings) -> set[str]:
    return {finding["rule"] for finding in findings}


DRIVER = (
    "import sys, vhp_cli.commands.heal as command\n"
    "command.TARGET = 'stage_targets:slow'\n"
    "from vhp_cli.cli import main\nsys.exit(main(sys.argv[1:]))"
)


def started(model: Path, out: Path, *options: str) -> subprocess.Popen[bytes]:
    path = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    return subprocess.Popen(
        [sys.executable, "-c", DRIVER, "heal", str(model), "-o", str(out), "-j2", "--report", "-", *options],
        env={**os.environ, "PYTHONPATH": path},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )


def ended(process: subprocess.Popen[bytes]) -> tuple[int, bytes, bytes]:
    """Return exit code, output and messages."""
    with process:
        output, errors = process.communicate(timeout=60)
    return process.returncode, output, errors


def many(directory: Path, number: int = 20) -> Path:
    directory.mkdir()
    for index in range(number):
        ball = moved(sphere(10, subdivisions=2), (25.0 * index, 0, 0))
        write_mesh(directory / f"ball_{index}.stl", flipped(ball) if index % 2 else ball)
    return directory
