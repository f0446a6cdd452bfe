"""Models for ``vhp heal``, and what stands in for its stage."""

from __future__ import annotations

from pathlib import Path

import pytest
from shapes import box, flipped, sphere

from vhp_cli.commands import heal as command
from vhp_cli.formats import write_mesh


@pytest.fixture(autouse=True)
def _own_cache(tmp_path_factory, monkeypatch):
    monkeypatch.setenv("VHP_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))


@pytest.fixture
def stage(monkeypatch):
    """Choose what stands in for the stage."""

    def choose(name: str) -> None:
        monkeypatch.setattr(command, "TARGET", f"stage_targets:{name}")

    choose("turn_over")
    return choose


@pytest.fixture
def model(tmp_path) -> Path:
    directory = tmp_path / "model"
    directory.mkdir()
    write_mesh(directory / "skin.stl", sphere(60, subdivisions=3))
    write_mesh(directory / "liver.stl", flipped(sphere(15, (20, 0, 0), subdivisions=3)))
    write_mesh(directory / "nerve.stl", box((-12, -3, -3), (-6, 3, 3)))
    return directory


@pytest.fixture
def out(tmp_path) -> Path:
    return tmp_path / "out"
