"""Mutated and random files: a finding each, never an exception, never a hang, the exit code right."""

from __future__ import annotations

import json
import time

import numpy as np
import pytest
from click.testing import CliRunner
from shapes import sphere

from vhp_cli.commands.check import check
from vhp_cli.errors import UnreadableFileError
from vhp_cli.formats import parse_mesh, write_mesh
from vhp_cli.mesh import Mesh

SLOWEST_SECONDS = 20


def ascii_stl(mesh: Mesh) -> bytes:
    lines = ["solid tissue"]
    for triangle in mesh.vertices[mesh.faces]:
        corners = [f"      vertex {x:.9g} {y:.9g} {z:.9g}" for x, y, z in triangle]
        lines += ["  facet normal 0 0 0", "    outer loop", *corners, "    endloop", "  endfacet"]
    return "\n".join([*lines, "endsolid tissue", ""]).encode()


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """Return a damaged copy: flipped bits, a cut, a hole, a doubled or foreign stretch, or noise altogether."""
    kind, size = rng.integers(7), len(data)
    start = int(rng.integers(size))
    length = int(rng.integers(1, max(2, size // 8)))
    if kind == 0:
        damaged = bytearray(data)
        for _ in range(int(rng.integers(1, 20))):
            damaged[rng.integers(size)] ^= 1 << int(rng.integers(8))
        return bytes(damaged)
    if kind == 1:
        return data[:start]
    if kind == 2:
        return data[:start] + data[start + length :]
    if kind == 3:
        return data[:start] + data[start : start + length] * 2 + data[start + length :]
    if kind == 4:
        return data[:start] + rng.bytes(length) + data[start + length :]
    if kind == 5:
        words = [b"nan", b"-inf", b"1e999", b"facet", b"\x00\x00", b"\xff\xff\xff\xff", b"solid", b"\r", b"9" * 400]
        return data[:start] + words[rng.integers(len(words))] + data[start:]
    return rng.bytes(int(rng.integers(0, 3000)))


def surface(path, data: bytes) -> list[list[float]] | None:
    """Return the triangles in an order of their own, None if nothing can be read."""
    try:
        mesh = parse_mesh(path, data).mesh
    except UnreadableFileError:
        return None
    return sorted(mesh.vertices[mesh.faces].reshape(-1, 9).tolist())


def run_one(directory, seed: int) -> None:
    rng = np.random.default_rng(seed)
    mesh = sphere(20, subdivisions=1 + int(rng.integers(2)))
    suffix = (".stl", ".stl", ".ply", ".obj")[rng.integers(4)]
    path = directory / f"tissue{suffix}"
    write_mesh(path, mesh)
    data = ascii_stl(mesh) if suffix == ".stl" and rng.integers(2) else path.read_bytes()
    path.write_bytes(mutated(data, rng))
    write_mesh(directory / "sound.stl", sphere(10, (60, 0, 0)))

    started = time.monotonic()
    result = CliRunner().invoke(check, [str(directory), "--report", "-", "--no-cache", "-j1"])
    assert time.monotonic() - started < SLOWEST_SECONDS, seed
    assert result.exception is None or isinstance(result.exception, SystemExit), (seed, result.exception)
    report = json.loads(result.stdout)
    errors = [finding for finding in report["findings"] if finding["level"] == "error"]
    assert result.exit_code == (1 if errors else 0), seed
    by_name = {tissue["name"]: tissue for tissue in report["tissues"]}
    assert by_name["sound"]["outward"], seed
    # Damage that changes what an STL file holds leaves a trace: each facet stands alone there, so a vertex that
    # moved, a facet that is gone or came twice opens the surface. An indexed surface can change and stay sound.
    if suffix == ".stl" and surface(path, path.read_bytes()) != surface(path, data):
        assert report["findings"], seed


@pytest.mark.parametrize("seed", range(60))
def test_damaged_files(tmp_path, seed):
    run_one(tmp_path, seed)


@pytest.mark.slow
@pytest.mark.parametrize("hundred", range(10))
def test_a_thousand_damaged_files(tmp_path, hundred):
    for seed in range(1000 + 100 * hundred, 1100 + 100 * hundred):
        run_one(tmp_path, seed)
